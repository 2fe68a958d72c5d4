import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator.geometry import Box, Capsule, HalfSpace, Sphere, distance
from aleator.uncertainty import placements, realise
from compiling import compiled


class Scene(eqx.Module):
    obstacle: Sphere
    wall: HalfSpace
    shelf: Box


def scene():
    return Scene(
        Sphere([al.Uniform(1.0, half_width=0.2), 0.5], al.Decision(0.1, lower=0.0, upper=0.3)),
        HalfSpace(al.Decision(np.array([0.0, 2.0])), al.Normal(-1.0, std=0.1)),
        Box([3, 0], [0.5, al.Decision(0.25, lower=0.1, upper=0.5)], al.Normal(0.0, std=0.1)),
    )


def test_shapes_of_a_model_may_hold_distributions_and_decisions():
    places = placements(scene())
    assert set(places.distributions) == {"obstacle.center.0", "wall.offset", "shelf.orientation"}
    assert set(places.decisions) == {"obstacle.radius", "wall.normal", "shelf.half_sizes.1"}

    def distances(germ, decisions):
        model = realise(numbers_to_arrays(scene()), germ, decisions)
        link = Capsule([0.0, 0.0], [model.obstacle.center[0] * 0.0, 1.0], 0.05)
        return jnp.stack([distance(link, shape) for shape in (model.obstacle, model.wall, model.shelf)])

    values, slopes = compiled(lambda germ, x: (distances(germ, x), jax.jacfwd(distances)(germ, x)))(
        np.array([0.5, -1.0, 0.0]), places.vector("initial")
    )
    # The disc at x = 1 + 0.2 * 0.5, the wall y <= (-1 - 0.1) / 2, the left side of the shelf at 2.5.
    np.testing.assert_allclose(values, [1.1 - 0.1 - 0.05, 0.55 - 0.05, 2.5 - 0.05], atol=1e-12)
    np.testing.assert_allclose(np.asarray(slopes)[:2], [[0.2, 0.0, 0.0], [0.0, -0.05, 0.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sphere(np.zeros((5, 3))), r"received shape \(5, 3\)\. For a batch of shapes, use `jax\.vmap`"),
        (lambda: Sphere([0.0, 0.0], -1.0), r"Sphere: 'radius' must be zero or more; received -1"),
        (lambda: Capsule([0.0, 0.0], [0.0, 0.0, 1.0]), r"'start' of shape \(2,\) and 'end' of shape \(3,\)"),
        (lambda: Sphere([0.0, 0.0], al.Uniform(0.1, half_width=0.3)), r"'radius' .* can reach -0\.2\."),
        (lambda: Box(np.zeros(3), al.Decision(np.ones(3), -1.0, 2.0)), r"'half_sizes' .* can reach -1\."),
        (lambda: Box(np.zeros(3), np.ones(3), 2 * np.eye(3)), r"its columns are not orthonormal"),
        (lambda: HalfSpace([0.0, 0.0], 1.0), r"HalfSpace: 'normal' must not be zero"),
    ],
)
def test_numbers_that_make_no_shape_are_refused(make, message):
    with pytest.raises(al.ProblemError, match=message):
        make()


def test_distributions_and_decisions_that_keep_a_size_positive_are_taken():
    # A lognormal distribution begins at 0 and never takes it; a radius may be 0.
    sizes = (
        al.Gamma(mean=0.2, std=0.1, lower=0.05),
        al.LogNormal(mean=0.2, std=0.1),
        al.Uniform(al.Decision(0.5, 0.3, 1.0), half_width=0.2),
    )
    assert Box(np.zeros(3), sizes).half_sizes == sizes
    radius = al.Uniform(0.1, half_width=0.1)
    assert Sphere([0.0, 0.0], radius).radius is radius


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (Sphere([0.0, 0.0]), Box(np.zeros(3), np.ones(3)), r"a Sphere in 2 dimensions and a Box in 3 dimensions"),
        (Sphere([0.0, al.Normal(0.0, std=1.0)]), Sphere([0.0, 0.0]), r"'center' holds .*, which has no value yet"),
    ],
)
def test_pairs_without_a_distance_are_refused(first, second, message):
    with pytest.raises(al.ProblemError, match=message):
        distance(first, second)
