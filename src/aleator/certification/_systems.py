"""CHECK: one compiled program that simulates systems on a finer grid, with an integrator of another order.

It gives functionals of each system, and nothing else: all that follows from them is computed by NumPy, for each further
operation beside a loop over time, such as a slice or a sum, takes as long to compile as some inside.

The finer grid has an odd prime number of times as many steps, so that its instants are in no phase with those of the
problem's: what is constant at these, such as a ripple of their period, shows there.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Bound, Compiled, Use
from aleator._core.parallel import beside
from aleator.certification._fresh import FreshSystems, is_checked, systems_of
from aleator.design import (
    AbstractFunctional,
    Path,
    Problem,
    Sampled,
    divides_steps,
    functionals_of,
    integrated_paths,
    sample,
)
from aleator.dynamics import Grid
from aleator.ensemble import fill
from aleator.transcription import AbstractTranscribed, Discretised

# Most steps of all systems together in checks that take longer to compile well than to run, about ten times in all.
_FEW_STEPS = 500_000
# Fractions of the duration that are the same.
_SAME = 1e-9

Values = dict[AbstractFunctional, Float[np.ndarray, "systems ..."]]
"""Functionals of some systems, and the histories of all outputs in them, as paths."""


def _recorded(problem: Problem) -> tuple[tuple[AbstractFunctional, ...], tuple[AbstractFunctional, ...]]:
    """The functionals of a problem with the histories of their outputs, and the paths integrated over time."""
    functionals = functionals_of(problem.expressions)
    histories = (history_of(name) for one in functionals for name in one.outputs)
    return tuple(dict.fromkeys((*functionals, *histories))), integrated_paths(problem.expressions)


def history_of(output: str) -> AbstractFunctional:
    """An output at all instants."""
    return Path((output,))


def _check(
    problem: Problem,
    decisions: Float[Array, " n"],
    systems: tuple[Float[Array, "systems variables"], Mapping[str, Float[Array, "systems parts states"]] | None],
) -> Sampled:
    """Functionals of some systems, and the histories of their outputs; paths have their instants along the first axis,
    as they are simulated, and systems along the second.

    `systems`: germ points, and the states from which parts of the time are simulated.
    """
    functionals, paths = _recorded(problem)
    axes = Sampled(tuple(int(one.is_path) for one in functionals), (1,) * len(paths))
    return jax.vmap(lambda *one: sample(problem, functionals, paths, one[0], decisions, one[1]), 0, axes)(*systems)


def _use(problem: Problem, _: Array, systems: Any) -> Use:
    few = problem.grid.steps * len(systems[0]) <= _FEW_STEPS
    if divides_steps(problem) or (few and problem.is_integrated):
        return Use.ONCE
    return Use.BRIEF if few else Use.LOOPS


CHECK = Compiled(_check, use=_use)


def prepare_check(factor: int, problem: Problem, discretised: Discretised) -> Callable[[], object]:
    """Begin to compile CHECK, on another core; the function returned completes this."""
    if not is_checked(problem):
        return lambda: None
    finer = problem.finer(factor, problem.integrator.reference())
    bound, systems = _bound(finer, problem.placements.vector("initial")), (_points(discretised, problem), None)
    bound.begin(systems)
    return lambda: bound.prepare(systems)


def _bound(problem: Problem, decisions: Float[np.ndarray, " n"]) -> Bound:
    """CHECK of a problem, of its systems."""
    return CHECK.bound(numbers_to_arrays(problem.with_tables_looked_up()), jax_array(decisions), packed=False)


def _points(
    discretised: Discretised, problem: Problem, systems: FreshSystems | None = None
) -> Float[np.ndarray, "systems variables"]:
    """The collocation points, fresh systems, of the first draw by default, and the scenarios of the worst case."""
    systems, scenarios = systems_of(problem, 0) if systems is None else systems, discretised.constants.scenarios
    parts = discretised.collocation.points, systems.points, *([] if scenarios is None else [scenarios])
    return np.concatenate([np.asarray(one) for one in parts])


@final
@dataclass(frozen=True)
class Simulations:
    """Simulations of a problem at one point of its program.

    - `problem`: that on the finer grid, with its integrator;
    - `in_parts`: whether each step of the program's own grid, or a phase that an event ends, is simulated from the
      states of its mesh.
    """

    transcribed: AbstractTranscribed
    point: Float[np.ndarray, " variables"]
    problem: Problem
    in_parts: bool

    @cached_property
    def _bound(self) -> Bound:
        return _bound(self.problem, self.transcribed.decisions(self.point))

    def begin(
        self, systems: FreshSystems
    ) -> Callable[[], tuple[Values, tuple[Float[np.ndarray, "systems nodes ..."], ...]]]:
        """Begin on another core with the collocation points, the fresh systems and the scenarios of the worst case; the
        function returned waits for their functionals, one after the other, and for the paths that are integrated over
        time, at the instants and at the midpoints of steps.
        """
        points, courses = _points(self.transcribed.discretised, self.problem, systems), None
        if self.in_parts:
            count, predicted = len(self.transcribed.collocation.points), self._predicted(systems.points)
            courses = {
                phase: np.concatenate([rows[:count], predicted[phase], rows[count:]])
                for phase, rows in self._courses.items()
            }
        return self._begin(points, courses)

    def at(self, germ: Float[np.ndarray, "n variables"]) -> Values:
        """Functionals of any number of systems, as many in each run of the program as there were in the first."""
        size, waiting = len(_points(self.transcribed.discretised, self.problem)), []
        for first in range(0, len(germ), size):
            points = fill(germ[first : first + size], size)
            waiting.append(self._begin(points, self._predicted(points) if self.in_parts else None))
        runs = [wait()[0] for wait in waiting]
        return {one: np.concatenate([run[one] for run in runs])[: len(germ)] for one in runs[0]}

    def _begin(self, points: Any, courses: Any) -> Callable[[], tuple[Values, tuple[np.ndarray, ...]]]:
        self._bound.begin((points, courses))
        wait, (functionals, _) = beside(lambda: self._bound((points, courses))), _recorded(self.problem)

        def values() -> tuple[Values, tuple[np.ndarray, ...]]:
            each, nodes = jax.tree.map(np.asarray, wait())
            moved = (np.moveaxis(one, int(of.is_path), 0) for of, one in zip(functionals, each, strict=True))
            return dict(zip(functionals, moved, strict=True)), tuple(np.moveaxis(one, 1, 0) for one in nodes)

        return values

    @cached_property
    def _courses(self) -> dict[str, Float[np.ndarray, "systems parts states"]]:
        """By phase, the states of a mesh at the beginning of each step, or of the phase if an event ends it, in all
        systems of the program.
        """
        states, courses = self.transcribed.states_at(self.point), {}
        assert states is not None
        for phase in states.phases or ("",):
            grid = self.transcribed.problem.grid.of(f"{phase}.")
            assert isinstance(grid, Grid)
            begins = grid.fractions[: 1 if grid.until is not None else -1]
            courses[phase] = states.rows(phase)[:, np.searchsorted(states.fractions(phase), begins - _SAME)]
        return courses

    def _predicted(self, germ: Float[np.ndarray, "n variables"]) -> dict[str, Float[np.ndarray, "n parts states"]]:
        """The same of other systems, by the expansions of these states."""
        basis, collocation, _ = self.transcribed.discretised
        matrix, count = basis.matrix(germ), len(collocation.points)
        fitted = {phase: np.asarray(collocation.coefficients(rows[:count])) for phase, rows in self._courses.items()}
        return {phase: np.tensordot(matrix, terms, axes=1) for phase, terms in fitted.items()}
