"""Why a problem is not solved: a sentence and what to do, with the solver's own words behind in parentheses."""

import re

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al


class Plane(al.AlgebraicSystem):
    """Functions of two numbers."""

    x: al.Number
    y: al.Number
    kind: str = eqx.field(static=True)

    def outputs(self):
        x, y = self.x, self.y
        found = {
            "valley": 100 * (y - x**2) ** 2 + (1 - x) ** 2,
            "slope": -x - y,
            "kink": jnp.abs(x - 0.3) + jnp.abs(y),
            "root": jnp.sqrt(x - y - 5.0),
        }
        return {"f": found[self.kind], "square": x**2 + y**2}


def plane(kind, reach=10.0, limits=()):
    system = Plane(x=al.Decision(-1.2, -reach, reach), y=al.Decision(1.0, -reach, reach), kind=kind)
    return al.Problem(system, minimize=al.output("f").mean, subject_to=limits)


SQUARE = al.output("square").mean
SOLVERS = pytest.mark.parametrize(
    "make", [al.solvers.FilterSQP, al.solvers.Ipopt, al.solvers.Slsqp, al.solvers.InteriorPoint]
)
CASES = {
    "stopped": (lambda: plane("valley"), {"max_iterations": 3}, "Allow the solver more iterations"),
    "stopped outside": (
        lambda: plane("valley", limits=[SQUARE.equals(150.0)]),
        {"max_iterations": 1},
        "Allow the solver more iterations",
    ),
    "infeasible": (lambda: plane("valley", limits=[SQUARE <= 1.0, SQUARE >= 2.0]), {}, "Relax a limit"),
    "unbounded": (lambda: plane("slope", reach=np.inf), {}, "Give all decisions bounds"),
    "kink": (lambda: plane("kink"), {}, "Make it smooth there"),
}


@pytest.mark.slow
@SOLVERS
@pytest.mark.parametrize("name", CASES)
def test_a_reason_comes_with_a_remedy_and_the_words_of_the_solver_stand_in_parentheses(name, make):
    problem, options, remedy = CASES[name]
    solution = al.solve(problem(), make(**options), throw=False)
    why = solution.why()
    assert not solution.ok
    assert remedy in why
    assert re.search(r"[^ ] \(the solver said: [a-z][^()]*\)\.$", why), why
    assert why.index(remedy) < why.index("(the solver said")
    assert ".." not in why
    assert ". ." not in why


@SOLVERS
def test_a_model_that_is_not_finite_is_told_in_whole_sentences(make):
    why = al.solve(plane("root"), make(), throw=False).why()
    assert "Look for a root" in why
    assert ".." not in why


class Unstopped(al.System):
    """A cart that is pushed without limits."""

    states = ("x", "v")
    gain: al.Number = 1.0

    def rhs(self, t, z, push):
        return z.v, self.gain * push

    def outputs(self, t, z, push):
        return {"x": z.x}


@pytest.mark.slow
@pytest.mark.parametrize("way", [al.Sequential(), al.Simultaneous()], ids=["shooting", "collocation"])
@pytest.mark.parametrize("gain", [1.0, al.Uniform(1.0, half_width=0.1)], ids=["certain", "uncertain"])
def test_an_objective_without_a_least_value_is_never_solved(way, gain):
    problem = al.Problem(
        Unstopped(gain),
        grid=al.Grid(1.0, 8),
        inputs={"push": al.Control(0.0)},
        minimize=al.terminal("x").mean,
        expansion=al.Expansion(order=2),
    )
    found = al.solve(problem, transcription=way, throw=False)
    assert not found.ok
    assert "decisions are far out on a side without a bound" in found.why()
