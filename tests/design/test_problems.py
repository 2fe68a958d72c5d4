"""Problems: how they read, and what is refused before anything is solved."""

import equinox as eqx
import jax
import numpy as np
import pytest

import aleator as al
from zoo import (
    LOSS,
    ONE_STEP,
    RESPONSE,
    Gain,
    Hardening,
    Oscillator,
    bar_problem,
    gain_problem,
    optimum,
    oscillator_problem,
    sine,
)


def test_a_problem_prints_as_mathematics():
    assert str(oscillator_problem()) == "\n".join(
        [
            "minimise    0.1 c + μ[rms(v)]",
            "over        c ∈ [0.05, 8], from 0.5",
            "subject to  x: μ[x(t)] + 2 σ[x(t)] ≤ 0.14 for all t",
            "            x: μ[x(t)] − 2 σ[x(t)] ≥ -0.14 for all t",
            "where       k ~ Uniform(mean=10, half_width=2)",
            "dynamics    Oscillator(x, v), 80 steps of 0.05 s, RungeKutta4",
            "expansion   order 3 in 1 variables, TotalDegree index set, HammersleyPoints, LeastSquares fit",
        ]
    )


def test_deterministic_and_uncertain_are_inverse():
    problem = bar_problem()
    nominal = al.deterministic(problem)
    assert not nominal.placements.distributions
    assert list(nominal.placements.decisions) == ["width"]
    assert eqx.tree_equal(al.uncertain(nominal), problem)
    assert eqx.tree_equal(al.deterministic(nominal), nominal)


def declare(system=None, **changes):
    system = system or Oscillator(m=1.0, c=al.Decision(0.5, 0.05, 8.0), k=al.Uniform(10.0, half_width=2.0))
    options = {"grid": al.Grid(4.0, 80), "inputs": {"force": sine()}, "minimize": al.rms("x").mean}
    return al.Problem(system, **(options | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"minimize": al.rms("xx").mean}, r"no output of Oscillator 'xx'; expected one of \[.*\]. Did you mean 'x'\?"),
        ({"inputs": {"force": sine(), "wind": sine()}}, r"takes the inputs \['force'\]; received \['force', 'wind'\]"),
        ({"grid": al.Grid(6.0, 80)}, "Input 'force' is known from 0 to 5 s, but the grid runs from 0 to 6 s"),
        ({"minimize": al.path("x").mean}, r"objective must be one number, but 'μ\[x\(t\)\]' has shape \(81,\)"),
        ({"subject_to": [al.rms("x").mean]}, "expected constraints.*received Expression"),
        (
            {"system": Oscillator(m=1.0, c=0.1, k=al.Uniform(al.Decision(10.0, 1.0, 20.0), half_width=2.0))},
            "'k' must stay positive.*can reach -1",
        ),
    ],
)
def test_a_problem_that_does_not_fit_together_is_refused_in_words(changes, message):
    with pytest.raises(al.ProblemError, match=message):
        declare(**changes)


def test_a_systems_own_signals_are_refused_where_they_do_not_reach_over_the_grid():
    class Wheel(al.Mechanical):
        names = ("a",)
        inertia: al.Number = 1.0

        def mass_matrix(self, q):
            return self.inertia * np.eye(1)

    def problem(t_final):
        torque = {"a_torque": al.Tabulated([0.0, 1.0], [0.0, 1.0])}
        driven = al.ForwardDynamics(Wheel(al.Uniform(1.0, half_width=0.1)), torque=torque)
        return al.Problem(driven, grid=al.Grid(t_final, 6), minimize=al.terminal("a").mean)

    assert problem(1.0).grid.latest == 1.0
    with pytest.raises(al.ProblemError, match=r"Signal 'torque' of ForwardDynamics is known from 0 to 1 s.*0 to 3 s"):
        problem(3.0)


def test_a_system_without_states_may_be_driven_from_outside():
    class Square(al.System):
        states = ()
        gain: al.Number = 1.0

        def rhs(self, t, z):
            return ()

        def outputs(self, t, z, u):
            return {"y": self.gain * (u - 0.3) ** 2}

    gain, u = al.Uniform(2.0, half_width=0.5), al.BSpline(al.Decision(np.zeros(4), -1.0, 1.0))
    problem = al.Problem(Square(gain), grid=al.Grid(1.0, 10), inputs={"u": u}, minimize=al.integral("y").mean)
    np.testing.assert_allclose(optimum(problem).decisions["inputs.u.free"], 0.3, atol=1e-3)


def test_constraints_may_come_in_any_nesting():
    constraints = [RESPONSE.within(-1, 1), [[RESPONSE.mean <= 2]], LOSS.mean <= 3]
    problem = al.Problem(Gain(1.0, 1.0), grid=ONE_STEP, minimize=LOSS.mean, subject_to=constraints)
    assert [one.upper for one in problem.constraints] == [1.0, np.inf, 2.0, 3.0]
    assert problem.names == ("response", "loss")


# --- Numbers that make no body ---------------------------------------------------------------------------------------


class Pendulum(al.Multibody):
    mass: al.Number = 1.0
    length: al.Number = 0.5
    inertia: al.Number = 0.01

    def bodies(self):
        return (
            al.Body(
                "a",
                joint=al.joints.Revolute("y"),
                mass=self.mass,
                center=(self.length, 0.0, 0.0),
                inertia=(0.0, self.inertia, 0.0),
            ),
        )


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"inertia": al.Uniform(0.1, half_width=0.3)}, r"not negative; received -0\.2\. In the .* inertia = -0\.2\."),
        ({"inertia": jax.device_put(-0.1)}, r"not negative; received -0\.1"),
    ],
)
def test_numbers_that_make_no_body_are_refused_whatever_they_are_made_of(numbers, message):
    motion = {"a": al.PowerSeries(start=(0.0, 0.0), end=(1.0, 0.0))}
    with pytest.raises(al.ProblemError, match=message):
        al.Problem(
            al.InverseDynamics(Pendulum(**numbers), motion=motion),
            grid=al.Grid(1.0, 10),
            minimize=al.objectives.effort("a_torque"),
        )


# --- Algebraic problems -----------------------------------------------------------------------------------------------


X = al.output("x")
SYSTEM = Hardening(a=al.Uniform(2.0, half_width=al.Decision(0.2, 0.01, 1.5)))


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda: al.Problem(SYSTEM, minimize=al.integral("x").mean), r"Hardening is algebraic.*al\.output\('x'\)"),
        (
            lambda: al.Problem(gain_problem().system, grid=ONE_STEP, minimize=al.output("loss").mean),
            r"Gain evolves in time.*al\.terminal\('loss'\)",
        ),
        (lambda: al.Problem(SYSTEM, minimize=X.mean, grid=al.Grid(1.0, 2)), "drop the grid"),
        (lambda: al.Problem(SYSTEM, minimize=X.mean, inputs={"f": sine()}), r"takes no inputs; received \['f'\]"),
    ],
    ids=["over time", "without time", "a grid", "inputs"],
)
def test_a_problem_that_does_not_fit_its_kind_of_system_is_refused(declare, message):
    with pytest.raises(al.ProblemError, match=message):
        declare()
