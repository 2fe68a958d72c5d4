"""CHECK: one compiled program that simulates systems on a finer grid, with an integrator of another order; and fresh
systems, which a solver has not seen, with the weights by which they stand for all.

CHECK gives functionals of each system, and nothing else: all that follows from them is computed by NumPy, for each
further operation beside a loop over time, such as a slice or a sum, takes as long to compile as some inside.

The finer grid has an odd prime number of times as many steps, so that its instants are in no phase with those of the
problem's: what is constant at these, such as a ripple of their period, shows there.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar, final

import jax
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Bound, Compiled, Use
from aleator._core.parallel import beside
from aleator.design import (
    AbstractFunctional,
    Expression,
    Path,
    Problem,
    Sampled,
    divides_steps,
    functionals_of,
    integrated_paths,
    sample,
    statistics_in,
)
from aleator.dynamics import FINER, Grid, Simulation
from aleator.ensemble import at_levels, fill, random_levels
from aleator.statistics import CornishFisher, Kurtosis, Skewness
from aleator.trajectories import AbstractTrajectory, BSpline, least_steps, piecewise_in
from aleator.transcription import AbstractTranscribed, Discretised

# Factor of steps for systems that follow trajectories, whose limits are enforced between instants, and for others;
# then the least number of steps in all, and between two knots.
_FOLLOWING, _PLAIN, _FEWEST, _BY_PIECE = 11, 3, 1000, 4
# Fresh systems of one draw: enough for a standard error, and cheap beside one evaluation with derivatives; and of an
# answer where these leave a doubt. Of one or two germ variables the latter cover the range densely.
_DRAWN, _MOST, _DENSE, _MOST_DENSE = 32, 1024, 256, 2048
# What two successive points of an even sequence differ by, in one and in two variables: the golden ratio and its next.
_EVEN_STEPS = {1: (0.6180339887498949,), 2: (0.7548776662466927, 0.5698402909980532)}
# The depths of tails, as parts of all systems: more than 4 standard deviations of a normal germ, and the median. Third
# and fourth powers owe something to more than 5.
_DEEPEST, _DEEPEST_OF_SHAPES, _SHALLOWEST = 1e-5, 1e-8, 0.5
# Most steps of all systems together in checks that take longer to compile well than to run, about ten times in all.
_FEW_STEPS = 500_000
# Fractions of the duration that are the same.
_SAME = 1e-9

OF_THE_SHAPE = (Skewness, Kurtosis, CornishFisher)
"""Statistics of third and fourth powers."""

_Part = TypeVar("_Part")

Values = dict[AbstractFunctional, Float[np.ndarray, "systems ..."]]
"""Functionals of some systems, and the histories of all outputs in them, as paths."""
Nodes = tuple[Float[np.ndarray, "systems nodes ..."], ...]
"""Paths that are integrated over time, at the instants and at the midpoints of steps."""


class FreshSystems(NamedTuple):
    """Germ points, and the weights with which their mean stands for all systems."""

    points: Float[np.ndarray, "fresh variables"]
    weights: Float[np.ndarray, " fresh"]

    @classmethod
    def joined(cls, parts: Iterable["FreshSystems"]) -> "FreshSystems":
        """All systems of some parts."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))

    @property
    def least_and_most(self) -> tuple[int, int]:
        """How many systems like these an answer deserves, and how many where these leave a doubt."""
        return (_DENSE, _MOST_DENSE) if self.points.shape[1] in _EVEN_STEPS else (_DRAWN, _MOST)


def fresh_systems(problem: Problem, count: int, draw: int) -> FreshSystems:
    """Half of the systems drawn at random, in the others one germ after the other in its lower or its upper tail.

    Of one or two germs the former half goes on evenly from draw to draw (Kronecker sequences by the golden ratio and
    its generalisation, begun at random): 256 systems leave no part of more than 1.5 % of one germ's range without any.

    An output may owe much of its spread to the one system in a hundred that no collocation point and none of a few
    random systems resembles. Depths within a tail are log-uniform, spread evenly over the systems of that tail. Weights
    undo the choice (multiple importance sampling with the balance heuristic of Veach and Guibas, 1995); none exceeds 2.
    """
    germs, generator, half = problem.placements.germs.values(), np.random.default_rng(2 + draw), count // 2
    deepest = _DEEPEST_OF_SHAPES if has_shape(problem.expressions) else _DEEPEST
    levels = random_levels(generator, count, len(germs))
    if steps := _EVEN_STEPS.get(len(germs)):
        begun = np.random.default_rng(2).random(len(steps))
        levels[:half] = (begun + np.outer(draw * half + np.arange(1, half + 1), steps)) % 1
    place = np.arange(count - half)
    tails = place % (2 * len(germs))
    which, upper, drawn = tails // 2, tails % 2 == 1, np.bincount(tails, minlength=2 * len(germs))
    # One in each of the equal parts of its tail's logarithmic range.
    parts = np.empty(len(tails))
    parts[np.argsort(tails, kind="stable")] = generator.random(len(tails))
    parts = (place // (2 * len(germs)) + parts) / drawn[tails]
    depths = deepest * (_SHALLOWEST / deepest) ** parts
    levels[half + place, which] = np.where(upper, 1 - depths, depths)

    def density(depths: np.ndarray) -> np.ndarray:
        """Of a level at a depth below the median, relative to a random one."""
        inside = (depths >= deepest) & (depths <= _SHALLOWEST)
        return np.where(inside, 1 / (np.maximum(depths, deepest) * np.log(_SHALLOWEST / deepest)), 0.0)

    in_tails = density(levels) @ drawn[::2] + density(1 - levels) @ drawn[1::2]
    return FreshSystems(at_levels(germs, levels), count / (half + in_tails))


def has_shape(expressions: tuple[Expression, ...]) -> bool:
    """Whether a statistic of third or fourth powers stands in some expression."""
    return any(isinstance(one.kind, OF_THE_SHAPE) for one in statistics_in(expressions))


def simulates_inside(problem: Problem) -> bool:
    """Whether the model itself calls `simulate`."""
    equations = problem.simulation.equations
    return equations is not None and equations.finer is not None


def systems_of(problem: Problem, draw: int) -> FreshSystems:
    """Fresh systems of a problem for one run of CHECK, the same at every call, so that answers are repeatable."""
    count = len(problem.placements.germs)
    if not count:
        return FreshSystems(np.zeros((0, 0)), np.zeros(0))
    if count in _EVEN_STEPS and not (problem.system.has_time or simulates_inside(problem)):
        return fresh_systems(problem, _MOST, draw)  # where nothing is simulated
    # A step with many equations of single numbers takes hardly longer for all systems at once.
    draws = _DENSE // _DRAWN if divides_steps(problem) and count in _EVEN_STEPS else 1
    return FreshSystems.joined(fresh_systems(problem, _DRAWN, draw * draws + one) for one in range(draws))


def is_checked(problem: Problem) -> bool:
    """Whether a problem simulates something that has a grid, or that is uncertain."""
    has_parts = problem.system.has_time or bool(problem.placements.germs) or simulates_inside(problem)
    return has_parts and bool(functionals_of(problem.expressions))


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


def _recorded(problem: Problem) -> tuple[tuple[AbstractFunctional, ...], tuple[AbstractFunctional, ...]]:
    """The functionals of a problem with the histories of their outputs, and the paths integrated over time."""
    functionals = functionals_of(problem.expressions)
    histories = (Path((name,)) for one in functionals for name in one.outputs)
    return tuple(dict.fromkeys((*functionals, *histories))), integrated_paths(problem.expressions)


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
    bound = _bound(finer, problem.placements.vector("initial"))
    systems = _points(discretised, systems_of(problem, 0)), None
    bound.begin(systems)
    return lambda: bound.prepare(systems)


def _bound(problem: Problem, decisions: Float[np.ndarray, " n"]) -> Bound:
    """CHECK of a problem, of its systems."""
    return CHECK.bound(numbers_to_arrays(problem.with_tables_looked_up()), jax_array(decisions), packed=False)


def _points(discretised: Discretised, systems: FreshSystems) -> Float[np.ndarray, "systems variables"]:
    """The collocation points, fresh systems, and the scenarios of the worst case."""
    scenarios = discretised.constants.scenarios
    parts = discretised.collocation.points, systems.points, *([] if scenarios is None else [scenarios])
    return np.concatenate([np.asarray(one) for one in parts])


@final
@dataclass(frozen=True)
class Simulations:
    """Simulations of a problem at one point of its program.

    - `problem`: that on the finer grid, with its integrator;
    - `departed`: by how much a simulation from the first instant departs from a mesh, in a sentence, if by so much that
      each step of the program's own grid, or a phase that an event ends, is simulated from the states of the mesh.
    """

    transcribed: AbstractTranscribed
    point: Float[np.ndarray, " variables"]
    problem: Problem
    departed: str

    @cached_property
    def _bound(self) -> Bound:
        return _bound(self.problem, self.transcribed.decisions(self.point))

    def begin(self, systems: FreshSystems) -> Callable[[], tuple[Values, Nodes]]:
        """Begin on another core with the collocation points, the fresh systems and the scenarios of the worst case; the
        function returned waits for what is recorded of all of them, one after the other.
        """
        points, courses = _points(self.transcribed.discretised, systems), None
        if self.departed:
            count, predicted = len(self.transcribed.collocation.points), self._predicted(systems.points)
            each = self._courses.items()
            courses = {one: np.concatenate([rows[:count], predicted[one], rows[count:]]) for one, rows in each}
        return self._begin(points, courses)

    def at(self, germ: Float[np.ndarray, "n variables"]) -> Values:
        """Functionals of any number of systems, as many in each run of the program as there were in the first."""
        size, waiting = len(_points(self.transcribed.discretised, systems_of(self.problem, 0))), []
        for first in range(0, len(germ), size):
            points = fill(germ[first : first + size], size)
            waiting.append(self._begin(points, self._predicted(points) if self.departed else None))
        # Other threads begin with the first ones, this one with the last.
        runs = [wait()[0] for wait in reversed(waiting)][::-1]
        return {one: np.concatenate([run[one] for run in runs])[: len(germ)] for one in runs[0]}

    def _begin(self, points: Any, courses: Any) -> Callable[[], tuple[Values, Nodes]]:
        self._bound.begin((points, courses))
        wait, (functionals, _) = beside(lambda: self._bound((points, courses))), _recorded(self.problem)

        def values() -> tuple[Values, Nodes]:
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
        matrix, collocation = self.transcribed.basis.matrix(germ), self.transcribed.collocation
        fitted = ((one, rows[: len(collocation.points)]) for one, rows in self._courses.items())
        return {one: np.tensordot(matrix, collocation.coefficients(rows), axes=1) for one, rows in fitted}
