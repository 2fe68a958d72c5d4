"""What is refused of a system once its numbers are known: starts that cannot be held, and bounds that make no body."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

# What holds the pendulum level: its weight of 1 kg at 0.5 m.
LEVEL = 9.81 * 0.5


class Pendulum(al.Multibody):
    mass: al.Number = 1.0
    length: al.Number = 0.5
    inertia: al.Number = 0.01
    tilt: al.Number = 0.0

    def bodies(self):
        return (
            al.Body(
                "a",
                joint=al.joints.Revolute("y"),
                mass=self.mass,
                center=(self.length, 0.0, 0.0),
                inertia=(0.0, self.inertia, 0.0),
                orientation=(0.0, self.tilt, 0.0),
            ),
        )


def planned(model, start, limit=3.0, final=1.0, limits=None):
    motion = al.BSpline(al.Decision(np.linspace(0.0, 1.0, 6), -4.0, 4.0), start=start, end=(1.0, 0.0))
    return al.Problem(
        al.InverseDynamics(model, motion={"a": motion}),
        grid=al.Grid(final, 10),
        minimize=al.objectives.effort("a_torque"),
        subject_to=al.path("a_torque").within(-limit, limit) if limits is None else limits,
        expansion=al.Expansion(order=1),
    )


@pytest.mark.parametrize(
    "model", [Pendulum(), Pendulum(mass=al.Uniform(1.0, half_width=0.1)), Pendulum(inertia=al.Decision(0.1, 0.0, 1.0))]
)
def test_a_start_that_is_kept_at_rest_beyond_its_limits_is_refused(model):
    message = rf"cannot hold the system still at the start, which needs a_torque = -{LEVEL:.4g} "
    with pytest.raises(al.ProblemError, match=message):
        planned(model, (0.0, 0.0, 0.0), final=al.Decision(1.0, 0.5, 5.0))
    assert planned(model, (0.0, 0.0, 0.0), 1.01 * LEVEL).constraints


@pytest.mark.parametrize(
    ("model", "start"),
    [
        (Pendulum(), (0.0, 0.0)),
        (Pendulum(), (0.0, 1.0, 0.0)),
        (Pendulum(), (al.Decision(0.0, -1.0, 1.0), 0.0, 0.0)),
        (Pendulum(), (0.0, 0.0, al.Decision(0.0, -9.0, 9.0))),
        (Pendulum(mass=al.Uniform(al.Decision(1.0, 0.4, 1.0), std=0.05)), (0.0, 0.0, 0.0)),
        # Its torque has no slope there: any tilt makes it smaller.
        (Pendulum(tilt=al.Decision(0.0, -1.0, 1.0)), (0.0, 0.0, 0.0)),
    ],
)
def test_a_start_that_may_move_or_that_decisions_change_is_not(model, start):
    assert planned(model, start).constraints


def test_a_limit_that_is_decided_itself_is_not_taken_for_one():
    class Limited(Pendulum):
        limit: al.Number = 1.0

    decided = al.path("a_torque").mean + al.value("limit") >= 0.0
    assert planned(Limited(limit=al.Decision(1.0, 0.0, 9.0)), (0.0, 0.0, 0.0), limits=[decided]).constraints


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"inertia": al.Uniform(0.1, half_width=0.3)}, r"not negative; received -0\.2\. In the .* inertia = -0\.2\."),
        ({"mass": al.Uniform(0.1, half_width=0.3)}, r"a mass that is not negative; .* In the system with mass = -0\.2"),
        ({"inertia": jnp.asarray(-0.1)}, r"not negative; received -0\.1"),
    ],
)
def test_numbers_that_make_no_body_are_refused_whatever_they_are_made_of(numbers, message):
    with pytest.raises(al.ProblemError, match=message):
        planned(Pendulum(**numbers), (0.0, 0.0))


def test_an_orientation_of_jax_is_looked_at_as_well():
    class Turned(al.Multibody):
        turn: object

        def bodies(self):
            return (al.Body("a", joint=al.joints.Revolute("y"), mass=1.0, center=(0.5, 0, 0), orientation=self.turn),)

    with pytest.raises(al.ProblemError, match="expected a rotation matrix"):
        planned(Turned(2 * jnp.eye(3)), (0.0, 0.0))
    assert planned(Turned(jnp.eye(3)), (0.0, 0.0)).constraints


def test_control_points_of_a_motion_are_not_tried_at_their_bounds():
    class Cautious(Pendulum):
        """Knows no posture beyond three."""

        def diagnose(self, q):
            return "" if abs(float(q[0])) < 3.0 else "beyond"

    motion = al.BSpline(al.Decision(np.zeros(6), -9.0, 9.0))
    system = al.InverseDynamics(Cautious(length=al.Decision(0.5, 0.1, 1.0)), motion={"a": motion})
    assert al.Problem(system, grid=al.Grid(1.0, 4), minimize=al.objectives.effort("a_torque")).objective.atoms
