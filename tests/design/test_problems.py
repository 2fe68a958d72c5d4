import equinox as eqx
import numpy as np
import pytest

import aleator as al
from zoo import LOSS, ONE_STEP, RESPONSE, Gain, Oscillator, bar_problem, gain_problem, optimum, oscillator_problem, sine


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


def test_a_deterministic_problem_prints_that_nothing_spreads():
    text = str(al.deterministic(gain_problem(sigmas=1.0)))
    assert text.endswith("expansion   none: nothing is uncertain, every σ is 0")
    assert "~" not in text


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
        ({"subject_to": [al.path("sprng").at_most(1)]}, "no output of Oscillator 'sprng'.*Did you mean 'spring'"),
        ({"minimize": al.value("k.spread")}, r"no number of the model 'k\.spread'; expected one of"),
        ({"subject_to": [al.value("mass") <= 1]}, "no number of the model 'mass'"),
        (
            {"minimize": al.cost.reciprocal("k.half_widht", bias=0.0, scale=1.0)},
            r"no number of the model 'k\.half_widht'.*Did you mean 'k\.half_w",
        ),
        ({"inputs": {}}, r"Oscillator takes the inputs \['force'\]; received \[\]"),
        ({"inputs": {"force": sine(), "wind": sine()}}, r"takes the inputs \['force'\]; received \['force', 'wind'\]"),
        ({"grid": al.Grid(6.0, 80)}, "Input 'force' is known from 0 to 5 s, but the grid runs from 0 to 6 s"),
        ({"grid": al.Grid(al.Decision(4.0, 3.0, 6.0), 80)}, "Input 'force' is known .* the grid runs from 0 to 6 s"),
        ({"grid": al.Grid(4.0, 80, t_start=-1.0)}, "but the grid runs from -1 to 4 s"),
        ({"minimize": al.path("x").mean}, r"objective must be one number, but 'μ\[x\(t\)\]' has shape \(81,\)"),
        ({"minimize": al.rms("x")}, "differs between realisations"),
        ({"subject_to": [True]}, "expected constraints, such as .*received bool 'True'"),
        ({"subject_to": [al.rms("x").mean]}, "expected constraints.*received Expression"),
        ({"system": "car"}, "'system' must be a System or AlgebraicSystem; received str 'car'"),
        (
            {"system": Oscillator(m=al.Uniform(1.0, half_width=1.0), c=0.1, k=10.0)},
            r"'m' must stay positive, but Uniform\(mean=1, half_width=1\) can reach 0",
        ),
        (
            {"system": Oscillator(m=1.0, c=0.1, k=al.Uniform(al.Decision(10.0, 1.0, 20.0), half_width=2.0))},
            "'k' must stay positive.*can reach -1",
        ),
        ({"system": Oscillator(m=al.Normal(1.0, 0.1), c=0.1, k=10.0)}, "'m' must stay positive.*unbounded below"),
    ],
)
def test_a_problem_that_does_not_fit_together_is_refused_in_words(changes, message):
    with pytest.raises(al.ProblemError, match=message):
        declare(**changes)


def test_terms_whose_shapes_do_not_go_together_are_refused():
    class Two(al.System):
        states = ("x",)
        gain: float = 1.0

        def rhs(self, t, z):
            return (0.0 * z.x,)

        def outputs(self, t, z):
            return {"pair": np.ones(2), "triple": np.ones(3)}

    with pytest.raises(al.ProblemError, match="have incompatible shapes"):
        declare(
            Two(),
            inputs={},
            minimize=al.value("gain"),
            subject_to=[al.terminal("pair").mean + al.terminal("triple").mean <= 1],
        )
    with pytest.raises(al.ProblemError, match=r"objective must be one number, .* has shape \(2,\)"):
        declare(Two(), inputs={}, minimize=al.terminal("pair").mean)


def test_a_system_without_states_is_refused():
    class Nothing(al.System):
        def rhs(self, t, z):
            return ()

        def outputs(self, t, z):
            return {}

    with pytest.raises(al.ProblemError, match="Nothing names no states"):
        declare(Nothing(), inputs={}, minimize=al.terminal("x").mean)


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
