"""A problem at one point, by other means than those that found it: the collocation points and fresh systems, which no
solver has seen, are simulated on a finer grid by an integrator of another order, see `_systems.py`.

All checks of an answer read two tables: `Check.functionals` and `Check.limits`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array, quietly
from aleator.certification._systems import FreshSystems, Nodes, Simulations, Values, systems_of
from aleator.design import (
    AbstractFunctional,
    Constraint,
    Expression,
    Path,
    Problem,
    Statistic,
    functionals_of,
    grid_at,
    instants_of,
    statistics_in,
)
from aleator.dynamics import AbstractIntegrator, Grid, Rodas5P
from aleator.statistics import AbstractAtLevel, Mean, Std, Variance
from aleator.transcription import (
    AbstractTranscribed,
    ExpansionScope,
    Meaning,
    Terms,
    bound_size,
    excess_of,
    scope_from,
    tails_in,
)

# Rounding as a part of the magnitude of an output and of a constraint, and integration error as a part of an output's.
_ROUNDING, ROUNDING, NEGLIGIBLE_SPREAD = 1e-12, 1e-9, 1e-6
# A simulation that departs from a mesh by so many times what it simulates.
_DEPARTED = 10.0


@final
@dataclass(frozen=True)
class Checked:
    """One functional by CHECK, a path at every instant of the finer grid.

    - `reach`: how large it could be in a typical system, see `AbstractFunctional.reach`;
    - `in_limits`: how large it is by the constraints on it: one with a bound of zero is a difference of numbers of its
      constraint's magnitude;
    - `is_spread`: whether a statistic of it other than the mean stands in the problem;
    - `coefficients`: of its expansion, whose moments are `mean` and `std`;
    - `fresh`: at the fresh systems, of some `weights`; `predicted`: what its expansion predicts there.
    """

    reach: float
    in_limits: float
    is_spread: bool
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
    def rounding(self) -> float:
        """Its rounding, by how large it could be, or as far as constraints on it show it."""
        return max(_ROUNDING * self.reach, ROUNDING * self.in_limits)

    @cached_property
    def is_certain(self) -> bool:
        """Whether its spread is rounding or, where none stands in the problem, the error of an integrator: by the
        expansion, and in the fresh systems about the mean as far as they have values.

        For example, the rate at the end of a motion that comes to rest is zero in every system, up to rounding.
        """
        negligible = max(self.rounding, 0.0 if self.is_spread else NEGLIGIBLE_SPREAD * self.reach)
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.tensordot(self.weights, (self.fresh - self.mean) ** 2, axes=1)
            spread = np.max(np.sqrt(squares / max(self.weights.sum(), 1.0)), initial=0.0)
        return bool(np.max(self.std) <= negligible) and not spread > negligible

    def at(self, where: Any) -> "Checked":
        """The same at some instants."""
        some = slice(None), where
        return replace(
            self, coefficients=self.coefficients[some], fresh=self.fresh[some], predicted=self.predicted[some]
        )


class Limit(NamedTuple):
    """A limit on both grids, a path with a row for each instant, others with one row.

    - `own`, `fine`: its values at the instants of the problem's grid, and of that with `factor` times as many steps;
    - `size`: its smaller bound or, where that is zero, how large its expression may be;
    - `times`: the instants of its own rows, s; NaN for a limit that is no path.
    """

    constraint: Constraint
    own: Float[np.ndarray, "instants entries"]
    fine: Float[np.ndarray, "finer entries"]
    factor: int
    size: float
    times: Float[np.ndarray, " instants"]

    @property
    def beyond(self) -> Float[np.ndarray, "finer entries"]:
        """The excess over the nearer bound on the finer grid."""
        return excess_of(self.constraint, self.fine)

    @property
    def away(self) -> Float[np.ndarray, "instants entries"]:
        """How far its own values are from what it reaches on the finer grid within a step, so that a jump that lies on
        the other side of an instant there makes no difference.
        """
        windows = np.arange(len(self.own))[:, None] * self.factor + np.arange(-self.factor, self.factor + 1)
        around = self.fine[np.clip(windows, 0, len(self.fine) - 1)]
        return np.maximum(self.own - around.max(axis=1), around.min(axis=1) - self.own)

    def __str__(self) -> str:
        return f"'{self.constraint.name}' ({self.constraint})"


@final
@dataclass(frozen=True)
class Check:
    """A problem at one point of its program by CHECK.

    - `functionals`: each functional in the expressions; `scope`: what these follow from on the finer grid;
    - `systems`: the fresh systems; `simulations`: of any others;
    - `factor`: how many times as many steps the finer grid has.
    """

    functionals: dict[AbstractFunctional, Checked]
    scope: ExpansionScope
    systems: FreshSystems
    simulations: Simulations
    factor: int

    @property
    def transcribed(self) -> AbstractTranscribed:
        """The problem's program."""
        return self.simulations.transcribed

    @property
    def point(self) -> Float[np.ndarray, " variables"]:
        """The point of the program."""
        return self.simulations.point

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
    def limits(self) -> tuple[Limit, ...]:
        """All limits of the problem, on both grids."""
        sizes, limits = row_sizes(self.transcribed, self.point), []
        each = zip(self.problem.constraints, self.values[1:], self.transcribed.rows, strict=True)
        for i, (one, fine, rows) in enumerate(each):
            times = instants_of(one, self.problem.grid, lambda: self.times)
            size = bound_size(one) or self.reach_of(one.expression) or float(np.max(sizes[rows]))
            own, fine = self.at_instants(i).reshape(len(times), -1), fine.reshape(len(fine) if one.is_path else 1, -1)
            limits.append(Limit(one, own, fine, self.factor, size, times))
        return tuple(limits)

    @cached_property
    def statistics(self) -> dict[Statistic, Float[np.ndarray, "..."]]:
        """Each statistic in the expressions, at the instants of the problem's own grid."""
        every = {one: np.asarray(one.evaluate(self.scope)) for one in statistics_in(self.problem.expressions)}
        return {one: value[self.own(one)] for one, value in every.items()}

    @property
    def is_finite(self) -> bool:
        """Whether all moments are."""
        return all(np.isfinite(part).all() for own in self.functionals.values() for part in (own.mean, own.std))

    @property
    def gained(self) -> float:
        """By how much the objective differs from that at the start."""
        return abs(self.transcribed.at(self.transcribed.program.start).objective - self.meaning.objective)

    def reach_of(self, expression: Expression) -> float:
        """The possible size of an expression, from that of its functionals; zero if unknown."""

        def reach(atom: Any) -> float:
            if not isinstance(atom, Statistic):
                return 0.0
            largest = self.functionals[atom.functionals[0]].reach
            if isinstance(atom.kind, Variance):
                return largest**2
            # A spread is no larger than the functional itself.
            return largest if atom.kind.speaks_of_one_system or isinstance(atom.kind, Std) else 0.0

        terms = zip(expression.factors, expression.atoms, strict=True)
        return sum(abs(float(factor)) * sum(map(reach, atom.parts)) for factor, atom in terms)

    def of(self, systems: FreshSystems) -> "Check":
        """The same with other fresh systems."""
        values, matrix = self.simulations.at(systems.points), self.transcribed.basis.matrix(systems.points)

        def checked(one: AbstractFunctional, own: Checked) -> Checked:
            predicted = np.tensordot(matrix, own.coefficients, axes=1)
            return replace(own, fresh=values[one], predicted=predicted, weights=systems.weights)

        each = self.functionals.items()
        return replace(self, systems=systems, functionals={one: checked(one, own) for one, own in each})

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
        simulations = Simulations(transcribed, point, problem.finer(factor, integrator), departed)
        simulated = simulations.begin(systems)

        def result() -> Check:
            functionals, scope = _expanded(simulations, systems, factor, *simulated())
            return Check(functionals, scope, systems, simulations, factor)

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
    simulations: Simulations, systems: FreshSystems, factor: int, values: Values, nodes: Nodes
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
        history = values[Path((name,))][:count, ::factor]
        peaks[name] = np.tensordot(typical, np.maximum(history.max(axis=1), -history.min(axis=1)), axes=1)
    sizes, in_limits = row_sizes(transcribed, simulations.point), dict.fromkeys(functionals, 0.0)
    for one, rows in zip(problem.constraints, transcribed.rows, strict=True):
        for functional, unit in bounded_by(one):
            largest = float(np.max(sizes[rows], initial=0.0)) / unit
            in_limits[functional] = max(in_limits[functional], largest)
    atoms = (atom for atom in statistics_in(problem.expressions) if not isinstance(atom.kind, Mean))
    # Of what white noise adds to a variance the mean stands there.
    spread = [one for atom in atoms for one in atom.functionals[: 1 if getattr(atom.kind, "noisy", False) else None]]
    grid, matrix = grid_at(problem, decisions), transcribed.basis.matrix(systems.points)
    checked = {
        one: Checked(
            reach=float(np.max(one.reach(peaks, grid.of(one.place)))),
            in_limits=in_limits[one],
            is_spread=one in spread,
            coefficients=np.asarray(own),
            fresh=values[one][count : count + drawn].copy(),  # without all the others
            predicted=np.tensordot(matrix, own, axes=1),
            weights=systems.weights,
        )
        for one, own in zip(functionals, terms.coefficients, strict=True)
    }
    scope = scope_from(problem, functionals, terms, transcribed.constants, decisions)
    for one in tails_in(transcribed.problem.expressions):
        if one.is_path and isinstance(one.kind, AbstractAtLevel):
            # At all instants they would take longer than all the rest.
            own, lines = np.asarray(scope.coefficients[one.functionals[0]]), scope.constants.of(one.kind)
            scope.know((one,), (one.kind.along(own, lines, factor),))
    return checked, scope


def _departed(check: Check) -> str:
    """By how much a simulation departs most from what a program says of its point, in a sentence; empty unless that is
    by orders of magnitude.
    """
    resolved, furthest, sentence = check.transcribed.resolve(check.point), _DEPARTED, ""
    for one, checked in check.functionals.items():
        own = np.asarray(resolved[one.text()].mean)
        away = float(np.max(np.abs(checked.mean[check.own(one)] - own)))
        size = max(float(np.max(np.abs(own))), checked.in_limits)
        # NaN departs furthest.
        if size > 0 and not away <= furthest * size:
            furthest, sentence = away / size, f"{one.text()} departs by {away:.2g}, where its magnitude is {size:.2g}"
    return sentence


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
