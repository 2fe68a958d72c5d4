"""Work on all cores: the results of a plain loop, in order, and what fails does so in its turn."""

import threading
from itertools import count, islice

import pytest

import aleator as al
from aleator._core.parallel import CORES, beside, dropped_on_failure, in_order
from zoo import MASS, Bar, bar_problem


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


def test_what_fails_does_so_after_what_comes_before_it_and_no_more_is_taken_than_is_worked_on():
    taken = []

    def items():
        for item in count():
            taken.append(item)
            yield item

    def work(item):
        if item == 3:
            raise ValueError("three")
        return item

    found = in_order(work, items())
    assert list(islice(found, 3)) == [0, 1, 2]
    assert len(taken) <= 3 + CORES
    with pytest.raises(ValueError, match="three"):
        next(found)


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


def test_what_waits_for_a_thread_is_worked_on_by_the_caller_and_by_no_other_once_work_has_failed():
    al.threads(2)
    running, released, done, waiting = threading.Event(), threading.Event(), [], []
    blocking = beside(lambda: (running.set(), released.wait(10)))
    assert running.wait(10)
    here = threading.current_thread()
    assert list(in_order(lambda item: threading.current_thread() is here, range(4))) == [True] * 4

    def interrupted():
        with dropped_on_failure():
            waiting.append(beside(done.append, 1))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    released.set()
    blocking()
    assert done == []
    waiting[0]()
    assert done == [1]
    assert beside(lambda: 2)() == 2
    with pytest.raises(ZeroDivisionError):
        beside(lambda: 1 / 0)()


RUN_BY = set()


class Watched(Bar):
    """It notes who runs its code: nobody's code need bear two threads at once."""

    def outputs(self):
        RUN_BY.add(threading.get_ident())
        return super().outputs()


def test_the_code_of_a_model_is_run_by_the_thread_that_solves_and_no_other():
    RUN_BY.clear()
    bar = bar_problem()
    watched = Watched(bar.system.width, bar.system.load)
    solution = al.solve(al.Problem(watched, minimize=MASS.mean, subject_to=bar.constraints))
    assert solution.ok
    assert al.validate(solution, 1000, batch=100).samples == 1000
    assert {threading.get_ident()} == RUN_BY
