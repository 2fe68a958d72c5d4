"""The value of an expression from estimates of its statistics, and how far their errors could move it."""

from collections.abc import Mapping
from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator.design._declaration import AbstractProblem
from aleator.design._expression import Expression
from aleator.design._response import step_at
from aleator.design._scope import AbstractScopeOfInstants, Value
from aleator.design._statistic import Statistic
from aleator.statistics import AbstractStatistic
from aleator.uncertainty import named_numbers


class Estimated(NamedTuple):
    """An estimate with its error, such as a standard error: numbers, or one number per instant."""

    value: Float[np.ndarray, "*shape"]
    error: Float[np.ndarray, "*shape"]


def estimated(
    problem: AbstractProblem,
    expression: Expression,
    statistics: Mapping[str, Estimated],
    decisions: Float[np.ndarray, " n"],
    doubt: float = 0.0,
) -> Estimated | None:
    """An expression at given decisions, its `statistics` being known by their texts; None where one is missing.

    - `doubt`: the relative error of the model's own numbers in the expression.

    Its error is the sum of what the error of each would change: the worst case, for their dependence is not known.
    """
    at = jnp.asarray(decisions)
    numbers, step = named_numbers(problem.simulation, at), step_at(problem, at)
    used = {leaf.name for leaf in expression.leaves if isinstance(leaf, Value)}
    needed = {leaf.text() for leaf in expression.leaves if isinstance(leaf, Statistic)}
    if not needed <= set(statistics):
        return None
    known = {name: np.asarray(numbers[name]) for name in used}
    known = {name: Estimated(value, doubt * np.abs(value)) for name, value in known.items()}
    known |= {text: statistics[text] for text in needed}

    def evaluated(moved: str | None = None) -> np.ndarray:
        return np.asarray(expression.evaluate(_Estimates(known, step, moved)))

    value = evaluated()
    moving = (name for name, one in known.items() if np.any(one.error))
    return Estimated(value, sum((np.abs(evaluated(one) - value) for one in moving), start=np.zeros(value.shape)))


@final
class _Estimates(AbstractScopeOfInstants):
    """Statistics and numbers by their texts, the one that is `moved`, if any, shifted by its error."""

    def __init__(self, known: Mapping[str, Estimated], step: Array, moved: str | None):
        self._known, self.step, self._moved = known, step, moved

    @override
    def statistic(self, functionals: tuple[Any, ...], kind: AbstractStatistic) -> Array:
        return self.value(Statistic(functionals, kind).text())

    @override
    def value(self, name: str) -> Array:
        one = self._known[name]
        return jnp.asarray(one.value + one.error if name == self._moved else one.value)
