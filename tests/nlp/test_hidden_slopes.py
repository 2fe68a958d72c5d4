"""Linear programs, and objectives of which one term hides the others: closed forms, and SciPy's HiGHS."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from nlp_problems import INF, evaluation, program

import aleator as al
from aleator.nlp import FilterSQP
from zoo import cases

SEEDS = cases(range(3))


def linear(cost, matrix, most, start, lower, upper):
    """Minimise `cost x` subject to `matrix x <= most` between bounds, with the typical magnitudes of decisions."""
    cost, matrix, start = np.array(cost), np.reshape(matrix, (-1, len(cost))), np.array(start)
    span = np.array(upper) - np.array(lower)
    scale = np.maximum(np.abs(start), np.where(np.isfinite(span), span / 10, 0.0))
    return program(
        lambda x: evaluation(float(cost @ x), cost, matrix @ x, matrix),
        start,
        lower,
        upper,
        [(-INF, float(one)) for one in most],
        scale,
    )


def random_linear(seed):
    """Ranges over seven orders of magnitude, costs over four; feasible by construction, since some point is inside."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 7)), int(rng.integers(0, 5))
    span = 10.0 ** rng.uniform(-3, 4, n)
    lower = rng.uniform(-1, 0, n) * span
    cost = rng.normal(size=n) * 10.0 ** rng.uniform(-2, 2, n) / span
    matrix = rng.normal(size=(m, n)) / span
    most = matrix @ rng.uniform(lower, lower + span) + rng.uniform(0, 0.5, m)
    return linear(cost, matrix, most, rng.uniform(lower, lower + span), lower, lower + span), (cost, matrix, most)


@pytest.mark.parametrize("seed", SEEDS)
def test_linear_programs_of_any_scales_end_at_the_optimum_of_highs(solver, seed):
    given, (cost, matrix, most) = random_linear(seed)
    exact = scipy.optimize.linprog(cost, matrix, most, bounds=np.column_stack([given.lower, given.upper]))
    outcome = solver.solve(given)
    assert outcome.ok
    most_change = float(np.abs(cost) @ (given.upper - given.lower))
    assert outcome.evaluation.objective == pytest.approx(exact.fun, abs=1e-5 * most_change)


def test_a_level_rises_as_far_as_it_must():
    offset = 1e4
    # The least level above two rows that are far above its start: -4 + offset.
    rows = [[1.0, 0.0, -1.0], [0.0, 1.0, -1.0]]
    given = linear([0.0, 0.0, 1.0], rows, [-offset, -offset], [0.5, 0.5, 1.0], [-4.0, -4.0, 0.0], [4.0, 4.0, INF])
    outcome = FilterSQP().solve(given)
    assert outcome.ok
    assert outcome.point == pytest.approx([-4.0, -4.0, offset - 4.0], rel=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_no_term_of_a_sum_hides_the_others(solver, seed):
    # Terms over twelve orders of magnitude, linear ones and squares, each in a variable of its own.
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    weights, centres, is_linear = 10.0 ** rng.uniform(-4, 8, n), rng.uniform(-3, 3, n), rng.random(n) < 0.5

    def evaluate(x):
        terms = np.where(is_linear, weights * (x + 4), weights * (x - centres) ** 2)
        return evaluation(float(terms.sum()), np.where(is_linear, weights, 2 * weights * (x - centres)))

    given = program(evaluate, np.zeros(n), np.full(n, -4.0), np.full(n, 4.0), variable_scale=np.full(n, 0.8))
    outcome = solver.solve(given)
    # The least value is zero: what is left is nothing beside the start, and may hide what no double shows.
    assert outcome.ok
    assert outcome.evaluation.objective <= 1e-6 * evaluate(np.zeros(n)).objective


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


@pytest.mark.parametrize("weight", [1e4, 1e8])
def test_a_curved_valley_is_followed_to_its_end_or_told(solver, weight):
    def evaluate(x):
        off = x[1] - x[0] ** 2
        slope = [-2 * (1 - x[0]) - 4 * weight * off * x[0], 2 * weight * off]
        return evaluation(OFFSET + (1 - x[0]) ** 2 + weight * off**2, slope)

    outcome = solver.solve(program(evaluate, [0.5, 1.0]))
    is_minimum = outcome.evaluation.objective == pytest.approx(OFFSET, rel=1.5e-3)
    assert is_minimum or (not outcome.ok and "floor of a steep valley" in outcome.message), outcome
    assert is_minimum or weight > 1e4


def test_a_minimum_of_zero_is_not_probed_for_ever(solver):
    # Two variables of which only the sum matters: beside rounding there is nothing to gain.
    outcome = solver.solve(
        program(lambda x: evaluation((x[0] + x[1] - 1) ** 2, 2 * (x[0] + x[1] - 1) * np.ones(2)), [3.0, 0.0])
    )
    assert outcome.ok
    assert outcome.evaluation.objective < 1e-9


# --- An objective that changes without a slope is refused, where its decision acts smoothly on a limit ----------------


class Bar(al.AlgebraicSystem):
    """A bar whose cost is some function of its width."""

    width: al.Number
    load: al.Number
    kind: str

    def outputs(self):
        return {"stress": self.load / self.width, "cost": COSTS[self.kind](self.width)}


COSTS = {
    "hundredths": lambda width: jnp.round(width, 2),
    "never thinner": lambda width: jnp.maximum(width, 3.5),
}


def problem(kind):
    stress = al.output("stress")
    strong = (stress.mean + 3 * stress.std <= 0.5).named("stress")
    bar = Bar(al.Decision(4.0, 0.1, 10.0), al.Uniform(1.0, half_width=0.3), kind)
    return al.Problem(bar, minimize=al.output("cost").mean, subject_to=[strong])


def test_a_rounded_objective_is_refused_by_name():
    kind = "hundredths"
    with pytest.raises(al.ProblemError, match="changes with 'width', but all its derivatives tried are zero"):
        al.solve(problem(kind))
    assert any("by width" in one for one in al.examine(problem(kind)).wrong)


@pytest.mark.slow
def test_an_objective_that_is_flat_in_part_is_solved():
    kind = "never thinner"
    assert al.solve(problem(kind)).objective == pytest.approx(3.5, rel=1e-9)
    assert not al.examine(problem(kind)).wrong


def test_a_search_compares_values_and_says_so():
    found = al.solve(problem("hundredths"), al.solvers.DifferentialEvolution(seed=1, evaluations=600))
    assert found.objective == pytest.approx(3.04, abs=1e-9)
    assert "values alone chose 'width'" in str(found.effort)


class Halved(al.AlgebraicSystem):
    """Values of k² - 2k + a and of k² a, whose derivatives by k are halves of what they should be in part."""

    k: al.Number
    a: al.Number

    def outputs(self):
        square = jax.lax.stop_gradient(self.k) * self.k
        return {"cost": square - 2 * self.k + self.a, "load": square * self.a}


@pytest.mark.parametrize("of_a_limit", cases([False, True]))
def test_a_derivative_that_is_lost_in_part_is_contradicted_by_values(of_a_limit):
    # By its derivatives the cost is least at k = 2, where it is 0 and not -1; the limit has twice its true price.
    limits = [al.output("load").std <= 0.4] if of_a_limit else []
    objective = -al.value("k") if of_a_limit else al.output("cost").mean
    model = Halved(al.Decision(1.0 if of_a_limit else 3.0, -5.0, 5.0), al.Normal(0.0, 0.1))
    problem = al.Problem(model, minimize=objective, subject_to=limits, expansion=al.Expansion(order=2))
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


@pytest.mark.slow
def test_rules_of_differentiation_that_are_right_are_not_doubted():
    class Smooth(al.AlgebraicSystem):
        k: al.Number
        a: al.Number

        def outputs(self):
            return {"cost": jax.nn.softplus(self.k) + jax.nn.softplus(-self.k) + jax.nn.relu(self.k - 3.0) + self.a**2}

    problem = al.Problem(Smooth(al.Decision(1.0, -5.0, 5.0), al.Normal(0.0, 0.1)), minimize=al.output("cost").mean)
    assert problem.simulation.equations.may_lose_derivatives
    assert al.solve(problem).objective == pytest.approx(2 * np.log(2.0) + 0.01, rel=1e-9)
