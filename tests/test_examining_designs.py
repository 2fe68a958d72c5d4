"""What `examine` tells of a problem around a design: kinks, jumps, wrong derivatives, scales, history."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.studies._check import Check
from zoo import algebraic


class Rule(al.AlgebraicSystem):
    """`y` is a rule of two numbers that are decided."""

    unknowns = ()
    rule: Any
    a: Any = al.Decision(0.5, -2.0, 2.0)
    b: Any = al.Decision(0.3, -2.0, 2.0)

    def outputs(self):
        return {"y": self.rule(self.a, self.b), "z": self.a + self.b}


def of(rule, *limits, **numbers):
    return al.Problem(Rule(rule, **numbers), minimize=al.output("y").mean, subject_to=limits)


Z = al.output("z").mean <= 2.0


@jax.custom_jvp
def off(a):
    """A derivative that is a little wrong."""
    return jnp.exp(a)


off.defjvp(lambda primal, tangent: (jnp.exp(*primal), 1.01 * jnp.exp(*primal) * tangent[0]))


@algebraic
def faulty(a, b, away, weights):
    """A rule that stops a gradient solver: which one, and how far away from the start, is data."""
    kink, jump = jnp.abs(a - 0.5 - away) + a**4, jnp.where(a < 0.5 + away, 0.0, 1.0) + a**4
    rules = kink, jump, jax.lax.stop_gradient(a) ** 2, off(a)
    return {"y": sum(weight * rule for weight, rule in zip(weights, rules, strict=True)) + b}


# The rule of each, and how far away.
RULES = {
    "kink": (0, 0.0),
    "kink close by": (0, 1e-9),
    "jump": (1, 0.0),
    "jump close by": (1, -1e-7),
    "wrong": (2, 0.0),
    "wrong by little": (3, 0.0),
}


def fault(what, a=0.5, b=0.3):
    """The model of one of the rules, at some decisions."""
    rule, away = RULES[what]
    return faulty(al.Decision(a, -2.0, 2.0), al.Decision(b, -2.0, 2.0), away, np.eye(4)[rule].tolist())


@pytest.mark.parametrize("what", RULES)
def test_what_stops_a_gradient_solver_is_named_with_its_decision_in_objective_and_limit(what):
    y = al.output("y").mean
    told = al.examine(al.Problem(fault(what), minimize=y, subject_to=[(y <= 9.0).named("limit")]))
    kinds = {"kink": told.kinks, "jump": told.jumps, "wrong": told.wrong}
    by_objective, by_limit = kinds.pop(what.split()[0])
    assert by_objective.startswith("objective μ[y], by a")
    assert by_limit.startswith("limit") or by_limit.startswith("μ[y] ≤ 9, by a")
    assert not any(kinds.values())
    assert not told.ok
    assert ("switching time" in str(told)) == (what.split()[0] != "kink")


def test_a_smooth_problem_has_nothing_to_tell_and_at_a_bound_one_side_is_enough():
    found = al.examine(of(lambda a, b: a**2 + jnp.sin(b), Z, b=al.Decision(0.5, -2.0, 2.0)))
    assert found.ok
    assert found.history is None
    # Relative to the objective's value, over the typical magnitude of a decision.
    assert found.effects.shape == (2, 2)
    assert found.effects[1, 0] == pytest.approx(found.effects[1, 1])
    at_bound = {"a": al.Decision(-2.0, -2.0, 2.0), "b": al.Decision(2.0, -2.0, 2.0)}
    assert al.examine(of(lambda a, b: a**2 + jnp.exp(b), **at_bound)).ok
    assert al.examine(al.Problem(fault("wrong", -2.0, 2.0), minimize=al.output("y").mean)).wrong


def test_a_solve_can_be_examined_with_the_history_of_every_point_that_was_evaluated():
    problem = of(lambda a, b: jnp.abs(a - 0.1) + 10 * jnp.abs(a + b), Z)
    with pytest.raises(al.SolveError) as caught:
        al.solve(problem, al.solvers.FilterSQP(max_iterations=40))
    failed = caught.value.solution
    told = al.examine(failed)
    assert told.kinks
    visited = failed.effort.visited
    assert told.history is not None
    assert 3 < told.history.evaluations == visited.evaluations <= failed.effort.evaluations
    assert visited.objectives[0] == pytest.approx(0.4 + 8.0)
    assert np.nanmin(visited.objectives) == pytest.approx(failed.objective, abs=1e-6)
    assert visited.best(1e-6)[-1] == pytest.approx(failed.objective, abs=1e-6)


def test_a_design_that_is_not_finite_is_refused_by_what_is_not_and_told_by_the_check_of_a_study():
    log = (al.expressions.function(jnp.log, al.value("a")) <= 1.0).named("log")
    nowhere = of(lambda a, b: a + b**2, log, a=al.Decision(-1.0, -2.0, 2.0))
    with pytest.raises(al.SimulationError, match=r"not finite here: log\(a\) ≤ 1\. .*decisions are a = -1, b = 0\.3"):
        al.examine(nowhere)
    check = Check(al.Study({"near": of(lambda a, b: a + b), "nowhere": nowhere}))
    assert [one[:16] for one in check.troubles if "finite" in one] == ["nowhere: examine"]
    assert list(check.table().header) == ["", "near", "nowhere"]


def test_an_infinite_slope_is_told_of_its_decision_and_hides_no_other():
    root = al.value("a") ** 0.5
    system = Rule(lambda a, b: a + b, a=al.Decision(0.0, 0.0, 2.0))
    found = al.examine(al.Problem(system, minimize=root + al.value("b") ** 2, subject_to=[Z]))
    (sentence,) = found.endless
    assert sentence.startswith("objective a^0.5 + b², by a")
    assert "no finite derivative" in str(found)
    assert [found.kinks, found.jumps, found.wrong, found.unfit] == [()] * 4
    assert not found.ok
    # The change over a tenth of the typical magnitude of 0.3.
    assert found.effects[0, 1] > 0.1


@pytest.mark.parametrize(
    ("rule", "start", "kind"),
    [
        (lambda a, b: jnp.maximum(a, -a) + b, 0.0, "kinks"),
        (lambda a, b: jax.lax.stop_gradient(a) ** 2 + b, 2.0, "wrong"),
    ],
)
def test_at_a_bound_where_one_side_is_seen_a_kink_is_told_from_a_wrong_derivative(rule, start, kind):
    found = al.examine(of(rule, a=al.Decision(start, 0.0, 2.0)))
    told = {name: getattr(found, name) for name in ("kinks", "jumps", "wrong", "endless")}
    assert [name for name, sentences in told.items() if any("by a" in one for one in sentences)] == [kind]
