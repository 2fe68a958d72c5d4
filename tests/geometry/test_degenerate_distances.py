"""Places where derivatives could be infinite, vanish or cancel, and how smooth distances are elsewhere."""

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from random_shapes import PAIRS_AT_ONCE, distances

from aleator.geometry import Box, Capsule, HalfSpace, Sphere, distance
from compiling import compiled

UP = np.array([0.0, 0.0, 1.0])

COINCIDENT = {
    "two centres": (lambda x: Sphere(x, 0.5), Sphere([1.0, 2.0, 3.0], 0.2), -0.7),
    "a slanted segment through a centre": (
        lambda x: Capsule(x - np.array([0.1, 0.7, 0.3]), x + np.array([0.1, 0.7, 0.3]), 0.1),
        Sphere([1.0, 2.0, 3.0], 0.2),
        -0.3,
    ),
    "one segment on another": (lambda x: Capsule(x - UP, x + UP, 0.1), Capsule([1.0, 2.0, 2.5], [1.0, 2.0, 9.0]), -0.1),
    "segments that cross": (
        lambda x: Capsule(x - UP, x + UP, 0.1),
        Capsule([0.0, 2.0, 3.0], [2.0, 2.0, 3.0], 0.2),
        -0.3,
    ),
    "a segment through a box": (lambda x: Capsule(x - 3 * UP, x + 3 * UP), Box([1.0, 2.0, 3.0], [0.7, 0.5, 1.0]), -0.5),
    "a centre in a cube": (lambda x: Sphere(x, 0.1), Box([1.0, 2.0, 3.0], [0.5, 0.5, 0.5]), -0.6),
    "two cubes": (lambda x: Box(x, [0.5, 0.5, 0.5]), Box([1.0, 2.0, 3.0], [0.5, 0.5, 0.5]), -1.0),
    "a segment that lies on the floor": (lambda x: Capsule(x, x + np.array([1.0, 0.0, 0.0])), HalfSpace(UP, 3.0), 0.0),
}


@compiled
def near_coincidence(shapes, shift):
    """The distance with the first shape shifted, its derivative by the shift, and two derivatives by all numbers."""
    numbers, rebuild = jax.flatten_util.ravel_pytree(shapes)
    some = jnp.sin(1.0 + jnp.arange(numbers.size))

    def value(numbers, shift):
        moving, fixed = rebuild(numbers)
        places = [name for name in ("center", "start", "end") if hasattr(moving, name)]
        moved = [getattr(moving, name) + shift for name in places]
        return distance(eqx.tree_at(lambda shape: [getattr(shape, name) for name in places], moving, moved), fixed)

    def slope(numbers):
        return jax.jvp(lambda numbers: value(numbers, shift), (numbers,), (some,))[1]

    return (
        value(numbers, shift),
        jax.jacfwd(value, argnums=1)(numbers, shift),
        jax.jvp(slope, (numbers,), (some,)),
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", COINCIDENT)
def test_derivatives_are_finite_and_push_apart_where_shapes_coincide(name):
    make, fixed, expected = COINCIDENT[name]
    shapes = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), (make(np.array([1.0, 2.0, 3.0])), fixed))
    depth, away, by_numbers = near_coincidence(shapes, jnp.zeros(3))
    np.testing.assert_allclose(depth, expected, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(away), 1.0, atol=1e-12)
    # The first step along the derivative gains its whole length.
    np.testing.assert_allclose(near_coincidence(shapes, 0.05 * away)[0], expected + 0.05, atol=1e-12)
    assert np.isfinite(by_numbers).all()


def test_nearly_parallel_segments_have_the_distance_of_their_lines_and_exact_derivatives():
    # Two segments that cross at their middles, one above the other at height 0.5, turned by an angle.
    angles = np.resize([0.0, 1e-12, 1e-9, 1e-7, 3e-7, 1e-5], PAIRS_AT_ONCE)
    p = np.zeros((PAIRS_AT_ONCE, 2, 10))
    p[:, 0, 3] = 1.0
    p[:, 1, 2], p[:, 1, 3], p[:, 1, 4] = 0.5, np.cos(angles), np.sin(angles)
    p[:, :, 9] = 0.1
    values, slopes = distances(("capsule", "capsule"), 3)(p)
    np.testing.assert_allclose(values, 0.3, atol=1e-13)
    np.testing.assert_allclose(slopes[:, 1, 2], 1.0, atol=1e-6)
    by_angle = slopes[:, 1, 4] * np.cos(angles) - slopes[:, 1, 3] * np.sin(angles)
    np.testing.assert_allclose(by_angle, 0.0, atol=1e-6)


def test_the_derivative_is_continuous_along_a_link_that_sweeps_past_a_disc_and_through_contact():
    disc = Sphere([0.9, 0.5], 0.2)

    def value(angle):
        return distance(Capsule([0.0, 0.0], [jnp.cos(angle), jnp.sin(angle)], 0.1), disc)

    angles = np.linspace(-1.5, 0.45, 4001)
    gaps, slopes = (np.asarray(part) for part in compiled(jax.vmap(jax.value_and_grad(value)))(angles))
    assert gaps.min() < 0 < gaps.max()
    # The nearest point changes from the link's end to its inside: the slope is Lipschitz, its own slope jumps.
    assert np.abs(np.diff(slopes)).max() < 10 * (angles[1] - angles[0])
