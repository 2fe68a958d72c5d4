"""Statistics of a problem's functionals by an expansion: where its expressions take their numbers."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, final

import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.design import (
    AbstractFunctional,
    AbstractScope,
    Expression,
    Problem,
    Sampled,
    grid_at,
    integrated_paths,
    joined,
    sampled,
)
from aleator.dynamics import Grid
from aleator.expansion import Collocation
from aleator.statistics import AbstractStatistic, Constants
from aleator.uncertainty import named_numbers


@final
class ExpansionScope(AbstractScope):
    """Takes every statistic from the coefficients of expansions.

    - `samples`: each functional at the collocation points; `coefficients`: those of the expansions fitted to them;
    - `numbers`: those of the model, by name; `between`: what integrals over time are taken from;
    - `realised`: each functional on the realisations at which limits on the worst case are held;
    - `taken`: the statistics that it has been asked for, in that order.
    """

    def __init__(
        self,
        samples: Mapping[AbstractFunctional, Float[Array, "points ..."]],
        coefficients: Mapping[AbstractFunctional, Float[Array, "terms ..."]],
        constants: Constants,
        numbers: Mapping[str, Any],
        between: "Between | None" = None,
        realised: Mapping[AbstractFunctional, Float[Array, "scenarios ..."]] = MappingProxyType({}),
    ):
        self.samples = samples
        self._coefficients = coefficients
        self._realised = realised
        self.taken: list[Float[Array, "..."]] = []
        self._constants = constants
        self._numbers = numbers
        self._between = between

    def evaluated(self, expressions: tuple[Expression, ...]) -> tuple[tuple[Array, ...], tuple[tuple[Array, ...], ...]]:
        """Expressions, each flattened, and the statistics that each of them asked for."""
        blocks, taken = [], []
        for one in expressions:
            before = len(self.taken)
            blocks.append(jnp.ravel(one.evaluate(self)))
            taken.append(tuple(self.taken[before:]))
        return tuple(blocks), tuple(taken)

    @override
    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> Float[Array, "..."]:
        terms = joined([self._coefficients[one] for one in functionals])
        found = jnp.asarray(kind.of(terms, self._constants.of(kind)))
        # Those of several taken jointly stand along a last axis.
        expected = terms.shape[1:] if len(functionals) == 1 else terms.shape[1:-1]
        if found.shape != expected:
            raise ProblemError(
                f"{type(kind).__name__}.of: expected shape {expected} from coefficients of shape {terms.shape}, the "
                f"first axis being that of the terms; received shape {found.shape}."
            )
        self.taken.append(found)
        return found

    @override
    def time_integral(self, expression: Expression) -> Float[Array, ""]:
        assert self._between is not None
        nodes, weights = self._between
        inner = ExpansionScope({}, {**self._coefficients, **nodes}, self._constants, self._numbers)
        integral = jnp.tensordot(weights, expression.evaluate(inner), axes=1)
        # Every second node is an instant, at which statistics are told.
        self.taken += [one if one.ndim == 0 else one[::2] for one in inner.taken]
        return integral

    @override
    def realised(self, functional: AbstractFunctional) -> Float[Array, "... scenarios"]:
        return jnp.moveaxis(self._realised[functional], 0, -1)

    @override
    def value(self, name: str) -> Float[Array, ""]:
        return self._numbers[name]


class Between(NamedTuple):
    """What integrals of statistics over time are taken from.

    - `coefficients`: of paths at the instants and in the middles between them; `weights`: of the quadrature there.
    """

    coefficients: Mapping[AbstractFunctional, Float[Array, "terms nodes ..."]]
    weights: Float[Array, " nodes"]


def scope_of(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    collocation: Collocation,
    constants: Constants,
    decisions: Float[Array, " n"],
) -> ExpansionScope:
    """The scope of expressions of some functionals at given decisions.

    Simulates once, at all collocation points and at the scenarios of the worst case together.
    """
    paths = tuple(one for one in integrated_paths(problem.expressions) if one in functionals)
    count, every = len(collocation.points), _with_scenarios(collocation.points, constants.scenarios)
    found = sampled(problem, functionals, paths, every, decisions) if functionals else Sampled((), ())
    samples = {one: values[:count] for one, values in zip(functionals, found.values, strict=True)}
    realised = {one: values[count:] for one, values in zip(functionals, found.values, strict=True)}
    coefficients = {one: collocation.coefficients(values) for one, values in samples.items()}
    nodes = {one: collocation.coefficients(values[:count]) for one, values in zip(paths, found.nodes, strict=True)}
    grid = grid_at(problem, decisions)
    between = Between(nodes, grid.node_weights) if isinstance(grid, Grid) else None
    numbers = named_numbers(problem.simulation, decisions)
    return ExpansionScope(samples, coefficients, constants, numbers, between, realised)


def _with_scenarios(
    points: Float[Array, "points variables"], scenarios: Float[Array, "scenarios variables"] | None
) -> Float[Array, "every variables"]:
    return points if scenarios is None else jnp.concatenate([points, scenarios])
