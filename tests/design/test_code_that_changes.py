"""Code that changes between declaration, solution and evidence: compiled anew, or refused by name, never mixed."""

import random
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
import changing_physics
from aleator.transcription.sequential import EVALUATE
from changing_physics import goal

GOAL = 1.0
ARRAY = np.array([0.0, 1.0])


class Box:
    """A mutable object that a model may hold."""

    def __init__(self, goal):
        self.goal = goal


BOX = Box(1.0)


class Toward(al.System):
    """Minimising the square at the end finds the goal, wherever the code reads it: `x(t_f) = (a - goal)²`."""

    states = ("x",)
    goal = 1.0
    a: al.Number = al.Uniform(al.Decision(0.0, -9.0, 9.0), half_width=0.5)

    def target(self):
        raise NotImplementedError

    def rhs(self, t, z):
        return ((self.a - self.target()) ** 2,)

    def outputs(self, t, z):
        return {"x": z.x}


def problem(system):
    return al.Problem(
        system,
        grid=al.Grid(1.0, 2),
        minimize=al.terminal("x").mean,
        subject_to=[al.terminal("x").at_most(100.0, sigmas=1.0)],
        expansion=al.Expansion(order=2),
    )


def declared(target):
    """A problem whose goal is what `target(system)` says, and that function as it may be replaced."""
    kind = type("Reads", (Toward,), {"target": target, "__module__": __name__})
    return problem(kind())


def through_global():
    def change(value):
        globals()["GOAL"] = value

    return declared(lambda self: GOAL), change


def through_closure():
    where = 1.0

    def change(value):
        nonlocal where
        where = value

    return declared(lambda self: where), change


def through_class_attribute():
    one = declared(lambda self: self.goal)
    return one, lambda value: setattr(type(one.system), "goal", value)


def through_inherited_attribute():
    return declared(lambda self: self.goal), lambda value: setattr(Toward, "goal", value)


def through_method():
    one = declared(lambda self: 1.0)
    return one, lambda value: setattr(type(one.system), "target", lambda self: value)


def through_code_of_a_method():
    one = declared(lambda self: 1.0)

    def change(value):
        kind: Any = type(one.system)
        kind.target.__code__ = (lambda self: 3.0).__code__ if value == 3.0 else (lambda self: 1.0).__code__

    return one, change


def through_default():
    def target(self, to=1.0):
        return to

    return declared(target), lambda value: setattr(target, "__defaults__", (value,))


def through_function_of_another_module():
    return declared(lambda self: goal()), lambda value: setattr(changing_physics, "GOAL", value)


def through_attribute_of_a_module():
    return declared(lambda self: changing_physics.GOAL), lambda value: setattr(changing_physics, "GOAL", value)


def through_import_inside():
    def target(self):
        import changing_physics as inside

        return inside.GOAL

    return declared(target), lambda value: setattr(changing_physics, "GOAL", value)


def through_array():
    return declared(lambda self: ARRAY[1]), lambda value: ARRAY.__setitem__(1, value)


def through_list_of_another_module():
    return declared(lambda self: changing_physics.TABLE[1]), lambda value: changing_physics.TABLE.__setitem__(1, value)


def through_object():
    return declared(lambda self: BOX.goal), lambda value: setattr(BOX, "goal", value)


def through_name_that_no_code_shows():
    return declared(lambda self: getattr(changing_physics, "GO" + "AL")), lambda value: setattr(
        changing_physics, "GOAL", value
    )


WAYS = [
    through_global,
    through_closure,
    through_class_attribute,
    through_inherited_attribute,
    through_method,
    through_code_of_a_method,
    through_default,
    through_function_of_another_module,
    through_attribute_of_a_module,
    through_import_inside,
    through_array,
    through_list_of_another_module,
    through_object,
    through_name_that_no_code_shows,
]


@pytest.fixture(params=WAYS, ids=lambda way: way.__name__.removeprefix("through_"))
def changing(request):
    """A problem and what changes its goal, which is put back."""
    one, change = request.param()
    yield one, change
    change(1.0)


def found(solution):
    """Where the solution went. The square is least at the goal, whatever the spread."""
    return solution.decisions["a.mean"]


@pytest.mark.slow
def test_a_solution_is_of_the_code_as_it_is_now_and_evidence_refuses_any_other(changing):
    one, change = changing
    change(3.0)
    moved = al.solve(one)
    assert found(moved) == pytest.approx(3.0, abs=1e-6)
    assert al.validate(moved, 100).functionals["x(t_f)"].mean == pytest.approx(0.25 / 3, rel=0.3)
    change(1.0)
    with pytest.raises(al.ProblemError, match=r"validate: the code of Reads is not what it was when"):
        al.validate(moved, 100)
    # The executable that was traced at 3 serves no problem that is solved at 1.
    assert found(al.solve(one)) == pytest.approx(1.0, abs=1e-6)
    compiled = EVALUATE.compilations
    change(3.0)
    assert found(al.solve(one)) == pytest.approx(3.0, abs=1e-6)
    assert EVALUATE.compilations == compiled
    al.validate(moved, 100)


@pytest.mark.parametrize(
    ("way", "named"),
    [
        (through_global, r"the global 'GOAL' that .*<lambda> reads was 1.0 and is 3.0"),
        (through_closure, r"the closure variable 'where' that .*<lambda> reads was 1.0 and is 3.0"),
        (through_class_attribute, r"Reads.goal has changed"),
        (through_inherited_attribute, r"Toward.goal was 1.0 and is 3.0"),
        (through_function_of_another_module, r"the global 'GOAL' that goal reads was 1.0 and is 3.0"),
        (through_array, r"the global 'ARRAY' that .*<lambda> reads has changed"),
        (through_object, r"the global 'BOX.goal' that .*<lambda> reads was 1.0 and is 3.0"),
    ],
)
def test_what_has_changed_is_named(way, named):
    one, change = way()
    solution = al.solve(one)
    change(3.0)
    try:
        with pytest.raises(al.ProblemError, match=named):
            al.validate(solution, 100)
    finally:
        change(1.0)


def test_a_deterministic_twin_follows_the_code_too():
    one, change = through_global()
    twin = al.deterministic(one)
    change(3.0)
    try:
        solution = al.solve(twin)
        assert found(solution) == pytest.approx(3.0, abs=1e-6)
        al.validate(solution, 100)
    finally:
        change(1.0)
    with pytest.raises(al.ProblemError, match="GOAL"):
        al.validate(solution, 100)


class Certain(al.AlgebraicSystem):
    """Nothing is uncertain, and the code reads a global."""

    a: al.Number = al.Decision(0.0, -9.0, 9.0)

    def outputs(self):
        return {"x": (self.a - GOAL) ** 2}


@pytest.mark.parametrize("solved_again", [False, True])
@pytest.mark.parametrize("moving", [False, True])
def test_evidence_of_a_design_without_uncertainty_refuses_other_code_too(monkeypatch, moving, solved_again):
    if moving:
        kind = type("Moves", (Toward,), {"target": lambda self: GOAL, "__module__": __name__})
        one = al.Problem(kind(a=al.Decision(0.0, -9.0, 9.0)), grid=al.Grid(1.0, 2), minimize=al.terminal("x").mean)
    else:
        one = al.Problem(Certain(), minimize=al.output("x").mean)
    solution = al.solve(one)
    monkeypatch.setitem(globals(), "GOAL", 4.0)
    if solved_again:
        al.solve(one)
    for _ in range(2):
        with pytest.raises(
            al.ProblemError, match=r"validate: the code of \w+ is not what it was when the design .*GOAL"
        ):
            al.validate(solution)
    monkeypatch.setitem(globals(), "GOAL", 1.0)
    assert al.validate(solution).agrees


def test_what_does_not_change_the_equations_is_no_change():
    """A global that is read and left unused, and one that is replaced by its equal."""
    unused = 1.0
    one = declared(lambda self: (unused, GOAL)[1])
    solution = al.solve(one)
    unused = 5.0
    compiled = EVALUATE.compilations
    al.validate(solution, 100)
    al.solve(one)
    assert EVALUATE.compilations == compiled


@pytest.mark.parametrize(
    "sweep",
    [
        lambda one, progress: al.pareto(one, "x", [50.0, 60.0, 70.0], progress=progress),
        lambda one, progress: al.multistart(one, 3, progress=progress),
    ],
    ids=["pareto", "multistart"],
)
def test_sweeps_do_not_mix_two_states_of_the_code(sweep):
    one, change = through_global()

    def progress(what, done, total):
        change(3.0 if done == 2 else 1.0)

    with pytest.raises(al.ProblemError, match="the global 'GOAL'"):
        sweep(one, progress)
    change(1.0)


def test_a_calibration_does_not_mix_two_states_of_the_code():
    one, change = through_global()

    def progress(what, done, total):
        change(3.0 if done else 1.0)

    limited = one.with_bound("x", 0.2)
    try:
        with pytest.raises(al.ProblemError, match="the global 'GOAL'"):
            al.calibrate(limited, "x", 0.06, samples=400, progress=progress)
    finally:
        change(1.0)


def test_arrays_of_a_model_are_those_of_its_declaration():
    """A problem is data: what becomes of an array that it was declared with is no concern of it."""

    class Weighted(al.System):
        states = ("x",)
        goals: al.Number
        a: al.Number

        def rhs(self, t, z):
            return (((self.a - self.goals) ** 2).sum(),)

        def outputs(self, t, z):
            return {"x": z.x}

    goals = np.array([0.0, 4.0])
    one = al.Problem(
        Weighted(goals, al.Uniform(al.Decision(0.0, -9.0, 9.0), half_width=0.1)),
        grid=al.Grid(1.0, 2),
        minimize=al.terminal("x").mean,
    )
    goals[1] = 6.0
    solution = al.solve(one)
    assert found(solution) == pytest.approx(2.0, abs=1e-6)
    goals[1] = 8.0
    assert float(al.validate(solution, 100).functionals["x(t_f)"].mean) == pytest.approx(8.0, rel=0.01)
    assert found(al.solve(one)) == pytest.approx(2.0, abs=1e-6)


COUNT = [0]


def counted(self):
    COUNT[0] += 1
    return float(COUNT[0])


def rolled(self):
    return float(np.random.default_rng().uniform())


def drawn(self):
    return float(np.random.uniform())  # noqa: NPY002


def tossed(self):
    return random.random()


def timed(self):
    import time

    return time.perf_counter()


@pytest.mark.parametrize("target", [counted, rolled, drawn, tossed, timed], ids=lambda one: one.__name__)
@pytest.mark.parametrize("method", ["rhs", "outputs", "initial"])
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

    with pytest.raises(al.ProblemError, match=rf"Fickle computes something else each time .*\b{target.__name__}\b"):
        problem(Fickle())


def test_algebraic_equations_that_differ_each_time_are_refused_too():
    class Fickle(al.AlgebraicSystem):
        unknowns = ("x",)
        a: al.Number = al.Decision(0.0, -9.0, 9.0)

        def guess(self):
            return {"x": random.random()}

        def residual(self, rho):
            return (rho.x - self.a,)

    with pytest.raises(
        al.ProblemError, match=r"Fickle computes something else each time .*'random' that .*guess reads"
    ):
        al.Problem(Fickle(), minimize=al.output("x").mean)


def test_side_effects_that_leave_the_equations_alone_are_allowed():
    calls = []

    def target(self):
        calls.append(1)
        return GOAL

    one = declared(target)
    solution = al.solve(one)
    assert found(solution) == pytest.approx(1.0, abs=1e-6)
    compiled = EVALUATE.compilations
    al.solve(one)
    al.validate(solution, 100)
    assert EVALUATE.compilations == compiled
    assert calls


def test_numbers_drawn_from_a_seed_are_no_accident():
    def target(self):
        return float(np.random.default_rng(3).uniform(2.0, 2.5))

    expected = np.random.default_rng(3).uniform(2.0, 2.5)
    assert found(al.solve(declared(target))) == pytest.approx(expected, abs=1e-6)


def test_functions_that_remember_what_they_have_read_are_asked_again():
    """A function of `jax.jit` keeps what it has read: what it gives is what counts, and it is followed."""
    cell = {"goal": 1.0}

    @jax.jit
    def remembered():
        return jnp.asarray(cell["goal"])

    one = declared(lambda self: remembered())
    assert found(al.solve(one)) == pytest.approx(1.0, abs=1e-6)
    cell["goal"] = 3.0
    remembered.clear_cache()  # type: ignore[attr-defined]
    assert found(al.solve(one)) == pytest.approx(3.0, abs=1e-6)
