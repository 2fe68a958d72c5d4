"""Whether derivatives in elements leave out how a jump moves.

Points of elements are fixed while a design is sought, so that a system beside a jump stays on its side of it however
the decisions move the jump: the derivative of a mean lacks the systems that change sides. So the statistics are
differenced over steps that are long beside the elements around the jump, in elements that are divided anew at each.
"""

import itertools
import warnings
from dataclasses import replace

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from aleator._core.arrays import jax_array
from aleator._core.errors import ExpansionWarning
from aleator.design import is_worst_case
from aleator.ensemble import at_levels
from aleator.expansion import AbstractBasis, MultiElement, PiecewiseBasis
from aleator.nlp import missed_slope, probe_at
from aleator.transcription import AbstractTranscribed, divided, transcribe

# Lengths of the steps, in typical magnitudes of the decisions, and the largest error of elements that resolves these.
_STEPS, _RESOLVED = (1e-2, 3e-3), 1e-2
# An element over which a functional varies so many times faster than over all, by a germ variable in its deviations,
# may hold a jump; two that differ at their face by so many times the error of all, in the mean square of one, may have
# it between them.
_STEEP = 10.0
# How far beside a face values are taken, as a probability.
_BESIDE = 1e-9
# Spreads below this part of the largest along a path are none.
_NEGLIGIBLE = 1e-6


def unfollowed_jumps(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], multipliers: Float[np.ndarray, " rows"]
) -> str:
    """A sentence on a jump at a point of a program that moves with the decisions, which their derivatives leave out;
    empty if there is none.
    """
    problem, basis = transcribed.problem, transcribed.basis
    if not (isinstance(problem.expansion, MultiElement) and isinstance(basis, PiecewiseBasis)):
        return ""
    if not _may_jump(transcribed, basis, point):
        return ""
    decisions, probe = transcribed.decisions(point), probe_at(transcribed.program, point, _STEPS)
    probe = probe._replace(along=transcribed.decisions(probe.along))
    settings = replace(problem.expansion, error=min(problem.expansion.error, _RESOLVED))
    finer = eqx.tree_at(lambda tree: tree.expansion, problem, settings)
    with warnings.catch_warnings():
        # Elements that do not suffice within the budget are warned of at the answer itself.
        warnings.simplefilter("ignore", ExpansionWarning)
        for step, side in itertools.product(probe.lengths, probe.sides):
            moved = decisions + side * step * probe.along
            finer = divided(finer, transcribed.discretised, moved) or finer
    simulated = transcribe(finer)
    weights = np.zeros(simulated.program.constraint_lower.shape)
    for one, rows, own in zip(problem.constraints, simulated.rows, transcribed.rows, strict=True):
        # Limits on the worst case use the model itself, and a mesh may have rows between the instants.
        if weights[rows].shape == multipliers[own].shape and not is_worst_case(one):
            weights[rows] = multipliers[own]
    miss = missed_slope(simulated.program, decisions, weights, probe)
    if miss is None:
        return ""
    return (
        "derivatives leave out how a jump moves: along a random direction the objective and the limits that hold it "
        f"change by {miss.seen:.3g} in elements that are divided anew, where their derivatives say {miss.exact:.3g}. "
        "Smooth the jump over a width (al.smooth.step); or let values choose, al.solvers.NelderMead(polish=False) with "
        "throw=False, and judge that design by al.validate, for no derivative confirms it"
    )


def _may_jump(transcribed: AbstractTranscribed, basis: PiecewiseBasis, point: Float[np.ndarray, " variables"]) -> bool:
    """Whether some functional differs between the sides of a face of two elements, or varies within one, as it could at
    a jump alone, or at a steep flank.
    """
    cells, *sides = _beside_faces(basis)
    below, above = (basis.matrix(at_levels(basis.germs.values(), levels)) for levels in sides)
    across = np.sqrt(basis.probability[cells])[:, None] * (above - below)
    sizes = np.array([_deviations(one) for one in basis.pieces]) / _deviations(basis)
    differs = _STEEP * transcribed.problem.expansion.error  # type: ignore[union-attr]
    for samples in transcribed.at(point).samples:
        terms = np.asarray(transcribed.collocation.coefficients(jax_array(samples)))
        terms = terms.reshape(len(terms), -1)
        spread = np.sqrt((terms[1:] ** 2).sum(axis=0))
        terms = terms[:, spread > _NEGLIGIBLE * spread.max(initial=0.0)]
        spread = np.sqrt((terms[1:] ** 2).sum(axis=0))
        parts = np.asarray(basis.division.elements(jax_array(terms))) ** 2
        within = np.sqrt(np.einsum("ctn,tv->cvn", parts, basis.pieces[0].indices > 0))
        if (within > _STEEP * spread * sizes[:, :, None]).any() or (np.abs(across @ terms) > differs * spread).any():
            return True
    return False


def _deviations(basis: AbstractBasis) -> Float[np.ndarray, " variables"]:
    """The standard deviation of each germ variable."""
    return np.array([germ.recurrence(1)[1][1] for germ in basis.germs.values()])


def _beside_faces(
    basis: PiecewiseBasis,
) -> tuple[Int[np.ndarray, " faces"], Float[np.ndarray, "faces n"], Float[np.ndarray, "faces n"]]:
    """The element above each face, and the probability levels just below and just above the middle of the face."""
    low, high = (np.array([getattr(cell, end) for cell in basis.cells]) for end in ("low", "high"))
    cells, variables = np.nonzero(low > 0)
    levels = np.repeat(((low + high) / 2)[None, cells], 2, axis=0)
    faces = low[cells, variables]
    levels[:, np.arange(len(cells)), variables] = np.stack([faces - _BESIDE, faces + _BESIDE])
    return cells, levels[0], levels[1]
