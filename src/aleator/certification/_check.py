"""CHECK: a problem at one point, by other means than those that found it.

One compiled program simulates the collocation points and fresh systems, which no solver has seen, on a finer grid and
with an integrator of another order. The finer grid has an odd prime number of times as many steps, so that its instants
are in no phase with those of the problem's: what is constant at these, such as a ripple of their period, shows there.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, TypeVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Bound, Compiled, Use
from aleator._core.parallel import beside
from aleator.certification._fresh import FreshSystems, simulates_inside, systems_of
from aleator.design import (
    AbstractFunctional,
    Constraint,
    Peak,
    Problem,
    Statistic,
    divides_steps,
    functionals_of,
    grid_at,
    statistics_in,
)
from aleator.dynamics import FINER, AbstractIntegrator, Grid, Rodas5P, Simulation
from aleator.expansion import Collocation
from aleator.statistics import Constants, Mean, Std
from aleator.trajectories import AbstractTrajectory, BSpline, least_steps, piecewise_in
from aleator.transcription import AbstractTranscribed, Discretised, scope_from, simulated

_Part = TypeVar("_Part")

# Factor of steps for systems that follow trajectories, whose limits are enforced between instants, and for others;
# then the least number of steps in all, and between two knots.
_FOLLOWING, _PLAIN, _FEWEST, _BY_PIECE = 11, 3, 1000, 4
# Most steps of all systems together in a check that takes longer to compile well than to run.
_BRIEF = 500_000
# Rounding as a part of the magnitude of an output and of a constraint, and integration error as a part of an output's.
_ROUNDING, ROUNDING, NEGLIGIBLE_SPREAD = 1e-12, 1e-9, 1e-6
# A simulation that departs from a mesh by so many times what it simulates; fractions of the duration that are the same.
_DEPARTED, _SAME = 10.0, 1e-9


@final
@dataclass(frozen=True)
class Check:
    """A problem's numbers at one point by CHECK.

    - `values`: the objective, then the constraints, those of paths at every instant of the finer grid;
    - `statistics`: each statistic in the expressions;
    - `reaches`: how large each functional could be in a typical system, see `AbstractFunctional.reach`;
    - `coefficients`: of the expansion of each functional, whose moments are `means` and `stds`;
    - `fresh`: each functional at the fresh systems; `predicted`: what its expansion predicts there;
    - `systems`: the fresh systems; `factor`: how many times as many steps the finer grid has; `integrator`: its name;
    - `departed`: by how much a simulation from the first instant departs from a mesh, in a sentence, if by so much that
      each step was simulated from the mesh's own state; else empty.

    Statistics, moments and functionals of paths are at every instant of the finer grid.
    """

    values: tuple[Float[np.ndarray, "..."], ...]
    statistics: tuple[Float[np.ndarray, "..."], ...]
    reaches: tuple[float, ...]
    coefficients: tuple[Float[np.ndarray, "terms ..."], ...]
    fresh: tuple[Float[np.ndarray, "fresh ..."], ...]
    predicted: tuple[Float[np.ndarray, "fresh ..."], ...]
    systems: FreshSystems
    factor: int
    integrator: str
    departed: str = ""

    @cached_property
    def means(self) -> tuple[Float[np.ndarray, "..."], ...]:
        """The mean of each functional."""
        return self._all_of(Mean())

    @cached_property
    def stds(self) -> tuple[Float[np.ndarray, "..."], ...]:
        """The standard deviation of each functional."""
        return self._all_of(Std())

    def _all_of(self, kind: Mean | Std) -> tuple[Float[np.ndarray, "..."], ...]:
        coefficients: tuple[Any, ...] = self.coefficients
        return tuple(np.asarray(kind.of(one, ())) for one in coefficients)

    def at_own(self, problem: Problem) -> dict[Statistic, Float[np.ndarray, "..."]]:
        """The statistics in the expressions of a problem, those of paths at the instants of its own grid."""
        each = zip(statistics_in(problem.expressions), map(np.asarray, self.statistics), strict=True)
        return {one: value[:: self.factor] if one.functionals[0].is_path else value for one, value in each}

    @property
    def is_finite(self) -> bool:
        """Whether all moments are."""
        return all(np.isfinite(one).all() for one in (*self.means, *self.stds))

    def spread(self, functional: int) -> Float[np.ndarray, "..."]:
        """The standard deviation of a functional in the fresh systems about the mean by its expansion."""
        away, weights = self.fresh[functional] - self.means[functional], self.systems.weights
        with np.errstate(over="ignore", invalid="ignore"):
            return np.sqrt(np.tensordot(weights, away**2, axes=1) / max(weights.sum(), 1.0))


def _check(
    problem: Problem,
    collocation: Collocation,
    constants: Constants,
    decisions: Float[Array, " n"],
    drawn: tuple[Float[Array, "fresh variables"], Float[Array, "systems parts states"] | None],
) -> tuple[Any, ...]:
    """Values, statistics and reaches as in `Check`; coefficients of each functional, and its fresh samples.

    `drawn`: fresh systems, and the states from which parts of the time are simulated.
    """
    systems, courses = drawn
    functionals = functionals_of(problem.expressions)
    names = dict.fromkeys(name for one in functionals for name in one.outputs)
    peaks = tuple(Peak((name,)) for name in names)
    every = tuple(dict.fromkeys((*functionals, *peaks)))
    points = jnp.concatenate([collocation.points, systems])
    fit, scenarios = collocation.pseudo_inverse, constants.scenarios
    samples, terms = simulated(problem, every, points, fit, scenarios, decisions, courses)
    scope = scope_from(problem, every, terms, constants, decisions)
    scope.take_together(problem.expressions)
    values = tuple(jnp.asarray(one.evaluate(scope)) for one in problem.expressions)
    coefficients = dict(zip(every, terms.coefficients, strict=True))
    by_functional = dict(zip(every, samples, strict=True))
    count, grid = len(collocation.points), grid_at(problem, decisions)
    # Of a typical system: the outermost points, whose weights are next to nothing, may exceed it by any factor.
    typical = jnp.abs(collocation.weights)
    highest = {
        name: jnp.tensordot(typical, by_functional[peak][:count], axes=1)
        for name, peak in zip(names, peaks, strict=True)
    }
    reaches = tuple(jnp.max(one.reach(highest, grid.of(one.place))) for one in functionals)
    fresh = tuple(by_functional[one][count:] for one in functionals)
    return values, tuple(scope.taken), reaches, tuple(coefficients[one] for one in functionals), fresh


def _use(problem: Problem, collocation: Collocation, *others: Any) -> Use:
    if divides_steps(problem):
        return Use.ONCE
    systems, _ = others[-1]
    steps = problem.grid.steps * (len(collocation.points) + len(systems))
    return Use.BRIEF if steps <= _BRIEF else Use.LOOPS


CHECK = Compiled(_check, use=_use)


def begin_check(
    transcribed: AbstractTranscribed,
    point: Float[np.ndarray, " variables"],
    factor: int,
    systems: FreshSystems | None = None,
) -> Callable[[], Check]:
    """Begin to check a problem at a point, on another core; the function returned waits for the result.

    `factor`: see `check_factor`; `systems`: fresh ones, as many as those of the first draw, which are the default.

    Where states are variables, a stiff model has an answer that no explicit method confirms: what is not finite is
    simulated again by an implicit one. Nor does a simulation from the first instant confirm the answer to an unstable
    one: where it departs by orders of magnitude, each step of the grid is simulated from the state that the mesh has.
    """
    systems = systems_of(transcribed.problem, 0) if systems is None else systems
    return checks_at(transcribed, point, factor)(systems)


def checks_at(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], factor: int
) -> Callable[[FreshSystems], Callable[[], Check]]:
    """`begin_check` as a function of the fresh systems, for several draws at one point."""
    problem = transcribed.problem

    @cache
    def bound(integrator: AbstractIntegrator) -> Bound:
        return _bound(problem.finer(factor, integrator), transcribed.discretised, transcribed.decisions(point))

    def begun(systems: FreshSystems, integrator: AbstractIntegrator, departed: str = "") -> Callable[[], Check]:
        named = type(integrator).__name__ if problem.is_integrated else "Simpson's rule"
        courses = _courses(transcribed, point, systems) if departed else None
        check, drawn = bound(integrator), (systems.points, courses)
        check.begin(drawn)
        wait = beside(lambda: check(drawn))

        def result() -> Check:
            values, statistics, reaches, coefficients, fresh = jax.tree.map(np.asarray, wait())
            predict = transcribed.discretised.basis.matrix(systems.points)
            predicted = tuple(np.tensordot(predict, one, axes=1) for one in coefficients)
            numbers = values, statistics, tuple(map(float, reaches)), coefficients, fresh, predicted
            return Check(*numbers, systems, factor, named, departed)

        return result

    reference = problem.integrator.reference()

    def begin(systems: FreshSystems) -> Callable[[], Check]:
        explicit = begun(systems, reference)

        def checked() -> Check:
            # Asked for next; computed here while the check runs on another core.
            transcribed.resolve(point)
            check = explicit()
            if transcribed.fineness == 1 or not problem.is_integrated:
                return check
            if not check.is_finite:
                check = begun(systems, Rodas5P())()
            # The parts of a time that is sought, or of several phases, cannot be simulated each by itself.
            has_parts = isinstance(problem.grid, Grid) and problem.grid.until is None
            if not has_parts or not (departed := _departed(transcribed, point, check)):
                return check
            again = begun(systems, reference, departed)()
            return again if again.is_finite else begun(systems, Rodas5P(), departed)()

        return checked

    return begin


def _departed(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check) -> str:
    """By how much a simulation departs most from what a program says of its point, in a sentence; empty unless that is
    by orders of magnitude.
    """
    functionals, resolved = functionals_of(transcribed.problem.expressions), transcribed.resolve(point)
    bounds = rounding_at(transcribed, point, [0.0] * len(functionals))
    furthest, sentence = _DEPARTED, ""
    for one, mean in zip(functionals, check.means, strict=True):
        own = np.asarray(resolved[one.text()].mean)
        away = float(np.max(np.abs(mean[:: check.factor] - own if one.is_path else mean - own)))
        size = max(float(np.max(np.abs(own))), bounds[one] / ROUNDING)
        # NaN departs furthest.
        if size > 0 and not away <= furthest * size:
            furthest, sentence = away / size, f"{one.text()} departs by {away:.2g}, where its magnitude is {size:.2g}"
    return sentence


def _courses(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], systems: FreshSystems
) -> Float[np.ndarray, "systems steps states"]:
    """The states of a mesh at the beginning of each step of the grid: at the collocation points, at the fresh systems
    as their expansions predict them, and at the scenarios.
    """
    states, (basis, collocation, _) = transcribed.states_at(point), transcribed.discretised
    assert states is not None
    assert isinstance(transcribed.problem.grid, Grid)
    begins = np.searchsorted(states.fractions(), transcribed.problem.grid.fractions[:-1] - _SAME)
    rows, count = states.rows()[:, begins], len(collocation.points)
    fitted = np.tensordot(np.asarray(collocation.pseudo_inverse), rows[:count], axes=1)
    predicted = np.tensordot(np.asarray(basis.matrix(systems.points)), fitted, axes=1)
    return np.concatenate([rows[:count], predicted, rows[count:]])


def prepare_check(factor: int, problem: Problem, discretised: Discretised) -> Callable[[], object]:
    """Begin to compile what `begin_check` will need, on another core; the function returned completes this."""
    if not is_checked(problem):
        return lambda: None
    finer, start = problem.finer(factor, problem.integrator.reference()), problem.placements.vector("initial")
    bound, drawn = _bound(finer, discretised, start), (systems_of(problem, 0).points, None)
    bound.begin(drawn)
    return lambda: bound.prepare(drawn)


def is_checked(problem: Problem) -> bool:
    """Whether a problem simulates something that has a grid, or that is uncertain."""
    has_parts = problem.system.has_time or bool(problem.placements.germs) or simulates_inside(problem)
    return has_parts and bool(functionals_of(problem.expressions))


def _bound(problem: Problem, discretised: Discretised, decisions: Float[np.ndarray, " n"]) -> Bound:
    """CHECK of a problem, of fresh systems and the states of `_courses`."""
    _, collocation, constants = discretised
    return CHECK.bound(numbers_to_arrays(problem), collocation, constants, jax_array(decisions), packed=False)


def check_factor(problem: Problem, between: int | None) -> int:
    """How many times as many steps the finer grid of a problem has, an odd prime number times what reaches the nodes of
    its controls; 1 without time.

    `between`: the least number, see `solve`.
    """
    if not functionals_of(problem.expressions):
        return 1
    if not problem.system.has_time:
        return FINER if simulates_inside(problem) else 1
    phases = problem.simulation.phases.values()
    chosen = between if between is not None else _FOLLOWING if pieces(problem) else _PLAIN
    by_piece = max(-(-_BY_PIECE * _pieces(one) // one.grid.steps) for one in phases)
    least = max(chosen, -(-_FEWEST // problem.grid.steps), by_piece, 3)
    # Steps end at each node of a control.
    own = (math.lcm(least_steps((one.system, one.inputs)), one.grid.steps) // one.grid.steps for one in phases)
    whole = math.lcm(*own)
    least = max(3, -(-least // whole))
    prime = next(one for one in range(least, 2 * least) if all(one % k for k in range(2, int(one**0.5) + 1)))
    return whole * prime


def rounding_at(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], reaches: Iterable[float]
) -> dict[AbstractFunctional, float]:
    """The rounding of functionals, by how large they could be, or as far as constraints on them show it: one with a
    bound of zero is a difference of numbers of its constraint's magnitude.
    """
    problem, sizes = transcribed.problem, row_sizes(transcribed, point)
    rounding = {one: _ROUNDING * reach for one, reach in zip(functionals_of(problem.expressions), reaches, strict=True)}
    for one, rows in zip(problem.constraints, transcribed.rows, strict=True):
        size = float(np.max(sizes[rows], initial=0.0))
        for functional, factor in bounded_by(one):
            rounding[functional] = max(rounding[functional], ROUNDING * size / factor)
    return rounding


def row_sizes(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " rows"]:
    """The magnitude of each row of the constraints around a point."""
    program = transcribed.program
    if program.sizes is None:
        return np.ones(len(program.constraint_lower)) * program.constraint_scale
    return program.sizes(point, program.evaluate(point))


def bounded_by(constraint: Constraint) -> Iterator[tuple[Any, float]]:
    """The functionals that a constraint bounds in their own unit, and the magnitudes of their factors."""
    for factor, atom in zip(constraint.expression.factors, constraint.expression.atoms, strict=True):
        if isinstance(atom, Statistic) and atom.kind.speaks_of_one_system and float(factor) != 0:
            yield from ((one, abs(float(factor))) for one in atom.functionals)


def spread_functionals(problem: Problem) -> tuple[AbstractFunctional, ...]:
    """The functionals of which a statistic other than the mean stands in a problem."""
    atoms = [atom for atom in statistics_in(problem.expressions) if not isinstance(atom.kind, Mean)]
    return tuple(dict.fromkeys(one for atom in atoms for one in atom.functionals))


def certain(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], check: Check, *further: Check
) -> tuple[AbstractFunctional, ...]:
    """The functionals whose spread is rounding or, where none stands in the problem, the error of an integrator: by
    the expansion, and in the fresh systems of all checks as far as they have values.

    For example, the rate at the end of a motion that comes to rest is zero in every system, up to rounding.
    """
    rounding, judged = rounding_at(transcribed, point, check.reaches), spread_functionals(transcribed.problem)

    def is_certain(i: int, one: AbstractFunctional) -> bool:
        negligible = max(rounding[one], 0.0 if one in judged else NEGLIGIBLE_SPREAD * check.reaches[i])
        spreads = [np.max(other.spread(i), initial=0.0) for other in (check, *further)]
        return bool(np.max(check.stds[i]) <= negligible) and not any(spread > negligible for spread in spreads)

    return tuple(one for i, one in enumerate(functionals_of(transcribed.problem.expressions)) if is_certain(i, one))


def pieces(problem: Problem) -> int:
    """The largest number of polynomial pieces of the trajectories that a problem's system follows; 0 for none.

    What follows trajectories is arbitrary between two instants.
    """
    return max(map(_pieces, problem.simulation.phases.values()))


def _pieces(phase: Simulation) -> int:
    parts = phase.system, phase.inputs
    whole = least_steps(parts) if piecewise_in(parts) else 0
    splines = (one.count - one.degree for one in parts_in(parts, BSpline))
    return max([bool(parts_in(parts, AbstractTrajectory)), whole, *splines])


def parts_in(tree: Any, kind: type[_Part]) -> list[_Part]:
    """All parts of a model that are of a kind, including those inside parts of other kinds."""
    leaves = jax.tree.leaves(tree, is_leaf=lambda node: isinstance(node, kind))
    return [one for one in leaves if isinstance(one, kind)]
