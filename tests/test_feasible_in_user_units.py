"""A constraint is satisfied in the user's units, whatever a solver divided it by; if it cannot be, that is said."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

SOLVERS = pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=lambda one: type(one).__name__
)


class Unstable(al.System):
    """`x' = 30 (x - x³) + u` from rest: within a second any input takes x to about ±1, and none further."""

    states = ("x", "J")
    unit: float = 1.0

    def rhs(self, t, z, u):
        return 30 * (z.x - z.x**3) + u, u**2

    def outputs(self, t, z):
        return {"x": self.unit * z.x, "J": z.J, "miss": self.unit * (z.x - 3.0)}


def unstable(constraint, unit=1.0):
    return al.Problem(
        Unstable(unit),
        grid=al.Grid(1.0, steps=400),
        inputs={"u": al.BSpline(al.Decision(np.zeros(8), -0.1, 0.1))},
        minimize=al.terminal("J").mean,
        subject_to=[constraint],
    )


@pytest.mark.parametrize(
    "solver",
    [al.solvers.FilterSQP(), al.solvers.Ipopt(), pytest.param(al.solvers.Slsqp(), marks=pytest.mark.slow)],
    ids=lambda one: type(one).__name__,
)
def test_a_wild_gradient_at_the_start_makes_no_infeasible_problem_solved(solver):
    with pytest.raises(
        al.SolveError, match=r"'x' is violated by .* where = 3 is asked \(μ\[x\(t_f\)\] = 3\)"
    ) as caught:
        al.solve(unstable(al.terminal("x").mean.equals(3.0)), solver)
    solution = caught.value.solution
    assert solution.status is al.Status.INFEASIBLE
    assert solution.constraints[0].violation == pytest.approx(2.0, abs=0.06)
    assert not solution.constraints[0].holds


@SOLVERS
def test_a_wild_gradient_at_the_start_loosens_no_constraint_that_can_be_met(solver):
    solution = al.solve(unstable(al.terminal("x").mean.equals(0.5)), solver)
    assert solution.constraints[0].values[0] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_bound_of_zero_is_judged_by_the_values_around_it_in_any_unit(unit):
    # x - 3 cannot be zero, however steep it was.
    solution = al.solve(unstable(al.terminal("miss").mean.equals(0.0), unit=unit), throw=False)
    assert solution.status is al.Status.INFEASIBLE
    assert solution.constraints[0].violation / unit == pytest.approx(2.0, abs=0.06)


class Thrust(al.System):
    """A mass pushed from rest, in any units of length, force and cost."""

    states = ("x", "v", "J")
    length: float
    force: float
    cost: float

    def rhs(self, t, z, f):
        return z.v, f / self.force, (f / self.force) ** 2

    def outputs(self, t, z):
        return {"x": self.length * z.x, "v": self.length * z.v, "J": self.cost * z.J}


def thrust(length, force, cost, fastest):
    """From rest to rest over one length in one second at least effort: 12 by a parabola of speed that peaks at 1.5."""
    return al.Problem(
        Thrust(length, force, cost),
        grid=al.Grid(1.0, steps=10),
        inputs={"f": al.BSpline(al.Decision(np.zeros(5), -20 * force, 20 * force))},
        minimize=al.terminal("J").mean,
        subject_to=[
            al.terminal("x").mean.equals(length),
            al.terminal("v").mean.equals(0.0),
            al.path("v").at_most(fastest * length),
        ],
    )


@SOLVERS
@pytest.mark.parametrize(
    ("length", "force", "cost"),
    [(1.0, 1.0, 1.0), (1e-9, 1.0, 1.0), (1e9, 1.0, 1.0), (1.0, 1e-9, 1e9), (1.0, 1e9, 1e-9), (1e-9, 1e9, 1e9)],
)
def test_units_of_objective_constraints_and_decisions_change_neither_answer_nor_verdict(solver, length, force, cost):
    if isinstance(solver, al.solvers.Slsqp) and force != 1.0:
        pytest.skip("solved too, but in thousands of evaluations: the cost has no slope at the start to scale it by")
    solution = al.solve(thrust(length, force, cost, fastest=2.0), solver)
    assert solution.objective / cost == pytest.approx(12.0, rel=1e-6)
    end, rest, _ = solution.constraints
    assert end.values[0] / length == pytest.approx(1.0, abs=1e-6)
    assert rest.values[0] / length == pytest.approx(0.0, abs=1e-5)
    if isinstance(solver, al.solvers.Slsqp) and (length, force, cost) != (1.0, 1.0, 1.0):
        return  # it takes thousands of evaluations to find that nothing is feasible
    # A mean speed of one cannot be had with a speed of at most a half.
    broken = al.solve(thrust(length, force, cost, fastest=0.5), solver, throw=False)
    assert broken.status is al.Status.INFEASIBLE
    assert max(one.violation for one in broken.constraints) / length > 0.05


class Terms(al.System):
    """Functions of one number that are not smooth somewhere."""

    states = ("nothing",)
    a: float

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        jump = (self.a - 3.0) ** 2 + jnp.where(self.a > 2.0, 50.0, 0.0)
        return {"kink": jnp.abs(self.a - 2.0) + 0.1 * self.a, "jump": jump}


def terms(output):
    return al.Problem(Terms(al.Decision(0.3, 0.0, 10.0)), grid=al.Grid(1.0, 2), minimize=al.terminal(output).mean)


@pytest.mark.parametrize(("output", "known"), [("kink", "has a kink close by"), ("jump", "jumps close by")])
def test_a_solver_that_gets_stuck_says_what_is_known_of_the_reason_first(output, known):
    solution = al.solve(terms(output), al.solvers.FilterSQP(), throw=False)
    assert solution.status is al.Status.FAILED
    assert solution.decisions["a"] == pytest.approx(2.0, abs=1e-3)
    why = solution.why()
    assert known in why
    assert why.index(known) < why.index("the solver said")


class Push(al.System):
    """A mass, certain or not, pushed from rest."""

    states = ("x", "v")
    mass: float

    def rhs(self, t, z, f):
        return z.v, f / self.mass

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v}


@pytest.mark.slow
@SOLVERS
@pytest.mark.parametrize("spread", [False, True], ids=["norm", "spread"])
def test_a_norm_or_spread_is_optimal_at_zero_where_it_has_its_kink(solver, spread):
    goal = al.terminal("x").std if spread else al.objectives.terminal_mean_error({"x": 1.0, "v": 0.0})
    problem = al.Problem(
        Push(al.Uniform(1.0, half_width=0.1) if spread else 1.0),
        grid=al.Grid(1.0, steps=50),
        inputs={"f": al.BSpline(al.Decision(np.full(4, 1.0), -20.0, 20.0))},
        minimize=goal,
        expansion=al.Expansion(order=1),
    )
    solution = al.solve(problem, solver, throw=False)
    assert solution.ok, solution.why()
    assert solution.objective == pytest.approx(0.0, abs=1e-6)


class Many(al.System):
    """A root of a difference that becomes negative, of forty decisions."""

    states = ("nothing",)
    chosen: np.ndarray

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        return {"y": jnp.sqrt(jnp.sum(self.chosen) - 50.0)}


def test_a_failed_simulation_is_told_by_its_reason_and_at_most_five_numbers():
    problem = al.Problem(Many(al.Decision(np.ones(40), 0.0, 2.0)), grid=al.Grid(1.0, 2), minimize=al.terminal("y").mean)
    with pytest.raises(al.SimulationError) as caught:
        al.solve(problem)
    message = str(caught.value)
    assert message.startswith("The simulation is not finite: output 'y'")
    assert message.count("chosen[") == 5
    assert "and 35 more" in message
