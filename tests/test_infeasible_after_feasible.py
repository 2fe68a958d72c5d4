"""No program is called infeasible of which a point was evaluated that meets all constraints, such as the start."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.nlp import Evaluation, NonlinearProgram, Status, feasible_elsewhere
from aleator.nlp.search import DifferentialEvolution


class Stepped(al.AlgebraicSystem):
    """A cost that falls with `size`, and a load of 1 beyond `edge`, 0 before."""

    size: al.Number
    noise: al.Number
    edge: float = 2.0

    def outputs(self):
        return {"load": jnp.where(self.size > self.edge, 1.0, 0.0) + 0.01 * self.noise, "gain": (self.size - 1.0) ** 2}


def stepped(start, edge=2.0):
    system = Stepped(al.Decision(start, 0.0, 10.0), al.Normal(0.0, 0.1), edge)
    return al.Problem(system, minimize=-al.output("gain").mean, subject_to=[al.output("load").mean <= 0.5])


SOLVERS = [
    al.solvers.FilterSQP(),
    al.solvers.Ipopt(),
    al.solvers.Slsqp(),
    al.solvers.InteriorPoint(),
    DifferentialEvolution(evaluations=8),
]


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda one: type(one).__name__)
def test_a_search_that_jumps_over_a_step_from_a_feasible_start_finds_no_infeasible_problem(solver):
    solution = al.solve(stepped(1.5), solver, throw=False)
    assert solution.status is not Status.INFEASIBLE
    assert solution.decisions["size"] <= 2.0
    assert not solution.violated
    assert "cannot all be met" not in solution.why()


def test_it_gives_back_the_best_design_that_holds_and_tells_of_the_jump():
    solution = al.solve(stepped(1.5), throw=False)
    assert solution.status is Status.FAILED
    assert solution.objective <= -0.25 + 1e-9
    assert "seem to jump" in solution.why()
    assert "al.examine" in solution.why()


def test_a_problem_that_no_point_seen_meets_is_infeasible_still():
    class Bowl(al.AlgebraicSystem):
        size: al.Number

        def outputs(self):
            return {"y": 1.0 + (self.size - 3.0) ** 2}

    problem = al.Problem(
        Bowl(al.Decision(1.5, 0.0, 10.0)), minimize=al.output("y").mean, subject_to=[al.output("y").mean <= 0.5]
    )
    assert al.solve(problem, throw=False).status is Status.INFEASIBLE


def notched(centre):
    """A descending objective, and a constraint that holds in a narrow notch alone and has a slope nowhere."""

    def evaluate(x):
        inside = abs(x[0] - centre) < 0.05
        return Evaluation(-x[0], np.array([-1.0]), np.array([0.0 if inside else 1.0]), np.zeros((1, 1)))

    return NonlinearProgram(
        evaluate=evaluate,
        start=np.array([centre]),
        lower=np.array([0.0]),
        upper=np.array([10.0]),
        constraint_lower=np.array([-np.inf]),
        constraint_upper=np.array([0.5]),
        constraint_scale=np.array([1.0]),
        variable_scale=np.array([1.0]),
    )


def test_the_programs_own_start_counts_where_the_search_began_elsewhere():
    program, solver = notched(7.7), al.solvers.FilterSQP()
    elsewhere = np.array([1.0])
    outcome = solver.solve(program, start=elsewhere)
    assert outcome.status is Status.INFEASIBLE
    found = feasible_elsewhere(program, outcome, elsewhere, lambda other, first: solver.solve(other, start=first))
    assert found.status is not Status.INFEASIBLE
    np.testing.assert_allclose(found.point, 7.7, atol=0.05)
    assert found.violation == 0.0
