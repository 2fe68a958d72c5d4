"""Limits on the worst case hold for the model, wherever its worst realisation lies and whatever its expansion says."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

import aleator as al
from aleator.solving import _stages
from aleator.transcription import transcribe
from aleator.transcription.sequential import EVALUATE
from compiling import compiled
from zoo import Decay, algebraic, cases, optimum

Y = al.output("y")
WIDE = al.Uniform(0.0, half_width=1.0)
WORST = Y.at_most(1.0, worst_case=True)

# The limit is met where a tanh(a) = 1.
TURN = optimize.brentq(lambda a: a * np.tanh(a) - 1, 1.0, 1.5)


def least(a):
    """Of the two-sided rule, whose peak is far at a = 1; it takes the most where the slope of a is made up for."""
    return a - np.exp(-(((a - 0.5 * np.clip(2 * a, -1, 1)) / 0.2) ** 2))


LOW = optimize.minimize_scalar(least, bounds=(-1, 0), method="bounded", options={"xatol": 1e-12}).fun
RULES = {
    "a narrow peak inside": (lambda g, a, b: g * (1 + jnp.exp(-(((a - 0.37) / 0.05) ** 2)) + 0 * b), 0.5),
    "a place that moves with the design": (
        lambda g, a, b: g * 2 * a - jnp.cosh(2 * a) + 1 - (b - a) ** 2,
        np.sinh(TURN),
    ),
    "a ridge between the axes": (lambda g, a, b: g * (1 + a - 40 * (a - b - 0.4) ** 2 - 2.5 * (a - 0.4) ** 2), 2 / 3),
    "two sides": (lambda g, a, b: g * (a - jnp.exp(-(((a - 0.5 * b) / 0.2) ** 2))), -1.0 / LOW),
    "a line": (lambda g, a, b: g * (2 + a), 1 / 3),
    "a square": (lambda g, a, b: g * a**2, 1.0),
}


@algebraic
def surface(gain, a, b, weights):
    """An output that is a rule of a gain and of two uncertain numbers: which rule, is data."""
    rules = (rule(gain, a, b) for rule, _ in RULES.values())
    return {"y": sum(weight * one for weight, one in zip(weights, rules, strict=True))}


def largest_gain(name, limit=WORST, a: Any = WIDE, b: Any = WIDE):
    """The problem of the largest gain under a limit."""
    system = surface(al.Decision(0.1, 0.01, 5.0), a, b, [float(name == one) for one in RULES])
    return al.Problem(system, minimize=-1.0 * al.value("gain"), subject_to=[limit])


@compiled
def each_rule(gain, a, b):
    return {name: rule(gain, a, b) for name, (rule, _) in RULES.items()}


@pytest.mark.parametrize("name", [name for name in RULES if name not in ("two sides", "a line", "a square")])
def test_the_design_is_that_of_the_true_worst_case_wherever_it_lies(name):
    _, gain = RULES[name]
    solution = al.solve(largest_gain(name))
    assert solution.decisions["gain"] == pytest.approx(gain, rel=2e-6)
    (worst,) = solution.certificate.worst_case.realisations
    assert worst.value == pytest.approx(1.0, rel=1e-5)
    assert each_rule(gain, worst.numbers["a"], worst.numbers["b"])[name] == pytest.approx(1.0, rel=1e-5)


def test_a_system_that_breaks_a_limit_on_the_worst_case_is_an_alarm():
    peaked = al.solve(largest_gain("a narrow peak inside"))
    assert al.validate(peaked, 5000).violations["y"].count == 0
    broken = dataclasses.replace(peaked, vector=1.5 * peaked.vector)
    with pytest.warns(al.ExpansionWarning, match="'y'"):
        assert not al.validate(broken, 5000).agrees


def test_the_zone_of_a_tolerance_ends_where_its_normal_distribution_goes_on():
    part = al.Toleranced(0.5, tolerance=0.3)
    solution = al.solve(largest_gain("a square", a=part, b=0.0))
    assert solution.decisions["gain"] == pytest.approx(1 / 0.8**2, rel=1e-6)


def test_a_lower_limit_is_held_from_below_and_both_limits_at_once():
    solution = al.solve(largest_gain("two sides", Y.within(-1.0, 1.0, worst_case=True)))
    assert solution.decisions["gain"] == pytest.approx(-1.0 / LOW, rel=1e-6)
    assert len(solution.certificate.worst_case.realisations) == 2


def test_other_bounds_compile_nothing_and_a_solution_hands_its_scenarios_to_the_next():
    problem = largest_gain("a place that moves with the design")
    first = al.solve(problem)
    before = EVALUATE.compilations
    assert al.solve(problem.with_bound("y", 0.5)).certificate.worst_case.rounds > 1
    assert EVALUATE.compilations == before
    again = al.solve(problem, warm_start=first)
    assert again.certificate.worst_case.rounds == 1
    assert again.decisions["gain"] == pytest.approx(first.decisions["gain"], rel=1e-7)


def test_a_search_that_comes_to_no_end_is_said_so(monkeypatch):
    monkeypatch.setattr(_stages, "_MOST_SCENARIOS", 1)
    with pytest.raises(al.SolveError, match=r"After 1 rounds y reaches .* with a = .* beyond its bound"):
        al.solve(largest_gain("a place that moves with the design"))


def test_values_without_bound_have_no_worst_case_and_what_is_certain_is_its_own():
    with pytest.raises(al.ProblemError, match=r"worst_case of 'y': 'a' can take values without bound.*probability"):
        al.solve(largest_gain("a line", a=al.Normal(0.0, 1.0)))
    both = al.correlated({name: al.Uniform.bounds(-1.0, 1.0) for name in ("a", "b")}, {("a", "b"): 0.5})
    with pytest.raises(al.ProblemError, match=r"worst_case of 'y': 'a', 'b' are correlated.*without correlations"):
        al.solve(largest_gain("a line", **both))
    solution = al.solve(largest_gain("a line", a=1.0, b=0.0))
    assert solution.decisions["gain"] == pytest.approx(1 / 3, rel=1e-7)
    assert solution.certificate.worst_case is None


# --- Over time -------------------------------------------------------------------------------------------------------


class Waves(al.System):
    """A level with waves on it, whose crests lie between the instants of ten steps."""

    states = ("nothing",)
    level: al.Number
    depth: al.Number

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        return {"i": self.level * (1.0 + self.depth * jnp.sin(2 * jnp.pi * t))}


def test_a_limit_over_time_holds_between_instants_for_the_worst_system():
    problem = al.Problem(
        Waves(al.Decision(1.0, 0.1, 10.0), al.Uniform(0.5, half_width=0.05)),
        grid=al.Grid(1.0, 10),
        minimize=-1.0 * al.value("level"),
        subject_to=[al.path("i").within(-2.0, 2.0, worst_case=True)],
    )
    solution = al.solve(problem, between=20)
    assert solution.decisions["level"] == pytest.approx(2.0 / 1.55, rel=1e-3)
    worst = solution.certificate.worst_case.realisations[0]
    assert worst.time not in solution.instants
    assert worst.time == pytest.approx(0.25, abs=0.01)
    assert worst.numbers["depth"] == pytest.approx(0.55)
    with pytest.raises(al.SolveError, match=r"'i' is violated by .* at t = .* s: .* \(with depth = 0.55\)"):
        al.solve(problem.with_bound("i", 0.01))


# --- At collocation points alone, for distributions without bounds too -----------------------------------------------


AT_POINTS = Y.at_most(3.0, at_points=True)


def test_a_limit_at_the_points_of_an_unbounded_distribution_is_active_at_the_worst_of_them():
    problem = largest_gain("a square", AT_POINTS, a=al.Normal(1.0, 0.5), b=0.0)
    solution = al.solve(problem)
    points = np.asarray(transcribe(problem).collocation.points)
    assert solution.decisions["gain"] == pytest.approx(3.0 / ((1.0 + 0.5 * points) ** 2).max(), rel=1e-7)
    (constraint,) = solution.constraints
    assert constraint.values == pytest.approx(3.0, rel=1e-7)
    assert constraint.active
    # Systems between the points may break it, and are counted.
    assert 0 < al.validate(solution, 20_000).violations["y"].estimate < 0.05


@pytest.mark.parametrize("way", cases([al.Sequential(), al.Simultaneous()]))
def test_limits_over_time_hold_at_each_point(way):
    problem = al.Problem(
        Decay(al.Normal(1.0, 0.1), start=al.Decision(1.0, 0.1, 9.0)),
        grid=al.Grid(1.0, 20),
        minimize=al.value("start"),
        subject_to=[al.path("x").at_least(0.5, at_points=True)],
    )
    found = optimum(problem, transcription=way)
    points = np.asarray(found.transcribed.collocation.points)
    assert found.decisions["start"] == pytest.approx(0.5 * np.exp(1.0 + 0.1 * points.max()), rel=1e-5)
