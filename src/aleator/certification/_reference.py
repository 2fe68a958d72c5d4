"""A problem on a finer grid with an integrator of another order, by which its own grid is judged, and one system of its
family at instants that no grid has.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.design import (
    AbstractFunctional,
    Constraint,
    OneSystem,
    Peak,
    Problem,
    Statistic,
    functionals_of,
    grid_at,
    responses,
    step_at,
)
from aleator.dynamics import Grid
from aleator.expansion import Collocation
from aleator.statistics import Constants, Mean, Std
from aleator.trajectories import AbstractTrajectory, BSpline, least_steps, piecewise_in
from aleator.transcription import AbstractTranscribed, Discretised, scope_of
from aleator.uncertainty import named_numbers

# The other instants come from a prime number of steps: at least this many, and this many times those of the finer grid.
_STEPS, _BEYOND = 4099, 1.5
# Factor of steps for systems that follow trajectories, whose limits are enforced between instants, and for others;
# then the least number of steps in all, and between two knots.
_FOLLOWING, _PLAIN, _FEWEST, _BY_PIECE = 10, 2, 100, 4
# Rounding, as a part of a magnitude.
ROUNDING = 1e-9
# Allowance for the error of the finer grid itself, which is much smaller.
OWN_ERROR = 1.25


class Alone(NamedTuple):
    """One system of the family: a problem's expressions for it, then its functionals."""

    expressions: tuple[Float[np.ndarray, "..."], ...]
    functionals: tuple[Float[np.ndarray, "..."], ...]


def middle(collocation: Collocation) -> int:
    """The index of the collocation point that is closest to the mean of all."""
    points, weights = np.asarray(collocation.points), np.asarray(collocation.weights)
    away = points - weights @ points
    size = np.sqrt(weights @ away**2)
    return int(np.argmin(np.sum((away / np.where(size > 0, size, 1.0)) ** 2, axis=1)))


def alone(
    problem: Problem, values: Mapping[AbstractFunctional, Array], decisions: Float[Array, " n"]
) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
    """The parts of `Alone` from the functionals of one system."""
    scope = OneSystem(values, named_numbers(problem.simulation, decisions), step_at(problem, decisions))
    expressions = tuple(jnp.asarray(one.evaluate(scope)) for one in problem.expressions)
    return expressions, tuple(values[one] for one in functionals_of(problem.expressions))


def _elsewhere(problem: Problem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> tuple:
    functionals = functionals_of(problem.expressions)
    values = responses(problem, functionals, germ[None], decisions)
    return alone(problem, dict(zip(functionals, (one[0] for one in values), strict=True)), decisions)


ELSEWHERE = Compiled(_elsewhere, use=Use.ONCE)


def alone_elsewhere(
    problem: Problem, collocation: Collocation, decisions: Float[np.ndarray, " n"], factor: int
) -> Callable[[], Alone]:
    """The system in the middle of a problem's family, at a few thousand instants that no grid of the problem has.

    It is simulated on another core; the function returned waits for the result.

    A grid and those with a whole multiple of its steps share their instants. A ripple whose period is one step is
    constant at all of them, and a shock between two of them is invisible. A prime number of steps gives other instants,
    and more of them than the grid of `factor` times as many steps.
    """
    assert isinstance(problem.grid, Grid)
    # The nodes of controls are instants of every grid.
    whole = least_steps((problem.system, problem.inputs))
    steps = whole * _prime_from(-(-max(_STEPS, int(_BEYOND * factor * problem.grid.steps)) // whole))
    there = numbers_to_arrays(problem.on_grid(problem.grid.divided(steps)))
    point = jax_array(np.asarray(collocation.points)[middle(collocation)])
    simulated = ELSEWHERE.begin(there, point, jax_array(decisions))
    return lambda: Alone(*jax.tree.map(np.asarray, simulated()))


def _prime_from(number: int) -> int:
    return next(one for one in range(number, 2 * number) if all(one % k for k in range(2, int(one**0.5) + 1)))


class Reference(NamedTuple):
    """A problem's numbers at one point on the finer grid.

    - `values`: the objective, then the constraints, those of paths at every instant of that grid;
    - `means`, `stds`: of each functional; `reaches`: how large each could be, see `AbstractFunctional.reach`;
    - `alone`: one system of the family, the one at the collocation point in their middle; `elsewhere`: the same system
      at other instants, see `alone_elsewhere`;
    - `factor`: how many times as many steps that grid has; `integrator`: its name.
    """

    values: tuple[Float[np.ndarray, "..."], ...]
    means: tuple[Float[np.ndarray, "..."], ...]
    stds: tuple[Float[np.ndarray, "..."], ...]
    reaches: tuple[float, ...]
    alone: Alone
    elsewhere: Alone
    factor: int
    integrator: str


def _referenced(
    problem: Problem,
    collocation: Collocation,
    constants: Constants,
    which: Int[Array, ""],
    decisions: Float[Array, " n"],
) -> tuple[Any, ...]:
    functionals = functionals_of(problem.expressions)
    names = dict.fromkeys(name for one in functionals for name in one.outputs)
    peaks = tuple(Peak((name,)) for name in names)
    scope = scope_of(problem, tuple(dict.fromkeys((*functionals, *peaks))), collocation, constants, decisions)
    scope.take_together(problem.expressions)
    values = tuple(jnp.asarray(one.evaluate(scope)) for one in problem.expressions)
    terms = [collocation.coefficients(scope.samples[one]) for one in functionals]
    means, stds = (tuple(kind.of(one, ()) for one in terms) for kind in (Mean(), Std()))
    highest = {name: jnp.max(scope.samples[peak]) for name, peak in zip(names, peaks, strict=True)}
    grid = grid_at(problem, decisions)
    reaches = tuple(one.reach(highest, grid) for one in functionals)
    one_system = {one: scope.samples[one][which] for one in functionals}
    return values, means, stds, reaches, alone(problem, one_system, decisions)


REFERENCE = Compiled(_referenced, use=Use.ROWS)


def reference_factor(problem: Problem, between: int | None) -> int:
    """How many times as many steps the finer grid of a problem has; 1 for a problem without time."""
    grid = problem.grid
    if not (isinstance(grid, Grid) and functionals_of(problem.expressions)):
        return 1
    parts = pieces(problem)
    chosen = between if between is not None else _FOLLOWING if parts else _PLAIN
    return max(chosen, _PLAIN, -(-_FEWEST // grid.steps), -(-_BY_PIECE * parts // grid.steps))


def follows_trajectories(problem: Problem) -> bool:
    """Whether a problem's system follows trajectories, which are arbitrary between two instants."""
    return pieces(problem) > 0


def pieces(problem: Problem) -> int:
    """The largest number of polynomial pieces of the trajectories that a problem's system follows; 0 for none."""

    def is_trajectory(node: Any) -> bool:
        return isinstance(node, AbstractTrajectory)

    parts = problem.system, problem.inputs
    followed = any(map(is_trajectory, jax.tree.leaves(parts, is_leaf=is_trajectory)))
    whole = least_steps(parts) if piecewise_in(parts) else 0
    return max([followed, whole, *(one.count - one.degree for one in splines_in(parts))])


def splines_in(tree: Any) -> list[BSpline]:
    """All splines in a model or a part of it, including those inside other trajectories."""

    def is_spline(node: Any) -> bool:
        return isinstance(node, BSpline)

    return [one for one in jax.tree.leaves(tree, is_leaf=is_spline) if is_spline(one)]


def reference(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], factor: int) -> Reference:
    """A problem's numbers on a grid of `factor` times as many steps, with another integrator."""
    problem, collocation, decisions = transcribed.problem, transcribed.collocation, transcribed.decisions(point)
    elsewhere = alone_elsewhere(problem, collocation, decisions, factor)
    arguments = _arguments(problem, transcribed.discretised, factor, decisions)
    values, means, stds, reaches, one = jax.tree.map(np.asarray, REFERENCE(*arguments))
    named = type(arguments[0].integrator).__name__ if problem.is_integrated else "Simpson's rule"
    reaches = tuple(float(np.max(one)) for one in reaches)
    return Reference(values, means, stds, reaches, Alone(*one), elsewhere(), factor, named)


def prepare_reference(problem: Problem, discretised: Discretised, factor: int) -> None:
    """Begin to compile what `reference` will need."""
    REFERENCE.prepare(*_arguments(problem, discretised, factor, problem.placements.vector("initial")))


def _arguments(
    problem: Problem, discretised: Discretised, factor: int, decisions: Float[np.ndarray, " n"]
) -> tuple[Problem, Collocation, Constants, Array, Array]:
    grid, integrator = problem.grid, problem.integrator.reference()
    assert isinstance(grid, Grid)
    finer = problem.on_grid(grid.finer(factor), integrator)
    _, collocation, constants = discretised
    which = jax_array(middle(collocation))
    return numbers_to_arrays(finer), collocation, constants, which, jax_array(decisions)


def rounding_of(transcribed: AbstractTranscribed, sizes: Float[np.ndarray, " rows"]) -> dict[Any, float]:
    """The rounding of functionals, as far as constraints on them show it, whose rows have the magnitudes `sizes`.

    A functional with a bound of zero is a difference of numbers of that magnitude.
    """
    rounding: dict[Any, float] = {}
    for one, rows in zip(transcribed.problem.constraints, transcribed.rows, strict=True):
        size = float(np.max(sizes[rows], initial=0.0))
        for functional, factor in bounded_by(one):
            rounding[functional] = max(rounding.get(functional, 0.0), ROUNDING * size / factor)
    return rounding


def row_sizes(transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"]) -> Float[np.ndarray, " rows"]:
    """The magnitude of each row of the constraints around a point."""
    program = transcribed.program
    if program.magnitudes is None:
        return np.ones(len(program.constraint_lower)) * program.constraint_scale
    return program.magnitudes(point, program.evaluate(point)).size


def bounded_by(constraint: Constraint) -> Iterator[tuple[Any, float]]:
    """The functionals that a constraint bounds in their own unit, and the magnitudes of their factors."""
    for factor, atom in zip(constraint.expression.factors, constraint.expression.atoms, strict=True):
        if isinstance(atom, Statistic) and atom.kind.speaks_of_one_system and float(factor) != 0:
            yield from ((one, abs(float(factor))) for one in atom.functionals)


def bound_size(constraint: Constraint) -> float:
    """The smaller of a constraint's finite bounds in magnitude; zero if one of them is zero, or none is finite."""
    bounds = map(float, (constraint.lower, constraint.upper))
    return min((abs(bound) for bound in bounds if np.isfinite(bound)), default=0.0)
