"""What a system says of itself once its numbers are known: asked at the initial decisions, before compilation."""

from collections.abc import Iterator
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.design._declaration import AbstractProblem, Model
from aleator.design._expression import Constraint
from aleator.design._functionals import Path
from aleator.design._scope import AbstractScope
from aleator.design._statistic import AbstractFunctional, statistics_in
from aleator.dynamics import Grid, System
from aleator.statistics import AbstractStatistic
from aleator.uncertainty import AbstractGerm, at_means, named_numbers, realise, uncertain_numbers

# An unbounded variable is tried this far out on either side: beyond lies one realisation in a billion.
_TAIL = 1e-9


def refuse_trouble(problem: AbstractProblem) -> None:
    """Raise `ProblemError` for what a system finds wrong with itself, or where it cannot hold its start.

    It is asked at the means, then with each uncertain number at either end of its law, the others at their medians.
    """
    if not isinstance(problem.system, System) or not _speaks(problem.system):
        return
    start = jnp.asarray(problem.survey.vector("initial"))
    mean = realise(at_means(problem.model), jnp.zeros(0), start)
    _refuse(mean, "")
    for germ in _extremes(list(problem.survey.germs.values())):
        numbers = uncertain_numbers(problem.survey, jnp.asarray(germ), start)
        where = ", ".join(f"{name} = {float(number):.4g}" for name, number in numbers.items())
        _refuse(realise(problem.model, jnp.asarray(germ), start), f" In the system with {where}.")
    _refuse_unheld(problem, mean)


def _speaks(system: System) -> bool:
    return type(system).trouble is not System.trouble


def _refuse(model: Model, who: str) -> None:
    if trouble := model.system.trouble(model.grid):  # type: ignore[union-attr]
        raise ProblemError(trouble + who)


def _extremes(germs: list[AbstractGerm]) -> Iterator[Float[np.ndarray, " variables"]]:
    """Germ points with one variable at an end of its law, the others at their medians."""
    middle = np.array([float(germ.quantile(np.array(0.5))) for germ in germs])
    for i, germ in enumerate(germs):
        for end, level in zip(germ.support(), (_TAIL, 1 - _TAIL), strict=True):
            point = middle.copy()
            point[i] = end if np.isfinite(end) else float(germ.quantile(np.array(level)))
            yield point


def _refuse_unheld(problem: AbstractProblem, model: Model) -> None:
    """Refuse limits of torques that cannot hold the start still: no motion of the kind would begin."""
    if not isinstance(model.system, System) or not isinstance(model.grid, Grid):
        return
    held = model.system.holding(model.grid)
    for constraint in problem.constraints:
        inside = statistics_in((constraint.expression,))
        functionals = [one for atom in inside for one in atom.functionals]
        torques = all(isinstance(one, Path) and one.output in held for one in functionals)
        # What is integrated over time says nothing of the start.
        over_time = any(atom.measures and not atom.is_path for atom in constraint.expression.atoms)
        if not functionals or not torques or over_time:
            continue
        value = float(constraint.expression.evaluate(_Held(problem, held)))
        if not float(constraint.lower) - 1e-9 <= value <= float(constraint.upper) + 1e-9:
            raise ProblemError(_unheld(constraint, {one.output: float(held[one.output]) for one in functionals}))


def _unheld(constraint: Constraint, torques: dict[str, float]) -> str:
    needed = ", ".join(f"{name} = {value:.4g}" for name, value in torques.items())
    return (
        f"Constraint '{constraint.name}' ({constraint}) cannot hold the system still at the start, which takes "
        f"{needed} "
        "at the means. Raise the limit, lighten the load, or start in another posture."
    )


@final
class _Held(AbstractScope):
    """A system that is held still: every mean is the value it takes, and nothing spreads."""

    def __init__(self, problem: AbstractProblem, held: Any):
        self._problem, self._held = problem, held

    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> Array:
        value = jnp.asarray(self._held[functionals[0].output])
        return value if kind.speaks_of_one_system else jnp.zeros_like(value)

    @property
    def weights(self) -> Array:
        return jnp.zeros(1)

    def value(self, name: str) -> Array:
        return named_numbers(self._problem.model, jnp.asarray(self._problem.survey.vector("initial")))[name]
