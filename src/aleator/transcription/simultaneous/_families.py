"""A problem's equations as families of blocks: signals, initial states, rates, records, and its expressions."""

from collections.abc import Iterator, Mapping
from functools import cache, partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    At,
    Expression,
    Problem,
    Value,
    beside_integrals,
    expanded_functionals,
    extreme_functionals,
    time_integrals,
)
from aleator.dynamics import AbstractMeanRate, System, together
from aleator.statistics import Constants
from aleator.transcription._expansions import ExpansionScope
from aleator.transcription.simultaneous._blocks import Block, Family
from aleator.transcription.simultaneous._evaluations import known_numbers
from aleator.transcription.simultaneous._layout import (
    Layout,
    PhaseLayout,
    PhaseVariables,
    Plan,
    Variables,
    integrals_over_time,
)
from aleator.transcription.simultaneous._pointwise import Pointwise
from aleator.transcription.simultaneous._shapes import apart
from aleator.uncertainty import named_numbers


class PhaseFamilies(NamedTuple):
    """The families of one phase.

    - `known`: the signals at all mesh points, then the duration unless each realisation has its own: one block; zero if
      these are affine, for matrices then hold how decisions act;
    - `initial`: the states of each realisation at the first mesh point: initial ones, those that follow from the end of
      the phase before, or those with which a cycle repeats;
    - `rates`: the blocks of the scheme, mean rates of states, then of integrands; `equations`: those of the algebraic
      variables, wherever signals are told;
    - `paths`, `ends`: outputs wherever paths are recorded, and at the last instant; `composed`: functionals of
      histories and integrals;
    - `nodes`: outputs at the nodes of integrals over time; `levels`: the function of the event that ends each
      realisation, at the last instant.
    """

    known: Family
    initial: Family
    rates: Family
    equations: Family
    paths: Family
    ends: Family
    composed: Family
    nodes: Family
    levels: Family


class Families(NamedTuple):
    """All families of a program.

    - `phases`: those of each phase; `expressions`: the objective, then the constraints; `integrands`: of integrals of
      statistics, by the fraction of the duration.
    """

    phases: tuple[PhaseFamilies, ...]
    expressions: tuple[Family, ...]
    integrands: tuple[Family, ...]

    @property
    def every(self) -> tuple[Family, ...]:
        """All of them in order: of each kind those of all phases, then the others."""
        return (*(one for kind in zip(*self.phases, strict=True) for one in kind), *self.expressions, *self.integrands)


KNOWN, RATES, EQUATIONS = (PhaseFamilies._fields.index(name) for name in ("known", "rates", "equations"))


def number_of(kind: int, phase: int, phases: int) -> int:
    """The number of one phase's family of a kind among all families."""
    return kind * phases + phase


def objective_of(phases: int) -> int:
    """The number of the objective's family."""
    return len(PhaseFamilies._fields) * phases


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
    each = [_Phase(phase, variables, own, points) for phase, own in zip(layout.phases, variables.phases, strict=True)]
    return Families(
        tuple(_families_of(layout, one, each[i - 1] if i else None) for i, one in enumerate(each)),
        tuple(_limits(layout, problem, constants, variables)),
        tuple(_integrand(layout, problem, constants, one, variables) for one in integrals_over_time(problem)),
    )


class _Phase(NamedTuple):
    """A phase with its variables, and the decisions: what its blocks are given."""

    layout: PhaseLayout
    whole: Variables
    variables: PhaseVariables
    points: Float[np.ndarray, "realisations germs"]

    @property
    def shared(self) -> np.ndarray:
        """The duration, unless each realisation has its own."""
        return self.variables.duration[0, : int(not self.layout.pointwise.is_open)]

    @property
    def durations(self) -> np.ndarray:
        """The duration of each realisation, shape (realisations, 1), if it has its own; else (realisations, 0)."""
        own = self.variables.duration[:, : int(self.layout.pointwise.is_open)]
        return np.broadcast_to(own, (len(self.points), own.shape[1]))

    @property
    def model(self) -> np.ndarray:
        """What all blocks share: the decisions of the model itself, and the duration."""
        return np.concatenate([self.whole.decisions[self.layout.pointwise.direct], self.shared])

    def at(self, which: np.ndarray, sides: np.ndarray) -> np.ndarray:
        """Signals, duration, states and algebraic variables at some mesh points of every realisation."""
        first = sides if sides.ndim == 1 else sides[:, 0]
        parts = [self.begun(sides), self.variables.states[:, which], self.variables.algebraic[:, first]]
        return np.concatenate(parts, axis=2)

    def begun(self, sides: np.ndarray) -> np.ndarray:
        """Signals and duration."""
        signals, shape = self.variables.signals[sides].reshape(len(sides), -1), (len(self.points), len(sides))
        each = signals, self.durations[:, None]
        return np.concatenate([np.broadcast_to(one, (*shape, one.shape[-1])) for one in each], axis=2)

    def end(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What blocks at the last mesh point of every realisation are given, without algebraic variables."""
        mesh = self.layout.mesh
        own = np.concatenate([self.begun(np.array([len(mesh.sides) - 1])), self.variables.states[:, -1:]], axis=2)
        return self.model, own, self.points, mesh.places[-1:]


def _families_of(layout: Layout, own: _Phase, before: _Phase | None) -> PhaseFamilies:
    """The families of a phase, with what the phase before it gives its blocks."""
    phase, _, variables, points = own
    pointwise, mesh, grid, recorded = phase.pointwise, phase.mesh, phase.pointwise.grid, phase.recorded
    instants, sides = mesh.instants(recorded), mesh.instant_sides(recorded)
    declared = np.searchsorted(instants, mesh.instants(grid.fractions))
    nodes, node_sides = mesh.instants(grid.node_fractions), mesh.instant_sides(grid.node_fractions)
    places, every, model, at = mesh.places, np.arange(len(mesh.sides)), own.model, own.at
    decisions = own.whole.decisions
    none = decisions[None, None, :0]
    integrals = variables.integrals.shape[2]
    histories = variables.paths[:, declared].reshape(len(variables.paths), -1)
    needs_histories = any(not isinstance(one, AbstractIntegral | At) for one in pointwise.composed)
    composing = [own.durations, variables.integrals[:, -1]]
    composing = np.concatenate([*composing, histories if needs_histories else histories[:, :0]], axis=1)

    def observed(names: tuple[str, ...], which: np.ndarray, sides: np.ndarray) -> Family:
        return Family(partial(pointwise.outputs, names), model, at(which, sides), points, places[sides])

    def known(outer: Any, inner: Any, shared: Array, rest: Array) -> Array:
        del outer, inner, rest
        if layout.plan.is_affine:
            return jnp.zeros(variables.signals.size + own.shared.size)
        return known_numbers(pointwise, mesh.places, shared)

    def composed(outer: Any, inner: Any, shared: Array, rest: Array) -> Array:
        del outer, inner
        duration, rest = (rest[0], rest[1:]) if pointwise.is_open else (shared[0], rest)
        return pointwise.composites(phase.shapes, duration, rest[:integrals], rest[integrals:])

    initial = Family(pointwise.initial, model, own.begun(every[:1]), points, places[:1])
    if grid.periodic:
        initial = Family(pointwise.again, *own.end())
    elif before is not None:
        initial = Family(partial(before.layout.pointwise.onward, phase.name), *before.end())
    residuals = pointwise.residuals if phase.shapes.algebraic else _nothing
    return PhaseFamilies(
        Family(known, decisions[: 0 if layout.plan.is_affine else None], none),
        initial,
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
        Family(composed, own.shared, composing[:, None]),
        observed(pointwise.nodes, nodes, node_sides),
        Family(pointwise.level if pointwise.is_open else _nothing, *own.end()),
    )


def functions(problem: Problem, constants: Constants | None, plan: Plan | AbstractMeanRate) -> dict[int, Block]:
    """The functions of families, by their numbers: of all on a plan; by mean rates alone, of those that grow with the
    mesh.
    """
    every = Pointwise.each(problem)
    names = max(_names(problem, one.phase) for one in every)
    if isinstance(plan, AbstractMeanRate):
        blocks = [{RATES: partial(one.mean_rates, plan), EQUATIONS: one.residuals} for one in every]
        return {
            number_of(kind, i, len(every)): partial(together, names, block)
            for i, own in enumerate(blocks)
            for kind, block in own.items()
        }
    assert constants is not None
    layout = Layout.of(problem, plan)
    nowhere = np.zeros((plan.realisations, len(problem.placements.germ_names)))
    whole = families(layout, problem, constants, nowhere, layout.view(np.zeros(layout.count))).every
    return {i: partial(together, names, one.function) for i, one in enumerate(whole)}


def _names(problem: Problem, phase: str) -> int:
    """How many states and algebraic variables of a phase have names."""
    system = problem.simulation.of(f"{phase}." if phase else "").system
    assert isinstance(system, System)
    return len(system.states) + len(system.algebraic)


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
        shared=np.concatenate([variables.phases[0].duration.ravel(), family.shared]),
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
    constants = constants.for_one_of(len(own))
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
    numbers = cache(partial(named_numbers, problem.simulation, decisions))
    pairs = [*_taken(parts[0], others), *_taken(parts[1], own)]
    coefficients = {one.functional: values for one, values in pairs if one.is_expanded}
    realised = {one.functional: values for one, values in pairs if not one.is_expanded}
    scope = ExpansionScope(coefficients, constants, numbers, scenarios=realised, totals=iter(totals))
    return jnp.ravel(expression.evaluate(scope))


def _taken(parts: list[_Part], numbers: Array) -> list[tuple[_Part, Array]]:
    """Parts with their values, from these side by side."""
    return list(zip(parts, apart(numbers, [one.shape for one in parts]), strict=True))
