"""Several threads at once give what one gives, and compile once what they share."""

import sys
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core.compilation import Compiled
from aleator.transcription.sequential import EVALUATE


class Gap(al.System):
    """`x' = (a - goal)² - x / 10`: least where `a` meets the goal."""

    states = ("x",)
    a: al.Number
    goal: al.Number

    def rhs(self, t, z):
        return ((self.a - self.goal) ** 2 - 0.1 * z.x,)

    def outputs(self, t, z):
        return {"x": z.x}


def gap(goal, steps=20):
    return al.Problem(
        Gap(al.Uniform(al.Decision(0.0, -9.0, 9.0), half_width=0.1), goal),
        grid=al.Grid(1.0, steps),
        minimize=al.terminal("x").mean,
        subject_to=[al.terminal("x").at_most(5.0, sigmas=1.0)],
    )


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
    one = gap(2.0, steps=21)
    before = EVALUATE.compilations
    solutions = list(threads.map(lambda _: al.solve(one, solver), range(12)))
    assert EVALUATE.compilations <= before + 1
    alone = al.solve(one, solver)
    for found in solutions:
        np.testing.assert_array_equal(found.vector, alone.vector)
        assert found.objective == alone.objective
        assert found.decisions["a.mean"] == pytest.approx(2.0, abs=1e-5)


@pytest.mark.slow
def test_problems_of_their_own_in_many_threads_do_not_get_mixed_up(threads):
    goals = np.linspace(-3.0, 3.0, 12)
    found = list(threads.map(lambda goal: al.solve(gap(goal)).decisions["a.mean"], goals))
    np.testing.assert_allclose(found, goals, atol=1e-5)
    structures = list(threads.map(lambda steps: al.solve(gap(1.0, steps)).decisions["a.mean"], [2, 3, 4, 5, 6, 7]))
    np.testing.assert_allclose(structures, 1.0, atol=1e-5)


def test_starts_and_evidence_in_many_threads_are_those_of_one(threads):
    one = gap(2.0)
    starts = [{"a.mean": start} for start in np.linspace(-8.0, 8.0, 12)]
    solutions = list(threads.map(lambda start: al.solve(one, start=start), starts))
    np.testing.assert_allclose([found.decisions["a.mean"] for found in solutions], 2.0, atol=1e-5)
    evidence = list(threads.map(lambda seed: al.validate(solutions[0], 500, seed=seed), [0, 1] * 4))
    means = [float(found.functionals["x(t_f)"].mean) for found in evidence]
    assert means[0] != means[1]
    assert means == means[:2] * 4


def test_expansions_in_many_threads_are_those_of_one(threads):
    distributions = {"u": al.Normal(1.5, 0.2)}
    found = list(threads.map(lambda power: al.expand(lambda at: at["u"] ** power, distributions).mean, [1, 2, 3] * 4))
    exact = [1.5, 1.5**2 + 0.04, 1.5**3 + 3 * 1.5 * 0.04]
    np.testing.assert_allclose(np.array(found), exact * 4, rtol=1e-12)


def test_what_one_thread_compiles_the_others_wait_for(threads):
    traces = []

    def function(x):
        traces.append(1)
        return jnp.sin(x)

    compiled = Compiled(function)
    found = list(threads.map(lambda _: float(compiled(jnp.asarray(0.5))), range(12)))
    assert found == [float(np.sin(0.5))] * 12
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
