"""The states between the nodes of a mesh of segments that are integrated, and what their integration errs by.

The same rule with twice the steps tells both: its error is less by two to the power of the order.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator.design import Problem
from aleator.dynamics import MultipleShooting, SegmentRate
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._mesh_error import Drift
from aleator.transcription.simultaneous._pointwise import Pointwise


def _flown(
    problem: Problem,
    points: Float[Array, "realisations germs"],
    pieces: tuple[tuple[float, float], ...],
    rate: SegmentRate,
    at: tuple[Array, ...],
) -> Float[Array, "realisations pieces states"]:
    """The states at the ends of pieces of the duration, from decisions, duration and the states at their beginnings.

    - `pieces`: fractions of the duration.
    """
    decisions, duration, states = at
    asked = Pointwise.of(problem)
    shared = jnp.append(decisions[asked.direct], duration)
    first, last = np.array(pieces).T
    places = np.stack(np.broadcast_arrays(np.linspace(first, last, len(rate.told), axis=1), 0.0), axis=2)
    # A piece sees its own side of a jump.
    places[:, -1, 1] = 1.0
    every = places.reshape(-1, 2)
    signals = asked.known(every[:, 0], decisions, every[:, 1] > 0).reshape(len(places), -1)

    def moved(germ: Array, place: Array, signal: Array, state: Array) -> Array:
        mean = asked.mean_rates(rate, germ, place, shared, jnp.concatenate([signal, state]))
        return state + (place[-1, 0] - place[0, 0]) * mean[: state.size]

    inner = jax.vmap(moved, in_axes=(None, 0, 0, 0))
    return jax.vmap(inner, in_axes=(0, None, None, 0))(points, jnp.asarray(places), signals, states)


FLOWN = Compiled(_flown, use=Use.ONCE)


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
    at = jnp.asarray(values.decisions), jnp.asarray(values.duration[0]), jnp.asarray(begun)
    rate = SegmentRate(2 * mesh.scheme.steps)
    return np.asarray(FLOWN(traced, jnp.asarray(points), tuple(map(tuple, pieces.tolist())), rate, at))


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
