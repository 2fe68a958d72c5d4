"""The error of a mesh, and how it is refined: its intervals are divided, or all are given more stages, whichever takes
fewer points.

- Over an interval of a collocation scheme states are polynomials. The integral of the magnitude by which their rates
  miss those of the dynamics is an estimate of the error that the interval adds (Betts, Practical Methods for Optimal
  Control, 4.6).
- Segments are integrated. The same rule with twice the steps, half a segment at a time, tells the states between their
  nodes and the error, which is less by two to the power of the order.
- Rates there are those of the program's own blocks at other places: nothing of them is compiled again.
- Where states are smooth, errors fall geometrically with the number of stages; where they are not, only shorter
  intervals help (Patterson, Hager and Rao, Optimal Control Applications and Methods 36 (2015) 398).
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from numpy.polynomial import legendre

from aleator.design import Problem
from aleator.dynamics import AbstractCollocation, AbstractScheme, MultipleShooting
from aleator.transcription.simultaneous._blocks import Family
from aleator.transcription.simultaneous._evaluations import evaluated_at, signals_at
from aleator.transcription.simultaneous._families import RATES, number_of
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._mesh import Mesh
from aleator.transcription.simultaneous._program import Assembled

# Between two meshes an interval is divided into at most so many parts; each is to be this much better than asked.
_MOST_PARTS, _AHEAD = 8, 2.0
# Rates fall by no less than this from one Legendre polynomial to the next: more is chance.
_LEAST_RATIO = 0.05
# How many of the last polynomials tell how fast.
_LAST = 3

Rates: TypeAlias = Callable[[np.ndarray, np.ndarray], Float[np.ndarray, "realisations blocks states"]]
"""The mean rates of states at blocks of places, shape (blocks, told, 2), from the states at the first place of each."""


def state_rates(
    traced: Problem,
    layout: Layout,
    assembled: Assembled,
    points: Float[np.ndarray, "realisations germs"],
    variables: Float[np.ndarray, " n"],
    which: int,
    places: Float[np.ndarray, "blocks told 2"],
    states: Float[np.ndarray, "realisations blocks states"],
) -> Float[np.ndarray, "realisations blocks states"]:
    """The mean rates of the states of a phase, by its number and by the fraction of its duration; algebraic variables
    are solved for.
    """
    phase, values = layout.phases[which], layout.view(variables)
    pointwise, duration, shape = phase.pointwise, values.phases[which].duration, (len(points), len(places))
    signals = signals_at(pointwise, places.reshape(-1, 2), values.decisions).reshape(len(places), -1)
    model = values.decisions[pointwise.direct]
    shared = model if pointwise.is_open else np.append(model, duration)
    parts = [np.broadcast_to(signals, (len(points), *signals.shape))]
    parts += [np.broadcast_to(duration[:, None], (*shape, 1))] if pointwise.is_open else []
    parts.append(states)
    if phase.shapes.algebraic:
        at = model, duration, signals, states
        parts.append(evaluated_at("algebraic", (traced, phase.name), points, places[:, 0], *at))
    own = np.concatenate(parts, axis=2)
    numbers = shared.size + np.arange(own.size).reshape(own.shape)
    family = Family(pointwise.rates, np.arange(shared.size), numbers, points, places)
    number = number_of(RATES, which, len(layout.phases))
    return assembled.evaluated.rates(number, family, np.append(shared, own))[:, :, : states.shape[2]]


class Drift(NamedTuple):
    """How far states drift from their equations within each interval, relative to their magnitudes.

    - `errors`: shape (realisations, intervals, states);
    - `ratios`: by what an error would be multiplied if the scheme had one stage more, at most 1.
    """

    errors: Float[np.ndarray, "realisations intervals states"]
    ratios: Float[np.ndarray, "realisations intervals states"]

    @property
    def worst(self) -> Float[np.ndarray, "realisations intervals"]:
        """The error of the state that drifts most."""
        return self.errors.max(axis=2, initial=0.0)

    def with_more(self, stages: int) -> Float[np.ndarray, " intervals"]:
        """The largest error of each interval to be expected of a scheme with so many stages more."""
        return np.max(self.errors * self.ratios**stages, axis=(0, 2), initial=0.0)


def drift_of(
    mesh: Mesh,
    rates_at: Rates,
    rates: Float[np.ndarray, "realisations asked rates"],
    values: Float[np.ndarray, "realisations points states"],
    sizes: Float[np.ndarray, "realisations points states"],
) -> Drift:
    """The drift of all states of a phase, with how fast it would fall with the number of stages.

    - `rates_at`: see `Rates`; `rates`: of the states at the points where the scheme asks for them;
    - `values`: the states; `sizes`: how large they are.
    """
    assert isinstance(mesh.scheme, AbstractCollocation)
    count = values.shape[2]
    nodes, weights = legendre.leggauss(len(mesh.scheme.nodes) + 2)
    inner, weights = (1 + nodes) / 2, weights / 2
    fractions = (np.array(mesh.nodes)[:-1, None] + mesh.lengths[:, None] * inner).ravel()
    states = states_on(mesh, fractions, values, rates)
    places = np.stack([fractions, np.zeros_like(fractions)], axis=1)[:, None]
    true_rates = rates_at(places, states)
    stage_rates = rates[:, mesh.stages, :count]
    polynomial = np.einsum("qi,pkis->pkqs", mesh.scheme.interpolated(inner), stage_rates)
    missed = np.abs(polynomial - true_rates.reshape(polynomial.shape))
    average = np.einsum("q,pkqs->pks", weights, missed)
    return Drift(mesh.lengths[:, None] * average / sizes[:, :1], _ratios(mesh.scheme, stage_rates, average))


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
    mesh: Mesh,
    rates_at: Rates,
    values: Float[np.ndarray, "realisations points states"],
    fractions: Float[np.ndarray, " places"],
    side: Literal["left", "right"] = "right",
) -> Float[np.ndarray, "realisations places states"]:
    """The states at some fractions of the duration, each from the last node up to there, or before there (`left`)."""
    before = np.clip(np.searchsorted(mesh.nodes, fractions, side) - 1, 0, len(mesh.lengths) - 1)
    begun, states = np.array(mesh.nodes)[before], values[:, before]
    middles = (begun + fractions) / 2
    for first, last in ((begun, middles), (middles, fractions)):
        places = np.stack(np.broadcast_arrays(np.linspace(first, last, len(mesh.scheme.told), axis=1), 0.0), axis=2)
        # A piece sees its own side of a jump.
        places[:, -1, 1] = 1.0
        states = states + (last - first)[:, None] * rates_at(places, states)
    return states


def segment_drift(
    mesh: Mesh,
    rates_at: Rates,
    values: Float[np.ndarray, "realisations points states"],
    sizes: Float[np.ndarray, "realisations points states"],
) -> Drift:
    """The error of each segment, relative to the magnitudes of the states. Its order cannot be raised."""
    assert isinstance(mesh.scheme, MultipleShooting)
    finer = segment_states(mesh, rates_at, values, np.array(mesh.nodes[1:]), "left")
    errors = np.abs(values[:, 1:] - finer) / (1 - 0.5**mesh.scheme.order) / sizes[:, :1]
    return Drift(errors, np.ones_like(errors))


class Goal(NamedTuple):
    """What is asked of meshes.

    - `error`: of every interval, infinite for none;
    - `schemes`: that of the first mesh, then those with more stages that later ones may have.
    """

    error: float
    schemes: tuple[AbstractScheme, ...]


def refinement(
    goal: Goal, scheme: AbstractScheme, drifts: Sequence[Drift]
) -> tuple[AbstractScheme, list[Int[np.ndarray, " _"]]]:
    """The scheme of the meshes after those that have another, and in how many parts each interval of each phase is to
    be divided.
    """
    ends = np.cumsum([one.errors.shape[1] for one in drifts])[:-1]
    choices = []
    for one in goal.schemes[goal.schemes.index(scheme) :]:
        more = len(one.points) - len(scheme.points)
        expected = np.concatenate([one.with_more(more) for one in drifts]) * (_AHEAD if more else 1.0)
        needed = parts_of(expected, goal.error, one.estimated_order)
        choices.append((needed.sum() * (len(one.points) - 1), one, needed))
    _, best, parts = min(choices, key=lambda choice: choice[0])
    return best, np.split(np.minimum(parts, _MOST_PARTS), ends)


def parts_of(errors: Float[np.ndarray, " intervals"], tolerance: float, order: int) -> Int[np.ndarray, " intervals"]:
    """In how many parts each interval of a mesh is to be divided, for its error to be a tolerance.

    - `order`: by one more, the power of its length by which an interval's states are estimated to err. Between the
      stages of a collocation scheme rates are interpolated, and err by the power of their number.
    """
    return np.maximum(np.ceil((_AHEAD * errors / tolerance) ** (1 / (order + 1))).astype(int), 1)
