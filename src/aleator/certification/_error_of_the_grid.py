"""`grid_error`: the error of a problem's own grid at a point, by comparison with a finer one."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator.certification._limits_on_grids import broken, limit_sizes, reach_of, unresolved
from aleator.certification._reference import OWN_ERROR, ROUNDING, Reference, bounded_by, pieces, rounding_of, row_sizes
from aleator.design import Expression, Problem, functionals_of
from aleator.dynamics import Grid
from aleator.solution import Deviation, GridError
from aleator.transcription import AbstractTranscribed

# A magnitude below this part of its possible size is zero up to integration error.
_NEGLIGIBLE_SPREAD, _NEGLIGIBLE_VALUE = 1e-6, 1e-3
# Avoids a division of zero by zero.
_TINY = 1e-30


def grid_error(
    transcribed: AbstractTranscribed,
    point: Float[np.ndarray, " variables"],
    finer: Reference,
    accuracy: float,
    shown: Mapping[str, float] = MappingProxyType({}),
) -> GridError:
    """The error of a problem's own grid at a point, by comparison with a finer one.

    `shown`: differences of functionals at instants that the finer one does not have either; of the objective under "".
    """
    problem, resolved = transcribed.problem, transcribed.resolve(point)
    assert isinstance(problem.grid, Grid)
    meaning = transcribed.at(point)
    times = meaning.times
    functionals = functionals_of(problem.expressions)
    reaches = dict(zip(functionals, finer.reaches, strict=True))
    sizes_of_rows = row_sizes(transcribed, point)
    rounding = rounding_of(transcribed, sizes_of_rows)
    deviations = {}
    for i, one in enumerate(functionals):
        own = resolved[one.text()]
        mean, std = (np.asarray(part)[:: finer.factor if one.is_path else 1] for part in _at_least_1d(finer, i))
        change = np.maximum(np.abs(np.asarray(own.mean) - mean), np.abs(np.asarray(own.std) - std))
        limits = _limits(problem, one)
        spread, value, reach = float(np.max(std)), float(np.max(np.abs(mean))), reaches[one]
        magnitudes = [*limits, *([spread] if spread > _NEGLIGIBLE_SPREAD * reach else [])]
        # A quantity that has to be zero, and is, has no magnitude of its own.
        alone = value if value > _NEGLIGIBLE_VALUE * reach else reach
        size = max(min(magnitudes, default=alone), max(ROUNDING * reach, rounding.get(one, 0.0), _TINY) / accuracy)
        when = float(times[int(np.argmax(change.reshape(len(times), -1).max(axis=1)))]) if one.is_path else np.nan
        largest = max(float(np.max(change)), shown.get(one.text(), 0.0))
        deviations[one.text()] = Deviation(OWN_ERROR * largest, accuracy * size, when, one.order)
    objective = meaning.objective
    away = OWN_ERROR * max(abs(objective - float(finer.values[0])), shown.get("", 0.0))
    floor = _NEGLIGIBLE_VALUE * reach_of(problem.objective, reaches)
    sizes = limit_sizes(transcribed, reaches, sizes_of_rows)
    return GridError(
        steps=problem.grid.steps,
        factor=finer.factor,
        integrator=finer.integrator,
        accuracy=accuracy,
        objective=Deviation(away, max(accuracy * max(abs(objective), floor), _TINY), order=_order(problem.objective)),
        functionals=deviations,
        broken=broken(transcribed, meaning.constraints, finer, sizes, accuracy),
        unresolved=unresolved(transcribed, meaning, finer, sizes),
        pieces=pieces(problem) or 1,
        by_tolerances=problem.integrator.refined() is not problem.integrator,
    )


def _order(objective: Expression) -> int:
    """The order of convergence of the objective: the lowest among its parts."""
    return min([one.order for one in functionals_of((objective,))], default=Deviation.order)


def _at_least_1d(finer: Reference, which: int) -> tuple[np.ndarray, np.ndarray]:
    return np.atleast_1d(finer.means[which]), np.atleast_1d(finer.stds[which])


def _limits(problem: Problem, functional: Any) -> list[float]:
    """The bounds other than zero that a functional is held to, in its own unit."""
    found = []
    for one in problem.constraints:
        sizes = [abs(float(bound)) for bound in (one.lower, one.upper)]
        for bounded, factor in bounded_by(one):
            found += [size / factor for size in sizes if bounded == functional and 0 < size < np.inf]
    return found
