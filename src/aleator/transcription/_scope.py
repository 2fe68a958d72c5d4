"""Statistics of a problem's functionals by an expansion: where its expressions take their numbers."""

from collections.abc import Mapping
from typing import Any, final

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator.collocation import Collocation
from aleator.design import AbstractFunctional, AbstractScope, Expression, Problem, grid_at, joined, responses
from aleator.statistics import AbstractStatistic, Constants
from aleator.uncertainty import named_numbers


@final
class ExpansionScope(AbstractScope):
    """Takes every statistic from the coefficients of expansions.

    - `samples`: each functional at the collocation points; `coefficients`: those of the expansions fitted to them;
    - `numbers`: those of the model, by name; `weights`: of the instants;
    - `taken`: the statistics that it has been asked for, in that order.
    """

    def __init__(
        self,
        samples: Mapping[AbstractFunctional, Float[Array, "points ..."]],
        coefficients: Mapping[AbstractFunctional, Float[Array, "terms ..."]],
        constants: Constants,
        numbers: Mapping[str, Any],
        weights: Float[Array, " instants"],
    ):
        self.samples = samples
        self._coefficients = coefficients
        self.taken: list[Float[Array, "..."]] = []
        self._constants = constants
        self._numbers = numbers
        self._weights = weights

    def evaluated(self, expressions: tuple[Expression, ...]) -> tuple[tuple[Array, ...], tuple[tuple[Array, ...], ...]]:
        """Expressions, each flattened, and the statistics that each of them asked for."""
        blocks, taken = [], []
        for one in expressions:
            before = len(self.taken)
            blocks.append(jnp.ravel(one.evaluate(self)))
            taken.append(tuple(self.taken[before:]))
        return tuple(blocks), tuple(taken)

    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> Float[Array, "..."]:
        """See `AbstractScope.statistic`."""
        found = kind.of(joined([self._coefficients[one] for one in functionals]), self._constants.of(kind))
        self.taken.append(found)
        return found

    @property
    def weights(self) -> Float[Array, " instants"]:
        """See `AbstractScope.weights`."""
        return self._weights

    def value(self, name: str) -> Float[Array, ""]:
        """See `AbstractScope.value`."""
        return self._numbers[name]


def scope_of(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    collocation: Collocation,
    constants: Constants,
    decisions: Float[Array, " n"],
) -> ExpansionScope:
    """The scope of expressions of some functionals at given decisions: simulates at all collocation points once."""
    samples = responses(problem, functionals, collocation.points, decisions) if functionals else ()
    numbers = named_numbers(problem.model, decisions)
    weights = grid_at(problem, decisions).weights
    found = dict(zip(functionals, samples, strict=True))
    coefficients = {one: collocation.coefficients(values) for one, values in found.items()}
    return ExpansionScope(found, coefficients, constants, numbers, weights)
