"""A problem's equations as families of blocks: signals, initial states, rates, records, and its expressions."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    Expression,
    Problem,
    Value,
    beside_integrals,
    expanded_functionals,
    extreme_functionals,
    time_integrals,
)
from aleator.dynamics import AbstractMeanRate
from aleator.statistics import Constants
from aleator.transcription._expansions import ExpansionScope
from aleator.transcription.simultaneous._blocks import Block, Family
from aleator.transcription.simultaneous._layout import Layout, Plan, Variables, integrals_over_time, known_numbers
from aleator.transcription.simultaneous._pointwise import Pointwise, apart
from aleator.uncertainty import named_numbers


class Families(NamedTuple):
    """All families of a program.

    - `known`: the signals at all mesh points, then the duration: one block; without decisions if these are affine,
      for matrices then hold how they act;
    - `initial`: the initial states of each realisation, at the first mesh point;
    - `rates`: the blocks of the scheme, mean rates of states, then of integrands; `equations`: those of the algebraic
      variables, wherever signals are told;
    - `paths`, `ends`: outputs wherever paths are recorded, and at the last instant; `composed`: functionals of
      histories and integrals;
    - `nodes`: outputs at the nodes of integrals over time;
    - `expressions`: the objective, then the constraints; `integrands`: of integrals of statistics, by the fraction of
      the duration.
    """

    known: Family
    initial: Family
    rates: Family
    equations: Family
    paths: Family
    ends: Family
    composed: Family
    nodes: Family
    expressions: tuple[Family, ...]
    integrands: tuple[Family, ...]

    @property
    def every(self) -> tuple[Family, ...]:
        """All of them in order."""
        return (*self[:-2], *self.expressions, *self.integrands)


KNOWN, RATES, EQUATIONS, OBJECTIVE = (
    Families._fields.index(name) for name in ("known", "rates", "equations", "expressions")
)


def families(
    layout: Layout,
    problem: Problem,
    constants: Constants,
    points: Float[np.ndarray, "realisations germs"],
    variables: Variables,
) -> Families:
    """The families of a problem, with the variables that they are given: their values, or their numbers.

    - `points`: the germ points of the realisations.
    """
    pointwise, mesh, grid = layout.pointwise, layout.plan.mesh, layout.pointwise.grid
    recorded = layout.plan.recorded(grid)
    instants, sides = mesh.instants(recorded), mesh.instant_sides(recorded)
    declared = np.searchsorted(instants, mesh.instants(grid.fractions))
    nodes, node_sides = mesh.instants(grid.node_fractions), mesh.instant_sides(grid.node_fractions)
    places, every = mesh.places, np.arange(len(mesh.sides))
    model = np.concatenate([variables.decisions[pointwise.direct], variables.duration])
    none = variables.decisions[None, None, :0]
    integrals = variables.integrals.shape[2]
    histories = variables.paths[:, declared].reshape(len(variables.paths), -1)
    summed = variables.integrals[:, -1]
    needs_histories = any(not isinstance(one, AbstractIntegral) for one in pointwise.composed)
    composing = np.concatenate([summed, histories if needs_histories else histories[:, :0]], axis=1)

    def at(which: np.ndarray, sides: np.ndarray) -> np.ndarray:
        """Signals, states and algebraic variables at some mesh points of every realisation."""
        first = sides if sides.ndim == 1 else sides[:, 0]
        return np.concatenate([signals_at(sides), variables.states[:, which], variables.algebraic[:, first]], axis=2)

    def signals_at(sides: np.ndarray) -> np.ndarray:
        signals = variables.signals[sides].reshape(len(sides), -1)
        return np.broadcast_to(signals, (len(points), *signals.shape))

    def observed(names: tuple[str, ...], which: np.ndarray, sides: np.ndarray) -> Family:
        return Family(partial(pointwise.outputs, names), model, at(which, sides), points, places[sides])

    def known(outer: Any, inner: Any, shared: Array, own: Array) -> Array:
        del outer, inner, own
        return known_numbers(pointwise, mesh.places, shared if shared.size else jnp.zeros(layout.sizes.decisions))

    def composed(outer: Any, inner: Any, shared: Array, own: Array) -> Array:
        del outer, inner
        return pointwise.composites(layout.shapes, shared[0], own[:integrals], own[integrals:])

    residuals = pointwise.residuals if layout.shapes.algebraic else _nothing
    return Families(
        Family(known, variables.decisions[: 0 if layout.plan.is_affine else None], none),
        Family(pointwise.initial, model, signals_at(every[:1]), points, places[:1]),
        Family(
            partial(pointwise.mean_rates, mesh.scheme.rate),
            model,
            at(mesh.asked, mesh.asked_sides),
            points,
            places[mesh.asked_sides],
        ),
        Family(residuals, model, at(mesh.sides, every), points, places),
        observed(pointwise.paths, instants, sides),
        observed(pointwise.ends, instants[-1:], sides[-1:]),
        Family(composed, variables.duration, composing[:, None]),
        observed(pointwise.nodes, nodes, node_sides),
        tuple(_limits(layout, problem, constants, variables)),
        tuple(_integrand(layout, problem, constants, one, variables) for one in integrals_over_time(problem)),
    )


def functions(problem: Problem, constants: Constants | None, plan: Plan | AbstractMeanRate) -> dict[int, Block]:
    """The functions of families, by their numbers: of all on a plan; by mean rates alone, of those that grow with the
    mesh.
    """
    if isinstance(plan, AbstractMeanRate):
        pointwise = Pointwise.of(problem)
        return {RATES: partial(pointwise.mean_rates, plan), EQUATIONS: pointwise.residuals}
    assert constants is not None
    layout = Layout.of(problem, plan)
    nowhere = np.zeros((plan.realisations, len(problem.placements.germ_names)))
    every = families(layout, problem, constants, nowhere, layout.view(np.zeros(layout.count))).every
    return {i: one.function for i, one in enumerate(every)}


def _nothing(*_: Any) -> Array:
    """No rows."""
    return jnp.zeros(0)


class _Part(NamedTuple):
    """Some variables of a limit: the coefficients of a functional, or its values on the scenarios."""

    functional: AbstractFunctional
    is_expanded: bool
    shape: tuple[int, ...]


def _limits(layout: Layout, problem: Problem, constants: Constants, variables: Variables) -> Iterator[Family]:
    """The objective, then the constraints, whose integrals over time are variables."""
    first, coefficients = 0, layout.coefficients(variables)
    for one in problem.expressions:
        last = first + len(time_integrals(one))
        yield _limit(layout, problem, constants, one, variables, coefficients, variables.totals[first:last])
        first = last


def _integrand(
    layout: Layout, problem: Problem, constants: Constants, expression: Expression, variables: Variables
) -> Family:
    """The integrand of an integral over time: one block a node."""
    coefficients = {**layout.coefficients(variables), **layout.between(variables)}
    family = _limit(layout, problem, constants, expression, variables, coefficients, variables.totals[:0])
    block = family.function
    return family._replace(
        function=lambda outer, inner, s, o: s[0] * block(outer, inner, s[1:], o),
        shared=np.concatenate([variables.duration, family.shared]),
    )


def _limit(
    layout: Layout,
    problem: Problem,
    constants: Constants,
    expression: Expression,
    variables: Variables,
    coefficients: Mapping[AbstractFunctional, Any],
    totals: Any,
) -> Family:
    """An expression: one block an instant where it is one number an instant, else a single one.

    - `totals`: its integrals over time.
    """
    samples, beside = layout.samples(variables), beside_integrals(expression)
    speaks_of_numbers = any(isinstance(one, Value) for one in beside.leaves)
    decisions = variables.decisions if speaks_of_numbers else variables.decisions[:0]
    parts = [(one, True, coefficients[one]) for one in expanded_functionals((beside,))]
    parts += [(one, False, samples[one][layout.plan.points :]) for one in extreme_functionals((beside,))]
    moving, still = [], []
    for functional, is_expanded, numbers in parts:
        is_own = expression.is_path and functional.is_path
        # One part an instant, the first axis.
        numbers = np.moveaxis(numbers, 1, 0) if is_own else numbers
        part = _Part(functional, is_expanded, numbers.shape[1:] if is_own else numbers.shape)
        (moving if is_own else still).append((part, numbers.reshape(len(numbers), -1) if is_own else numbers.ravel()))
    shared = np.concatenate([decisions, totals, *(numbers for _, numbers in still)])
    none = variables.decisions[None, :0]
    own = np.concatenate([numbers for _, numbers in moving], axis=1) if moving else none
    block = partial(_expression, problem, constants, expression, (decisions.size, len(totals)))
    parts = [part for part, _ in still], [part for part, _ in moving]
    return Family(lambda _, __, s, o: block(parts, s, o), shared, own[None])


def _expression(
    problem: Problem,
    constants: Constants,
    expression: Expression,
    sizes: tuple[int, int],
    parts: tuple[list[_Part], list[_Part]],
    shared: Array,
    own: Array,
) -> Float[Array, " rows"]:
    decisions, totals, others = jnp.split(shared, np.cumsum(sizes))
    numbers = named_numbers(problem.simulation, decisions) if decisions.size else {}
    pairs = [*_taken(parts[0], others), *_taken(parts[1], own)]
    coefficients = {one.functional: values for one, values in pairs if one.is_expanded}
    realised = {one.functional: values for one, values in pairs if not one.is_expanded}
    scope = ExpansionScope(coefficients, constants, numbers, scenarios=realised, totals=iter(totals))
    return jnp.ravel(expression.evaluate(scope))


def _taken(parts: list[_Part], numbers: Array) -> list[tuple[_Part, Array]]:
    """Parts with their values, from these side by side."""
    return list(zip(parts, apart(numbers, [one.shape for one in parts]), strict=True))
