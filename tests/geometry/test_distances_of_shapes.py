import itertools

import jax
import numpy as np
import pytest
from random_shapes import KINDS, PAIRS, core, distances, parameters, shape
from scipy.optimize import lsq_linear
from scipy.spatial import ConvexHull

from aleator.geometry import HalfSpace, distance
from compiling import compiled


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


# By default one program for each number of edges and each branch; the others take long to compile.
BY_DEFAULT = [
    (("capsule", "capsule"), 2),
    (("box", "box"), 2),
    (("sphere", "capsule"), 3),
    (("capsule", "capsule"), 3),
    (("sphere", "box"), 3),
]
CASES = [
    pytest.param(
        kinds, size, id=f"{'-'.join(kinds)}-{size}", marks=[] if (kinds, size) in BY_DEFAULT else pytest.mark.slow
    )
    for kinds in PAIRS
    for size in (2, 3)
]


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
