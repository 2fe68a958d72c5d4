"""Objectives of which one term hides the others, and those without a slope or with a wrong one: closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from nlp_problems import INF, evaluation, program

import aleator as al
from aleator.nlp import FilterSQP
from zoo import Bar, bar_problem


@pytest.mark.parametrize("weight", [1e2, 1e8])
def test_a_priced_excess_hides_no_other_decision(solver, weight):
    # An exact penalty of the limit x <= 1 by an excess t: the optimum is 4 at (1, 1, 0).
    def evaluate(x):
        value = (x[0] - 3) ** 2 + (x[1] - 1) ** 2 + weight * x[2]
        return evaluation(value, [2 * (x[0] - 3), 2 * (x[1] - 1), weight], [x[0] - x[2]], [[1.0, 0.0, -1.0]])

    given = program(
        evaluate, [0.5, 0.5, 0.0], [-4.0, -4.0, 0.0], [4.0, 4.0, INF], [(-INF, 1.0)], np.array([0.8, 0.8, 1.0])
    )
    outcome = solver.solve(given)
    # Interior points end 1e-9 from bounds, which has its own price.
    assert not outcome.ok or outcome.point == pytest.approx([1.0, 1.0, 0.0], abs=1e-3)
    if isinstance(solver, FilterSQP):
        assert outcome.ok
        assert outcome.evaluation.objective == pytest.approx(4.0, rel=1e-6)


# --- Steep valleys, as large penalties make them ----------------------------------------------------------------------

# Points of control at which a trajectory has the end position 1 and the end velocity 0, by large penalties.
ROWS = np.array([[0.35, 0.25, 0.2, 0.15, 0.1, 0.05], [0.1, 0.2, 0.2, 0.2, 0.2, 0.1]])
ENDS, OFFSET = np.array([1.0, 0.0]), 3.0


def penalised(weight):
    """Least sum of squares, with two linear equations as penalties; and its minimum by the normal equations."""

    def evaluate(x):
        missed = ROWS @ x - ENDS
        return evaluation(OFFSET + x @ x + weight * missed @ missed, 2 * x + 2 * weight * ROWS.T @ missed)

    # By Woodbury's identity, because the normal equations themselves lose as many digits as the weight has.
    exact = ROWS.T @ np.linalg.solve(np.eye(2) / weight + ROWS @ ROWS.T, ENDS)
    return program(evaluate, np.ones(6)), exact


@pytest.mark.parametrize("weight", [1e4, 1e12])
def test_large_penalties_do_not_hide_the_minimum(solver, weight):
    given, exact = penalised(weight)
    outcome = solver.solve(given)
    assert outcome.ok
    missed = ROWS @ exact - ENDS
    assert outcome.evaluation.objective == pytest.approx(OFFSET + exact @ exact + weight * missed @ missed, rel=1e-4)
    assert outcome.point == pytest.approx(exact, abs=0.03)


# --- An objective that changes without a slope is refused, where its decision acts smoothly on a limit ----------------


class Rounded(Bar):
    """A bar that costs hundredths of its width."""

    def outputs(self):
        return {**super().outputs(), "cost": jnp.round(self.width, 2)}


def rounded_problem():
    bar = bar_problem()
    rounded = Rounded(bar.system.width, bar.system.load)
    return al.Problem(rounded, minimize=al.output("cost").mean, subject_to=bar.constraints)


def test_a_rounded_objective_is_refused_by_name():
    with pytest.raises(al.ProblemError, match="changes with 'width', but all its derivatives tried are zero"):
        al.solve(rounded_problem())
    assert any("by width" in one for one in al.examine(rounded_problem()).wrong)


def test_a_search_compares_values_and_says_so():
    found = al.solve(rounded_problem(), al.solvers.DifferentialEvolution(seed=1, evaluations=600))
    assert found.objective == pytest.approx(3.04, abs=1e-9)
    assert "values alone chose 'width'" in str(found.effort)


class Halved(al.AlgebraicSystem):
    """Values of k² - 2k + a, whose derivatives by k are halves of what they should be in part."""

    k: al.Number
    a: al.Number

    def outputs(self):
        square = jax.lax.stop_gradient(self.k) * self.k
        return {"cost": square - 2 * self.k + self.a}


def test_a_derivative_that_is_lost_in_part_is_contradicted_by_values():
    # By its derivatives the cost is least at k = 2, where it is 0 and not -1.
    model = Halved(al.Decision(3.0, -5.0, 5.0), al.Normal(0.0, 0.1))
    problem = al.Problem(model, minimize=al.output("cost").mean, expansion=al.Expansion(order=2))
    with pytest.raises(al.SolveError, match="where their derivatives say"):
        al.solve(problem)


@jax.custom_jvp
def total(a, b):
    return a + b


total.defjvp(lambda at, along: (total(*at), along[0] + 3.0 * along[1]))


def test_a_wrong_rule_in_an_expression_is_contradicted_by_values():
    model = Halved(al.Decision(1.0, -5.0, 5.0), al.Decision(1.0, -5.0, 5.0))
    limit = al.expressions.function(total, al.value("k"), al.value("a")) >= 2.0
    # By its derivatives the nearest point of k + a = 2 is (0.5, 1.5).
    problem = al.Problem(model, minimize=al.value("k") ** 2 + al.value("a") ** 2, subject_to=[limit])
    with pytest.raises(al.SolveError, match="where their derivatives say"):
        al.solve(problem)
