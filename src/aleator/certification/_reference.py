"""A problem on a finer grid with an integrator of another order, by which its own grid is judged."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.certification._alone import Alone, alone, alone_elsewhere, middle
from aleator.certification._jumps import splines_in
from aleator.design import (
    Constraint,
    Peak,
    Problem,
    Statistic,
    functionals_of,
    grid_at,
)
from aleator.dynamics import Grid
from aleator.expansion import Collocation
from aleator.statistics import Constants, Mean, Std
from aleator.trajectories import AbstractTrajectory, least_steps, piecewise_in
from aleator.transcription import AbstractTranscribed, Discretised, scope_of

# Factor of steps for systems that follow trajectories, whose limits are enforced between instants, and for others;
# then the least number of steps in all, and between two knots.
_FOLLOWING, _PLAIN, _FEWEST, _BY_PIECE = 10, 2, 100, 4
# Rounding, as a part of a magnitude.
ROUNDING = 1e-9
# Allowance for the error of the finer grid itself, which is much smaller.
OWN_ERROR = 1.25


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
    found: dict[Any, float] = {}
    for one, rows in zip(transcribed.problem.constraints, transcribed.rows, strict=True):
        size = float(np.max(sizes[rows], initial=0.0))
        for functional, factor in bounded_by(one):
            found[functional] = max(found.get(functional, 0.0), ROUNDING * size / factor)
    return found


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
