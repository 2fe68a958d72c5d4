"""Statistics of outputs that white noise moves: what the noise adds to their variance at an instant."""

from typing import Any, TypeVar

import jax
import jax.numpy as jnp

from aleator._core.arrays import jax_array
from aleator._core.errors import ProblemError
from aleator.design._expression import Expression
from aleator.design._functionals import Path, Terminal
from aleator.design._response import AbstractProblem
from aleator.design._statistic import AbstractFunctional, Extreme, Statistic, functionals_of, statistics_in
from aleator.dynamics import System, initial_state, named
from aleator.feedback import VARIANCE, Noisy
from aleator.statistics import Mean, Std, Variance
from aleator.uncertainty import at_means, realise

Tree = TypeVar("Tree")


def with_noise(tree: Tree) -> Tree:
    """Expressions and constraints in which standard deviations and variances have the part that noise causes.

    Raises `ProblemError` for statistics that would leave it out.
    """

    def is_atom(node: Any) -> bool:
        return isinstance(node, Statistic | Extreme)

    return jax.tree.map(lambda node: _told(node) if is_atom(node) else node, tree, is_leaf=is_atom)


def _told(atom: Any) -> Any:
    kind, (functional, *others) = getattr(atom, "kind", None), atom.functionals
    if isinstance(kind, Mean) or any(name.endswith(VARIANCE) for one in atom.functionals for name in one.outputs):
        return atom
    if not (isinstance(kind, Std | Variance) and isinstance(functional, Path | Terminal) and not others):
        raise ProblemError(
            f"'{atom.text()}': white noise has a part in it that no covariance tells: expected means, and std or "
            "variance of al.path or al.terminal, as in .at_most(bound, sigmas=3). For other statistics use noise with "
            "germ variables, al.processes.RandomProcess."
        )
    variance = type(functional)((f"{functional.output}{VARIANCE}",))
    return Statistic((functional, variance), type(kind)(noisy=True))


def variances_by_noise(expressions: tuple[Expression, ...]) -> dict[AbstractFunctional, AbstractFunctional]:
    """What white noise adds to the variance, by the functional whose statistics it enters."""
    noisy = (one.functionals for one in statistics_in(expressions) if getattr(one.kind, "noisy", False))
    return {each[0]: each[1] for each in noisy}


def refuse_infinite(problem: AbstractProblem) -> None:
    """Raise `ProblemError` for the spread of an output that contains white noise itself."""
    if not problem.has_noise:
        return
    start, moved = jax_array(problem.placements.vector("initial")), dict[str, dict[str, None]]()
    for phase, one in realise(at_means(problem.simulation), jnp.zeros(0), start).phases.items():
        at, system, traced = one.start(), one.system, one.traced
        assert at is not None
        assert isinstance(system, Noisy)
        assert isinstance(traced, System)
        moved[phase] = dict.fromkeys(system.with_noise_itself(at.t, initial_state(traced, *at), at.inputs))
    infinite = named(moved)
    for name in (name for one in functionals_of(problem.expressions) for name in one.outputs):
        if name.endswith(VARIANCE) and name.removesuffix(VARIANCE) in infinite:
            raise ProblemError(
                f"'{name.removesuffix(VARIANCE)}' contains white noise itself, whose variance at an instant is "
                "infinite: expected the spread of an output that follows from the states. Use "
                "al.processes.RandomProcess, or let noise pass a filter, which is a state."
            )
