"""A problem at one point, by other means than those that found it: the collocation points and fresh systems, which no
solver has seen, are simulated on a finer grid by an integrator of another order, see `_systems.py`.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array, quietly
from aleator.certification._systems import FreshSystems, Simulations, Values, history_of, systems_of
from aleator.design import AbstractFunctional, Constraint, Problem, Statistic, functionals_of, grid_at, statistics_in
from aleator.dynamics import AbstractIntegrator, Grid, Rodas5P
from aleator.statistics import Mean, Std
from aleator.transcription import AbstractTranscribed, ExpansionScope, Meaning, Terms, scope_from

# Rounding as a part of the magnitude of an output and of a constraint, and integration error as a part of an output's.
_ROUNDING, ROUNDING, NEGLIGIBLE_SPREAD = 1e-12, 1e-9, 1e-6
# A simulation that departs from a mesh by so many times what it simulates.
_DEPARTED = 10.0


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

    - `functionals`: each functional in the expressions; `scope`: what these follow from on the finer grid;
    - `systems`: the fresh systems; `simulations`: of any others;
    - `factor`: how many times as many steps the finer grid has;
    - `departed`: by how much a simulation from the first instant departs from a mesh, in a sentence, if by so much that
      each step was simulated from the mesh's own state; else empty.
    """

    functionals: dict[AbstractFunctional, Checked]
    scope: ExpansionScope
    systems: FreshSystems
    simulations: Simulations
    factor: int
    departed: str

    @property
    def transcribed(self) -> AbstractTranscribed:
        """The problem's program."""
        return self.simulations.transcribed

    @property
    def point(self) -> Float[np.ndarray, " variables"]:
        """The point of the program."""
        return self.simulations.point

    @property
    def integrator(self) -> str:
        """What simulates on the finer grid."""
        problem = self.simulations.problem
        return type(problem.integrator).__name__ if problem.is_integrated else "Simpson's rule"

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
    def values(self) -> tuple[Float[np.ndarray, "..."], ...]:
        """The objective, then the constraints, those of paths at every instant of the finer grid."""
        return tuple(np.asarray(one.evaluate(self.scope)) for one in self.problem.expressions)

    @cached_property
    def statistics(self) -> dict[Statistic, Float[np.ndarray, "..."]]:
        """Each statistic in the expressions, at the instants of the problem's own grid."""
        every = {one: np.asarray(one.evaluate(self.scope)) for one in statistics_in(self.problem.expressions)}
        return {one: value[self.own(one)] for one, value in every.items()}

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

    def again(self, draws: Iterable[FreshSystems]) -> "Check":
        """The same with all systems of some draws in the place of the present ones."""
        systems = FreshSystems(*map(np.concatenate, zip(*draws, strict=True)))
        values, matrix = self.simulations.at(systems.points), self.transcribed.basis.matrix(systems.points)
        functionals = {
            one: replace(
                own,
                fresh=values[one],
                predicted=np.tensordot(matrix, own.coefficients, axes=1),
                weights=systems.weights,
            )
            for one, own in self.functionals.items()
        }
        return replace(self, systems=systems, functionals=functionals)

    def at_instants(self, number: int) -> Float[np.ndarray, " some"]:
        """The rows of a constraint at the instants of the problem's own grid, by its program."""
        return self.transcribed.at_instants(self.problem.constraints[number], self.meaning.constraints[number])

    def own(self, functional: AbstractFunctional | Statistic) -> Any:
        """Where the values of a functional at the instants of the problem's own grid stand among all."""
        return np.s_[:: self.factor] if functional.is_path else ...


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
    problem = transcribed.problem
    systems = systems_of(problem, 0) if systems is None else systems

    def begun(integrator: AbstractIntegrator, departed: str = "") -> Callable[[], Check]:
        simulations = Simulations(transcribed, point, problem.finer(factor, integrator), in_parts=bool(departed))
        simulated = simulations.begin(systems)

        def result() -> Check:
            functionals, scope = _expanded(simulations, systems, factor, *simulated())
            return Check(functionals, scope, systems, simulations, factor, departed)

        return result

    reference = problem.integrator.reference()
    explicit = begun(reference)

    def checked() -> Check:
        # Asked for next; computed here while the check runs on another core.
        transcribed.resolve(point)
        check = explicit()
        if transcribed.fineness == 1 or not problem.is_integrated:
            return check
        if not check.is_finite:
            check = begun(Rodas5P())()
        # A time that is sought has no parts that could be simulated each by itself.
        is_sought = isinstance(problem.grid, Grid) and problem.grid.until is not None
        if is_sought or not (departed := _departed(check)):
            return check
        again = begun(reference, departed)()
        return again if again.is_finite else begun(Rodas5P(), departed)()

    return checked


@quietly
def _expanded(
    simulations: Simulations, systems: FreshSystems, factor: int, values: Values, nodes: tuple[np.ndarray, ...]
) -> tuple[dict[AbstractFunctional, Checked], ExpansionScope]:
    """Each functional, and the scope of the expressions, from all that `Simulations.begin` gives."""
    transcribed, problem = simulations.transcribed, simulations.problem
    collocation, functionals = transcribed.collocation, functionals_of(problem.expressions)
    count, drawn = len(collocation.points), len(systems.points)
    decisions = jax_array(transcribed.decisions(simulations.point))
    terms = Terms(
        coefficients=tuple(collocation.coefficients(values[one][:count]) for one in functionals),
        nodes=tuple(collocation.coefficients(one[:count]) for one in nodes),
        realised=tuple(values[one][count + drawn :] for one in functionals),
    )
    # Of a typical system: the outermost points, whose weights are next to nothing, may exceed it by any factor. The
    # instants of the problem's own grid tell how large it is.
    typical, peaks = np.abs(collocation.weights), {}
    for name in dict.fromkeys(name for one in functionals for name in one.outputs):
        history = values[history_of(name)][:count, ::factor]
        peaks[name] = np.tensordot(typical, np.maximum(history.max(axis=1), -history.min(axis=1)), axes=1)
    grid, matrix = grid_at(problem, decisions), transcribed.basis.matrix(systems.points)
    checked = {
        one: Checked(
            reach=float(np.max(one.reach(peaks, grid.of(one.place)))),
            coefficients=np.asarray(own),
            fresh=values[one][count : count + drawn].copy(),  # without all the others
            predicted=np.tensordot(matrix, own, axes=1),
            weights=systems.weights,
        )
        for one, own in zip(functionals, terms.coefficients, strict=True)
    }
    return checked, scope_from(problem, functionals, terms, transcribed.constants, decisions)


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
