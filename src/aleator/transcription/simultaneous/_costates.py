"""Costates and switching functions, from the multipliers of a simultaneous program's defects.

The Lagrangian is `f + λᵀ c`. A defect says `x_i - x_0 - h Σ_j w_ij r_j = 0` of the states at the points of an interval
and of its blocks: so each mean rate has the weight `-h Σ_i λ_i w_ij`, and each mean integrand that of its integral.
A node's state belongs to two intervals. The costate is the derivative by the state that the later one begins with and
that is recorded: as the Lagrangian is stationary, minus the derivative of the earlier interval's defects. Divided by
the scheme's quadrature, weighted derivatives of rates are those of the Hamiltonian (Hager, Numerische Mathematik 87,
2000).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._program import Assembled


class Adjoint(NamedTuple):
    """Costates of a phase at the nodes, and the derivatives of the Hamiltonian by the signals wherever these are told
    and weighed.

    - `states`: shape (realisations, nodes, states); `signals`: shape (weighed, signals).
    """

    states: Float[np.ndarray, "realisations nodes states"]
    signals: Float[np.ndarray, "weighed signals"]


def adjoint(
    layout: Layout,
    assembled: Assembled,
    point: Float[np.ndarray, " variables"],
    multipliers: Float[np.ndarray, " rows"],
    phase: int,
) -> Adjoint:
    """Those of a phase, by its number, at a point of a program with multipliers of its rows."""
    mesh, shapes = layout.phases[phase].mesh, layout.phases[phase].shapes
    numbers, ties = layout.numbers.phases[phase], assembled.rows.ties
    of_variable = np.zeros(layout.count)
    of_variable[ties.variables] = multipliers[ties.rows]
    defects, integrals = of_variable[numbers.states], of_variable[numbers.integrals]
    slopes, sides = assembled.rate_slopes(point, phase, mesh.asked_sides), mesh.asked_sides
    first = slopes.shape[-1] - shapes.states
    by_states = slopes[..., first:]
    by_signals = slopes[..., first - sides.shape[1] * shapes.signals : first]
    by_signals = by_signals.reshape(*slopes.shape[:-1], sides.shape[1], shapes.signals)

    lengths, scheme = mesh.lengths, mesh.scheme
    of_defects = np.einsum("k,rkis,ij->rkjs", lengths, defects[:, mesh.points[:, 1:]], scheme.weights)
    of_integrals = np.einsum("k,rki,j->rkji", lengths, integrals, scheme.weights[-1])
    weights = -np.concatenate([of_defects, of_integrals], axis=3)

    before = -defects[:, mesh.points[:, -1]]
    if scheme.asked.stop is None:  # The last block begins at the node itself.
        before = before - np.einsum("rkm,rkms->rks", weights[:, :, -1], by_states[:, mesh.stages[:, -1]])
    states = np.concatenate([-defects[:, :1], before], axis=1)

    by_side = np.zeros((len(mesh.places), shapes.signals))
    each = np.einsum("rkjm,rkjmts->kjts", weights, by_signals[:, mesh.stages])
    np.add.at(by_side, sides[mesh.stages], each)
    # Where each realisation has a duration of its own there are no signals.
    duration = float(point[numbers.duration[0, 0]])
    return Adjoint(states, by_side[mesh.weighed] / (duration * mesh.weights[mesh.weighed, None]))
