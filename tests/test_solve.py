import warnings
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

import aleator as al
from aleator.expansion import HammersleyPoints
from tiny_models import LOSS, ONE_STEP, RESPONSE, SPREAD, Gain, gain_problem, oscillator_problem

SOLVERS = pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=lambda one: type(one).__name__
)


@SOLVERS
@pytest.mark.parametrize(("upper", "sigmas"), [(2.0, 1.0), (2.0, 3.0), (1.0, 0.5)])
def test_the_optimum_of_a_small_problem_is_its_closed_form(solver, upper, sigmas):
    solution = al.solve(gain_problem(upper, sigmas), solver)
    gain = upper / (1 + sigmas * SPREAD)
    assert solution.ok
    assert solution.decisions["gain"] == pytest.approx(gain, rel=1e-7)
    assert solution.objective == pytest.approx((gain - 3) ** 2 + 1, rel=1e-7)
    assert solution.active == ("response",)
    # d objective / d upper = 2 (gain - 3) / (1 + sigmas SPREAD)
    shadow_price = 2 * (3 - gain) / (1 + sigmas * SPREAD)
    assert solution.constraints[0].multipliers == pytest.approx([shadow_price], rel=1e-5)
    assert solution.multiplier("response") == pytest.approx(shadow_price, rel=1e-5)


@SOLVERS
def test_multipliers_are_what_the_objective_falls_by_when_the_bound_moves(solver):
    def optimum(bound):
        return al.solve(gain_problem(bound), solver).objective

    step = 1e-3
    slope = (optimum(2.0 + step) - optimum(2.0 - step)) / (2 * step)
    assert al.solve(gain_problem(2.0), solver).constraints[0].multipliers[0] == pytest.approx(-slope, rel=1e-4)


def test_a_lower_bound_has_a_negative_multiplier():
    problem = al.Problem(
        Gain(al.Decision(5.0, 0.0, 10.0), 1.0), grid=ONE_STEP, minimize=LOSS.mean, subject_to=[RESPONSE.mean >= 4]
    )
    solution = al.solve(problem)
    assert solution.decisions["gain"] == pytest.approx(4.0, rel=1e-8)
    assert solution.constraints[0].multipliers == pytest.approx([-2.0], rel=1e-6)
    assert solution.multiplier("response") == pytest.approx(2.0, rel=1e-6)


@SOLVERS
def test_a_decision_at_its_own_bound_is_reported_with_its_multiplier(solver):
    problem = al.Problem(Gain(al.Decision(1.0, 0.0, 2.0), 1.0), grid=ONE_STEP, minimize=LOSS.mean)
    solution = al.solve(problem, solver)
    assert solution.active == ("gain",)
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-7)
    assert solution.bound_multipliers["gain"] == pytest.approx(2.0, rel=1e-5)  # -d(gain - 3)²/d gain


def test_nothing_binds_where_the_optimum_is_inside():
    solution = al.solve(gain_problem(upper=50.0))
    assert solution.decisions["gain"] == pytest.approx(3.0, rel=1e-6)
    assert solution.active == ()
    assert solution.multiplier("response") == pytest.approx(0.0, abs=1e-6)


def test_a_design_of_several_decisions_agrees_with_scipy():
    """Gain and shift together, with a normal gain error: the constrained minimum by SciPy on closed-form moments."""
    sigma, kappa, bound = 0.2, 1.5, 2.0
    problem = al.Problem(
        Gain(al.Decision(0.5, 0.0, 10.0), al.Normal(1.0, sigma), al.Decision(0.0, -5.0, 5.0)),
        grid=ONE_STEP,
        minimize=LOSS.mean + 0.3 * RESPONSE.variance,
        subject_to=[RESPONSE.at_most(bound, sigmas=kappa)],
    )
    solution = al.solve(problem)
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
    limited = RESPONSE.mean + RESPONSE.std
    system = gain_problem().system
    weight = bounded.multiplier("response")
    weighted = al.solve(al.Problem(system, grid=ONE_STEP, minimize=LOSS.mean + weight * limited))
    assert weighted.decisions["gain"] == pytest.approx(bounded.decisions["gain"], rel=1e-6)


def test_a_problem_without_uncertainty_is_solved_all_the_same():
    solution = al.solve(gain_problem(theta=1.0, sigmas=2.0))
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-8)
    assert solution.certificate.expansion.points == 1
    assert all(float(one.std) == 0 for one in solution.moments.values())
    assert "nothing is uncertain" in str(solution)


def test_the_three_solvers_agree_on_a_problem_with_path_constraints():
    optima = [
        al.solve(oscillator_problem(), solver).objective
        for solver in (al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp())
    ]
    assert optima == pytest.approx([optima[0]] * 3, rel=1e-6)
    solution = al.solve(oscillator_problem())
    assert solution.active == ("x",)
    assert solution.constraints[0].values.shape == (81,)
    assert max(one.violation for one in solution.constraints) < 1e-8


class Ramp(al.System):
    """`x = gain t`: a path that grows."""

    states = ("x",)
    gain: float

    def rhs(self, t, z):
        return (self.gain,)

    def outputs(self, t, z):
        return {"x": z.x, "gap": z.x - self.gain * t}


def ramp_problem(*extra):
    return al.Problem(
        Ramp(al.Decision(3.0, 2.0, 10.0)),
        grid=al.Grid(2.0, 8),
        minimize=al.integral("x").mean,
        subject_to=[al.path("x").at_most(1.5), *extra],
    )


@SOLVERS
def test_an_infeasible_problem_says_which_constraint_when_and_by_how_much(solver):
    # The gain is at least 2, so x(2) is at least 4, which exceeds 1.5 by 2.5.
    gap = (al.terminal("gap").mean >= 0).named("gap")
    with pytest.raises(al.SolveError, match=r"'x' is violated by 2\.5 at t = 2 s: 4 where ≤ 1\.5 is asked") as caught:
        al.solve(ramp_problem(gap), solver)
    solution = caught.value.solution
    assert solution.status is al.Status.INFEASIBLE
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-6)
    assert [one.name for one in solution.violated] == ["x"]
    assert solution.constraints[0].worst_time == 2.0


def test_an_infeasible_problem_is_returned_where_asked():
    solution = al.solve(ramp_problem(), throw=False)
    assert not solution.ok
    assert "'x' is violated by 2.5 at t = 2 s" in solution.why()
    assert "'x' is violated by 2.5 at t = 2 s" in str(solution)


def test_a_problem_without_decisions_is_refused():
    with pytest.raises(al.ProblemError, match="no decisions"):
        al.solve(al.Problem(Gain(1.0, 1.0), grid=ONE_STEP, minimize=LOSS.mean))


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
    "integrator",
    [al.integrators.RungeKutta4(), pytest.param(al.integrators.Tsit5(max_steps=8000), marks=pytest.mark.slow)],
    ids=["RungeKutta4", "Tsit5"],
)
def test_a_simulation_that_blows_up_at_one_point_only_is_named(integrator):
    # Points in germ space are 2 u - 1 of the Hammersley set: with six points the largest rate is the last one's.
    points = 2 * HammersleyPoints().levels(6, 1)[:, 0] - 1
    rates = 0.6 + 0.35 * points
    end = 1.2
    broken = np.flatnonzero(rates * end > 1)
    assert broken.tolist() == [5]
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
    fixed = isinstance(integrator, al.integrators.RungeKutta4)
    where = "output 'x' from t = " if fixed else "Tsit5 stops at t = "
    told = float(message.split(where)[1].split(" s")[0])
    assert told == pytest.approx(1 / rates[5], rel=0.02)


def test_a_broken_derivative_is_told_from_a_broken_simulation():
    class Root(al.System):
        states = ("x",)
        gain: float

        def rhs(self, t, z):
            return (0.0 * z.x,)

        def outputs(self, t, z):
            return {"x": jnp.sqrt(self.gain - 1.0)}

    problem = al.Problem(Root(al.Decision(1.0, 1.0, 2.0)), grid=ONE_STEP, minimize=al.terminal("x").mean)
    with pytest.raises(
        al.SimulationError, match="every simulation is finite, but the objective, a constraint or its der"
    ):
        al.solve(problem)


def test_an_expansion_that_does_not_resolve_an_output_warns():
    class Step(al.System):
        states = ("x",)
        gain: float
        theta: float

        def rhs(self, t, z):
            return (0.0 * z.x,)

        def outputs(self, t, z):
            return {"x": self.gain**2 + jnp.where(self.theta > 0.1, 1.0, -1.0)}

    def solve(expansion):
        return al.solve(
            al.Problem(
                Step(al.Decision(1.0, -2.0, 2.0), al.Uniform(0.0, half_width=1.0)),
                grid=ONE_STEP,
                minimize=al.terminal("x").mean,
                expansion=expansion,
            )
        )

    with pytest.warns(al.ExpansionWarning, match=r"order 2 does not resolve x\(t_f\) \(0\.\d+\).*Raise the order"):
        solution = solve(al.Expansion(2))
    assert solution.certificate.expansion.worst > 0.05


def test_a_resolved_expansion_does_not_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert al.solve(gain_problem()).certificate.expansion.worst < 1e-10


def test_a_warm_start_needs_fewer_evaluations():
    cold = al.solve(oscillator_problem())
    moved = oscillator_problem().with_bound("x", 0.138)
    assert al.solve(moved, warm_start=cold).effort.evaluations < al.solve(moved).effort.evaluations
    assert al.solve(moved, warm_start=cold).objective == pytest.approx(al.solve(moved).objective, rel=1e-8)


def test_arrays_of_decisions_come_back_in_their_shape():
    class Many(al.System):
        states = ("x",)
        targets: np.ndarray
        chosen: np.ndarray

        def rhs(self, t, z):
            return (0.0 * z.x,)

        def outputs(self, t, z):
            return {"loss": jnp.sum((self.chosen - self.targets) ** 2)}

    targets = np.array([1.0, -2.0, 5.0])
    problem = al.Problem(
        Many(targets, al.Decision(np.zeros(3), -3.0, 3.0)), grid=ONE_STEP, minimize=al.terminal("loss").mean
    )
    solution = al.solve(problem)
    np.testing.assert_allclose(solution.decisions["chosen"], [1.0, -2.0, 3.0], atol=1e-6)
    assert solution.active == ("chosen[2]",)


def test_a_solution_prints_its_certificate():
    text = str(al.solve(gain_problem()))
    for line in (
        "status       solved",
        "decision     gain = ",
        "response: μ[response(t_f)] + σ[response(t_f)] ≤ 2: active",
    ):
        assert line in text
    assert "shadow price" in text
    assert "worst leave-one-out error" in text


class Square(al.System):
    """One number `a` and outputs of it, constant in time."""

    states = ("x",)
    a: Any
    spread: Any = 0.0

    def rhs(self, t, z):
        return (0.0 * z.x,)

    def outputs(self, t, z):
        return {"a": self.a + self.spread, "q": (self.a - 3.0) ** 2, "e": jnp.exp(self.a), "g": (self.a - TARGET) ** 2}


TARGET = 3.0


def square_problem(*subject_to, minimize=None, start=1.0):
    return al.Problem(
        Square(al.Decision(start, 0.0, 10.0)),
        grid=al.Grid(1.0, 2),
        minimize=al.terminal("q").mean if minimize is None else minimize,
        subject_to=subject_to,
    )


@pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=lambda one: type(one).__name__
)
@pytest.mark.parametrize("offset", [0.0, 1e5, 1e8])
def test_an_offset_of_the_objective_does_not_move_the_optimum(solver, offset):
    solution = al.solve(square_problem(minimize=al.terminal("q").mean + offset), solver)
    assert solution.decisions["a"] == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize("remote", [-1e3, -1e9, -1e12])
def test_a_remote_second_bound_does_not_loosen_the_first(remote):
    expression = al.terminal("e").mean
    both = al.Problem(
        Square(al.Decision(0.5, 0.0, 10.0)),
        grid=al.Grid(1.0, 2),
        minimize=al.terminal("q").mean,
        subject_to=[al.Constraint(expression, lower=remote, upper=2.0)],
    )
    solution = al.solve(both)
    assert solution.decisions["a"] == pytest.approx(np.log(2.0), rel=1e-6)


def test_a_bound_of_zero_that_holds_to_rounding_is_not_called_violated():
    solution = al.solve(square_problem((al.terminal("e").mean - 2.0 <= 0.0).named("limit"), start=0.5))
    assert solution.ok
    assert solution.violated == ()
    assert "violated" not in str(solution)


@pytest.mark.parametrize("number", [2.0, 4.0])
def test_the_shadow_price_of_an_equality_has_the_sign_of_the_fall_when_its_number_is_raised(number):
    solution = al.solve(square_problem(al.terminal("a").mean.equals(number)))
    slope = 2 * (number - 3.0)  # d (a - 3)² / d a
    assert solution.multiplier("a") == pytest.approx(-slope, rel=1e-6)


def test_code_that_reads_a_global_is_compiled_anew_when_the_global_has_changed(monkeypatch):
    problem = square_problem(minimize=al.terminal("g").mean)
    assert al.solve(problem).decisions["a"] == pytest.approx(3.0, abs=1e-6)
    monkeypatch.setitem(globals(), "TARGET", 7.0)
    changed = square_problem(minimize=al.terminal("g").mean)
    assert al.solve(changed).decisions["a"] == pytest.approx(7.0, abs=1e-6)


def test_wrong_arguments_are_refused_in_words():
    problem = square_problem()
    with pytest.raises(al.ProblemError, match=r"expected a solver, such as al.solvers.Ipopt\(\)"):
        al.solve(problem, "ipopt")
    with pytest.raises(al.ProblemError, match="expected a Problem"):
        al.solve(problem.system)
    with pytest.raises(al.ProblemError, match="expected a Solution"):
        al.validate(problem)


def test_a_decision_at_its_bound_is_named_whatever_the_solver():
    for solver in (al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()):
        solution = al.solve(square_problem(minimize=al.terminal("a").mean), solver)
        assert solution.active == ("a",)
