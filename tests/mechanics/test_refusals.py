"""What the dynamics refuse, in words, before anything is compiled."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from double_pendulum import Acrobot, Matrices, Passive, Pendubot, Rates, Tendons

import aleator as al

GRID = al.Grid(1.0, 10)
REST = (np.zeros(2), np.zeros(2), np.zeros(2))
MOTION = al.BSpline(
    al.Decision(np.ones((2, 2)), -3.0, 3.0), start=REST, end=(np.ones(2), np.zeros(2), np.zeros(2)), degree=5
)
TORQUE = al.BSpline(np.zeros((4, 2)))


def problem(system, *constraints, grid=GRID, minimize=None):
    return al.Problem(
        system, grid=grid, minimize=al.objectives.final_time() if minimize is None else minimize, subject_to=constraints
    )


class Loaded(Matrices):
    """An arm with a payload at its tip, which must not be negative."""

    m_2: al.Number = al.parameter("kg", positive=True, default=0.8)


class Flat(Matrices):
    """A mass matrix that is what one says."""

    matrix: Any = ((1.0, 0.0), (0.0, 1.0))

    def mass_matrix(self, q):
        return jnp.array(self.matrix)


class Skew(Matrices):
    actuator_names = ("a", "b")

    def actuation(self, q):
        return jnp.array([[1.0, 2.0], [2.0, 4.0]])


class Taken(Matrices):
    def outputs(self, motion):
        return {"elbow": motion.q[1], "free": motion.q[0]}


class NoDict(Matrices):
    def outputs(self, motion):
        return motion.q


class Twice(Matrices):
    names = ("x", "x_rate")


class Clash(Matrices):
    actuator_names = ("shoulder", "elbow")

    def actuation(self, q):
        return jnp.eye(2)


class Motor(Matrices):
    actuator_names = ("motor",)


class Wide(Matrices):
    def actuation(self, q):
        return jnp.eye(3)


class Crooked(Matrices):
    def bias(self, q, v):
        return jnp.zeros(3)


class Multiplied(Matrices):
    """Gives `C v` in the place of `C`: the product with `v` would be one number, added to all forces."""

    def coriolis(self, q, v):
        return Matrices.coriolis(self, q, v) @ v


class OneForce(Matrices):
    def forces(self, q, v):
        return 9.81


class Pushed(Matrices):
    """Its torques come through a number, which would multiply whatever there is."""

    def actuation(self, q):
        return 2.0


class Vector(al.Lagrangian):
    """An energy for each coordinate."""

    names = ("x",)

    def kinetic_energy(self, q, v):
        return 0.5 * v**2


class Quartic(Vector):
    def kinetic_energy(self, q, v):
        return jnp.sum(0.5 * v**2 + v**4)


class Comma(Matrices):
    names = "shoulder"


class OneRate(Rates):
    def accelerations(self, q, v, torque):
        return torque[0]


class Quadratic(Rates):
    def accelerations(self, q, v, torque):
        return torque**2


class Geared(Rates):
    """What its torques do depends on the velocities."""

    def accelerations(self, q, v, torque):
        return torque * (1 + v)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            lambda: al.InverseDynamics(Pendubot(), motion=MOTION),
            r"Pendubot is under-actuated: .*Use al\.HybridDynamics",
        ),
        (lambda: al.InverseDynamics(Passive(), motion=MOTION), r"its torques \(none\) cannot realise"),
        (lambda: problem(al.InverseDynamics(Skew(), motion=MOTION)), "Skew is under-over-actuated"),
        (lambda: al.InverseDynamics(Matrices(), motion={"elbow": 1.0}), r"received none for \['shoulder'\]"),
        (lambda: al.InverseDynamics(Matrices(), motion={"hip": 1.0, "elbow": 0.0, "shoulder": 0.0}), r"no \['hip'\]"),
        (lambda: al.InverseDynamics(Matrices(), motion=al.BSpline(np.zeros(4))), r"shape \(2,\).*received shape \(\)"),
        (lambda: al.InverseDynamics(Matrices(), motion=3.0), "expected a trajectory, or trajectories by name"),
        (
            lambda: al.InverseDynamics(
                Matrices(), motion={"shoulder": al.Tabulated([0.0, 1.0], [0.0, 1.0]), "elbow": 0.0}
            ),
            "a prescribed motion needs velocity and acceleration",
        ),
        (lambda: al.ForwardDynamics(Matrices(), torque={"hip_torque": 1.0}), r"no \['hip_torque'\]"),
        (
            lambda: al.ForwardDynamics(Matrices(), torque={"elbow_torque": np.ones(3)}),
            "expected a trajectory or one number",
        ),
        (lambda: al.ForwardDynamics(Matrices(), torque={"elbow_torque": TORQUE}), r"one number; received shape \(2,\)"),
        (lambda: al.ForwardDynamics(Matrices(), start={"hip": 1.0}), r"no \['hip'\] to start; expected some of"),
        (lambda: al.ForwardDynamics(Matrices(), start=(0.1, 0.2)), "expected a start by name"),
        (
            lambda: al.ForwardDynamics(Matrices(), start={"elbow": np.zeros(2)}),
            "expected one number as the start of 'elbow'",
        ),
        (lambda: al.ForwardDynamics(Matrices(), start={"elbow": np.nan}), "start of 'elbow' must be finite"),
        (lambda: al.ForwardDynamics(Matrices(), start={"elbow": "up"}), "expected numbers, distributions or decisions"),
        (lambda: al.HybridDynamics(Pendubot(), motion={"hip": 1.0}), r"for some of \['shoulder', 'elbow'\]"),
        (lambda: al.HybridDynamics(Pendubot(), motion=TORQUE), "expected trajectories by name"),
        (lambda: al.HybridDynamics(Pendubot(), motion={}), "but not all"),
        (
            lambda: al.HybridDynamics(Pendubot(), motion={"shoulder": 1.0, "elbow": 0.0}),
            r"Use al\.InverseDynamics for all",
        ),
        (
            lambda: al.HybridDynamics(Pendubot(), motion={"shoulder": 1.0}, start={"shoulder": 0.0}),
            r"no \['shoulder'\] to start; expected some of \['elbow', 'elbow_rate'\]",
        ),
        (
            lambda: al.HybridDynamics(Pendubot(), motion={"shoulder": 1.0}, torque={"shoulder_torque": 1.0}),
            r"the unknown torques \(none\) cannot realise a prescribed motion of shoulder: expected at least 1",
        ),
        (lambda: al.HybridDynamics(Passive(), motion={"shoulder": 1.0}), r"the unknown torques \(none\)"),
        (
            lambda: problem(
                al.HybridDynamics(
                    Flat(matrix=((1, 0), (0, 1)), friction=0.0),
                    motion={"shoulder": 1.0},
                    torque={"shoulder_torque": 1.0},
                )
            ),
            r"the unknown torques \(elbow_torque\) cannot realise",
        ),
        (lambda: problem(al.ForwardDynamics(Flat(matrix=((1.0, 1.0), (1.0, 1.0))))), "singular at the start .*resists"),
        (
            lambda: problem(al.ForwardDynamics(Flat(matrix=((1.0, 0.0), (0.0, -1.0))))),
            "not positive definite at the start",
        ),
        (lambda: problem(al.ForwardDynamics(Flat(matrix=((1.0, 0.2), (0.0, 1.0))))), "is not symmetric at the start"),
        (lambda: problem(al.ForwardDynamics(Flat(matrix=((np.inf, 0.0), (0.0, 1.0))))), "is not finite at the start"),
        (lambda: problem(al.ForwardDynamics(Flat(matrix=(1.0, 2.0)))), r"mass_matrix\(q\): expected shape \(2, 2\)"),
        (lambda: problem(al.ForwardDynamics(Wide())), r"actuation\(q\): expected shape \(2, 2\); received \(3, 3\)"),
        (lambda: problem(al.ForwardDynamics(Crooked())), r"bias\(q, v\): expected shape \(2,\); received \(3,\)"),
        (lambda: al.simulate(al.ForwardDynamics(Multiplied()), GRID), r"coriolis\(q, v\): expected shape \(2, 2\)"),
        (lambda: al.simulate(al.ForwardDynamics(OneForce()), GRID), r"forces\(q, v\): expected shape \(2,\)"),
        (lambda: problem(al.ForwardDynamics(Flat(matrix=2.0))), r"mass_matrix\(q\): .*\(2, 2\); received \(\)"),
        (lambda: al.simulate(al.ForwardDynamics(Pushed()), GRID), r"actuation\(q\): expected shape \(2, 2\)"),
        (lambda: al.simulate(al.ForwardDynamics(Vector()), GRID), r"kinetic_energy\(q, v\): expected shape \(\)"),
        (lambda: problem(al.ForwardDynamics(Quartic())), "expected a quadratic function of the velocities"),
        (Comma, r"Comma\.names: expected names in a tuple; received the text 'shoulder'.*\('shoulder',\)"),
        (
            lambda: al.simulate(al.ForwardDynamics(Matrices(), torque=al.Tabulated([0.0, 1.0], [1.0, 1.0])), GRID),
            r"one value for each of \['shoulder_torque', 'elbow_torque'\]; received shape \(\)",
        ),
        (lambda: problem(al.ForwardDynamics(OneRate())), r"accelerations\(q, v, torque\): expected shape \(2,\)"),
        (
            lambda: problem(al.ForwardDynamics(Motor(), torque={"motor": 1.0})),
            r"\['motor'\] do not say along which velocity",
        ),
        (lambda: problem(al.ForwardDynamics(Quadratic())), "expected accelerations affine in the torques"),
        (lambda: problem(al.ForwardDynamics(Geared())), "independent of the velocities"),
        (
            lambda: problem(al.ForwardDynamics(Taken())),
            r"\['elbow'\] are standard outputs of every mechanical system; rename yours",
        ),
        (lambda: problem(al.ForwardDynamics(NoDict())), "outputs returns a dict of arrays by name"),
        (lambda: al.simulate(al.ForwardDynamics(Twice()), GRID), r"\['x_rate'\] name two outputs each"),
        (lambda: al.simulate(al.ForwardDynamics(Clash()), GRID), r"\['elbow', .*'shoulder'.*\] name two outputs each"),
        (lambda: al.Grid(al.Decision(1.0, 0.0, 2.0), 10), r"a decision that may be 0\.0: raise its lower bound"),
        (lambda: al.Grid(al.Decision(1.0), 10), "a decision that may be -inf"),
        (lambda: al.Grid(al.Decision(np.ones(2), 0.5, 2.0), 10), "expected one final time"),
        (lambda: al.Grid(al.Uniform(1.0, half_width=0.1), 10), "t_final must be a finite number"),
        (lambda: problem(al.ForwardDynamics(Loaded(m_2=al.Uniform(1.0, half_width=1.2)))), "m_2"),
        (lambda: problem(al.ForwardDynamics(Loaded(m_2=al.Decision(1.0, -0.5, 2.0)))), "m_2"),
        (
            lambda: problem(al.ForwardDynamics(Matrices(m_2=al.Uniform(1.0, half_width=1.2)))),
            r"not positive definite at the start .*In the system with m_2 = -0\.2",
        ),
        (lambda: problem(al.ForwardDynamics(Matrices(m_2=al.Normal(1.0, 0.2)))), r"In the system with m_2 = -0\.1"),
        (
            lambda: problem(al.InverseDynamics(Matrices(m_2=al.Uniform(1.0, half_width=1.0)), motion=MOTION)),
            r"singular at the start .*In the system with m_2 = 0\b",
        ),
    ],
)
def test_what_cannot_move_is_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_masses_of_very_different_sizes_are_no_singular_matrix():
    # A wheel of a watch on a truck: each resists its own torque well.
    system = al.ForwardDynamics(Flat(matrix=((1e5, 0.0), (0.0, 1e-10))))
    assert system.diagnose(GRID) == ""


def holding_torques():
    """What weight alone takes of the double pendulum when it is level."""
    arm = Matrices()
    second = 9.81 * arm.m_2 * arm.l_2
    return 9.81 * (arm.m_1 + arm.m_2) * arm.l_1 + second, second


def test_limits_of_torques_that_cannot_hold_the_start_are_refused():
    shoulder, elbow = holding_torques()
    message = rf"'elbow_torque' .*cannot hold the system still at the start, which needs elbow_torque = {elbow:.4g} "
    with pytest.raises(al.ProblemError, match=message):
        problem(
            al.InverseDynamics(Matrices(), motion=MOTION),
            al.path("shoulder_torque").within(-1.01 * shoulder, 1.01 * shoulder),
            al.path("elbow_torque").within(-0.99 * elbow, 0.99 * elbow, sigmas=1.0),
        )


def test_limits_of_torques_that_can_are_not():
    shoulder, elbow = holding_torques()
    constraints = (
        al.path("shoulder_torque").within(-1.01 * shoulder, 1.01 * shoulder),
        al.path("elbow_torque").within(-1.01 * elbow, 1.01 * elbow),
        # What is taken over time says nothing of the start.
        al.time_integral(al.path("elbow_torque").mean) <= -100.0,
        al.path("elbow_torque").mean + al.time_integral(al.path("shoulder_torque").mean) <= -100.0,
        # Nor does what is taken of a spread alone, and a spread may take from the mean what it will.
        al.path("elbow_torque").std >= 0.01,
        al.path("elbow_torque").skewness >= 0.01,
        al.path("elbow_torque").mean - 3.0 * al.path("elbow_torque").std <= 0.5 * elbow,
    )
    assert len(problem(al.InverseDynamics(Matrices(), motion=MOTION), *constraints).constraints) == 9


def test_an_arm_that_torques_drive_may_fall_from_where_they_cannot_hold_it():
    system = al.ForwardDynamics(Matrices(), torque=al.BSpline(al.Decision(np.zeros((4, 2)), -5.0, 5.0)))
    assert problem(system, *al.path("elbow_torque").within(-0.1, 0.1)).constraints


def test_systems_that_are_sound_are_not_refused():
    uncertain = al.Uniform(1.0, half_width=0.5)
    for system in (
        al.ForwardDynamics(Acrobot(m_2=uncertain), torque=al.BSpline(al.Decision(np.zeros((4, 1)), -5.0, 5.0))),
        al.HybridDynamics(Pendubot(m_2=uncertain), motion={"shoulder": al.BSpline(al.Decision(np.zeros(5)))}),
        al.InverseDynamics(Tendons(m_2=uncertain), motion=MOTION),
    ):
        assert problem(system, grid=al.Grid(al.Decision(1.0, 0.5, 2.0), 4)).physics


@pytest.mark.parametrize("name", ["shoulder_torque", "torque", "parameters"])
def test_torques_that_are_no_inputs_are_asked_for_where_the_system_is_made(name):
    given = {name: al.Tabulated([0.0, 1.0], [0.0, 1.0])}
    words = rf"ForwardDynamics takes no inputs: .* as its `torque`; received the inputs \['{name}'\]"
    with pytest.raises(al.ProblemError, match=words):
        al.simulate(al.ForwardDynamics(Matrices(), torque=TORQUE), GRID, inputs=given)
