"""Finer grids for a problem whose own is too coarse, and reasons why they may not help."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from aleator.design import Problem, functionals_of, history
from aleator.dynamics import Grid
from aleator.nlp import Status
from aleator.solution import TOLERATED, Solution

# The finest grid has at most this many times as many steps as the first.
_FINEST = 256
# An error above this part of the last one, with at least twice as many steps, does not converge.
_FALLS = 0.6
_SOLVED = (Status.SOLVED, Status.COARSE, Status.NOT_HELD)


def refinement(solutions: Sequence[Solution]) -> Problem | None:
    """The problem on a finer grid that should meet the tolerance, judging by the last solution; None to end.

    `solutions`: those on the grids so far, the coarsest first.
    """
    last, problem = solutions[-1], solutions[-1].problem
    error = last.certificate.grid_error
    between = last.certificate.between
    is_enough = last.status is not Status.NOT_HELD and not (between and between.is_costly)
    if error is None or (error.is_met and is_enough) or last.status not in _SOLVED:
        return None
    grid, begun = problem.grid, solutions[0].problem.grid
    assert isinstance(grid, Grid)
    assert isinstance(begun, Grid)
    # Limits may be exceeded between the instants even if the error of the grid is tolerated.
    steps = error.with_whole_pieces(2 * grid.steps) if error.is_met else error.steps_needed
    if steps > _FINEST * begun.steps or _does_not_help(solutions):
        return None
    return problem.on_grid(grid.divided(steps), problem.integrator.refined())


def _does_not_help(solutions: Sequence[Solution]) -> bool:
    """Whether finer grids do not lower the error.

    A finer grid may lead to another design with another error, so that only two failures in a row count.
    """
    ratios = [_ratio(one) for one in solutions[-3:]]
    return len(ratios) == 3 and min(ratios[1:]) > _FALLS * ratios[0]


def _ratio(solution: Solution) -> float:
    """The error of the grid, or the excess between its instants, over the tolerance."""
    error, between = solution.certificate.grid_error, solution.certificate.between
    if error is None:
        return np.inf
    beyond = between.worst / TOLERATED if solution.status is Status.NOT_HELD and between else 0.0
    return max(error.ratio, beyond, between.cost_ratio if between else 0.0)


def unconverged(solutions: Sequence[Solution]) -> str:
    """Why finer grids do not bring the error down to the tolerance, with the instant; empty if they do."""
    last = solutions[-1]
    error = last.certificate.grid_error
    if len(solutions) == 1 or error is None or error.is_met or last.status not in _SOLVED:
        return ""
    return (
        f"With up to {error.steps} steps the "
        f"error does not reach the tolerance: the model seems to jump in time, near t = {_when(last):.4g} s. Put the "
        "jump on an instant of the grid, make it smooth, or ask for less accuracy"
    )


def _when(solution: Solution) -> float:
    """The instant from which twice as many steps give another result, with uncertain numbers at their means."""
    problem = solution.problem
    grid = problem.grid
    assert isinstance(grid, Grid)
    finer = problem.on_grid(grid.finer(2))
    germ, decisions = jnp.zeros(len(problem.placements.germ_names)), jnp.asarray(solution.vector)
    coarse, fine = (jax.jit(lambda x, one=one: history(one, germ, x))(decisions) for one in (problem, finer))
    changes = np.zeros(grid.steps)
    for name in dict.fromkeys(name for one in functionals_of(problem.expressions) for name in one.outputs):
        one, other = (np.asarray(values).reshape(len(values), -1) for values in (coarse[name], fine[name][::2]))
        away = np.abs(one - other).max(axis=1) / max(float(np.abs(other).max()), np.finfo(float).tiny)
        changes = np.maximum(changes, np.abs(np.diff(away)))
    return float(solution.instants[int(np.argmax(changes))])
