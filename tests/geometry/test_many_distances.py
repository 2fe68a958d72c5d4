import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.geometry import Capsule, HalfSpace, Sphere, link_distances, smallest
from compiling import compiled


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


@pytest.mark.parametrize(
    ("links", "apart", "message"),
    [
        ([POINT, POINT], 2, "no two of 2 links are 2 places from each other. Give at least 3 links"),
        ([POINT, HalfSpace([0.0, 1.0], 0.0)], 1, "link 1 is a HalfSpace"),
    ],
)
def test_links_without_distances_are_refused(links, apart, message):
    with pytest.raises(al.ProblemError, match=message):
        link_distances(links, apart)
