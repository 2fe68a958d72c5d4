"""The error of a mesh: how far states drift from their equations between the points at which a scheme holds them.

Over an interval a scheme's states are polynomials. The integral of the magnitude by which their rates miss those of the
dynamics is an estimate of the error that the interval adds (Betts, Practical Methods for Optimal Control, 4.6).
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.polynomial import legendre

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem, refuse_changed_code
from aleator.dynamics import AbstractCollocation
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise

# Between two meshes an interval is divided into at most so many parts; each is to be this much better than asked.
_MOST_PARTS, _AHEAD = 8, 2.0


def _between(
    problem: Problem, points: Float[Array, "realisations germs"], fractions: tuple[float, ...], at: tuple[Array, ...]
) -> Float[Array, "realisations asked rates"]:
    """The rates of all states at some fractions of the duration, from decisions, duration and the states there."""
    decisions, duration, states = at
    asked = Pointwise.of(problem)
    signals, shared = asked.known(np.array(fractions), decisions), jnp.append(decisions[asked.direct], duration)
    places = jnp.stack([jnp.asarray(fractions), jnp.zeros(len(fractions))], axis=1)
    return asked.everywhere(asked.rates, points, places, shared, signals, states)[..., : states.shape[2]]


BETWEEN = Compiled(_between, use=Use.ONCE, unchanged=refuse_changed_code)


def interval_errors(
    traced: Problem,
    layout: Layout,
    points: Float[np.ndarray, "realisations germs"],
    rates: Float[np.ndarray, "realisations asked rates"],
    variables: Float[np.ndarray, " n"],
    scales: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "realisations intervals"]:
    """The error of each interval in each realisation: the largest of its states, relative to their magnitudes.

    - `rates`: of the states at the points where the scheme asks for them.
    """
    mesh, values = layout.plan.mesh, layout.view(variables)
    assert isinstance(mesh.scheme, AbstractCollocation)
    count = values.states.shape[2]
    if not count:
        return np.zeros((len(points), len(mesh.lengths)))
    nodes, weights = legendre.leggauss(len(mesh.scheme.nodes) + 2)
    inner, weights = (1 + nodes) / 2, weights / 2
    fractions = (np.array(mesh.nodes)[:-1, None] + mesh.lengths[:, None] * inner).ravel()
    states = states_on(mesh, fractions, values.states, rates)
    at = jnp.asarray(values.decisions), jnp.asarray(values.duration[0]), jnp.asarray(states)
    found = np.asarray(BETWEEN(traced, jnp.asarray(points), tuple(fractions.tolist()), at))
    polynomial = np.einsum("qi,pkis->pkqs", mesh.scheme.interpolated(inner), rates[:, mesh.stages, :count])
    missed = np.abs(polynomial - found.reshape(polynomial.shape))
    drift = mesh.lengths[None, :, None] * np.einsum("q,pkqs->pks", weights, missed)
    size = layout.view(scales).states[:, :1]
    return np.max(drift / size, axis=2)


def states_on(
    mesh: Mesh,
    fractions: Float[np.ndarray, " n"],
    states: Float[np.ndarray, "realisations points states"],
    rates: Float[np.ndarray, "realisations asked rates"],
) -> Float[np.ndarray, "realisations n states"]:
    """The states at some fractions of the duration, by the polynomials of a mesh."""
    assert isinstance(mesh.scheme, AbstractCollocation)
    which = np.clip(np.searchsorted(mesh.nodes, fractions, side="right") - 1, 0, len(mesh.lengths) - 1)
    inside = (fractions - np.array(mesh.nodes)[which]) / mesh.lengths[which]
    slopes = rates[:, mesh.stages, : states.shape[2]][:, which]
    moved = np.einsum("mi,pmis->pms", mesh.scheme.integrals(inside), slopes)
    return states[:, mesh.points[which, 0]] + mesh.lengths[which][None, :, None] * moved


def parts_of(errors: Float[np.ndarray, " intervals"], asked: float, order: int) -> Int[np.ndarray, " intervals"]:
    """In how many parts each interval of a mesh is to be divided, for its error to be what is asked.

    - `order`: by one more, the power of its length by which an interval's states are estimated to err. Between the
      stages of a collocation scheme rates are interpolated, and err by the power of their number.
    """
    needed = np.ceil((_AHEAD * errors / asked) ** (1 / (order + 1))).astype(int)
    return np.where(errors > asked, np.clip(needed, 2, _MOST_PARTS), 1)
