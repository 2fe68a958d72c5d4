"""Searches without derivatives find known optima, keep to their budget, and lose nothing when they are stopped."""

import signal
from dataclasses import replace

import numpy as np
import pytest
from nlp_problems import evaluation, hs71, program, rosenbrock

import aleator as al

EVERY = [
    al.solvers.NelderMead(),
    al.solvers.Direct(),
    al.solvers.DifferentialEvolution(),
    al.solvers.DualAnnealing(),
    al.solvers.CmaEs(),
]
SHORT = [al.solvers.NelderMead(evaluations=300), al.solvers.DifferentialEvolution(evaluations=600)]


def named(solver):
    return type(solver).__name__


def six_hump_camel():
    """Two global minima of -1.0316284534898774, and four others (Dixon and Szegő 1978)."""

    def evaluate(x):
        a, b = x
        value = (4 - 2.1 * a**2 + a**4 / 3) * a**2 + a * b + (-4 + 4 * b**2) * b**2
        return evaluation(value, [8 * a - 8.4 * a**3 + 2 * a**5 + b, a - 8 * b + 16 * b**3])

    return program(evaluate, [1.6, 0.6], [-3.0, -2.0], [3.0, 2.0]), -1.0316284534898774


def rastrigin():
    """A minimum of zero in the origin among a thousand others."""

    def evaluate(x):
        wave = 2 * np.pi * x
        return evaluation(float((10 + x**2 - 10 * np.cos(wave)).sum()), 2 * x + 20 * np.pi * np.sin(wave))

    return program(evaluate, [3.1, -4.2, 2.3], [-5.12] * 3, [5.12] * 3), 0.0


def within(one, lower, upper):
    return replace(one, lower=np.full(one.start.shape, lower), upper=np.full(one.start.shape, upper))


@pytest.mark.parametrize(
    ("solver", "case"),
    [
        (al.solvers.Direct(), six_hump_camel),
        (al.solvers.DifferentialEvolution(), six_hump_camel),
        (al.solvers.DualAnnealing(), rastrigin),
        (al.solvers.CmaEs(), rastrigin),
    ],
    ids=lambda one: getattr(one, "__name__", type(one).__name__),
)
def test_the_global_minimum_is_found_from_a_start_that_leads_elsewhere(solver, case):
    one, least = case()
    found = solver.solve(one)
    assert found.ok
    assert found.evaluation.objective == pytest.approx(least, abs=1e-4)
    local = al.solvers.FilterSQP().solve(one)
    assert local.evaluation.objective > least + 1e-3


@pytest.mark.parametrize("solver", EVERY, ids=named)
def test_equalities_and_limits_hold_at_the_polished_answer(solver):
    found = solver.solve(hs71())
    assert found.ok
    # Hock and Schittkowski 1981, problem 71.
    assert found.evaluation.objective == pytest.approx(17.0140173, rel=1e-7)
    assert found.evaluation.constraints[1] == pytest.approx(40.0, rel=1e-6)


def test_a_simplex_needs_no_bounds():
    found = al.solvers.NelderMead().solve(rosenbrock())
    np.testing.assert_allclose(found.point, [1.0, 1.0], atol=1e-5)


@pytest.mark.parametrize("solver", [al.solvers.DifferentialEvolution, al.solvers.CmaEs, al.solvers.DualAnnealing])
def test_a_seed_gives_the_same_search_again(solver):
    one, _ = rastrigin()
    first, again, other = (solver(seed=seed, evaluations=100).solve(one) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.searched.objectives, again.searched.objectives)
    assert not np.array_equal(first.searched.objectives, other.searched.objectives)


@pytest.mark.parametrize("solver", EVERY, ids=named)
def test_no_more_points_than_the_budget_are_evaluated(solver):
    asked, evaluations = [], 77
    one, _ = rastrigin()

    def values(points):
        asked.append(len(points))
        found = [one.evaluate(x) for x in points]
        return np.array([e.objective for e in found]), np.zeros((len(points), 0))

    found = replace(solver, evaluations=evaluations).solve(replace(one, values=values))
    assert sum(asked) == found.searched.evaluations <= evaluations
    assert found.evaluations > found.searched.evaluations


@pytest.mark.parametrize("solver", EVERY, ids=named)
@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_ends_the_search_and_the_best_point_is_polished(solver):
    one, _ = rastrigin()
    calls = []

    def evaluate(x):
        calls.append(x)
        if len(calls) == 60:
            signal.raise_signal(signal.SIGINT)
        return one.evaluate(x)

    found = solver.solve(replace(one, evaluate=evaluate))
    assert found.searched.end == "stopped by the user"
    assert found.searched.evaluations < 100
    assert found.ok
    assert found.evaluation.objective <= np.nanmin(found.searched.objectives)


def test_a_model_that_is_finite_nowhere_is_no_answer():
    one = program(lambda x: evaluation(np.nan, [np.nan]), [0.5], [0.0], [1.0])
    found = al.solvers.DifferentialEvolution(evaluations=100).solve(one)
    assert found.status is al.Status.EVALUATION_FAILED


@pytest.mark.parametrize("solver", SHORT, ids=named)
@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_while_the_best_point_is_polished_keeps_it(solver):
    one = within(rosenbrock(), -2.0, 2.0)
    polished = []

    def values(points):
        found = [one.evaluate(each) for each in points]
        return np.array([each.objective for each in found]), np.zeros((len(points), 0))

    def evaluate(x):
        polished.append(x)
        if len(polished) == 2:
            signal.raise_signal(signal.SIGINT)
        return one.evaluate(x)

    before = signal.getsignal(signal.SIGINT)
    found = replace(solver, evaluations=60).solve(replace(one, evaluate=evaluate, values=values))
    assert found.status is al.Status.INTERRUPTED
    assert found.evaluation.objective <= np.nanmin(found.searched.objectives) * (1 + 1e-9)
    assert found.searched.end.endswith("polishing was stopped by the user")
    assert found.searched.evaluations == 60
    assert signal.getsignal(signal.SIGINT) is before
