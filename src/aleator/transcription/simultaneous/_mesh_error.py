"""The error of a mesh: how far states drift from their equations between the points at which a scheme holds them.

Over an interval a scheme's states are polynomials. The integral of the magnitude by which their rates miss those of the
dynamics is an estimate of the error that the interval adds (Betts, Practical Methods for Optimal Control, 4.6).
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial import legendre

from aleator._core.arrays import jax_array
from aleator._core.compilation import Compiled, Use
from aleator.design import Problem
from aleator.dynamics import AbstractCollocation
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise

# Rates fall by no less than this from one Legendre polynomial to the next: more is chance.
_LEAST_RATIO = 0.05
# How many of the last polynomials tell how fast.
_LAST = 3


def _between(
    problem: Problem, points: Float[Array, "realisations germs"], fractions: tuple[float, ...], at: tuple[Array, ...]
) -> Float[Array, "realisations asked rates"]:
    """The rates of all states at some fractions of the duration, from decisions, duration and the states there."""
    decisions, duration, states = at
    asked = Pointwise.of(problem)
    signals, shared = asked.known(np.array(fractions), decisions), jnp.append(decisions[asked.direct], duration)
    places = jnp.stack([jnp.asarray(fractions), jnp.zeros(len(fractions))], axis=1)
    return asked.everywhere(asked.rates, points, places, shared, signals, states)[..., : states.shape[2]]


BETWEEN = Compiled(_between, use=Use.ONCE)


class Drift(NamedTuple):
    """How far states drift from their equations within each interval, relative to their magnitudes.

    - `errors`: shape (realisations, intervals, states);
    - `ratios`: by what an error would be multiplied if the scheme had one stage more, at most 1.
    """

    errors: Float[np.ndarray, "realisations intervals states"]
    ratios: Float[np.ndarray, "realisations intervals states"]

    def with_more(self, stages: int) -> Float[np.ndarray, " intervals"]:
        """The largest error of each interval to be expected of a scheme with so many stages more."""
        return np.max(self.errors * self.ratios**stages, axis=(0, 2), initial=0.0)


def drift_of(
    traced: Problem,
    layout: Layout,
    points: Float[np.ndarray, "realisations germs"],
    rates: Float[np.ndarray, "realisations asked rates"],
    variables: Float[np.ndarray, " n"],
    scales: Float[np.ndarray, " n"],
) -> Drift:
    """The drift of all states, with how fast it would fall with the number of stages.

    - `rates`: of the states at the points where the scheme asks for them.
    """
    mesh, values = layout.plan.mesh, layout.view(variables)
    assert isinstance(mesh.scheme, AbstractCollocation)
    count = values.states.shape[2]
    if not count:
        return Drift(*2 * (np.zeros((len(points), len(mesh.lengths), 0)),))
    nodes, weights = legendre.leggauss(len(mesh.scheme.nodes) + 2)
    inner, weights = (1 + nodes) / 2, weights / 2
    fractions = (np.array(mesh.nodes)[:-1, None] + mesh.lengths[:, None] * inner).ravel()
    states = states_on(mesh, fractions, values.states, rates)
    at = jax_array(values.decisions), jax_array(values.duration[0]), jax_array(states)
    found = np.asarray(BETWEEN(traced, jax_array(points), tuple(fractions.tolist()), at))
    told = rates[:, mesh.stages, :count]
    polynomial = np.einsum("qi,pkis->pkqs", mesh.scheme.interpolated(inner), told)
    missed = np.abs(polynomial - found.reshape(polynomial.shape))
    average = np.einsum("q,pkqs->pks", weights, missed)
    size = layout.view(scales).states[:, :1]
    return Drift(mesh.lengths[:, None] * average / size, _ratios(mesh.scheme, told, average))


def _ratios(
    scheme: AbstractCollocation,
    rates: Float[np.ndarray, "realisations intervals stages states"],
    missed: Float[np.ndarray, "realisations intervals states"],
) -> Float[np.ndarray, "realisations intervals states"]:
    """By what rates fall from one Legendre polynomial to the next, from the last ones to what is missed.

    Those of a smooth state fall geometrically, those of one with a kink ever more slowly (Liu, Hager and Rao, IEEE
    Transactions on Control Systems Technology 26 (2018) 1475).
    """
    stages = len(scheme.nodes)
    first = max(min(1, stages - 1), stages - _LAST)
    # Every second polynomial may be missing by symmetry.
    found = np.abs(np.einsum("ji,pkis->pkjs", scheme.spectrum[first:], rates)).max(axis=2)
    share = np.divide(missed, found, out=np.ones_like(missed), where=found > 0)
    return np.clip(share ** (1 / (stages - first)), _LEAST_RATIO, 1.0)


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
