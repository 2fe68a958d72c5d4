"""A problem is called solved or infeasible in the user's units and by all points seen, and is told why it is not."""

import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.nlp import DifferentialEvolution
from zoo import ONE_STEP, RESPONSE, Gain, algebraic, block_problem, cases

FILTER, IPOPT, SLSQP = al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()


def name_of(solver):
    return type(solver).__name__


@algebraic
def _wild(push, other, unit):
    """A place that rises from -1 to 1 within 1e-13 of the middle of the decision, as an unstable motion's end does."""
    place = 1e13 * push / jnp.sqrt(1.0 + (1e13 * push) ** 2)
    return {"x": unit * place, "miss": unit * (place - 3.0), "cost": push**2 + other**2}


def wild(limit, unit=1.0):
    system = _wild(al.Decision(0.0, -0.1, 0.1), al.Decision(0.05, -0.1, 0.1), unit)
    return al.Problem(system, minimize=al.output("cost").mean, subject_to=[limit])


@pytest.mark.parametrize("solver", cases([FILTER, IPOPT]), ids=name_of)
def test_a_wild_gradient_at_the_start_makes_no_infeasible_problem_solved_and_loosens_no_constraint(solver):
    with pytest.raises(al.SolveError, match=r"'x' is violated by .* where = 3 is asked \(μ\[x\] = 3\)") as caught:
        al.solve(wild(al.output("x").mean.equals(3.0)), solver)
    solution = caught.value.solution
    assert solution.status is al.Status.INFEASIBLE
    assert solution.constraints[0].violation == pytest.approx(2.0, abs=0.06)
    assert not solution.constraints[0].holds
    met = al.solve(wild(al.output("x").mean.equals(0.5)), solver)
    assert met.constraints[0].values[0] == pytest.approx(0.5, abs=1e-6)
    for unit in (1e-9, 1e9):  # a bound of zero is judged by the values around it: x - 3 cannot be zero
        missed = al.solve(wild(al.output("miss").mean.equals(0.0), unit), solver, throw=False)
        assert missed.status is al.Status.INFEASIBLE
        assert missed.constraints[0].violation / unit == pytest.approx(2.0, abs=0.06)


@algebraic
def _shares(first, second, length, force, cost):
    """Two forces share a way, in any units of length, force and cost."""
    a, b = first / force, second / force
    ways = {"way": a + b, "difference": a - 2.0 * b, "first": a, "second": b}
    return {name: length * way for name, way in ways.items()} | {"effort": cost * (a**2 + b**2)}


def shares(length, force, cost, most):
    """A way of one with the least effort, `2/3` and `1/3` of it each: an effort of 5/9."""
    bounds = (-20 * force, 20 * force)
    out = {name: al.output(name).mean for name in ("way", "difference", "first", "second", "effort")}
    limits = [out["way"].equals(length), out["difference"].equals(0.0)]
    limits += [out["first"] <= most * length, out["second"] <= most * length]
    system = _shares(al.Decision(0.0, *bounds), al.Decision(0.0, *bounds), length, force, cost)
    return al.Problem(system, minimize=out["effort"], subject_to=limits)


@pytest.mark.parametrize("solver", [FILTER, IPOPT, SLSQP], ids=name_of)
@pytest.mark.parametrize(("length", "force", "cost"), [(1.0, 1.0, 1.0), (1e-9, 1e9, 1e9), (1e9, 1e-9, 1e-9)])
def test_units_of_objective_constraints_and_decisions_change_neither_answer_nor_verdict(solver, length, force, cost):
    solution = al.solve(shares(length, force, cost, most=2.0), solver)
    assert solution.objective / cost == pytest.approx(5 / 9, rel=1e-6)
    assert solution.constraints[0].values[0] / length == pytest.approx(1.0, abs=1e-6)
    assert solution.constraints[1].values[0] / length == pytest.approx(0.0, abs=1e-5)
    # A way of one cannot be had of two that are at most a third.
    broken = al.solve(shares(length, force, cost, most=1 / 3), solver, throw=False)
    assert broken.status is al.Status.INFEASIBLE
    assert max(one.violation for one in broken.constraints) / length > 0.05


class Plane(al.AlgebraicSystem):
    """Functions of two numbers."""

    x: al.Number
    y: al.Number
    kind: str = eqx.field(static=True)

    def outputs(self):
        x, y = self.x, self.y
        kinds = {
            "valley": 100 * (y - x**2) ** 2 + (1 - x) ** 2,
            "slope": -x - y,
            "kink": jnp.abs(x - 0.3) + jnp.abs(y),
            "root": jnp.sqrt(x - y - 5.0),
            "gain": -((x - 1.0) ** 2),
        }
        beyond, outside = jnp.where(x > 2.0, 1.0, 0.0), jnp.where(jnp.abs(x - 7.7) < 0.05, 0.0, 1.0)
        return {"f": kinds[self.kind], "square": x**2 + y**2, "beyond": beyond, "outside": outside}


def plane(kind, reach=10.0, limits=(), start=-1.2):
    system = Plane(x=al.Decision(start, -reach, reach), y=al.Decision(1.0, -reach, reach), kind=kind)
    return al.Problem(system, minimize=al.output("f").mean, subject_to=limits)


@pytest.mark.parametrize("solver", cases([FILTER, IPOPT, DifferentialEvolution(evaluations=8)]), ids=name_of)
def test_a_search_that_jumps_over_a_step_from_a_feasible_start_finds_no_infeasible_problem(solver):
    problem = plane("gain", limits=[al.output("beyond").mean <= 0.5], start=1.5)
    solution = al.solve(problem, solver, throw=False)
    assert solution.status is not al.Status.INFEASIBLE
    assert solution.decisions["x"] <= 2.0
    assert not solution.violated
    assert "cannot all be met" not in solution.why()
    if solver is FILTER:  # the best design that holds
        assert solution.status is al.Status.FAILED
        assert solution.objective <= -0.25 + 1e-9
        assert "seem to jump" in solution.why()


def test_the_problems_own_start_counts_where_the_search_begins_elsewhere():
    """A limit that holds in a narrow notch alone, and has a slope nowhere."""
    problem = plane("gain", limits=[al.output("outside").mean <= 0.5], start=7.7)
    solution = al.solve(problem, start={"x": 1.0, "y": 1.0}, throw=False)
    assert solution.status is not al.Status.INFEASIBLE
    assert solution.decisions["x"] == pytest.approx(7.7, abs=0.05)
    assert not solution.violated


@pytest.mark.slow
@pytest.mark.parametrize("solver", cases([FILTER, SLSQP]), ids=name_of)
def test_a_spread_is_optimal_at_zero_where_it_has_its_kink(solver):
    gain = Gain(gain=al.Decision(0.7, -1.0, 2.0), theta=al.Uniform(0.0, half_width=0.1))
    solution = al.solve(al.Problem(gain, grid=ONE_STEP, minimize=RESPONSE.std), solver, throw=False)
    assert solution.ok, solution.why()
    assert solution.objective == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(
    ("limit", "price"),
    cases([(RESPONSE.std <= 0.0, np.sqrt(3) / 0.1), (RESPONSE.at_most(0.0, sigmas=2.0), np.sqrt(3) / 0.2)]),
)
def test_the_price_of_a_limit_on_a_spread_that_is_zero_is_that_of_its_slope_beside_the_kink(limit, price):
    gain = Gain(gain=al.Decision(0.7, -1.0, 2.0), theta=al.Uniform(0.0, half_width=0.1))
    solution = al.solve(al.Problem(gain, grid=ONE_STEP, minimize=-1.0 * al.value("gain"), subject_to=[limit]))
    assert solution.decisions["gain"] == pytest.approx(0.0, abs=1e-7)
    assert solution.multipliers[0] == pytest.approx(price, rel=1e-5)


SQUARE = al.output("square").mean
CASES = {
    "stopped": (lambda: plane("valley"), {"max_iterations": 3}, "Allow the solver more iterations"),
    "infeasible": (lambda: plane("valley", limits=[SQUARE <= 1.0, SQUARE >= 2.0]), {}, "Relax a limit"),
    "unbounded": (lambda: plane("slope", reach=np.inf), {}, "Give all decisions bounds"),
    "kink": (lambda: plane("kink"), {}, "Make it smooth there"),
    "root": (lambda: plane("root"), {}, "Look for a root"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_reason_comes_with_a_remedy_and_the_words_of_the_solver_stand_in_parentheses(name):
    problem, options, remedy = CASES[name]
    solution = al.solve(problem(), al.solvers.FilterSQP(**options), throw=False)
    why = solution.why()
    assert not solution.ok
    assert remedy in why
    if name != "root":
        assert re.search(r"[^ ] \(the solver said: [a-z][^()]*\)\.$", why), why
        assert why.index(remedy) < why.index("(the solver said")


@pytest.mark.parametrize(("share", "holds"), [(1.05, True), (0.95, False)])
def test_a_search_that_breaks_off_goes_on_from_a_design_that_holds_or_names_the_limits_that_contradict(share, holds):
    """Where a mass is uncertain, the spread of a place is a part of its mean that no force changes."""
    inverse = np.log(1.1 / 0.9) / 0.2, 1 / (1.1 * 0.9)  # the mean of 1 / m and that of its square
    part = np.sqrt(inverse[1] / inverse[0] ** 2 - 1)
    limits = [al.terminal("x").mean.equals(1.0), (al.terminal("x").std <= share * part).named("spread")]
    problem = block_problem(al.Uniform(1.0, half_width=0.1), subject_to=limits)
    solution = al.solve(problem, al.solvers.FilterSQP(max_iterations=2), throw=False)
    if holds:
        assert not solution.violated, solution.why()
        assert solution.objective == pytest.approx(3 / inverse[0] ** 2 / (1 - 0.05**2), rel=1e-6)
    else:
        assert solution.status is al.Status.INFEASIBLE
        assert re.search(r"no design was found .*: x, spread; al\.conflict", solution.why())
