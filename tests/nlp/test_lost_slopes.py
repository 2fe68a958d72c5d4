"""An objective that changes without a slope is refused, where its decision acts smoothly on a limit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import cases


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
