"""Limits on the worst case hold for the model, wherever its worst realisation lies and whatever its expansion says."""

import dataclasses
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, signal

import aleator as al
from aleator.certification import _worst_case
from aleator.transcription import transcribe
from aleator.transcription.sequential import EVALUATE
from tiny_models import ONE_STEP, gain_problem, oscillator_problem, sine

Y = al.terminal("y")
WIDE = al.Uniform(0.0, half_width=1.0)


def surface(rule):
    """A model whose output `y` is a rule of a gain and of the uncertain numbers `a` and `b`."""

    class Surface(al.System):
        states = ("nothing",)
        gain: Any
        a: Any
        b: Any = 0.0

        def rhs(self, t, z):
            return (0.0 * z.nothing,)

        def outputs(self, t, z):
            return {"y": jnp.asarray(rule(self.gain, self.a, self.b))}

    return Surface


def largest_gain(rule, limit, a=WIDE, b=WIDE, **options):
    """The problem of the largest gain under a limit."""
    system = surface(rule)(gain=al.Decision(0.1, 0.01, 5.0), a=a, b=b)
    defaults = {"grid": ONE_STEP, "minimize": -1.0 * al.value("gain"), "subject_to": [limit]}
    return al.Problem(system, **(defaults | options))


# The limit is met where a tanh(a) = 1.
TURN = optimize.brentq(lambda a: a * np.tanh(a) - 1, 1.0, 1.5)

CASES = {
    "a narrow peak inside": (lambda g, a, b: g * (1 + jnp.exp(-(((a - 0.37) / 0.05) ** 2)) + 0 * b), 0.5),
    "a kink": (lambda g, a, b: g * (2 - 4 * jnp.abs(a - 0.3) - jnp.abs(b + 0.6)), 0.5),
    "the inside of a face": (lambda g, a, b: g * (1 + a - 3 * jnp.abs(b - 0.23) ** 1.5), 0.5),
    "a corner": (lambda g, a, b: g * jnp.exp(a - 2 * b), np.exp(-3.0)),
    "two corners": (lambda g, a, b: g * (1 + jnp.abs(a) ** 3 + 0.1 * b), 1 / 2.1),
    "a place that moves with the design": (
        lambda g, a, b: g * 2 * a - jnp.cosh(2 * a) + 1 - (b - a) ** 2,
        np.sinh(TURN),
    ),
    "a ridge between the axes": (lambda g, a, b: g * (1 + a - 40 * (a - b - 0.4) ** 2 - 2.5 * (a - 0.4) ** 2), 2 / 3),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_the_design_is_that_of_the_true_worst_case_wherever_it_lies(case):
    rule, gain = CASES[case]
    solution = al.solve(largest_gain(rule, Y.at_most(1.0, worst_case=True)))
    assert solution.decisions["gain"] == pytest.approx(gain, rel=2e-6)
    assert al.validate(solution, 50_000, batch=5000).violations["y"].count == 0
    (worst,) = solution.certificate.worst_case.realisations
    assert worst.value == pytest.approx(1.0, rel=1e-5)
    assert rule(gain, worst.numbers["a"], worst.numbers["b"]) == pytest.approx(1.0, rel=1e-5)


def test_a_system_that_breaks_a_limit_on_the_worst_case_is_an_alarm():
    def rule(gain, a, b):
        return gain * (1 + jnp.exp(-(((a - 0.37) / 0.05) ** 2)) + 0 * b)

    solution = al.solve(largest_gain(rule, Y.at_most(1.0, worst_case=True)))
    broken = dataclasses.replace(solution, vector=1.5 * solution.vector)
    with pytest.warns(al.ExpansionWarning, match="'y'"):
        evidence = al.validate(broken, 5000)
    assert not evidence.agrees


def test_the_supremum_of_the_expansion_misses_what_the_worst_case_sees():
    rule, gain = CASES["a narrow peak inside"]
    with pytest.warns(al.ExpansionWarning):
        expanded = al.solve(largest_gain(rule, Y.supremum <= 1.0), throw=False)
    assert "Raise the order" in expanded.why()
    assert expanded.decisions["gain"] > 1.2 * gain
    with pytest.warns(al.ExpansionWarning):
        assert al.validate(expanded, 5000).violations["y"].count > 0


def test_a_lower_limit_is_held_from_below_and_both_limits_at_once():
    def rule(gain, a, b):
        return gain * (a - jnp.exp(-(((a - 0.5 * b) / 0.2) ** 2)))

    # At a = 1 the peak is far; it takes the most where the slope of a is made up for.
    def least(a):
        return a - np.exp(-(((a - 0.5 * np.clip(2 * a, -1, 1)) / 0.2) ** 2))

    low = optimize.minimize_scalar(least, bounds=(-1, 0), method="bounded", options={"xatol": 1e-12}).fun
    solution = al.solve(largest_gain(rule, Y.within(-1.0, 1.0, worst_case=True)))
    assert solution.decisions["gain"] == pytest.approx(-1.0 / low, rel=1e-6)
    assert len(solution.certificate.worst_case.realisations) == 2


def test_the_worst_of_many_variables_is_found_at_its_corner():
    class Many(al.System):
        states = ("nothing",)
        gain: Any
        parts: Any

        def rhs(self, t, z):
            return (0.0 * z.nothing,)

        def outputs(self, t, z):
            signs = jnp.array([1.0, -1.0] * 6)
            total = sum(sign * part for sign, part in zip(signs, self.parts, strict=True))
            return {"y": self.gain * (total + 0.02 * total**2)}

    system = Many(gain=al.Decision(0.01, 0.001, 5.0), parts=[al.Uniform(0.0, half_width=0.5) for _ in range(12)])
    problem = al.Problem(
        system,
        grid=ONE_STEP,
        minimize=-1.0 * al.value("gain"),
        subject_to=[Y.at_most(1.0, worst_case=True)],
        expansion=al.Expansion(order=1),
    )
    solution = al.solve(problem)
    assert solution.decisions["gain"] == pytest.approx(1 / (6 + 0.02 * 36), rel=1e-6)
    assert " and 7 more" in str(solution)


def worst_reach(damper, steps=2000):
    """The largest excursion of the oscillator over its springs and over time, on a far finer grid, by SciPy."""
    times = np.linspace(0.0, 4.0, steps + 1)
    force = np.sin(3.0 * times)
    reach = 0.0
    for k in np.linspace(8.0, 12.0, 41):
        system = signal.StateSpace([[0.0, 1.0], [-k, -damper]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
        _, x, _ = signal.lsim(system, force, times)
        reach = max(reach, np.abs(x).max())
    return reach


def test_a_limit_over_time_holds_between_instants_for_the_worst_system():
    # So few steps that the peaks lie between them.
    problem = oscillator_problem(
        subject_to=[al.path("x").within(-0.16, 0.16, worst_case=True)], grid=al.Grid(4.0, 25), minimize=al.value("c")
    )
    solution = al.solve(problem, between=10, accuracy=0.05)
    assert worst_reach(solution.decisions["c"]) == pytest.approx(0.16, rel=3e-3)
    evidence = al.validate(solution, 5000)
    assert evidence.violations["x"].count == 0
    worst = solution.certificate.worst_case.realisations[0]
    assert worst.time not in solution.instants
    assert "k = 8 " in f"{worst.sentence()} "


def test_an_infeasible_program_names_the_system_that_makes_it_so():
    problem = oscillator_problem(subject_to=[al.path("x").within(-0.01, 0.01, worst_case=True)])
    with pytest.raises(al.SolveError, match=r"'x' is violated by .* at t = .* s: .* \(with k = 8\)"):
        al.solve(problem)


def test_more_scenarios_and_other_bounds_compile_nothing():
    rule, _ = CASES["a place that moves with the design"]
    problem = largest_gain(rule, Y.at_most(1.0, worst_case=True))
    al.solve(problem)
    before = EVALUATE.compilations
    solution = al.solve(problem.with_bound("y", 0.5))
    assert solution.certificate.worst_case.rounds > 1
    assert EVALUATE.compilations == before


def test_a_solution_hands_its_scenarios_to_the_next_as_a_start():
    rule, _ = CASES["a place that moves with the design"]
    problem = largest_gain(rule, Y.at_most(1.0, worst_case=True))
    first = al.solve(problem)
    again = al.solve(problem, warm_start=first)
    assert again.certificate.worst_case.rounds == 1
    assert again.decisions["gain"] == pytest.approx(first.decisions["gain"], rel=1e-7)


def test_a_search_that_comes_to_no_end_is_said_so(monkeypatch):
    monkeypatch.setattr(_worst_case, "_MOST_ROUNDS", 1)
    rule, _ = CASES["a place that moves with the design"]
    with pytest.raises(al.SolveError, match=r"After 1 rounds y reaches .* with a = .* beyond its bound"):
        al.solve(largest_gain(rule, Y.at_most(1.0, worst_case=True)))


def test_values_without_bound_have_no_worst_case():
    problem = largest_gain(lambda g, a, b: g * a, Y.at_most(1.0, worst_case=True), a=al.Normal(0.0, 1.0), b=0.0)
    with pytest.raises(al.ProblemError, match=r"worst_case of 'y': 'a' can take values without bound.*probability"):
        al.solve(problem)


def test_the_worst_case_of_what_is_certain_is_its_value():
    problem = gain_problem()
    limit = al.terminal("response").at_most(2.0, worst_case=True)
    certain = al.deterministic(
        al.Problem(problem.system, grid=ONE_STEP, minimize=problem.objective, subject_to=[limit])
    )
    solution = al.solve(certain)
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-7)
    assert solution.certificate.worst_case is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "distribution",
    [
        al.Beta(alpha=al.Decision(2.0, 1.0, 4.0), beta=3.0, lower=-1.0, upper=1.0),
        al.Triangular(lower=-1.0, mode=al.Decision(0.2, -0.5, 0.5), upper=1.0),
        al.TruncatedNormal(al.Decision(0.2, -0.5, 0.5), 1.0, lower=-1.0, upper=1.0),
    ],
    ids=lambda distribution: type(distribution).__name__,
)
def test_a_distribution_whose_shape_is_decided_keeps_its_ends(distribution):
    limit = Y.at_most(1.0, worst_case=True)
    program = transcribe(largest_gain(lambda g, a, b: g * (2 + a), limit, a=distribution, b=0.0)).program
    # To begin with, limits are held at both ends.
    found = program.evaluate(program.start)
    assert found.constraints[:2] == pytest.approx(program.start[0] * np.array([1.0, 3.0]), rel=1e-12)
    np.testing.assert_allclose(found.jacobian[:2], [[1.0, 0.0], [3.0, 0.0]], atol=1e-12)


@pytest.mark.slow
def test_a_worst_case_of_vectors_over_time_is_that_of_each_entry():
    class Pair(al.System):
        states = ("x", "v")
        c: Any
        k: Any

        def rhs(self, t, z, force):
            return z.v, force - self.c * z.v - self.k * z.x

        def outputs(self, t, z, force):
            return {"both": jnp.stack([z.x, -z.x])}

    problem = al.Problem(
        Pair(al.Decision(0.5, 0.05, 8.0), al.Uniform(10.0, half_width=2.0)),
        grid=al.Grid(4.0, 80),
        inputs={"force": sine()},
        minimize=al.value("c"),
        subject_to=[al.path("both").at_most(0.16, worst_case=True)],
    )
    other = oscillator_problem(subject_to=[al.path("x").within(-0.16, 0.16, worst_case=True)], minimize=al.value("c"))
    assert al.solve(problem).decisions["c"] == pytest.approx(al.solve(other).decisions["c"], rel=1e-4)
