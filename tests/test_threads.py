"""Several threads at once give what one gives, and compile once what they share."""

import sys
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core.compilation import Compiled
from aleator._core.programs import Programs
from aleator.transcription.sequential import EVALUATE
from zoo import SPREAD, bar_problem, gain_problem


@pytest.fixture
def threads():
    """Threads that take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    with ThreadPoolExecutor(6) as pool:
        yield pool
    sys.setswitchinterval(before)


@pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=lambda one: type(one).__name__
)
def test_one_problem_in_many_threads_is_compiled_once_and_solved_alike(threads, solver):
    problem = gain_problem()
    before = EVALUATE.compilations
    solutions = list(threads.map(lambda _: al.solve(problem, solver), range(6)))
    assert EVALUATE.compilations <= before + 1
    alone = al.solve(problem, solver)
    for one in solutions:
        np.testing.assert_array_equal(one.vector, alone.vector)
        assert one.objective == alone.objective
        assert one.decisions["gain"] == pytest.approx(2.0 / (1.0 + SPREAD), rel=1e-6)


def test_problems_starts_and_evidence_of_many_threads_do_not_get_mixed_up(threads):
    bounds = np.linspace(1.0, 3.0, 6)
    gains = list(threads.map(lambda bound: al.solve(gain_problem(bound)).decisions["gain"], bounds))
    np.testing.assert_allclose(gains, bounds / (1.0 + SPREAD), rtol=1e-6)
    starts = np.linspace(0.5, 9.0, 6)
    solutions = list(threads.map(lambda start: al.solve(gain_problem(), start={"gain": start}), starts))
    np.testing.assert_allclose([one.decisions["gain"] for one in solutions], 2.0 / (1.0 + SPREAD), rtol=1e-6)
    evidence = list(threads.map(lambda seed: al.validate(solutions[0], 500, seed=seed), [0, 1] * 2))
    means = [float(one.functionals["response(t_f)"].mean) for one in evidence]
    assert means[0] != means[1]
    assert means == means[:2] * 2


@pytest.mark.slow
def test_structures_of_many_threads_do_not_get_mixed_up(threads):
    def width(order):
        return al.solve(bar_problem(expansion=al.Expansion(order=order))).decisions["width"]

    np.testing.assert_allclose(list(threads.map(width, range(1, 7))), (1.0 + 3.0 * SPREAD) / 0.5, rtol=1e-6)


def test_expansions_in_many_threads_are_those_of_one(threads):
    distributions = {"u": al.Normal(1.5, 0.2)}
    means = list(threads.map(lambda power: al.expand(lambda at: at["u"] ** power, distributions).mean, [1, 2, 3] * 4))
    exact = [1.5, 1.5**2 + 0.04, 1.5**3 + 3 * 1.5 * 0.04]
    np.testing.assert_allclose(np.array(means), exact * 4, rtol=1e-12)


def test_what_one_thread_compiles_the_others_wait_for(threads):
    traces = []

    def function(x):
        traces.append(1)
        return jnp.sin(x)

    compiled = Compiled(function)
    values = list(threads.map(lambda _: float(compiled(jnp.asarray(0.5))), range(12)))
    assert values == [float(np.sin(0.5))] * 12
    assert compiled.compilations == len(traces) == 1


def test_what_fails_to_compile_fails_in_every_thread_and_is_tried_again(threads):
    fails = True

    def function(x):
        if fails:
            raise ValueError("not yet")
        return x

    compiled = Compiled(function)
    tasks = [threads.submit(compiled, jnp.asarray(1.0)) for _ in range(6)]
    assert all(isinstance(task.exception(), ValueError) for task in tasks)
    fails = False
    assert float(compiled(jnp.asarray(1.0))) == 1.0


def test_only_so_many_programs_are_kept():
    kept = Programs(most=2)
    for key in "abac":
        kept.found(key)
    assert [key in kept for key in "abc"] == [True, False, True]
