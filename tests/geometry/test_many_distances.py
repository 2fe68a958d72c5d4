import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.geometry import Box, Capsule, HalfSpace, Sphere, distance, link_distances, smallest
from compiling import compiled


@pytest.mark.parametrize("sharpness", [0.5, 30.0, 1e6])
def test_the_smooth_smallest_lies_below_the_smallest_by_no_more_than_its_bound(sharpness):
    for scale in (1e-3, 1.0, 1e4):
        values = scale * np.random.default_rng(0).normal(size=(50, 7))
        found = np.asarray(compiled(jax.vmap(lambda row: smallest(row, sharpness)))(values))
        assert (found <= values.min(axis=1)).all()
        assert (found >= values.min(axis=1) - np.log(7) / sharpness - 1e-12 * scale).all()


def test_the_bound_of_the_smooth_smallest_is_met_by_equal_distances():
    np.testing.assert_allclose(smallest([0.3, 0.3, 0.3, 0.3], 50.0), 0.3 - np.log(4) / 50.0, rtol=1e-14)
    assert smallest(jnp.array([[0.3]])) == 0.3


def test_the_derivative_of_the_smooth_smallest_is_a_weighted_mean():
    values = jnp.array([0.02, 0.05, -0.01])
    weights = np.exp(-40.0 * values) / np.exp(-40.0 * values).sum()
    np.testing.assert_allclose(jax.jacfwd(lambda x: smallest(x, 40.0))(values), weights, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(([],), "at least one distance"), (([1.0], 0.0), "'sharpness' must be positive; received 0.0")],
)
def test_a_smooth_smallest_that_makes_no_sense_is_refused(arguments, message):
    with pytest.raises(al.ProblemError, match=message):
        smallest(*arguments)


def test_the_links_of_a_folded_arm_collide_and_neighbours_are_left_out():
    def arm(joints):
        angles = jnp.cumsum(joints)
        steps = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
        places = jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(steps, axis=0)])
        return [Capsule(places[i], places[i + 1], 0.05) for i in range(4)]

    stretched = link_distances(arm(jnp.zeros(4)))
    np.testing.assert_allclose(stretched, [0.9, 1.9, 0.9], atol=1e-12)
    # Turned by 90 degrees at each joint, the fourth link ends where the first begins.
    square = link_distances(arm(jnp.array([0.0, 1.0, 1.0, 1.0]) * np.pi / 2))
    np.testing.assert_allclose(square, [0.9, -0.1, 0.9], atol=1e-12)


@pytest.mark.slow
def test_the_distances_of_links_of_several_kinds_are_those_of_each_pair_in_order():
    rng = np.random.default_rng(1)
    links = [
        Capsule(rng.normal(size=2), rng.normal(size=2), 0.1),
        Sphere(rng.normal(size=2), 0.2),
        Box(rng.normal(size=2), [0.3, 0.1], 0.4),
        Capsule(rng.normal(size=2), rng.normal(size=2)),
        Sphere(rng.normal(size=2)),
    ]
    pairs = [(0, 2), (0, 3), (0, 4), (1, 3), (1, 4), (2, 4)]
    np.testing.assert_allclose(
        link_distances(links), [distance(links[i], links[j]) for i, j in pairs], rtol=1e-12, atol=1e-14
    )
    assert link_distances(links, apart=1).shape == (10,)


POINT = Sphere([0.0, 0.0])


@pytest.mark.parametrize(
    ("links", "apart", "message"),
    [
        ([POINT, POINT], 2, "no two of 2 links are 2 places from each other. Give at least 3 links"),
        ([POINT, POINT], 0, "'apart' is a whole number of at least 1; received 0"),
        ([POINT, HalfSpace([0.0, 1.0], 0.0)], 1, "link 1 is a HalfSpace"),
        ([POINT, Sphere([0.0, 0.0, 0.0])], 1, r"links of the same space; received dimensions \[2, 3\]"),
    ],
)
def test_links_without_distances_are_refused(links, apart, message):
    with pytest.raises(al.ProblemError, match=message):
        link_distances(links, apart)
