"""The evidence of a design without uncertainty: its one system, on a finer grid."""

import time

import jax.numpy as jnp
import numpy as np

from aleator._core.arrays import numbers_to_arrays
from aleator._core.errors import ProblemError
from aleator.design import functionals_of
from aleator.nlp import HELD
from aleator.solution import Solution
from aleator.validation._counted import is_counted, tolerances, uncounted
from aleator.validation._disagreement import Disagreement
from aleator.validation._evidence import Evidence, Sampled
from aleator.validation._proportion import Proportion
from aleator.validation._sampling import SIMULATE_BATCH
from aleator.validation._systems import refuse_broken

# Refinement factor of the grid.
_FINER = 10

# Relative differences up to this are ignored.
_RELATIVE = 1e-3


def alone(solution: Solution, started: float) -> Evidence:
    """Simulate the one system of a design without uncertainty, on a finer grid if it evolves in time.

    Raises `ProblemError` if there is nothing to simulate.
    """
    problem, factor = solution.problem, 1
    functionals = functionals_of(problem.expressions)
    if not functionals:
        raise ProblemError(
            "validate: this problem contains no functional of an output, so there is nothing to simulate."
        )
    if problem.system.has_time:
        factor = _FINER
        problem = problem.on_grid(problem.grid.finer(factor))
    batch = SIMULATE_BATCH(
        numbers_to_arrays(problem), jnp.zeros((1, 0)), jnp.asarray(solution.vector), jnp.asarray(1), 1
    )
    refuse_broken(problem, np.asarray(batch.finite), np.zeros((1, 0)), solution.vector)
    sampled, told = {}, []
    for i, one in enumerate(functionals):
        text = one.text()
        fine = np.asarray(batch.scalars[i][0]) if i in batch.scalars else np.asarray(batch.paths[i][0])[::factor]
        expected = np.asarray(solution.moments[text].mean)
        zero = np.zeros(np.shape(expected))
        sampled[text] = Sampled(text, fine, zero, zero, None, expected, zero, zero)
        away = np.abs(fine - expected)
        where = int(np.argmax(away))
        if not away.flat[where] <= _RELATIVE * max(float(np.max(np.abs(expected))), HELD):
            when = None if not one.is_path else float(solution.instants[where // (away.size // len(solution.instants))])
            numbers = float(expected.flat[where]), float(fine.flat[where])
            told.append(Disagreement(text, *numbers, 0.0, when, "the design's own grid"))
    beyond = np.asarray(batch.excess)[:, 0] > tolerances(solution)
    names = dict.fromkeys(one.name for one in problem.constraints if is_counted(one))
    broken = {
        name: np.array([any(beyond[i] for i, one in enumerate(problem.constraints) if one.name == name)])
        for name in names
    }
    return Evidence(
        solution=solution,
        samples=1,
        seed=0,
        violations={name: Proportion(int(mask.sum()), 1) for name, mask in broken.items()},
        joint=Proportion(int(any(mask.any() for mask in broken.values())), 1),
        uncounted=uncounted(solution.problem),
        instants=None,
        functionals=sampled,
        statistics={},
        trajectories=(),
        seconds=time.perf_counter() - started,
        broken=broken,
        disagreements=tuple(told),
        alone=factor,
    )
