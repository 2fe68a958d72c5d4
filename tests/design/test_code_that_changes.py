"""A problem is its equations as they were declared: code that changes later takes effect by declaring again."""

import random

import equinox as eqx
import numpy as np
import pytest

import aleator as al
from zoo import cases

GOAL = 1.0


class Toward(al.AlgebraicSystem):
    """Minimising the square finds the goal, wherever the code reads it."""

    a: al.Number = al.Uniform(al.Decision(0.0, -9.0, 9.0), half_width=0.5)

    def target(self):
        raise NotImplementedError

    def outputs(self):
        return {"x": (self.a - self.target()) ** 2}


def declared(target):
    """A problem whose goal is what `target(system)` says."""
    kind = type("Reads", (Toward,), {"target": target, "__module__": __name__})
    limit = al.output("x").at_most(100.0, sigmas=1.0)
    return al.Problem(kind(), minimize=al.output("x").mean, subject_to=[limit], expansion=al.Expansion(order=2))


def through_global():
    def change(value):
        globals()["GOAL"] = value

    return declared(lambda self: GOAL), change


def solved(problem):
    return al.solve(problem).decisions["a.mean"]


def test_designs_and_evidence_are_of_the_equations_that_were_declared():
    one, change = through_global()
    solution = al.solve(one)
    assert solution.decisions["a.mean"] == pytest.approx(1.0, abs=1e-6)
    change(3.0)
    try:
        assert solved(one) == pytest.approx(1.0, abs=1e-6)
        assert al.validate(solution, 100).functionals["x"].mean == pytest.approx(0.25 / 3, rel=0.3)
        again = al.Problem(one.system, minimize=one.objective, subject_to=one.constraints, expansion=one.expansion)
        assert solved(again) == pytest.approx(3.0, abs=1e-6)
    finally:
        change(1.0)


WEIGHT = 1.0


@pytest.mark.parametrize(
    "objective",
    cases(
        [
            lambda: al.expressions.function(lambda mean: WEIGHT * mean, al.output("x").mean),
            lambda: al.output("x").mean + al.cost.cost_curve("a.mean", lambda a: 0.0 * a + WEIGHT),
        ]
    ),
)
def test_functions_of_ones_own_in_expressions_are_refused_once_they_have_changed(objective, monkeypatch):
    one, _ = through_global()
    one = al.Problem(one.system, minimize=objective())
    solution = al.solve(one)
    monkeypatch.setattr(f"{__name__}.WEIGHT", 2.0)
    with pytest.raises(al.ProblemError, match="is not what it was when the problem was declared"):
        al.solve(one)
    with pytest.raises(al.ProblemError, match="declare it again"):
        al.validate(solution, 100)
    assert al.solve(al.Problem(one.system, minimize=objective())).objective > 1.5 * solution.objective


def test_a_problem_changed_as_a_tree_where_it_has_no_number_is_refused():
    class Kind(al.AlgebraicSystem):
        a: al.Number = al.Uniform(al.Decision(1.0, 0.5, 9.0), half_width=0.1)
        power: int = 2

        def outputs(self):
            return {"x": self.a**self.power}

    one = al.Problem(Kind(), minimize=al.output("x").mean)
    changed = eqx.tree_at(lambda problem: problem.system.power, one, 3)
    with pytest.raises(al.ProblemError, match="has another structure than the one whose equations were traced"):
        al.solve(changed)


COUNT = [0]


def counted(self):
    COUNT[0] += 1
    return float(COUNT[0])


def rolled(self):
    return float(np.random.default_rng().uniform())


def tossed(self):
    return random.random()


@pytest.mark.parametrize(("target", "method"), [(counted, "rhs"), (rolled, "outputs"), (tossed, "initial")])
def test_code_that_computes_something_else_each_time_is_refused_by_name(target, method):
    class Fickle(al.System):
        states = ("x",)
        a: al.Number = al.Decision(0.0, -9.0, 9.0)

        def rhs(self, t, z):
            return (self.a + (target(self) if method == "rhs" else 0.0),)

        def outputs(self, t, z):
            return {"x": z.x + (target(self) if method == "outputs" else 0.0)}

        def initial(self):
            return {"x": target(self) if method == "initial" else 0.0}

    with pytest.raises(al.ProblemError, match="Fickle computes something else each time"):
        al.Problem(Fickle(), grid=al.Grid(1.0, 2), minimize=al.terminal("x").mean)
