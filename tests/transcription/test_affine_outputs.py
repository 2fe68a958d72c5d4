"""Outputs that are affine in what the germ moves: told by their equations, and solved at a few points without error."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.studies import pick_and_place_time
from aleator.studies.two_link_arm import START, TARGET, TwoLinkArm
from aleator.transcription import transcribe
from aleator.transcription.sequential import _instantaneous as instantaneous
from aleator.transcription.sequential._affine import affine_features, anchored

GERM, MOVED = jnp.array([0.3, 0.4]), jnp.array([1.1, 2.0])


@jax.jit
def halved(x):
    return 0.5 * x


AFFINE = {
    "features of any kind times what is moved": lambda g, x: jnp.sin(x[0]) * g[0] ** 2 + x[1] * jnp.exp(g[1]),
    "no germ": lambda g, x: jnp.cos(x[0]) / x[1],
    "the germ alone": lambda g, x: g[0] * g[1],
    "products of matrices": lambda g, x: jnp.stack([x[0], x[1] ** 2]) @ jnp.stack([g, g**2]) @ x,
    "parts and sums": lambda g, x: jnp.sum(jnp.concatenate([x * g[0], jnp.flip(g)])[1:]) - jnp.cross(x, g),
    "a choice by what is moved": lambda g, x: jnp.where(x[0] > 0, g[0] * x[0], x[1]),
    "a quotient by what is moved": lambda g, x: (g[0] + x[0]) / x[1],
    "a function within": lambda g, x: halved(g[0] * x[0]),
}
OTHER = {
    "a product of uncertain numbers": lambda g, x: (x[0] * g[0]) * (x[1] * g[1]),
    "a root": lambda g, x: jnp.sqrt(x[0] + g[0]),
    "a choice by the germ": lambda g, x: jnp.where(g[0] > x[0], x[0], x[1]),
    "a quotient by the germ": lambda g, x: x[0] / (x[1] + g[0]),
    "a maximum": lambda g, x: jnp.maximum(x[0], g[0]),
    "rounding": lambda g, x: (x[0] * g[0]).astype(int) * 1.0,
    "a function within": lambda g, x: halved(jnp.abs(g[0] - x[0])),
    "a power": lambda g, x: (g[0] + x[0]) ** 2,
}


@pytest.mark.parametrize("name", AFFINE)
def test_what_is_affine_in_features_of_the_germ_follows_from_a_few_points(name):
    rng = np.random.default_rng(0)
    points = rng.uniform(-1, 1, (12, 2))
    features = [affine_features(lambda *at: [AFFINE[name](*at)], jnp.asarray(one), MOVED) for one in points]
    assert features[0][1] == (True,)
    anchors = anchored(points, np.stack([one for one, _ in features]), (True,))
    assert len(anchors.points) < 8
    np.testing.assert_allclose(anchors.weights.sum(axis=1), 1.0, rtol=1e-12)
    elsewhere = jnp.asarray(rng.uniform(0.5, 2, 2))
    solve = jax.vmap(lambda point: AFFINE[name](point, elsewhere))
    np.testing.assert_allclose(anchors.weights @ solve(anchors.points), solve(jnp.asarray(points)), rtol=1e-9)


@pytest.mark.parametrize("name", OTHER)
def test_what_is_not_affine_is_never_taken_to_be(name):
    assert affine_features(lambda *at: [OTHER[name](*at)], GERM, MOVED)[1] == (False,)


def test_outputs_are_told_apart_one_by_one():
    both = AFFINE["the germ alone"], OTHER["a root"], AFFINE["no germ"]
    features, affine = affine_features(lambda *at: [one(*at) for one in both], GERM, MOVED)
    assert affine == (True, False, True)
    np.testing.assert_allclose(features, [0.12])


def test_points_that_are_all_needed_are_all_kept():
    points = np.linspace(-1, 1, 4)[:, None]
    assert anchored(points, np.vander(points[:, 0], 4), (True,)) is None
    assert len(anchored(points, points, (True,)).points) == 2
    assert len(anchored(points, np.zeros((4, 0)), (True,)).points) == 1
    assert anchored(points, np.where(points > 0, points, np.inf), (True,)) is None


class SpatialArm(al.Multibody):
    """Two joints, and a load of uncertain mass at an uncertain place: torques know its mass and its moments."""

    payload: al.Number = al.parameter("kg", positive=True)
    offset: al.Number = al.parameter("m")

    def bodies(self):
        return (
            al.Body("base", joint=al.joints.Revolute("z"), mass=2.0, center=(0.1, 0.0, 0.2), inertia=(0.1, 0.1, 0.05)),
            al.Body("arm", parent="base", joint=al.joints.Revolute("y"), position=(0.0, 0.1, 0.3), mass=1.0),
            al.Body("load", parent="arm", joint=al.joints.Fixed(), position=(0.5, 0.0, self.offset), mass=self.payload),
        )


def spatial_problem():
    arm = SpatialArm(payload=al.Uniform(2.0, half_width=0.8), offset=al.Uniform(0.05, half_width=0.03))
    ends = {"start": ((0.0, 0.3), 0.0), "end": ((1.0, -0.5), 0.0)}
    points = al.fit_control_points(np.linspace((0.0, 0.3), (1.0, -0.5), 30), 4, **ends)
    return al.Problem(
        al.InverseDynamics(arm, motion=al.BSpline(al.Decision(points, -3.0, 3.0), **ends)),
        grid=al.Grid(al.Decision(2.0, 0.1, 20.0), 12),
        minimize=al.objectives.final_time(),
        subject_to=[al.path(f"{name}_torque").within(-60.0, 60.0, sigmas=1.0) for name in ("base", "arm")],
        expansion=al.Expansion(order=3),
    )


def tolerance_problem():
    """Torques are affine in the payload; the gap of an uncertain link is not."""
    arm = TwoLinkArm(
        payload=al.Uniform(1.0, half_width=al.Decision(0.2, 0.05, 0.5)), length_2=al.Uniform(0.9, half_width=0.05)
    )
    ends = {"start": (START, 0.0), "end": (TARGET, 0.0)}
    points = al.fit_control_points(np.linspace(START, TARGET, 30), 4, **ends)
    return al.Problem(
        al.InverseDynamics(arm, motion=al.BSpline(al.Decision(points, -3.0, 3.0), **ends)),
        grid=al.Grid(al.Decision(1.7, 1.0, 3.0), 12),
        minimize=al.objectives.final_time(),
        subject_to=[
            al.path("q1_torque").within(-40.0, 40.0, sigmas=1.5),
            al.path("tip_x").at_least(-3.0, sigmas=2.0),
            al.path("q2_rate").within(-9.0, 9.0),
        ],
        expansion=al.Expansion(order=3),
    )


@pytest.mark.parametrize(
    ("declared", "anchors"),
    [
        pytest.param(pick_and_place_time.robust_problem, 2, marks=pytest.mark.slow),
        pytest.param(spatial_problem, 4, marks=pytest.mark.slow),
        (tolerance_problem, None),
    ],
    ids=["two links", "a load in space", "a tolerance to decide"],
)
def test_rows_and_derivatives_are_those_of_all_points(monkeypatch, declared, anchors):
    problem = declared()
    few = transcribe(problem)
    x = problem.placements.vector("initial") + 0.01 * np.sin(np.arange(problem.placements.size))
    reached = instantaneous.anchors_of(few.traced, few.collocation, x)
    if anchors:
        assert len(reached.points) == anchors
        assert all(reached.affine)
    found = few.program.evaluate(x)
    resolved = few.resolve(x)
    monkeypatch.setattr("aleator.transcription.sequential._transcribed.anchors_of", lambda *_: None)
    again = declared()
    every = transcribe(again)
    expected = every.program.evaluate(x)
    size = np.abs(expected.jacobian).max()
    np.testing.assert_allclose(found.constraints, expected.constraints, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(found.jacobian, expected.jacobian, rtol=1e-9, atol=1e-11 * size)
    for text, one in every.resolve(x).items():
        np.testing.assert_allclose(resolved[text].std, one.std, rtol=1e-8, atol=1e-10)


def test_of_a_tolerance_to_decide_only_some_outputs_are_affine():
    problem = tolerance_problem()
    found = transcribe(problem)
    reached = instantaneous.anchors_of(found.traced, found.collocation, problem.placements.vector("initial"))
    assert reached is not None
    assert not all(reached.affine)
