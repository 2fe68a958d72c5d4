"""`al.solve`: optima, multipliers and verdicts against closed forms, and what is told where there is no solution."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

import aleator as al
from aleator.expansion import HammersleyPoints
from aleator.solution import ConstraintResult
from zoo import LOSS, ONE_STEP, RESPONSE, SPREAD, Decay, Gain, algebraic, gain_problem, optimum

SOLVERS = pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=lambda one: type(one).__name__
)


Square = algebraic(lambda a: {"a": a, "q": (a - 3.0) ** 2, "e": jnp.exp(a)})
A, Q, E = (al.output(name).mean for name in "aqe")


def square_problem(a=(-1e9, 1e9), e=(-1e9, 1e9), zero=(-1e3, 1e9), minimize=Q, start=1.0):
    """The square of `a - 3` with limits on `a`, on `exp(a)` and on `exp(a) - 2`, which are data."""
    limits = [
        al.Constraint(expression, lower=lower, upper=upper).named(name)
        for expression, (lower, upper), name in ((A, a, "a"), (E, e, "e"), (E - 2.0, zero, "zero"))
    ]
    return al.Problem(Square(al.Decision(start, 0.0, 10.0)), minimize=minimize, subject_to=limits)


@SOLVERS
def test_the_optimum_of_a_small_problem_is_its_closed_form(solver):
    solution = al.solve(gain_problem(2.0, sigmas=3.0), solver)
    gain = 2.0 / (1 + 3.0 * SPREAD)
    assert solution.ok
    assert solution.decisions["gain"] == pytest.approx(gain, rel=1e-7)
    assert solution.objective == pytest.approx((gain - 3) ** 2 + 1, rel=1e-7)
    assert solution.active == ("response",)
    # What the objective falls by as the bound rises.
    shadow_price = 2 * (3 - gain) / (1 + 3.0 * SPREAD)
    assert solution.constraints[0].multipliers == pytest.approx([shadow_price], rel=1e-5)
    assert solution.multiplier("response") == pytest.approx(shadow_price, rel=1e-5)
    assert solution.certificate.expansion.worst < 1e-10
    for line in ("status       solved", "decision     gain = ", "response: μ[response(t_f)]", "shadow price"):
        assert line in str(solution)


@SOLVERS
def test_a_decision_at_its_own_bound_is_reported_with_its_multiplier(solver):
    system = Gain(gain=al.Decision(1.0, 0.0, 2.0), theta=al.Uniform(1.0, half_width=0.3))
    problem = al.Problem(system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[RESPONSE.at_most(50.0, sigmas=1.0)])
    solution = al.solve(problem, solver)
    assert solution.active == ("gain",)
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-7)
    assert solution.bound_multipliers["gain"] == pytest.approx(2.0, rel=1e-5)  # -d(gain - 3)²/d gain
    assert solution.multiplier("response") == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("lower", "upper"), [(4.0, 1e9), (2.0, 2.0), (4.0, 4.0)], ids=["lower", "below", "above"])
def test_multipliers_of_lower_bounds_and_equalities_have_their_signs(lower, upper):
    solution = al.solve(square_problem(a=(lower, upper), start=5.0))
    slope = 2 * (lower - 3.0)  # d (a - 3)² / d a
    assert solution.decisions["a"] == pytest.approx(lower, rel=1e-8)
    assert solution.constraints[0].multipliers == pytest.approx([-slope], rel=1e-6)
    # Of an equality, the fall as its number is raised; of a limit, the fall as it is loosened.
    assert solution.multiplier("a") == pytest.approx(-slope if lower == upper else slope, rel=1e-6)


@pytest.mark.parametrize("limits", [{"e": (-1e12, 2.0)}, {"zero": (-1e3, 0.0)}], ids=["remote", "zero"])
def test_a_remote_second_bound_does_not_loosen_the_first_and_a_bound_of_zero_holds_to_rounding(limits):
    solution = al.solve(square_problem(**limits, start=0.5))
    assert solution.decisions["a"] == pytest.approx(np.log(2.0), rel=1e-6)
    assert solution.ok
    assert solution.violated == ()


def test_a_design_of_several_decisions_agrees_with_scipy():
    """Gain and shift together, with a normal gain error: the constrained minimum by SciPy on closed-form moments."""
    sigma, kappa, bound = 0.2, 1.5, 2.0
    problem = al.Problem(
        Gain(al.Decision(0.5, 0.0, 10.0), al.Normal(1.0, sigma), al.Decision(0.0, -5.0, 5.0)),
        grid=ONE_STEP,
        minimize=LOSS.mean + 0.3 * RESPONSE.variance,
        subject_to=[RESPONSE.at_most(bound, sigmas=kappa)],
    )
    solution = optimum(problem)
    reference = optimize.minimize(
        lambda x: (x[0] - 3) ** 2 + (x[1] - 1) ** 2 + 0.3 * (sigma * x[0]) ** 2,
        [0.5, 0.0],
        constraints=[{"type": "ineq", "fun": lambda x: bound - x[0] - x[1] - kappa * sigma * x[0]}],
        method="SLSQP",
        options={"ftol": 1e-14},
    )
    assert solution.objective == pytest.approx(reference.fun, rel=1e-8)
    assert list(solution.decisions.values()) == pytest.approx(reference.x, rel=1e-5)


# --- Where there is no solution --------------------------------------------------------------------------------------


@SOLVERS
def test_an_infeasible_problem_says_which_constraint_when_and_by_how_much(solver):
    # It doubles within two seconds from 2 at least: x(2) is at least 4, which exceeds 1.5 by 2.5.
    growth = Decay(-np.log(2.0) / 2, al.Decision(3.0, 2.0, 10.0))
    limits = [al.path("x").at_most(1.5), (al.terminal("x").mean >= 0).named("positive")]
    problem = al.Problem(growth, grid=al.Grid(2.0, 20), minimize=al.integral("x").mean, subject_to=limits)
    with pytest.raises(al.SolveError, match=r"'x' is violated by 2\.5 at t = 2 s: 4 where ≤ 1\.5 is asked") as caught:
        al.solve(problem, solver)
    solution = caught.value.solution
    assert solution.status is al.Status.INFEASIBLE
    assert solution.decisions["start"] == pytest.approx(2.0, rel=1e-6)
    assert [one.name for one in solution.violated] == ["x"]
    assert solution.constraints[0].worst_time == 2.0


@pytest.mark.parametrize(("lower", "upper", "time", "worst"), [(0.0, np.inf, 0.2, 0.5), (-np.inf, 4.0, 0.0, 3.0)])
def test_the_worst_instant_of_a_limit_is_that_of_least_slack_on_its_own_side(lower, upper, time, worst):
    values, times = np.array([3.0, 2.0, 0.5, 1.0]), np.array([0.0, 0.1, 0.2, 0.3])
    rest = {"multipliers": np.zeros(4), "active": np.zeros(4, dtype=bool), "scale": 1.0}
    result = ConstraintResult(name="limit", text="x(t)", lower=lower, upper=upper, values=values, times=times, **rest)
    assert (result.worst_time, result.worst, result.violation) == (time, worst, 0.0)


class Escape(al.System):
    """`x' = rate x²` from 1: infinite at `t = 1 / rate`."""

    states = ("x",)
    rate: float
    gain: float

    def rhs(self, t, z):
        return (self.rate * z.x**2,)

    def outputs(self, t, z):
        return {"x": self.gain * z.x}

    def initial(self):
        return {"x": 1.0}


def test_a_simulation_that_blows_up_at_one_point_only_is_named():
    # Points in germ space are 2 u - 1 of the Hammersley set: with six points the largest rate is the last one's.
    rates = 0.6 + 0.35 * (2 * HammersleyPoints().levels(6, 1)[:, 0] - 1)
    end = 1.2
    assert np.flatnonzero(rates * end > 1).tolist() == [5]
    problem = al.Problem(
        Escape(al.Uniform(0.6, half_width=0.35), al.Decision(1.0, 0.5, 2.0)),
        grid=al.Grid(end, 2000),
        minimize=al.terminal("x").mean,
        expansion=al.Expansion(order=1, points=6),
    )
    with pytest.raises(al.SimulationError) as caught:
        al.solve(problem)
    message = str(caught.value)
    assert f"collocation point 6 of 6 (rate = {rates[5]:.6g})" in message
    assert "gain = 1" in message
    told = float(message.split("output 'x' from t = ")[1].split(" s")[0])
    assert told == pytest.approx(1 / rates[5], rel=0.02)


# A root whose derivative is infinite at one, and which is no number for decisions that sum to less.
Broken = algebraic(lambda chosen: {"y": jnp.sqrt(jnp.sum(chosen) - 1.0)})


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (np.ones(1), "every simulation is finite, but the objective, a constraint or its der"),
        (np.full(40, 0.01), r"The simulation is not finite: output 'y'(.*chosen\[){5}.*and 35 more"),
    ],
    ids=["derivative", "simulation"],
)
def test_a_broken_derivative_is_told_from_a_broken_simulation(start, words):
    problem = al.Problem(Broken(al.Decision(start, 0.0, 2.0)), minimize=al.output("y").mean)
    with pytest.raises(al.SimulationError, match=words):
        al.solve(problem)


class Driven(al.System):
    """A mass, pushed ahead and back by inputs of their own."""

    states = ("x", "v")

    def rhs(self, t, z, ahead, back):
        return z.v, ahead - back

    def outputs(self, t, z, ahead, back):
        return {"x": z.x, "v": z.v}


def test_where_many_controls_begin_at_their_bounds_the_search_goes_on_by_interior_points():
    """To the place where it rests again a mass takes twice the root of the distance, by all the force there is."""
    controls = {
        "ahead": al.Control(lambda s: 1.0 * (s < 0.4), 0.0, 1.0, degree=0),
        "back": al.Control(lambda s: 1.0 * (s > 0.6), 0.0, 1.0, degree=0),
    }
    problem = al.Problem(
        Driven(),
        grid=al.Grid(al.Decision(2.5, 1.0, 6.0), 40),
        inputs=controls,
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(1.0), al.terminal("v").mean.equals(0.0)],
    )
    assert al.solve(problem).objective == pytest.approx(2.0, rel=1e-6)


class Reciprocal(al.AlgebraicSystem):
    x: al.Number

    def outputs(self):
        return {"cost": self.x + 1 / self.x}


@pytest.mark.parametrize("start", [10.0, 100.0])
@pytest.mark.parametrize("bounds", [(1e-3, 1e6), (1e-2, 1e7), (0.0, 1e7)])
def test_bounds_that_are_far_apart_do_not_tell_how_large_a_decision_is(bounds, start):
    solution = al.solve(al.Problem(Reciprocal(al.Decision(start, *bounds)), minimize=al.output("cost").mean))
    assert float(solution.decisions["x"]) == pytest.approx(1.0, rel=1e-4)
    assert not solution.at_bounds
