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
from jaxtyping import Float

from aleator._core.errors import ExpansionWarning
from aleator.design import is_worst_case
from aleator.expansion import MultiElement, PiecewiseBasis
from aleator.nlp import missed_slope, probe_at
from aleator.transcription import AbstractTranscribed, divided, transcribe

# Lengths of the steps, in typical magnitudes of the decisions, and the largest error of elements that resolves these.
_STEPS, _RESOLVED = (1e-2, 3e-3), 1e-2


def unfollowed_jumps(
    transcribed: AbstractTranscribed, point: Float[np.ndarray, " variables"], multipliers: Float[np.ndarray, " rows"]
) -> str:
    """A sentence on a jump at a point of a program that moves with the decisions, which their derivatives leave out;
    empty if there is none.
    """
    problem, basis = transcribed.problem, transcribed.basis
    # One element resolves what does not jump.
    if not (isinstance(problem.expansion, MultiElement) and isinstance(basis, PiecewiseBasis) and len(basis.cells) > 1):
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
