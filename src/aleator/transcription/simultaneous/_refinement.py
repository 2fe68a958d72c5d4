"""The error of a mesh, and how it is refined: its intervals are divided, or all are given more stages, whichever takes
fewer points.

- Over an interval of a collocation scheme states are polynomials. The integral of the magnitude by which their rates
  miss those of the dynamics is an estimate of the error that the interval adds (Betts, Practical Methods for Optimal
  Control, 4.6).
- Segments are integrated. The same rule with twice the steps tells the states between their nodes and the error, which
  is less by two to the power of the order.
- Where states are smooth, errors fall geometrically with the number of stages; where they are not, only shorter
  intervals help (Patterson, Hager and Rao, Optimal Control Applications and Methods 36 (2015) 398).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from numpy.polynomial import legendre

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem
from aleator.dynamics import AbstractCollocation, AbstractMeanRate, AbstractScheme, MultipleShooting, SegmentRate
from aleator.transcription.simultaneous._layout import Layout, Variables, in_chunks, signals_at
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._pointwise import Pointwise

# Between two meshes an interval is divided into at most so many parts; each is to be this much better than asked.
_MOST_PARTS, _AHEAD = 8, 2.0
# Rates fall by no less than this from one Legendre polynomial to the next: more is chance.
_LEAST_RATIO = 0.05
# How many of the last polynomials tell how fast.
_LAST = 3


def _mean_rates(
    problem: Problem,
    rate: AbstractMeanRate,
    points: Float[Array, "realisations germs"],
    at: tuple[Array, Array, Array, Array],
) -> Float[Array, "realisations blocks rates"]:
    """Mean rates at blocks of places, from what all share, and each one's places, signals, and states at the first."""
    shared, places, signals, states = at
    pointwise = Pointwise.of(problem)

    def mean(germ: Array, place: Array, signal: Array, state: Array) -> Array:
        return pointwise.mean_rates(rate, germ, place, shared, jnp.concatenate([signal, state]))

    inner = jax.vmap(mean, in_axes=(None, 0, 0, 0))
    return jax.vmap(inner, in_axes=(0, None, None, 0))(points, places, signals, states)


MEAN_RATES = Compiled(_mean_rates, use=Use.ONCE)


def _state_rates(
    traced: Problem,
    layout: Layout,
    points: Float[np.ndarray, "realisations germs"],
    rate: AbstractMeanRate,
    values: Variables,
    places: Float[np.ndarray, "blocks told 2"],
    states: Float[np.ndarray, "realisations blocks states"],
) -> Float[np.ndarray, "realisations blocks states"]:
    """The mean rates of states by the fraction of the duration; algebraic variables are solved for."""
    signals = signals_at(traced, places.reshape(-1, 2), values.decisions).reshape(len(places), -1)
    shared = np.append(values.decisions[layout.pointwise.direct], values.duration)
    parts = []
    for which, count in in_chunks(places):
        rates = MEAN_RATES(traced, rate, points, (shared, places[which], signals[which], states[:, which]))
        parts.append(np.asarray(rates)[:, :count, : states.shape[2]])
    return np.concatenate(parts, axis=1)


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
    places = np.stack([fractions, np.zeros_like(fractions)], axis=1)[:, None]
    true_rates = _state_rates(traced, layout, points, mesh.scheme.rate, values, places, states)
    stage_rates = rates[:, mesh.stages, :count]
    polynomial = np.einsum("qi,pkis->pkqs", mesh.scheme.interpolated(inner), stage_rates)
    missed = np.abs(polynomial - true_rates.reshape(polynomial.shape))
    average = np.einsum("q,pkqs->pks", weights, missed)
    size = layout.view(scales).states[:, :1]
    return Drift(mesh.lengths[:, None] * average / size, _ratios(mesh.scheme, stage_rates, average))


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
    last = np.abs(np.einsum("ji,pkis->pkjs", scheme.spectrum[first:], rates)).max(axis=2)
    share = np.divide(missed, last, out=np.ones_like(missed), where=last > 0)
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


def segment_states(
    traced: Problem,
    layout: Layout,
    points: Float[np.ndarray, "realisations germs"],
    variables: Float[np.ndarray, " n"],
    pieces: Float[np.ndarray, "pieces 2"],
) -> Float[np.ndarray, "realisations pieces states"]:
    """The states at the ends of pieces that begin at nodes: fractions of the duration."""
    mesh, values = layout.plan.mesh, layout.view(variables)
    assert isinstance(mesh.scheme, MultipleShooting)
    begun = values.states[:, np.searchsorted(mesh.nodes, pieces[:, 0])]
    rate, (first, last) = SegmentRate(2 * mesh.scheme.steps), pieces.T
    places = np.stack(np.broadcast_arrays(np.linspace(first, last, len(rate.told), axis=1), 0.0), axis=2)
    # A piece sees its own side of a jump.
    places[:, -1, 1] = 1.0
    mean = _state_rates(traced, layout, points, rate, values, places, begun)
    return begun + (last - first)[:, None] * mean


def segment_drift(
    traced: Problem,
    layout: Layout,
    points: Float[np.ndarray, "realisations germs"],
    variables: Float[np.ndarray, " n"],
    scales: Float[np.ndarray, " n"],
) -> Drift:
    """The error of each segment, relative to the magnitudes of the states. Its order cannot be raised."""
    mesh, values = layout.plan.mesh, layout.view(variables)
    nodes = np.array(mesh.nodes)
    finer = segment_states(traced, layout, points, variables, np.stack([nodes[:-1], nodes[1:]], axis=1))
    errors = np.abs(values.states[:, 1:] - finer) / (1 - 0.5**mesh.scheme.order) / layout.view(scales).states[:, :1]
    return Drift(errors, np.ones_like(errors))


def segment_states_on(
    traced: Problem,
    layout: Layout,
    points: Float[np.ndarray, "realisations germs"],
    variables: Float[np.ndarray, " n"],
    fractions: Float[np.ndarray, " places"],
) -> Float[np.ndarray, "realisations places states"]:
    """The states at some fractions of the duration, each from the node before it."""
    nodes = np.array(layout.plan.mesh.nodes)
    before = nodes[np.clip(np.searchsorted(nodes, fractions, side="right") - 1, 0, len(nodes) - 2)]
    return segment_states(traced, layout, points, variables, np.stack([before, fractions], axis=1))


class Goal(NamedTuple):
    """What is asked of meshes.

    - `error`: of every interval, infinite for none;
    - `schemes`: that of the first mesh, then those with more stages that later ones may have.
    """

    error: float
    schemes: tuple[AbstractScheme, ...]


def refinement(
    goal: Goal, scheme: AbstractScheme, drift: Drift
) -> tuple[AbstractScheme, Int[np.ndarray, " intervals"]]:
    """The scheme of the mesh after one that has another, and in how many parts each interval is to be divided."""
    choices = []
    for one in goal.schemes[goal.schemes.index(scheme) :]:
        more = len(one.points) - len(scheme.points)
        expected = drift.with_more(more) * (_AHEAD if more else 1.0)
        needed = parts_of(expected, goal.error, one.estimated_order)
        choices.append((needed.sum() * (len(one.points) - 1), one, needed))
    _, best, parts = min(choices, key=lambda choice: choice[0])
    return best, np.minimum(parts, _MOST_PARTS)


def parts_of(errors: Float[np.ndarray, " intervals"], tolerance: float, order: int) -> Int[np.ndarray, " intervals"]:
    """In how many parts each interval of a mesh is to be divided, for its error to be a tolerance.

    - `order`: by one more, the power of its length by which an interval's states are estimated to err. Between the
      stages of a collocation scheme rates are interpolated, and err by the power of their number.
    """
    needed = np.ceil((_AHEAD * errors / tolerance) ** (1 / (order + 1))).astype(int)
    return np.where(errors > tolerance, np.maximum(needed, 2), 1)
