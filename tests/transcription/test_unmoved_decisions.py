"""Answers at which decisions have not moved: maxima, saddles, flat starts, and models without derivatives."""

import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from tiny_models import ONE_STEP


class Choice(al.System):
    """No dynamics: responses of two numbers, each of which traps a search by slopes somewhere."""

    states = ("nothing",)
    a: Any
    b: Any = 0.0
    kind: str = "maximum"

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        a, b = self.a, self.b
        responses = {
            "maximum": lambda: (a**2 - 0.25) ** 2,
            "falling": lambda: -(a**2),
            "cosine": lambda: jnp.cos(a),
            "symmetric": lambda: (a - 1.0) ** 2 + (b**2 - 1.0) ** 2,
            "dead": lambda: 1.0 - jnp.maximum(0.0, a - 0.4),
            "minimum": lambda: (a - 0.25) ** 2,
            "round": lambda: (jnp.round(a) - 7.0) ** 2,
            "stopped": lambda: (jax.lax.stop_gradient(a) - 7.0) ** 2,
            "whole": lambda: (a.astype(int) - 7.0) ** 2,
        }
        return {"y": responses[self.kind]() * 1.0, "a": a * 1.0}


Y = al.terminal("y").mean


def answer(kind, a, *limits, b=0.0, solver=None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem = al.Problem(Choice(a, b, kind), grid=ONE_STEP, minimize=Y, subject_to=list(limits))
        return al.solve(problem, solver)


SOLVERS = pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=["sqp", "ipopt", "slsqp"]
)


@SOLVERS
@pytest.mark.parametrize(
    ("kind", "bounds", "best"),
    [("maximum", (-2.0, 2.0), 0.0), ("falling", (-1.0, 1.0), -1.0), ("cosine", (-3.0, 3.0), np.cos(3.0))],
)
def test_a_start_at_a_maximum_is_left(kind, bounds, best, solver):
    solution = answer(kind, al.Decision(0.0, *bounds), solver=solver)
    assert solution.ok
    assert solution.objective == pytest.approx(best, abs=1e-6)


def test_a_start_at_a_bound_that_holds_nothing_is_left():
    assert answer("falling", al.Decision(0.0, 0.0, 1.0)).objective == pytest.approx(-1.0)


def test_a_start_on_a_line_of_symmetry_is_left():
    solution = answer("symmetric", al.Decision(0.3, -2.0, 2.0), b=al.Decision(0.0, -2.0, 2.0))
    assert solution.objective == pytest.approx(0.0, abs=1e-8)
    assert abs(solution.decisions["b"]) == pytest.approx(1.0, rel=1e-4)


def test_a_maximum_under_a_limit_is_left_as_far_as_the_limit_lets():
    solution = answer("falling", al.Decision(0.0, -1.0, 1.0), al.terminal("a").within(-0.2, 0.3))
    assert solution.objective in (pytest.approx(-0.09, rel=1e-6), pytest.approx(-0.04, rel=1e-6))


def test_a_start_where_the_model_is_flat_is_left():
    assert answer("dead", al.Decision(0.0, -1.0, 1.0)).objective == pytest.approx(0.4)


def test_a_start_at_the_minimum_stays_there():
    solution = answer("minimum", al.Decision(0.25, -1.0, 1.0))
    assert solution.decisions["a"] == 0.25
    assert "nothing in the problem was found" not in str(solution)


@pytest.mark.parametrize("kind", ["round", "stopped", "whole"])
def test_a_decision_whose_derivative_was_lost_is_refused_by_name(kind):
    with pytest.raises(al.ProblemError, match=r"changes with 'a', but all its derivatives tried are zero"):
        answer(kind, al.Decision(2.0, 0.0, 10.0))


def test_a_decision_that_nothing_depends_on_is_named():
    solution = answer("minimum", al.Decision(0.1, -1.0, 1.0), b=al.Decision(0.3, 0.0, 1.0))
    assert solution.idle == ("b",)
    assert "decision     b = 0.3 (at its start: nothing in the problem was found to depend on b)" in str(solution)


@pytest.mark.parametrize("size", [1e8, 1e9, 1e10])
@pytest.mark.parametrize("start", [0.0, 1.0])
def test_a_decision_that_has_to_grow_by_orders_of_magnitude_is_no_proof_that_nothing_is_feasible(size, start):
    class Far(al.System):
        states = ("nothing",)
        d: Any

        def rhs(self, t, z):
            return (0.0 * z.nothing,)

        def outputs(self, t, z):
            return {"y": self.d / size, "loss": (self.d / size - 3.0) ** 2}

    problem = al.Problem(
        Far(al.Decision(start)),
        grid=ONE_STEP,
        minimize=al.terminal("loss").mean,
        subject_to=[al.terminal("y").mean <= 2.0],
    )
    assert al.solve(problem).decisions["d"] == pytest.approx(2 * size, rel=1e-5)


@pytest.mark.parametrize("shape", [lambda a: jnp.tanh(5 * a), lambda a: jnp.clip(a, 0.0, 1.0)], ids=["tanh", "clip"])
def test_a_start_where_a_constraint_saturates_is_no_proof_that_nothing_is_feasible(shape):
    class Saturated(al.System):
        states = ("nothing",)
        a: Any

        def rhs(self, t, z):
            return (0.0 * z.nothing,)

        def outputs(self, t, z):
            return {"y": shape(self.a), "loss": (self.a - 9.0) ** 2}

    problem = al.Problem(
        Saturated(al.Decision(8.0, 0.0, 10.0)),
        grid=ONE_STEP,
        minimize=al.terminal("loss").mean,
        subject_to=[al.terminal("y").mean <= 0.5],
    )
    solution = al.solve(problem)
    assert shape(solution.decisions["a"]) == pytest.approx(0.5, rel=1e-5)


class Pushed(al.System):
    """A unit mass that is pushed."""

    states = ("v",)

    def rhs(self, t, z, u):
        return (u,)

    def outputs(self, t, z, u):
        return {"v": z.v, "yield": -(u**2)}


@pytest.mark.parametrize("pieces", [10, 30])
@pytest.mark.parametrize("way", [al.Sequential(), al.Simultaneous()], ids=["shooting", "collocation"])
def test_every_decision_of_many_leaves_a_maximum(pieces, way):
    control = al.Control(np.zeros(pieces), -1.0, 1.0, degree=0)
    problem = al.Problem(Pushed(), grid=al.Grid(1.0, pieces), inputs={"u": control}, minimize=al.integral("yield").mean)
    assert al.solve(problem, transcription=way).objective == pytest.approx(-1.0, rel=1e-6)


def test_every_decision_of_many_leaves_a_maximum_as_far_as_a_limit_lets():
    # All pieces end at a bound; the last speed is their mean, which is at most a half: fifteen up, five down.
    problem = al.Problem(
        Pushed(),
        grid=al.Grid(1.0, 20),
        inputs={"u": al.Control(np.zeros(20), -1.0, 1.0, degree=0)},
        minimize=al.integral("yield").mean,
        subject_to=[al.terminal("v").within(-0.5, 0.5)],
    )
    assert al.solve(problem).objective == pytest.approx(-1.0, rel=1e-6)
