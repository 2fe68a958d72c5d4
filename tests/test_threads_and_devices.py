"""Work on all cores, by threads and on devices: the results of a plain loop, in order, and what fails in its turn."""

import json
import os
import re
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from itertools import count, islice
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import aleator as al
from aleator._core.compilation import Compiled
from aleator._core.parallel import (
    CORES,
    beside,
    dropped_on_failure,
    here,
    in_order,
    one_thread_of_blas,
    over_devices,
)
from aleator.transcription.sequential import EVALUATE
from zoo import MASS, SPREAD, Bar, bar_problem


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


def test_matrices_are_multiplied_by_one_thread_until_the_last_solve_that_overlaps_with_others_is_over():
    def threads_of_blas():
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    with threadpool_limits(2, "blas"):
        first, last = ExitStack(), ExitStack()
        first.enter_context(one_thread_of_blas())
        last.enter_context(one_thread_of_blas())
        first.close()
        assert threads_of_blas() == {1}
        last.close()
        assert threads_of_blas() == {2}


def test_the_code_of_a_model_is_run_by_the_thread_that_solves_and_no_other():
    RUN_BY.clear()
    bar = bar_problem()
    watched = Watched(bar.system.width, bar.system.load)
    solution = al.solve(al.Problem(watched, minimize=MASS.mean, subject_to=bar.constraints))
    assert solution.ok
    assert al.validate(solution, 1000, batch=100).samples == 1000
    assert {threading.get_ident()} == RUN_BY


# --- Several threads at once give what one gives, and compile once what they share ------------------------------------


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


@pytest.mark.parametrize("solver", [al.solvers.FilterSQP(), al.solvers.Ipopt()], ids=lambda one: type(one).__name__)
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


# --- Parts of a computation on several devices give what one device gives; where JAX sees a GPU, so does that ---------


SCRIPT = Path(__file__).with_name("answers_on_devices.py")
SEVERAL = 4


def ran(*arguments, flags="", platforms="cpu"):
    """What the script tells in a process of its own."""
    others = re.sub(r"--xla_force_host_platform_device_count=\d+", "", os.environ.get("XLA_FLAGS", ""))
    environment = os.environ | {"XLA_FLAGS": f"{others} {flags}".strip(), "JAX_PLATFORMS": platforms}
    finished = subprocess.run(
        [sys.executable, str(SCRIPT), *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert finished.returncode == 0, finished.stderr
    return json.loads(finished.stdout)


@pytest.fixture(scope="module")
def on_one():
    return ran()


@pytest.mark.slow
def test_several_devices_give_the_digits_of_one_and_compute_parts_in_turn(on_one):
    on_several, last = ran("placed", flags=f"--xla_force_host_platform_device_count={SEVERAL}"), SEVERAL - 1
    assert [on_one["devices"], on_several["devices"]] == [1, SEVERAL]
    assert on_one["answers"]["ok"]
    assert on_several["answers"] == on_one["answers"]
    assert on_one["turns"] == [[0, 0]] * 6
    assert on_several["turns"] == [[item % SEVERAL, item % SEVERAL] for item in range(6)]
    # What JAX or a user has placed stays there.
    assert on_several["told"] == [last, [[last, last]] * 6]
    assert on_several["placed"] == on_several["answers"]["decisions"]
    # Each device compiles what it runs: two parts of the collocation points, on two of the devices; eleven batches of
    # systems, on all.
    assert [on_one["parts"], on_one["batches"]] == [1, 1]
    assert [on_several["parts"], on_several["batches"]] == [2, SEVERAL]


def test_parts_come_in_their_order_and_a_failure_in_its_turn():
    assert list(over_devices(lambda item: item * item, range(20))) == [item * item for item in range(20)]
    results = over_devices(lambda item: 1 // (3 - item), range(6))
    assert [next(results) for _ in range(3)] == [0, 0, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)
    first, told = jax.local_devices()[0], []
    with jax.default_device(first):
        assert list(over_devices(lambda item: told.append((item, here().id)) or item, range(3))) == [0, 1, 2]
    assert {place for _, place in told} == {first.id}


def gpus():
    """How many GPUs JAX sees; none where it has been told of CPUs alone."""
    try:
        return len(jax.local_devices(backend="gpu"))
    except RuntimeError:
        return 0


@pytest.mark.slow
@pytest.mark.skipif(not gpus(), reason="JAX sees no GPU on this machine")
def test_a_gpu_gives_the_answers_of_the_processor(on_one):
    found = ran(platforms="")
    assert found["answers"]["ok"]
    # Sums in another order and other elementary functions: the last digits differ, and with them, at an optimum, the
    # decisions by the square root of what the solver's tolerance leaves open.
    for name, tolerance in (("decisions", 1e-5), ("objective", 1e-9), ("sampled", 1e-5), ("expanded", 1e-12)):
        one, other = (np.array([float.fromhex(bit) for bit in told["answers"][name]]) for told in (found, on_one))
        np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance)
