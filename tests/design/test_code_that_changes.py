"""A problem is its equations as they were declared: code that changes later takes effect by declaring again."""

import pickle
import random

import equinox as eqx
import jax
import numpy as np
import pytest

import aleator as al
from aleator import extending as ext
from aleator._core import equations, programs
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


def weighed(mean):
    return WEIGHT * mean


class Pushed(al.System):
    states = ("x",)
    a: al.Number = al.Decision(0.5, -9.0, 9.0)

    def initial(self):
        return {"x": self.a}

    def rhs(self, t, z, push):
        return (push,)

    def outputs(self, t, z):
        return {"x": z.x}


def weighed_mean():
    """The mean of `a²` is least where it is the variance of `a`, 1/12."""
    mean = al.expressions.function(weighed, al.output("x").mean)
    return al.Problem(Toward(), minimize=mean, subject_to=[mean <= 1.0])


def weighed_cost():
    cost = al.cost.cost_curve("a.mean", lambda a: WEIGHT * (1 + a**2) / 12)
    return al.Problem(Toward(), minimize=cost, subject_to=[al.output("x").mean <= 1.0])


def weighed_push():
    push = al.processes.signal(lambda t, p: WEIGHT * p.rate * t, rate=al.Normal(1.0, 0.01))
    system, end = Pushed(), al.terminal("x").mean
    return al.Problem(
        system, grid=al.Grid(1.0, 2), inputs={"push": push}, minimize=end, subject_to=[al.value("a") >= 0]
    )


@pytest.mark.parametrize(
    ("problem", "least"), cases([(weighed_mean, 1 / 12), (weighed_cost, 1 / 12), (weighed_push, 0.5)])
)
def test_functions_of_ones_own_are_what_they_were_when_they_were_given(problem, least, monkeypatch):
    monkeypatch.setattr(Toward, "target", lambda self: 0.0)
    one = problem()
    monkeypatch.setattr(f"{__name__}.WEIGHT", 2.0)
    solution = al.solve(one)
    assert solution.objective == pytest.approx(least, rel=1e-6)
    evidence = al.validate(solution, 1000)
    assert evidence.agrees
    if problem is weighed_mean:
        assert evidence.compared[0].value == pytest.approx(least, rel=0.1)
    assert al.solve(problem()).objective == pytest.approx(2 * least, rel=1e-6)


def test_a_function_that_comes_from_another_process_has_the_same_equations_here_or_is_refused(monkeypatch):
    monkeypatch.setattr(Toward, "target", lambda self: 0.0)
    mean = al.output("x").mean
    sent = pickle.dumps(al.expressions.function(weighed, mean))
    assert pickle.dumps(pickle.loads(sent)) == sent
    assert jax.tree.structure(pickle.loads(sent)) == jax.tree.structure(al.expressions.function(weighed, mean))
    monkeypatch.setattr(f"{__name__}.WEIGHT", 2.0)
    other = pickle.loads(sent)
    assert str(other) == "weighed(μ[x])"
    with pytest.raises(al.ProblemError, match="'weighed': the code of this process gives other equations"):
        al.Problem(Toward(), minimize=other)


class Weighed(ext.AbstractFunctional):
    needs_time = False

    def evaluate(self, taken, grid):
        return WEIGHT * taken.history[self.output][0]


def test_no_program_that_calls_a_class_of_ones_own_is_kept_for_other_runs(monkeypatch):
    monkeypatch.setattr(Toward, "target", lambda self: 0.0)
    for functional, is_declared in ((al.output("x"), True), (Weighed(("x",)), False)):
        assert al.Problem(Toward(), minimize=functional.mean).is_declared == is_declared


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


def test_the_second_trace_may_be_that_of_an_earlier_run(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_folder", programs._made(tmp_path))
    counts = []
    for value in (2.0, 2.0, 3.0):
        monkeypatch.setattr(equations, "_STEADY", set())  # as in another process
        calls = []
        declared(lambda self, value=value, calls=calls: calls.append(1) or value)
        counts.append(len(calls))
        # Neither this run's first trace nor its second is the next one's.
        with pytest.raises(al.ProblemError, match="something else each time"):
            declared(tossed)
    assert counts[1] < counts[0] == counts[2]
