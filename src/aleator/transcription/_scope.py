"""The scope in which a problem's expressions are evaluated: statistics of its functionals by an expansion."""

from collections.abc import Iterator, Mapping
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
    Statistic,
    grid_at,
    integrated_paths,
    joined,
    sampled,
)
from aleator.dynamics import Grid
from aleator.expansion import Collocation
from aleator.statistics import AbstractStatistic, Constants, together
from aleator.uncertainty import named_numbers


@final
class ExpansionScope(AbstractScope):
    """Takes every statistic from the coefficients of expansions.

    - `samples`: each functional at the collocation points; `coefficients`: those of the expansions fitted to them;
    - `numbers`: those of the model, by name; `between`: the terms for integrals over time;
    - `realised`: each functional on the realisations at which limits on the worst case are imposed;
    - `totals`: the values of integrals over time where these are known, in the order of evaluation;
    - `taken`: the statistics taken so far, in that order.
    """

    def __init__(
        self,
        samples: Mapping[AbstractFunctional, Float[Array, "points ..."]],
        coefficients: Mapping[AbstractFunctional, Float[Array, "terms ..."]],
        constants: Constants,
        numbers: Mapping[str, Any],
        between: "Between | None" = None,
        realised: Mapping[AbstractFunctional, Float[Array, "scenarios ..."]] = MappingProxyType({}),
        totals: Iterator[Float[Array, ""]] | None = None,
    ):
        self.samples = samples
        self._coefficients = coefficients
        self._realised = realised
        self.taken: list[Float[Array, "..."]] = []
        self._constants = constants
        self._numbers = numbers
        self._between = between
        self._totals = totals
        self._together: dict[tuple[tuple[AbstractFunctional, ...], int], Float[Array, "..."]] = {}

    def evaluated(self, expressions: tuple[Expression, ...]) -> tuple[tuple[Array, ...], tuple[tuple[Array, ...], ...]]:
        """Expressions, each flattened, and the statistics that each of them took."""
        blocks, taken = [], []
        self.take_together(expressions)
        for one in expressions:
            before = len(self.taken)
            blocks.append(jnp.ravel(one.evaluate(self)))
            taken.append(tuple(self.taken[before:]))
        return tuple(blocks), tuple(taken)

    def take_together(self, expressions: tuple[Expression, ...]) -> None:
        """Take those statistics of expressions now that share a loop, to be found where they are evaluated."""
        atoms = [atom for one in expressions for atom in one.atoms if isinstance(atom, Statistic)]
        found = together([(one.kind, self._terms(one.functionals)) for one in atoms], self._constants)
        # By identity, because the numbers in a statistic are traced.
        pairs = zip(atoms, found, strict=True)
        self._together = {(one.functionals, id(one.kind)): values for one, values in pairs if values is not None}

    def _terms(self, functionals: tuple[AbstractFunctional, ...]) -> Float[Array, "terms ..."]:
        return joined([self._coefficients[one] for one in functionals])

    @override
    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> Float[Array, "..."]:
        terms, found = self._terms(functionals), self._together.get((functionals, id(kind)))
        found = jnp.asarray(kind.of(terms, self._constants.of(kind)) if found is None else found)
        # Joint statistics take their functionals along a last axis.
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
        if self._totals is not None:
            return next(self._totals)
        assert self._between is not None
        nodes, weights, instants = self._between
        inner = ExpansionScope({}, {**self._coefficients, **nodes}, self._constants, self._numbers)
        integral = jnp.tensordot(weights, expression.evaluate(inner), axes=1)
        self.taken += [one if one.ndim == 0 else one[::instants] for one in inner.taken]
        return integral

    @override
    def realised(self, functional: AbstractFunctional) -> Float[Array, "... scenarios"]:
        return jnp.moveaxis(self._realised[functional], 0, -1)

    @override
    def value(self, name: str) -> Float[Array, ""]:
        return self._numbers[name]


class Between(NamedTuple):
    """The terms for integrals of statistics over time.

    - `coefficients`: of paths at the instants and in the middles between them; `weights`: of the quadrature there;
    - `instants`: at each so many of them is an instant, at which statistics are recorded.
    """

    coefficients: Mapping[AbstractFunctional, Float[Array, "terms nodes ..."]]
    weights: Float[Array, " nodes"]
    instants: int = 2


class Terms(NamedTuple):
    """The terms from which expressions are evaluated, in the order of the functionals, or a share of some points.

    - `coefficients`: of each functional; `nodes`: of each path whose statistics are integrated over time, at the
      instants and in the middles between them;
    - `realised`: each functional at the scenarios of the worst case, if there are any.
    """

    coefficients: tuple[Float[Array, "terms ..."], ...]
    nodes: tuple[Float[Array, "terms nodes ..."], ...]
    realised: tuple[Float[Array, "scenarios ..."], ...]


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
    samples, terms = simulated(
        problem, functionals, collocation.points, collocation.pseudo_inverse, constants.scenarios, decisions
    )
    return scope_from(problem, functionals, samples, terms, constants, decisions)


def simulated(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    points: Float[Array, "points variables"],
    fit: Float[Array, "terms points"],
    scenarios: Float[Array, "scenarios variables"] | None,
    decisions: Float[Array, " n"],
) -> tuple[tuple[Float[Array, "points ..."], ...], Terms]:
    """Functionals at some collocation points, and the contribution of these points to the coefficients.

    - `fit`: the columns of the collocation's `pseudo_inverse` that belong to the points.
    """
    if not functionals:
        return (), Terms((), (), ())
    count, every = len(points), points if scenarios is None else jnp.concatenate([points, scenarios])
    found = sampled(problem, functionals, _integrated(problem, functionals), every, decisions)
    samples = tuple(values[:count] for values in found.values)
    return samples, Terms(
        coefficients=tuple(jnp.tensordot(fit, values, axes=1) for values in samples),
        nodes=tuple(jnp.tensordot(fit, values[:count], axes=1) for values in found.nodes),
        realised=() if scenarios is None else tuple(values[count:] for values in found.values),
    )


def scope_from(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    samples: tuple[Float[Array, "points ..."], ...],
    terms: Terms,
    constants: Constants,
    decisions: Float[Array, " n"],
) -> ExpansionScope:
    """The scope of expressions whose functionals have been simulated."""
    paths, grid = _integrated(problem, functionals), grid_at(problem, decisions)
    nodes = dict(zip(paths, terms.nodes, strict=True))
    return ExpansionScope(
        dict(zip(functionals, samples, strict=False)),
        dict(zip(functionals, terms.coefficients, strict=True)),
        constants,
        named_numbers(problem.simulation, decisions),
        Between(nodes, grid.node_weights) if isinstance(grid, Grid) else None,
        dict(zip(functionals, terms.realised, strict=False)),
    )


def _integrated(problem: Problem, functionals: tuple[AbstractFunctional, ...]) -> tuple[AbstractFunctional, ...]:
    return tuple(one for one in integrated_paths(problem.expressions) if one in functionals)
