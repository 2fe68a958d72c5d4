import itertools

import jax
import mujoco
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


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_the_gap_of_random_shapes_is_that_of_a_quadratic_program(kinds, dimension):
    p = parameters(seed=1, spread=2.5)
    parts = [difference_of_cores(kinds, pair, dimension) for pair in p]
    gaps = np.array([gap_by_quadratic_program(center, edges) for center, edges, _ in parts])
    apart = gaps > 1e-6
    assert apart.sum() > 40
    expected = gaps - [radius for *_, radius in parts]
    np.testing.assert_allclose(distances(kinds, dimension)(p)[0][apart], expected[apart], atol=1e-11)


@pytest.mark.parametrize(
    ("kinds", "dimension"),
    [(("capsule", "capsule"), 2), *((kinds, size) for kinds in PAIRS if "box" in kinds for size in (2, 3))],
)
def test_the_depth_of_random_overlaps_is_that_of_the_hull_of_their_difference(kinds, dimension):
    p = parameters(seed=2, spread=0.4)
    parts = [difference_of_cores(kinds, pair, dimension) for pair in p]
    depths = np.array([depth_by_convex_hull(center, edges) for center, edges, _ in parts])
    overlap = depths < -1e-6
    assert overlap.sum() > 15
    expected = depths - [radius for *_, radius in parts]
    np.testing.assert_allclose(distances(kinds, dimension)(p)[0][overlap], expected[overlap], atol=1e-11)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_the_height_above_a_plane_is_that_of_the_lowest_vertex(kind, dimension):
    rng = np.random.default_rng(3)
    p = parameters(seed=3, spread=1.0)[:, 0]
    normals, offsets = 3 * rng.normal(size=(len(p), dimension)), rng.normal(size=len(p))
    found = compiled(
        jax.vmap(lambda p, normal, offset: distance(HalfSpace(normal, offset), shape(kind, p, dimension)))
    )(p, normals, offsets)
    expected = []
    for parameter, normal, offset in zip(p, normals, offsets, strict=True):
        center, edges, radius = core(kind, parameter, dimension)
        vertices = center + np.array(list(itertools.product((-1.0, 1.0), repeat=len(edges)))) @ edges
        expected.append(((vertices @ normal).min() - offset) / np.linalg.norm(normal) - radius)
    np.testing.assert_allclose(found, expected, atol=1e-13)


def mujoco_distance(kinds, p):
    """The signed distance that MuJoCo finds between the same two shapes."""
    geoms = "".join(f'<geom type="{kind}" size="1 1 1"/>' for kind in kinds)
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option ccd_tolerance="1e-10"/><worldbody>{geoms}</worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    found = []
    for pair in p:
        for i, kind in enumerate(kinds):
            center, edges, radius = core(kind, pair[i], 3)
            lengths = np.linalg.norm(edges, axis=1)
            axes = np.eye(3)
            if kind == "box":
                axes, model.geom_size[i] = (edges / lengths[:, None]).T, lengths
            else:
                model.geom_size[i] = [radius, lengths.sum(), 0.0]
            if kind == "capsule":
                # Its axis is its third one: the complete QR factorisation puts it first, up to its sign.
                axes = np.roll(np.linalg.qr(edges.T, mode="complete").Q, -1, axis=1)
            data.geom_xpos[i], data.geom_xmat[i] = center, axes.ravel()
        model.geom_rbound[:] = np.linalg.norm(model.geom_size, axis=1) * 2
        found.append(mujoco.mj_geomDistance(model, data, 0, 1, 100.0, None))
    return np.array(found)


@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_mujoco_finds_the_same_distances_in_space(kinds):
    p = parameters(seed=4, spread=1.0)
    found, expected = distances(kinds, 3)(p)[0], mujoco_distance(kinds, p)
    # Of boxes MuJoCo computes approximate depths, and of a segment through a box not even the sign.
    cores_are_apart = [gap_by_quadratic_program(*difference_of_cores(kinds, pair, 3)[:2]) > 1e-6 for pair in p]
    exact = np.array(cores_are_apart) & ((expected > 0) if "box" in kinds else True)
    assert exact.sum() > 40
    assert "box" in kinds or np.sum(expected[exact] < 0) > 2
    np.testing.assert_allclose(found[exact], expected[exact], atol=1e-8)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_derivatives_are_those_of_central_differences(kinds, dimension):
    p = parameters(seed=5, spread=1.2)
    evaluate = distances(kinds, dimension)
    derivatives = evaluate(p)[1]
    for place in np.ndindex(p[0].shape):
        step = np.zeros_like(p)
        step[:, *place] = 1e-6
        differences = (evaluate(p + step)[0] - evaluate(p - step)[0]) / 2e-6
        np.testing.assert_allclose(derivatives[:, *place], differences, atol=2e-8)


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_a_move_along_the_derivative_by_the_depth_ends_at_contact(kinds, dimension):
    p = parameters(seed=6, spread=0.2)
    depth, derivative = (np.asarray(part) for part in distances(kinds, dimension)(p))
    away = derivative[:, 1, :dimension]
    overlap = depth < 0
    assert overlap.sum() > 20
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), 1.0, atol=1e-12)
    p[:, 1, :dimension] -= depth[:, None] * away
    np.testing.assert_allclose(distances(kinds, dimension)(p)[0][overlap], 0.0, atol=1e-12)


def test_the_order_of_shapes_does_not_matter():
    p = parameters(seed=7, spread=1.0)[0]
    shapes = [
        *(shape(kind, one, 2) for kind, one in zip(KINDS, [*p, p[0] + 0.3], strict=True)),
        HalfSpace([0.6, 0.8], 0.1),
    ]
    for first, second in itertools.combinations(shapes, 2):
        np.testing.assert_allclose(distance(first, second), distance(second, first), atol=1e-14)
