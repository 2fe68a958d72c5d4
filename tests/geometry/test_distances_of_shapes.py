"""Distances of shapes, of degenerate ones and of many, against quadratic programs, hulls and closed forms."""

import itertools

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from random_shapes import KINDS, PAIRS_AT_ONCE, core, distances, parameters, shape
from scipy.optimize import lsq_linear
from scipy.spatial import ConvexHull

import aleator as al
from aleator.geometry import Box, Capsule, HalfSpace, Sphere, distance, link_distances, smallest
from compiling import compiled
from zoo import cases


def difference_of_cores(kinds, p, dimension):
    """Centre and half edges of the difference of two cores, and the sum of the radii."""
    (one, edges, radius), (other, more, further) = (core(kind, p[i], dimension) for i, kind in enumerate(kinds))
    return other - one, np.concatenate([edges, more]), radius + further


def gap_by_quadratic_program(center, edges):
    """The distance of the origin to the points `center + sum(s_i edges_i)`, `|s_i| <= 1`."""
    if not len(edges):
        return np.linalg.norm(center)
    return np.linalg.norm(lsq_linear(edges.T, -center, bounds=(-1.0, 1.0), method="bvls", tol=1e-14).fun)


def depth_by_convex_hull(center, edges):
    """Minus the depth of the origin in the same set, which has a volume; positive outside of it."""
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=len(edges))))
    return ConvexHull(center + signs @ edges).equations[:, -1].max()


# One program for each number of edges and each branch.
CASES = cases(
    [
        (("box", "box"), 2),
        (("sphere", "capsule"), 3),
        (("capsule", "capsule"), 3),
        (("sphere", "box"), 3),
        (("capsule", "capsule"), 2),
        (("box", "box"), 3),
    ],
    2,
)


@pytest.mark.parametrize(("kinds", "dimension"), CASES)
def test_gaps_are_those_of_a_quadratic_program_and_depths_those_of_a_convex_hull(kinds, dimension):
    p = parameters(seed=1, spread=1.2)
    parts = [difference_of_cores(kinds, pair, dimension) for pair in p]
    gaps = np.array([gap_by_quadratic_program(center, edges) for center, edges, _ in parts])
    radii, found = np.array([radius for *_, radius in parts]), np.asarray(distances(kinds, dimension)(p)[0])
    apart = gaps > 1e-6
    assert apart.sum() > 20
    np.testing.assert_allclose(found[apart], (gaps - radii)[apart], atol=1e-11)
    if "box" in kinds or (kinds, dimension) == (("capsule", "capsule"), 2):  # their difference has a volume
        depths = np.array([depth_by_convex_hull(center, edges) for center, edges, _ in parts])
        overlap = depths < -1e-6
        assert overlap.sum() > 5
        np.testing.assert_allclose(found[overlap], (depths - radii)[overlap], atol=1e-11)


@pytest.mark.parametrize(("kinds", "dimension"), CASES)
def test_derivatives_are_those_of_differences_and_a_move_along_them_by_the_depth_ends_at_contact(kinds, dimension):
    evaluate = distances(kinds, dimension)
    p = parameters(seed=5, spread=1.2)
    derivatives = np.asarray(evaluate(p)[1])
    for place in np.ndindex(p[0].shape):
        step = np.zeros_like(p)
        step[:, *place] = 1e-6
        differences = (evaluate(p + step)[0] - evaluate(p - step)[0]) / 2e-6
        np.testing.assert_allclose(derivatives[:, *place], differences, atol=2e-8)
    p = parameters(seed=6, spread=0.2)
    depth, derivative = (np.asarray(part) for part in evaluate(p))
    away, overlap = derivative[:, 1, :dimension], depth < 0
    assert overlap.sum() > 20
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1.0, atol=1e-12)
    p[:, 1, :dimension] -= depth[:, None] * away
    np.testing.assert_allclose(evaluate(p)[0][overlap], 0.0, atol=1e-12)


def test_the_height_above_a_plane_is_that_of_the_lowest_vertex():
    rng = np.random.default_rng(3)
    p = parameters(seed=3, spread=1.0)[:, 0]
    sides = {size: (3 * rng.normal(size=(len(p), size)), rng.normal(size=len(p))) for size in (2, 3)}
    cases = list(itertools.product(KINDS, sides))

    @compiled
    @jax.vmap
    def heights(p, sides):
        return [distance(HalfSpace(*sides[size]), shape(kind, p, size)) for kind, size in cases]

    for (kind, size), found in zip(cases, heights(p, sides), strict=True):
        expected = []
        for parameter, normal, offset in zip(p, *sides[size], strict=True):
            center, edges, radius = core(kind, parameter, size)
            vertices = center + np.array(list(itertools.product((-1.0, 1.0), repeat=len(edges)))) @ edges
            expected.append(((vertices @ normal).min() - offset) / np.linalg.norm(normal) - radius)
        np.testing.assert_allclose(found, expected, atol=1e-13)


def test_the_order_of_shapes_does_not_matter():
    p = parameters(seed=7, spread=1.0)[0]

    @compiled
    def both_ways(p):
        shapes = shape("capsule", p[0], 2), shape("box", p[1], 2), HalfSpace([0.6, 0.8], 0.1)
        pairs = list(itertools.combinations(shapes, 2))
        return [distance(*pair) for pair in pairs], [distance(*reversed(pair)) for pair in pairs]

    np.testing.assert_allclose(*both_ways(p), atol=1e-14)


# --- Places where derivatives could be infinite, vanish or cancel, and how smooth distances are elsewhere -------------


UP = np.array([0.0, 0.0, 1.0])

COINCIDENT = {
    "two centres": (lambda x: Sphere(x, 0.5), Sphere([1.0, 2.0, 3.0], 0.2), -0.7),
    "segments that cross": (
        lambda x: Capsule(x - UP, x + UP, 0.1),
        Capsule([0.0, 2.0, 3.0], [2.0, 2.0, 3.0], 0.2),
        -0.3,
    ),
    "a segment through a box": (lambda x: Capsule(x - 3 * UP, x + 3 * UP), Box([1.0, 2.0, 3.0], [0.7, 0.5, 1.0]), -0.5),
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


# --- Many distances ---------------------------------------------------------------------------------------------------


def test_the_smooth_smallest_lies_below_the_smallest_by_no_more_than_its_bound_and_weighs_by_distance():
    function = jax.vmap(jax.value_and_grad(smallest), in_axes=(0, None))
    program = compiled(lambda values, sharpness: (function(values, sharpness), smallest([0.3] * 4, sharpness)))
    values = np.concatenate([scale * np.random.default_rng(0).normal(size=(50, 7)) for scale in (1e-3, 1.0, 1e4)])
    least = values.min(axis=1)
    for sharpness in (0.5, 30.0, 1e6):
        (found, slopes), of_equal = jax.tree.map(np.asarray, program(values, sharpness))
        assert (found <= least).all()
        assert (found >= least - np.log(7) / sharpness - 1e-12 * np.abs(values).max(axis=1)).all()
        weights = np.exp(-sharpness * (values - least[:, None]))
        expected = weights / weights.sum(axis=1, keepdims=True)
        np.testing.assert_allclose(slopes, expected, rtol=1e-6, atol=1e-9)
        assert of_equal == pytest.approx(0.3 - np.log(4) / sharpness, rel=1e-12)  # the bound is met


def test_the_links_of_a_folded_arm_collide_and_neighbours_are_left_out():
    def arm(joints):
        angles = jnp.cumsum(joints)
        steps = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
        places = jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(steps, axis=0)])
        return [Capsule(places[i], places[i + 1], 0.05) for i in range(4)]

    of_arm = compiled(lambda joints: link_distances(arm(joints)))
    stretched = of_arm(np.zeros(4))
    np.testing.assert_allclose(stretched, [0.9, 1.9, 0.9], atol=1e-12)
    # Turned by 90 degrees at each joint, the fourth link ends where the first begins.
    square = of_arm(np.array([0.0, 1.0, 1.0, 1.0]) * np.pi / 2)
    np.testing.assert_allclose(square, [0.9, -0.1, 0.9], atol=1e-12)


def test_distances_of_links_of_two_kinds_come_in_the_order_of_their_pairs():
    # A rod along the x axis among points: grouped by kinds, the pairs 1-2, 1-3 and 2-3 change places in a cycle.
    points = {0: np.array([-3.0, 4.0]), 2: np.array([2.0, 1.0]), 3: np.array([5.0, 2.0])}
    rod = Capsule([0.0, 0.0], [4.0, 0.0], 0.5)
    links = [Sphere(points[0]), rod, Sphere(points[2]), Sphere(points[3])]

    def away(i: int, j: int) -> float:
        if 1 not in (i, j):
            return float(np.linalg.norm(points[i] - points[j]))
        (place,) = (points[k] for k in (i, j) if k != 1)
        return float(np.linalg.norm(place - [np.clip(place[0], 0.0, 4.0), 0.0])) - 0.5

    expected = [away(i, j) for i in range(4) for j in range(i + 1, 4)]
    np.testing.assert_allclose(compiled(lambda: link_distances(links, apart=1))(), expected, rtol=1e-12)


POINT = Sphere([0.0, 0.0])


def test_links_without_distances_are_refused():
    with pytest.raises(al.ProblemError, match="no two of 2 links are 2 places from each other"):
        link_distances([POINT, POINT], 2)
