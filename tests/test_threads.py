"""Several threads at once give what one gives, and compile once what they share."""

import sys
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core.compilation import Compiled
from aleator.transcription.sequential import EVALUATE
from zoo import SPREAD, bar_problem


@pytest.fixture
def threads():
    """Threads that take turns as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    with ThreadPoolExecutor(6) as pool:
        yield pool
    sys.setswitchinterval(before)


def width(load=1.0):
    return (load + 3.0 * SPREAD) / 0.5


@pytest.mark.parametrize(
    "solver", [al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()], ids=lambda one: type(one).__name__
)
def test_one_problem_in_many_threads_is_compiled_once_and_solved_alike(threads, solver):
    problem = bar_problem()
    before = EVALUATE.compilations
    solutions = list(threads.map(lambda _: al.solve(problem, solver), range(6)))
    assert EVALUATE.compilations <= before + 1
    alone = al.solve(problem, solver)
    for one in solutions:
        np.testing.assert_array_equal(one.vector, alone.vector)
        assert one.objective == alone.objective
        assert one.decisions["width"] == pytest.approx(width(), rel=1e-6)


def test_problems_starts_structures_and_evidence_of_many_threads_do_not_get_mixed_up(threads):
    loads = np.linspace(0.9, 1.4, 6)
    widths = list(threads.map(lambda load: al.solve(bar_problem(load)).decisions["width"], loads))
    np.testing.assert_allclose(widths, width(loads), rtol=1e-6)
    starts = np.linspace(0.5, 9.0, 6)
    solutions = list(threads.map(lambda start: al.solve(bar_problem(), start={"width": start}), starts))
    np.testing.assert_allclose([one.decisions["width"] for one in solutions], width(), rtol=1e-6)
    evidence = list(threads.map(lambda seed: al.validate(solutions[0], 500, seed=seed), [0, 1] * 2))
    means = [float(one.functionals["stress"].mean) for one in evidence]
    assert means[0] != means[1]
    assert means == means[:2] * 2
    distributions = {"u": al.Normal(1.5, 0.2)}
    expanded = threads.map(lambda power: al.expand(lambda at: at["u"] ** power, distributions).mean, [1, 2, 3] * 4)
    exact = [1.5, 1.5**2 + 0.04, 1.5**3 + 3 * 1.5 * 0.04]
    np.testing.assert_allclose(np.array(list(expanded)), exact * 4, rtol=1e-12)


def test_what_one_thread_compiles_the_others_wait_for_and_what_fails_is_tried_again(threads):
    traces, fails = [], True

    def function(x):
        traces.append(1)
        if fails:
            raise ValueError("not yet")
        return jnp.sin(x)

    compiled = Compiled(function)
    tasks = [threads.submit(compiled, np.asarray(0.5)) for _ in range(6)]
    assert all(isinstance(task.exception(), ValueError) for task in tasks)
    fails = False
    traces.clear()
    values = list(threads.map(lambda _: float(compiled(np.asarray(0.5))), range(12)))
    assert values == [float(np.sin(0.5))] * 12
    assert compiled.compilations == len(traces) == 1
