"""CHECK: a problem at one point, by other means than those that found it.

One compiled program simulates the collocation points and fresh systems, which no solver has seen, on a finer grid and
with an integrator of another order. The finer grid has an odd prime number of times as many steps, so that its instants
are in no phase with those of the problem's: what is constant at these, such as a ripple of their period, shows there.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Bound, Compiled, Use
from aleator._core.parallel import beside
from aleator.certification._fresh import FreshSystems, is_checked, systems_of
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
from aleator.dynamics import AbstractIntegrator, Grid, Rodas5P
from aleator.expansion import Collocation
from aleator.statistics import AbstractTail, Constants, Mean, Std
from aleator.transcription import AbstractTranscribed, Discretised, Meaning, scope_from, simulated

# Most steps of all systems together in a check that takes longer to compile well than to run.
_BRIEF = 500_000
# Rounding as a part of the magnitude of an output and of a constraint, and integration error as a part of an output's.
_ROUNDING, ROUNDING, NEGLIGIBLE_SPREAD = 1e-12, 1e-9, 1e-6
# A simulation that departs from a mesh by so many times what it simulates; fractions of the duration that are the same.
_DEPARTED, _SAME = 10.0, 1e-9


@final
@dataclass(frozen=True)
class Checked:
    """One functional by CHECK, a path at every instant of the finer grid.

    - `reach`: how large it could be in a typical system, see `AbstractFunctional.reach`;
    - `coefficients`: of its expansion, whose moments are `mean` and `std`;
    - `fresh`: at the fresh systems, of some `weights`; `predicted`: what its expansion predicts there.
    """

    reach: float
    coefficients: Float[np.ndarray, "terms ..."]
    fresh: Float[np.ndarray, "fresh ..."]
    predicted: Float[np.ndarray, "fresh ..."]
    weights: Float[np.ndarray, " fresh"]

    @cached_property
    def mean(self) -> Float[np.ndarray, "..."]:
        """The mean by its expansion."""
        return np.asarray(Mean().of(self.coefficients, ()))  # type: ignore[arg-type]

    @cached_property
    def std(self) -> Float[np.ndarray, "..."]:
        """The standard deviation by its expansion."""
        return np.asarray(Std().of(self.coefficients, ()))  # type: ignore[arg-type]

    @property
    def spread(self) -> Float[np.ndarray, "..."]:
        """The standard deviation in the fresh systems about the mean by its expansion."""
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.tensordot(self.weights, (self.fresh - self.mean) ** 2, axes=1)
            return np.sqrt(squares / max(self.weights.sum(), 1.0))


@final
@dataclass(frozen=True)
class Check:
    """A problem at one point of its program by CHECK.

    - `values`: the objective, then the constraints, those of paths at every instant of the finer grid;
    - `statistics`: each statistic in the expressions, at the instants of the problem's own grid;
    - `functionals`: each functional in them;
    - `systems`: the fresh systems; `factor`: how many times as many steps the finer grid has; `integrator`: its name;
    - `departed`: by how much a simulation from the first instant departs from a mesh, in a sentence, if by so much that
      each step was simulated from the mesh's own state; else empty.
    """

    transcribed: AbstractTranscribed
    point: Float[np.ndarray, " variables"]
    values: tuple[Float[np.ndarray, "..."], ...]
    statistics: dict[Statistic, Float[np.ndarray, "..."]]
    functionals: dict[AbstractFunctional, Checked]
    systems: FreshSystems
    factor: int
    integrator: str
    departed: str = ""

    @property
    def problem(self) -> Problem:
        """The problem."""
        return self.transcribed.problem

    @property
    def meaning(self) -> Meaning:
        """What its program says of the point."""
        return self.transcribed.at(self.point)

    @cached_property
    def times(self) -> Float[np.ndarray, " instants"]:
        """The instants of the problem's own grid, s."""
        return self.transcribed.times(self.point)

    @cached_property
    def rounding(self) -> dict[AbstractFunctional, float]:
        """The rounding of functionals, by how large they could be, or as far as constraints on them show it."""
        seen = magnitudes_in_limits(self.transcribed, self.point)
        return {one: max(_ROUNDING * own.reach, ROUNDING * seen[one]) for one, own in self.functionals.items()}

    @property
    def is_finite(self) -> bool:
        """Whether all moments are."""
        return all(np.isfinite(part).all() for own in self.functionals.values() for part in (own.mean, own.std))

    @property
    def gained(self) -> float:
        """By how much the objective differs from that at the start."""
        return abs(self.transcribed.at(self.transcribed.program.start).objective - self.meaning.objective)

    def again(self, draws: Iterable[FreshSystems]) -> "list[Check]":
        """The same with other fresh systems, as many in each draw."""
        waiting = [self._begin(systems) for systems in draws]
        return [check() for check in waiting]

    @cached_property
    def _begin(self) -> "Callable[[FreshSystems], Callable[[], Check]]":
        return checks_at(self.transcribed, self.point, self.factor)

    def at_instants(self, number: int) -> Float[np.ndarray, " some"]:
        """The rows of a constraint at the instants of the problem's own grid, by its program."""
        return self.transcribed.at_instants(self.problem.constraints[number], self.meaning.constraints[number])

    def own(self, functional: AbstractFunctional) -> Any:
        """Where the values of a functional at the instants of the problem's own grid stand among all."""
        return np.s_[:: self.factor] if functional.is_path else ...


def _check(
    problem: Problem,
    collocation: Collocation,
    constants: Constants,
    decisions: Float[Array, " n"],
    drawn: tuple[Float[Array, "fresh variables"], Mapping[str, Float[Array, "systems parts states"]] | None],
) -> tuple[Any, ...]:
    """Values, and statistics at all instants, as in `Check`; reaches, coefficients and fresh samples of functionals.

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
    # Tails by lines have more equations than the steps, and few runs.
    if divides_steps(problem) or any(isinstance(one.kind, AbstractTail) for one in statistics_in(problem.expressions)):
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
    one: where it departs by orders of magnitude, each step of the grid is simulated from the state that the mesh has,
    or a phase that an event ends, as a whole.
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
            values, statistics, *parts = jax.tree.map(np.asarray, wait())
            predict = transcribed.discretised.basis.matrix(systems.points)
            functionals = {
                one: Checked(float(reach), terms, fresh, np.tensordot(predict, terms, axes=1), systems.weights)
                for one, reach, terms, fresh in zip(functionals_of(problem.expressions), *parts, strict=True)
            }
            every = zip(statistics_in(problem.expressions), statistics, strict=True)
            of_own = {one: value[::factor] if one.functionals[0].is_path else value for one, value in every}
            return Check(transcribed, point, values, of_own, functionals, systems, factor, named, departed)

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
            # A time that is sought has no parts that could be simulated each by itself.
            is_sought = isinstance(problem.grid, Grid) and problem.grid.until is not None
            if is_sought or not (departed := _departed(check)):
                return check
            again = begun(systems, reference, departed)()
            return again if again.is_finite else begun(systems, Rodas5P(), departed)()

        return checked

    return begin


def _departed(check: Check) -> str:
    """By how much a simulation departs most from what a program says of its point, in a sentence; empty unless that is
    by orders of magnitude.
    """
    resolved, seen = check.transcribed.resolve(check.point), magnitudes_in_limits(check.transcribed, check.point)
    furthest, sentence = _DEPARTED, ""
    for one, checked in check.functionals.items():
        own = np.asarray(resolved[one.text()].mean)
        away = float(np.max(np.abs(checked.mean[check.own(one)] - own)))
        size = max(float(np.max(np.abs(own))), seen[one])
        # NaN departs furthest.
        if size > 0 and not away <= furthest * size:
            furthest, sentence = away / size, f"{one.text()} departs by {away:.2g}, where its magnitude is {size:.2g}"
    return sentence


def _courses(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], systems: FreshSystems
) -> dict[str, Float[np.ndarray, "systems steps states"]]:
    """By phase, the states of a mesh at the beginning of each step of its grid, or of the phase if an event ends it: at
    the collocation points, at the fresh systems as their expansions predict them, and at the scenarios.
    """
    states, grid, (basis, collocation, _) = (
        transcribed.states_at(point),
        transcribed.problem.grid,
        transcribed.discretised,
    )
    assert states is not None
    predict, count, courses = np.asarray(basis.matrix(systems.points)), len(collocation.points), {}
    for phase in states.phases or ("",):
        own = grid.of(f"{phase}.")
        assert isinstance(own, Grid)
        steps = own.fractions[: 1 if own.until is not None else -1]
        rows = states.rows(phase)[:, np.searchsorted(states.fractions(phase), steps - _SAME)]
        fitted = np.tensordot(np.asarray(collocation.pseudo_inverse), rows[:count], axes=1)
        courses[phase] = np.concatenate([rows[:count], np.tensordot(predict, fitted, axes=1), rows[count:]])
    return courses


def prepare_check(factor: int, problem: Problem, discretised: Discretised) -> Callable[[], object]:
    """Begin to compile what `begin_check` will need, on another core; the function returned completes this."""
    if not is_checked(problem):
        return lambda: None
    finer, start = problem.finer(factor, problem.integrator.reference()), problem.placements.vector("initial")
    bound, drawn = _bound(finer, discretised, start), (systems_of(problem, 0).points, None)
    bound.begin(drawn)
    return lambda: bound.prepare(drawn)


def _bound(problem: Problem, discretised: Discretised, decisions: Float[np.ndarray, " n"]) -> Bound:
    """CHECK of a problem, of fresh systems and the states of `_courses`."""
    _, collocation, constants = discretised
    return CHECK.bound(numbers_to_arrays(problem), collocation, constants, jax_array(decisions), packed=False)


def magnitudes_in_limits(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"]
) -> dict[AbstractFunctional, float]:
    """How large functionals are by the constraints on them: one with a bound of zero is a difference of numbers of its
    constraint's magnitude.
    """
    problem, sizes = transcribed.problem, row_sizes(transcribed, point)
    largest = dict.fromkeys(functionals_of(problem.expressions), 0.0)
    for one, rows in zip(problem.constraints, transcribed.rows, strict=True):
        for functional, factor in bounded_by(one):
            largest[functional] = max(largest[functional], float(np.max(sizes[rows], initial=0.0)) / factor)
    return largest


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


def certain(check: Check, *further: Check) -> tuple[AbstractFunctional, ...]:
    """The functionals whose spread is rounding or, where none stands in the problem, the error of an integrator: by
    the expansion, and in the fresh systems of all checks as far as they have values.

    For example, the rate at the end of a motion that comes to rest is zero in every system, up to rounding.
    """
    judged = spread_functionals(check.problem)

    def is_certain(one: AbstractFunctional, own: Checked) -> bool:
        negligible = max(check.rounding[one], 0.0 if one in judged else NEGLIGIBLE_SPREAD * own.reach)
        spreads = [np.max(other.functionals[one].spread, initial=0.0) for other in (check, *further)]
        return bool(np.max(own.std) <= negligible) and not any(spread > negligible for spread in spreads)

    return tuple(one for one, own in check.functionals.items() if is_certain(one, own))
