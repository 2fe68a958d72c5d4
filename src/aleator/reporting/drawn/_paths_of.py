"""The paths of a design: which there are by name, their limits, and their histories on simulated systems."""

from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError, SimulationError
from aleator.design import (
    AbstractFunctional,
    Constraint,
    Problem,
    Statistic,
    functionals_of,
    history,
    is_worst_case,
    path,
    refuse_changed,
    refuse_changed_code,
    responses,
)
from aleator.ensemble import draw
from aleator.reporting._numbers import given
from aleator.solution import Moments, Solution

# The multiple of the standard deviation in a band, where no limit says another.
_USUAL = 2.0


class Limits(NamedTuple):
    """The limits on a path: by their values, in words; the largest multiple of the standard deviation in them; their
    names.
    """

    texts: dict[float, str]
    sigmas: float
    names: set[str]


def paths_of(problem: Problem) -> dict[str, AbstractFunctional]:
    """The paths in a problem, each under the name of its output, or under its text where several are of one output."""
    every = [one for one in functionals_of(problem.expressions) if one.is_path]
    outputs = [one.output for one in every]
    return {one.output if outputs.count(one.output) == 1 else one.text(): one for one in every}


def limits_of(problem: Problem, functional: AbstractFunctional, unit: str) -> Limits:
    """The limits on one path alone: on its mean, with a multiple of its standard deviation or without, or on its worst
    case.
    """
    texts: dict[float, str] = {}
    sigmas, names = 0.0, set()
    for one in problem.constraints:
        if functionals_of((one.expression,)) != (functional,) or not _has_values_of_path(one):
            continue
        multiple = one.expression.sigmas or 0.0
        sigmas = max(sigmas, multiple)
        names.add(one.name)
        for bound in (float(one.lower), float(one.upper)):
            if np.isfinite(bound):
                texts[bound] = f"{one.name}: {given(bound, unit)}{_how(one, multiple)}"
    return Limits(texts, sigmas or _USUAL, names)


def _how(limit: Constraint, multiple: float) -> str:
    """For which systems a limit holds, in words."""
    if multiple:
        return f" at {multiple:.3g} σ"
    return " in the worst case" if is_worst_case(limit) else ""


def _has_values_of_path(limit: Constraint) -> bool:
    """Whether what is limited has the path's own values: its worst case, or one statistic of it, not in proportion, and
    its spreads.
    """
    if is_worst_case(limit):
        return True
    pairs = list(zip(limit.expression.factors, limit.expression.atoms, strict=True))
    located = [float(factor) for factor, atom in pairs if not atom.is_spread]
    return located == [1.0] and all(isinstance(atom, Statistic) for _, atom in pairs)


def components(
    name: str, mean: Float[np.ndarray, "instants ..."], std: Float[np.ndarray, "instants ..."]
) -> dict[str, Moments]:
    """A path by its name; of a vector over time, each component by its own."""
    if mean.ndim == 1:
        return {name: Moments(mean, std)}
    means, stds = (one.reshape(len(one), -1) for one in (mean, std))
    return {f"{name}[{i}]": Moments(means[:, i], stds[:, i]) for i in range(means.shape[1])}


def _respond(
    problem: Problem, functional: AbstractFunctional, germ: Float[jax.Array, "systems variables"], decisions: jax.Array
) -> Float[jax.Array, "systems instants ..."]:
    return responses(problem, (functional,), germ, decisions)[0]


_RESPOND = Compiled(_respond, unchanged=refuse_changed_code)


def simulated(solution: Solution, output: str, samples: int, seed: int) -> Float[np.ndarray, "systems instants ..."]:
    """An output of random systems at the decisions of a solution; of the one system where nothing is uncertain.

    Raises `ProblemError` if the code of the system has changed, and `SimulationError` for what is not finite.
    """
    problem = solution.problem
    refuse_changed("plot.histories", problem, "when the design was solved")
    germs = tuple(problem.placements.germs.values())
    points = draw(germs, samples, np.random.default_rng(seed)) if germs else np.zeros((1, 0))
    found = _RESPOND(numbers_to_arrays(problem), path(output), jnp.asarray(points), jnp.asarray(solution.vector))
    values = np.asarray(found)
    if not np.isfinite(values).all():
        raise SimulationError(
            f"plot.histories: expected finite numbers; '{output}' is not finite on some systems: see al.validate."
        )
    return values


def outputs_of(problem: Problem, solution: Solution) -> Mapping[str, str]:
    """The outputs of a system, by name. Raises `ProblemError` for a system without time."""
    if not problem.system.has_time:
        raise ProblemError("plot.histories: expected a system that evolves in time; received an algebraic one.")
    germ = jnp.zeros(len(problem.placements.germs))
    return dict.fromkeys(jax.eval_shape(lambda: history(problem, germ, jnp.asarray(solution.vector))), "")
