"""Work on all cores: the results of a plain loop, in order, and what fails does so in its turn."""

import threading
from concurrent.futures import CancelledError
from itertools import count, islice

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core import beside as cores
from aleator._core.beside import CORES, beside, dropped_on_failure, in_order, working
from aleator._core.compilation import Compiled
from zoo import Decay


@pytest.fixture(autouse=True)
def all_threads_again():
    yield
    al.threads(None)


def test_results_come_in_the_order_of_their_items_whoever_is_first():
    al.threads(2)
    waiting = [threading.Event() for _ in range(5)]
    waiting[-1].set()

    def last_first(item):
        waiting[min(item + 1, len(waiting) - 1) if item % 2 == 0 else -1].wait(10)
        waiting[item].set()
        return item**2

    assert list(in_order(last_first, range(5))) == [0, 1, 4, 9, 16]


def test_no_more_items_are_taken_than_are_worked_on():
    taken = []

    def items():
        for item in count():
            taken.append(item)
            yield item

    assert list(islice(in_order(lambda item: item, items()), 3)) == [0, 1, 2]
    assert len(taken) <= 3 + CORES


def test_what_fails_does_so_after_what_comes_before_it():
    def work(item):
        if item == 3:
            raise ValueError("three")
        return item

    found = in_order(work, range(7))
    assert list(islice(found, 3)) == [0, 1, 2]
    with pytest.raises(ValueError, match="three"):
        next(found)


def test_what_is_begun_beside_gives_its_result_and_its_error_when_asked():
    assert beside(sum, [1, 2, 3])() == 6
    with pytest.raises(ZeroDivisionError):
        beside(lambda: 1 / 0)()


def test_one_thread_does_it_all_by_itself_when_it_is_asked_for():
    al.threads(1)
    here = threading.current_thread()
    found = list(in_order(lambda item: (item, threading.current_thread() is here), range(3)))
    assert found == [(0, True), (1, True), (2, True)]
    done = []
    begun = beside(done.append, here)
    assert done == []
    begun()
    assert done == [here]


@pytest.mark.parametrize("count", [2, 3])
def test_no_more_threads_work_at_once_than_are_allowed(count):
    al.threads(count)
    at_work, most, lock, together = [0], [0], threading.Lock(), threading.Barrier(count)

    def work(item):
        with lock:
            at_work[0] += 1
            most[0] = max(most[0], at_work[0])
        together.wait(10)  # as many as are allowed are there at once, or none goes on
        with lock:
            at_work[0] -= 1
        return item

    assert list(in_order(work, range(3 * count))) == list(range(3 * count))
    assert most == [count]


def test_what_no_other_thread_has_begun_is_worked_on_by_the_caller():
    al.threads(2)
    running, released = threading.Event(), threading.Event()
    blocking = beside(lambda: (running.set(), released.wait(10)))
    assert running.wait(10)
    here = threading.current_thread()
    assert list(in_order(lambda item: threading.current_thread() is here, range(4))) == [True] * 4
    released.set()
    blocking()


@pytest.mark.parametrize("count", [0, True])
def test_threads_are_a_whole_number(count):
    with pytest.raises(al.ProblemError, match="threads: count is a whole number of at least 1"):
        al.threads(count)
    assert working() == CORES


@pytest.mark.parametrize(("said", "expected"), [(" 3 ", 3), ("", CORES)])
def test_the_environment_bounds_the_threads(monkeypatch, said, expected):
    monkeypatch.setenv(cores.VARIABLE, said)
    assert cores._wanted() == expected


@pytest.mark.parametrize("said", ["0", "two"])
def test_an_environment_that_says_no_number_of_threads_is_warned_of(monkeypatch, said):
    monkeypatch.setenv(cores.VARIABLE, said)
    with pytest.warns(al.AleatorWarning, match="ALEATOR_THREADS: expected a whole number"):
        assert cores._wanted() == CORES


def test_what_is_prepared_is_not_compiled_again():
    compiled = Compiled(lambda scale, x: scale["by"] * x)
    compiled.prepare({"by": jnp.asarray(1.0)}, jnp.zeros(3))
    np.testing.assert_array_equal(compiled({"by": jnp.asarray(2.0)}, jnp.arange(3.0)), [0.0, 2.0, 4.0])
    assert compiled.compilations == 1
    compiled({"by": jnp.asarray(2.0)}, jnp.arange(4.0))
    assert compiled.compilations == 2


RUN_BY = set()


class Watched(Decay):
    """It notes who runs its code: nobody's code need bear two threads at once."""

    def rhs(self, t, z):
        RUN_BY.add(threading.get_ident())
        return super().rhs(t, z)

    def outputs(self, t, z):
        RUN_BY.add(threading.get_ident())
        return super().outputs(t, z)


def test_the_code_of_a_model_is_run_by_the_thread_that_solves_and_no_other():
    RUN_BY.clear()
    limit, x = al.path("x").at_most(1.5, sigmas=1.0), al.terminal("x")
    model = Watched(al.Uniform(al.Decision(2.0, 1.0, 4.0), half_width=0.2))
    problem = al.Problem(model, grid=al.Grid(1.0, 20), minimize=x.mean, subject_to=[limit])
    solution = al.solve(problem)
    assert solution.ok
    assert al.validate(solution, 1000, batch=100).samples == 1000
    assert {threading.get_ident()} == RUN_BY


def test_what_waits_for_a_core_is_dropped_where_its_work_has_failed():
    al.threads(2)
    running, released, done = threading.Event(), threading.Event(), []
    blocking = [beside(lambda: (running.set(), released.wait(10)))]
    running.wait(10)
    waiting = []

    def interrupted():
        with dropped_on_failure():
            waiting.append(beside(done.append, 1))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    released.set()
    for one in blocking:
        one()
    with pytest.raises(CancelledError):
        waiting[0]()
    assert done == []
    assert beside(lambda: 2)() == 2
