"""Motion plans: derivatives instant by instant, their sparsity, and torques that follow from those at a few points."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.sequential import _instantaneous as instantaneous
from aleator.transcription.sequential._affine import affine_features, anchored
from compiling import compiled
from zoo import Pendulum, cases, derivative_error

# --- Derivatives -----------------------------------------------------------------------------------------------------


class Arm(Pendulum):
    """A pendulum, and a length that is no affine function of its mass."""

    def outputs(self, motion):
        return {"stretch": jnp.sqrt(self.mass + motion.q[0] ** 2)}


def codesign(**options):
    """Decisions in the motion, the model, a distribution, the final time, and one shared by motion and model."""
    shared = al.Decision(0.9, 0.5, 1.5).shared("length")
    mass = al.Uniform(1.0, half_width=al.Decision(0.2, 0.05, 0.5))
    arm = Arm(mass=mass, length=shared, gravity=al.Decision(9.0, 8.0, 10.0))
    points = al.Decision(np.linspace(0.3, 0.8, 8), -3.0, 3.0)
    torque, rate = al.path("angle_torque"), al.path("angle_rate")
    defaults = {
        "minimize": al.objectives.final_time() + al.objectives.effort("angle_torque"),
        "subject_to": [
            torque.within(-40.0, 40.0, sigmas=1.5),
            al.path("stretch").at_most(40.0, worst_case=True),
            (torque.mean - torque.std - al.value("gravity") >= -30.0).named("mixed"),
            rate.within(-9.0, 9.0),
            (al.time_integral(torque.std) <= 50.0).named("spread"),
        ],
    }
    return al.Problem(
        al.InverseDynamics(arm, motion={"angle": al.BSpline(points, start=(shared, 0.0), end=(1.0, 0.0))}),
        grid=al.Grid(al.Decision(1.7, 1.0, 3.0), 12),
        expansion=al.Expansion(order=2),
        **(defaults | options),
    )


def two_limits():
    """The torque is affine in the mass, the stretch is not."""
    limits = [al.path("angle_torque").at_most(40.0, sigmas=1.5), al.path("stretch").at_most(40.0, sigmas=1.0)]
    return codesign(minimize=al.objectives.final_time(), subject_to=limits)


def fixed_plan():
    """What is uncertain is in the motion, and so moves with the decisions."""
    start = al.Uniform(0.5, half_width=0.1)
    motion = al.BSpline(al.Decision(np.zeros(4), -3.0, 3.0), start=(start, 0.0))
    return al.Problem(
        al.InverseDynamics(Pendulum(), motion={"angle": motion}),
        grid=al.Grid(1.5, 6),
        minimize=al.objectives.effort("angle_torque"),
        subject_to=[al.path("angle_torque").at_most(100.0, sigmas=1.0)],
        expansion=al.Expansion(order=2),
    )


@pytest.mark.parametrize("declared", cases([codesign, fixed_plan]))
def test_derivatives_agree_with_finite_differences(declared):
    problem = declared()
    program = transcribe(problem).program
    x = problem.placements.vector("initial") + 0.01 * np.sin(np.arange(problem.placements.size))
    found = program.evaluate(x)

    def values(point):
        one = program.evaluate(point)
        return np.append(one.constraints, one.objective)

    jacobian = np.vstack([found.jacobian, found.gradient])
    assert derivative_error(values, jacobian, x, steps=(1e-4, 1e-5, 1e-6)) < 1e-6


# --- Sparsity --------------------------------------------------------------------------------------------------------


def test_no_derivative_of_a_plan_is_outside_the_sparsity():
    program = transcribe(codesign()).program
    assert program.sparsity.mean() < 0.8
    rng, lower, upper = np.random.default_rng(1), program.lower, program.upper
    for _ in range(5):
        x = np.clip(program.start + rng.standard_normal(program.start.shape), lower, upper)
        assert not (program.evaluate(x).jacobian != 0)[~program.sparsity].any()


# --- Outputs that are affine in what the germ moves ------------------------------------------------------------------


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


def test_what_is_not_affine_is_never_taken_to_be_and_outputs_are_told_apart():
    functions = {f"{i} {name}": rule for i, rules in enumerate((AFFINE, OTHER)) for name, rule in rules.items()}
    at, told = (np.array([0.3, 0.4]), np.array([1.1, 2.0])), []

    def features(rules, *at):
        values, affine = affine_features(lambda *at: [rule(*at) for rule in rules], *at)
        told.append(affine)
        return values

    jax.eval_shape(partial(features, functions.values()), *at)
    assert dict(zip(functions, told[0], strict=True)) == {name: name.startswith("0") for name in functions}
    some = compiled(partial(features, [AFFINE["the germ alone"], OTHER["a root"]]))
    np.testing.assert_allclose(some(*at), [0.12])


def test_points_that_are_all_needed_are_all_kept():
    points = np.linspace(-1, 1, 4)[:, None]
    assert anchored(points, np.vander(points[:, 0], 4), (True,)) is None
    assert len(anchored(points, points, (True,)).points) == 2
    assert len(anchored(points, np.zeros((4, 0)), (True,)).points) == 1
    assert anchored(points, np.where(points > 0, points, np.inf), (True,)) is None


def test_rows_and_derivatives_are_those_of_all_points(monkeypatch):
    problem = two_limits()
    few = transcribe(problem)
    x = problem.placements.vector("initial") + 0.01 * np.sin(np.arange(problem.placements.size))
    reached = instantaneous.anchors_of(few.traced, few.collocation, x)
    assert reached is not None
    assert any(reached.affine)
    assert not all(reached.affine)
    found, resolved = few.program.evaluate(x), few.resolve(x)
    monkeypatch.setattr("aleator.transcription.sequential._transcribed.anchors_of", lambda *_: None)
    every = transcribe(two_limits())
    expected = every.program.evaluate(x)
    size = np.abs(expected.jacobian).max()
    np.testing.assert_allclose(found.constraints, expected.constraints, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(found.jacobian, expected.jacobian, rtol=1e-9, atol=1e-11 * size)
    for text, one in every.resolve(x).items():
        np.testing.assert_allclose(resolved[text].std, one.std, rtol=1e-8, atol=1e-10)
