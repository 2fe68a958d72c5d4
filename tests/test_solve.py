"""`al.solve`: optima, multipliers and verdicts against closed forms, and what is told where there is no solution."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

import aleator as al
from aleator.expansion import HammersleyPoints
from zoo import (
    LOSS,
    MASS,
    ONE_STEP,
    RESPONSE,
    SPREAD,
    Bar,
    Gain,
    Wave,
    bar_problem,
    gain_problem,
    optimum,
    oscillator_problem,
)

SOLVERS = pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=lambda one: type(one).__name__
)


class Square(al.AlgebraicSystem):
    """Functions of one decided number."""

    a: al.Number

    def outputs(self):
        return {"a": self.a, "q": (self.a - 3.0) ** 2, "e": jnp.exp(self.a)}


A, Q, E = (al.output(name).mean for name in "aqe")


def square_problem(a=(-1e9, 1e9), e=(-1e9, 1e9), zero=(-1e3, 1e9), minimize=Q, start=1.0):
    """The square of `a - 3` with limits on `a`, on `exp(a)` and on `exp(a) - 2`, which are data."""
    limits = [
        al.Constraint(expression, lower=lower, upper=upper).named(name)
        for expression, (lower, upper), name in ((A, a, "a"), (E, e, "e"), (E - 2.0, zero, "zero"))
    ]
    return al.Problem(Square(al.Decision(start, 0.0, 10.0)), minimize=minimize, subject_to=limits)


@SOLVERS
@pytest.mark.parametrize(("upper", "sigmas"), [(2.0, 1.0), (2.0, 3.0), (1.0, 0.5)])
def test_the_optimum_of_a_small_problem_is_its_closed_form(solver, upper, sigmas):
    solution = al.solve(gain_problem(upper, sigmas), solver)
    gain = upper / (1 + sigmas * SPREAD)
    assert solution.ok
    assert solution.decisions["gain"] == pytest.approx(gain, rel=1e-7)
    assert solution.objective == pytest.approx((gain - 3) ** 2 + 1, rel=1e-7)
    assert solution.active == ("response",)
    # What the objective falls by as the bound rises.
    shadow_price = 2 * (3 - gain) / (1 + sigmas * SPREAD)
    assert solution.constraints[0].multipliers == pytest.approx([shadow_price], rel=1e-5)
    assert solution.multiplier("response") == pytest.approx(shadow_price, rel=1e-5)
    assert solution.certificate.expansion.worst < 1e-10


@SOLVERS
def test_a_decision_at_its_own_bound_is_reported_with_its_multiplier(solver):
    system = Gain(gain=al.Decision(1.0, 0.0, 2.0), theta=al.Uniform(1.0, half_width=0.3))
    problem = al.Problem(system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=[RESPONSE.at_most(50.0, sigmas=1.0)])
    solution = al.solve(problem, solver)
    assert solution.active == ("gain",)
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-7)
    assert solution.bound_multipliers["gain"] == pytest.approx(2.0, rel=1e-5)  # -d(gain - 3)²/d gain


def test_nothing_binds_where_the_optimum_is_inside():
    solution = al.solve(gain_problem(upper=50.0))
    assert solution.decisions["gain"] == pytest.approx(3.0, rel=1e-6)
    assert solution.active == ()
    assert solution.multiplier("response") == pytest.approx(0.0, abs=1e-6)


def test_a_solution_prints_its_certificate():
    text = str(al.solve(gain_problem()))
    for line in (
        "status       solved",
        "decision     gain = ",
        "response: μ[response(t_f)] + σ[response(t_f)] ≤ 2: active",
        "shadow price",
        "worst leave-one-out error",
    ):
        assert line in text


def test_a_lower_bound_has_a_negative_multiplier():
    solution = al.solve(square_problem(a=(4.0, 1e9), start=5.0))
    assert solution.decisions["a"] == pytest.approx(4.0, rel=1e-8)
    assert solution.constraints[0].multipliers == pytest.approx([-2.0], rel=1e-6)
    assert solution.multiplier("a") == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize("number", [2.0, 4.0])
def test_the_shadow_price_of_an_equality_has_the_sign_of_the_fall_when_its_number_is_raised(number):
    solution = al.solve(square_problem(a=(number, number)))
    slope = 2 * (number - 3.0)  # d (a - 3)² / d a
    assert solution.multiplier("a") == pytest.approx(-slope, rel=1e-6)


@SOLVERS
def test_an_offset_of_the_objective_does_not_move_the_optimum(solver):
    found = al.solve(square_problem(minimize=Q + 1e8), solver)
    assert found.decisions["a"] == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize("limits", [{"e": (-1e3, 2.0)}, {"e": (-1e12, 2.0)}, {"zero": (-1e3, 0.0)}])
def test_a_remote_second_bound_does_not_loosen_the_first_and_a_bound_of_zero_holds_to_rounding(limits):
    solution = al.solve(square_problem(**limits, start=0.5))
    assert solution.decisions["a"] == pytest.approx(np.log(2.0), rel=1e-6)
    assert solution.ok
    assert solution.violated == ()
    assert "violated" not in str(solution)


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


def test_weighted_sum_and_constraint_form_give_the_same_design():
    """Equations (108) and (113): the multiplier of the bound is the weight."""
    bounded = al.solve(gain_problem(2.0))
    weight = bounded.multiplier("response")
    weighted = LOSS.mean + weight * (RESPONSE.mean + RESPONSE.std)
    found = optimum(al.Problem(gain_problem().system, grid=ONE_STEP, minimize=weighted))
    assert found.decisions["gain"] == pytest.approx(bounded.decisions["gain"], rel=1e-6)


def test_a_problem_without_uncertainty_is_solved_all_the_same():
    solution = al.solve(al.Problem(Bar(al.Decision(4.0, 0.1, 10.0), 1.0), minimize=MASS.mean))
    assert solution.decisions["width"] == pytest.approx(0.1, rel=1e-8)
    assert solution.certificate.expansion.points == 1
    assert all(float(one.std) == 0 for one in solution.moments.values())
    assert "nothing is uncertain" in str(solution)


def test_a_warm_start_needs_fewer_evaluations():
    cold = al.solve(bar_problem())
    moved = bar_problem(stress=0.52)
    warm, afresh = al.solve(moved, warm_start=cold), al.solve(moved)
    assert warm.effort.evaluations < afresh.effort.evaluations
    assert warm.objective == pytest.approx((1.0 + 3.0 * SPREAD) / 0.52, rel=1e-8)


@pytest.mark.slow
def test_the_three_solvers_agree_on_a_path_near_resonance():
    problem = oscillator_problem()
    cold, *others = [
        al.solve(problem, solver) for solver in (al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp())
    ]
    assert [one.objective for one in others] == pytest.approx([cold.objective] * 2, rel=1e-6)
    assert cold.active == ("x",)
    assert cold.constraints[0].values.shape == (81,)
    assert max(one.violation for one in cold.constraints) < 1e-8


class Ramp(al.System):
    """`x = gain t`: a path that grows."""

    states = ("x",)
    gain: float

    def rhs(self, t, z):
        return (self.gain,)

    def outputs(self, t, z):
        return {"x": z.x, "gap": z.x - self.gain * t}


@SOLVERS
def test_an_infeasible_problem_says_which_constraint_when_and_by_how_much(solver):
    # The gain is at least 2, so x(2) is at least 4, which exceeds 1.5 by 2.5.
    problem = al.Problem(
        Ramp(al.Decision(3.0, 2.0, 10.0)),
        grid=al.Grid(2.0, 8),
        minimize=al.integral("x").mean,
        subject_to=[al.path("x").at_most(1.5), (al.terminal("gap").mean >= 0).named("gap")],
    )
    with pytest.raises(al.SolveError, match=r"'x' is violated by 2\.5 at t = 2 s: 4 where ≤ 1\.5 is asked") as caught:
        al.solve(problem, solver)
    solution = caught.value.solution
    assert solution.status is al.Status.INFEASIBLE
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-6)
    assert [one.name for one in solution.violated] == ["x"]
    assert solution.constraints[0].worst_time == 2.0
    returned = al.solve(problem, solver, throw=False)
    assert not returned.ok
    assert "'x' is violated by 2.5 at t = 2 s" in returned.why()
    assert "'x' is violated by 2.5 at t = 2 s" in str(returned)


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


@pytest.mark.parametrize(
    ("integrator", "where"),
    [
        (al.integrators.RungeKutta4(), "output 'x' from t = "),
        pytest.param(al.integrators.Tsit5(max_steps=8000), "Tsit5 stops at t = ", marks=pytest.mark.slow),
    ],
    ids=["RungeKutta4", "Tsit5"],
)
def test_a_simulation_that_blows_up_at_one_point_only_is_named(integrator, where):
    # Points in germ space are 2 u - 1 of the Hammersley set: with six points the largest rate is the last one's.
    rates = 0.6 + 0.35 * (2 * HammersleyPoints().levels(6, 1)[:, 0] - 1)
    end = 1.2
    assert np.flatnonzero(rates * end > 1).tolist() == [5]
    problem = al.Problem(
        Escape(al.Uniform(0.6, half_width=0.35), al.Decision(1.0, 0.5, 2.0)),
        grid=al.Grid(end, 4000),
        minimize=al.terminal("x").mean,
        expansion=al.Expansion(order=1, points=6),
        integrator=integrator,
    )
    with pytest.raises(al.SimulationError) as caught:
        al.solve(problem)
    message = str(caught.value)
    assert f"collocation point 6 of 6 (rate={rates[5]:.6g})" in message
    assert "gain=1" in message
    told = float(message.split(where)[1].split(" s")[0])
    assert told == pytest.approx(1 / rates[5], rel=0.02)


class Broken(al.AlgebraicSystem):
    """A root whose derivative is infinite at one, and which is no number for decisions that sum to less."""

    chosen: al.Number

    def outputs(self):
        return {"y": jnp.sqrt(jnp.sum(self.chosen) - 1.0)}


def test_a_broken_derivative_is_told_from_a_broken_simulation():
    problem = al.Problem(Broken(al.Decision(1.0, 1.0, 2.0)), minimize=al.output("y").mean)
    with pytest.raises(
        al.SimulationError, match="every simulation is finite, but the objective, a constraint or its der"
    ):
        al.solve(problem)


def test_a_failed_simulation_is_told_by_its_reason_and_at_most_five_numbers():
    problem = al.Problem(Broken(al.Decision(np.full(40, 0.01), 0.0, 2.0)), minimize=al.output("y").mean)
    with pytest.raises(al.SimulationError) as caught:
        al.solve(problem)
    message = str(caught.value)
    assert message.startswith("The simulation is not finite: output 'y'")
    assert message.count("chosen[") == 5
    assert "and 35 more" in message


def test_an_expansion_that_does_not_resolve_an_output_warns():
    problem = al.Problem(
        Wave(al.Decision(1.0, 0.5, 2.0), al.Uniform(0.0, half_width=1.0)),
        minimize=al.output("wave").variance,
        expansion=al.Expansion(2),
    )
    with pytest.warns(al.ExpansionWarning, match=r"order 2 does not resolve wave \(\d.*\).*Raise the order"):
        solution = al.solve(problem, throw=False)
    assert solution.certificate.expansion.worst > 0.05


class Many(al.AlgebraicSystem):
    """The distance of an array of decisions from an array of numbers."""

    targets: np.ndarray
    chosen: al.Number

    def outputs(self):
        return {"loss": jnp.sum((self.chosen - self.targets) ** 2)}


def test_arrays_of_decisions_come_back_in_their_shape():
    problem = al.Problem(
        Many(np.array([1.0, -2.0, 5.0]), al.Decision(np.zeros(3), -3.0, 3.0)), minimize=al.output("loss").mean
    )
    solution = al.solve(problem)
    np.testing.assert_allclose(solution.decisions["chosen"], [1.0, -2.0, 3.0], atol=1e-6)
    assert solution.active == ("chosen[2]",)


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda: al.solve(al.Problem(Bar(1.0, 1.0), minimize=MASS.mean)), "no decisions"),
        (lambda: al.solve(bar_problem(), "ipopt"), r"expected a solver, such as al.solvers.Ipopt\(\)"),
        (lambda: al.solve(bar_problem().system), "expected a Problem"),
        (lambda: al.validate(bar_problem()), "expected a Solution"),
    ],
)
def test_wrong_arguments_are_refused_in_words(call, word):
    with pytest.raises(al.ProblemError, match=word):
        call()
