"""Work by executors: the same results as anywhere, in whatever order it ends, whatever becomes of a worker."""

import sys
import threading
import warnings
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from aleator._core.executors import each_done, each_of, packed
from executors import AsProcesses, Inline, Lost, scattered
from zoo import MASS, SPREAD, STRESS, bar_problem, valleys_problem

VALUES = [0.5, 0.4, 0.6, -1.0]
NEEDED = 1.0 + 3.0 * SPREAD
SEARCH = al.solvers.DifferentialEvolution(evaluations=60, population=20)


@pytest.fixture
def threads():
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.fixture
def travelling():
    with AsProcesses(2) as executor:
        yield executor


# --- Plain functions -------------------------------------------------------------------------------------------------


def squares(items, offset):
    return [one**2 + offset for one in items]


def square(x):
    """Warns of two, and refuses three."""
    if x == 2:
        warnings.warn("rough", al.GridWarning, stacklevel=1)
    if x == 3:
        raise al.ProblemError("three is refused")
    return x**2


def square_each(items):
    return [square(one) for one in items]


def done(executor: Executor, count: int = 2) -> dict[int, int]:
    calls = {x: {"x": float(x)} for x in range(count)}
    return dict(each_done(executor, square, calls, [f"at x = {x}" for x in range(count)]))


class Backwards(ThreadPoolExecutor):
    """An executor of this process whose work ends in the reverse order, once all of it has been sent."""

    def __init__(self, count: int):
        super().__init__(1)
        self._count, self._sent = count, []

    def submit(self, fn, /, *args, **kwargs) -> Future:
        self._sent.append((Future(), fn, args))
        if len(self._sent) == self._count:
            threading.Thread(target=self._end).start()
        return self._sent[-1][0]

    def _end(self) -> None:
        for future, fn, args in reversed(self._sent):
            future.set_result(fn(*args))


def test_results_are_those_of_their_items_in_order_though_the_last_ends_first():
    items = list(range(20))
    with Backwards(len(items)) as executor:
        found = list(each_of(executor, squares, items, {"offset": 3}, "a test"))
    assert found == [(one, one**2 + 3) for one in items]


def test_warnings_and_refusals_of_workers_are_told_with_their_place(travelling: Executor):
    with pytest.warns(al.GridWarning, match=r"^at x = 2: rough$"):
        found = done(travelling, 4)
    assert (found.pop(3).args, found) == (("three is refused",), {0: 0, 1: 1, 2: 4})
    with pytest.raises(al.ProblemError, match="three is refused"):
        list(each_of(travelling, square_each, [1, 3], {}, "a test"))


UNBELIEVED = {
    "other work": (lambda results: results[0], "at x = 1: the executor gave the result of other work"),
    "nonsense": (lambda results: b"nonsense", "at x = .: expected what a worker has found; received b'nonsense'"),
}


@pytest.mark.parametrize("what", UNBELIEVED)
def test_what_is_no_result_of_the_work_that_was_sent_is_never_believed(what):
    given, said = UNBELIEVED[what]
    with pytest.raises(al.SimulationError, match=said):
        done(Inline(given))


def test_lost_workers_are_told_and_ctrl_c_in_one_is_ctrl_c():
    with pytest.raises(al.SimulationError, match=r"at x = .: its worker died .*gone\). Finished results are kept"):
        done(Lost(1, OSError("gone")))
    with pytest.raises(KeyboardInterrupt):
        done(Lost(1, KeyboardInterrupt()))
    with al.workers(2) as executor:
        pass
    with pytest.raises(al.SimulationError, match=r"at x = 0: .*the workers have been shut down"):
        done(executor)


def test_processes_are_refused_what_they_would_not_have_and_threads_take_it(travelling, threads, monkeypatch):
    local = lambda x: x  # noqa: E731 -- has no name that a pickle could tell
    with pytest.raises(al.ProblemError, match="Write its classes and functions in a module"):
        packed(travelling, local, {})
    assert packed(threads, local, {}).opened()[0] is local
    monkeypatch.setattr(squares, "__module__", "__main__")
    monkeypatch.setattr(sys.modules["__main__"], "squares", squares, raising=False)
    with pytest.raises(al.ProblemError, match="Move them into a module"):
        packed(travelling, squares, {})


# --- Each verb -------------------------------------------------------------------------------------------------------


def test_a_front_by_an_executor_and_its_evidence_are_those_of_here(tmp_path: Path, travelling: Executor, monkeypatch):
    with al.journal(tmp_path):
        front = al.pareto(bar_problem(), "stress", VALUES, executor=travelling)
    assert front.values.tolist() == VALUES
    np.testing.assert_allclose(front.objectives[:3], NEEDED / np.array(VALUES[:3]), rtol=1e-6)
    assert front.points[3].status is al.Status.INFEASIBLE
    assert all(point.problem.with_bound("stress", 0.5) == bar_problem() for point in front.points)
    here = al.pareto(bar_problem(), "stress", VALUES)
    assert here.objectives.tobytes() == front.objectives.tobytes()
    assert here.shadow_prices.tobytes() == front.shadow_prices.tobytes()
    designs = front.solutions[:2]
    counted = [al.validate_all(designs, 1000, executor=executor) for executor in (None, travelling)]
    assert str(counted[0]) == str(counted[1])
    assert all(one.solution is point for one, point in zip(counted[1].evidence, designs, strict=True))
    # What a journal has begins no worker.
    executor = al.workers(3)
    monkeypatch.setattr(executor, "submit", lambda *_: pytest.fail("nothing is left to do"))
    with al.journal(tmp_path):
        again = al.pareto(bar_problem(), "stress", VALUES, executor=executor)
    assert again.objectives.tobytes() == front.objectives.tobytes()


@pytest.mark.parametrize(("method", "traced"), [("monte_carlo", True), ("quasi_monte_carlo", False)])
def test_samples_by_an_executor_are_those_of_this_process_to_the_last_bit(travelling: Executor, method, traced: bool):
    model = {"off": al.Uniform(0.0, half_width=1.0), "more": al.Normal(2.0, 0.1)}
    sample, how = getattr(al.references, method), {"batch": 64, "traced": traced}
    here, there = (sample(scattered, model, 256, executor=executor, **how) for executor in (None, travelling))
    assert here.values.keys() == there.values.keys() == {"sum", "row"}
    for name, values in here.values.items():
        assert values.tobytes() == there.values[name].tobytes()
    assert here["sum"].mean.value == pytest.approx(2.0, abs=0.2)


# --- Generations of a search -----------------------------------------------------------------------------------------


@pytest.fixture
def sent(travelling: Executor, monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """What the executor was given, in order."""
    given, submit = [], travelling.submit

    def noted(work, pack):
        given.append(pack.opened()[1])
        return submit(work, pack)

    monkeypatch.setattr(travelling, "submit", noted)
    return given


def bits(solution: al.Solution) -> tuple[bytes, ...]:
    searched = solution.effort.searched
    return solution.vector.tobytes(), searched.objectives.tobytes(), searched.violations.tobytes()


def evaluations(sent: list[dict]) -> int:
    return sum(len(one) for call in sent if "items" in call for one in call["items"])


def test_a_search_by_an_executor_is_that_of_this_process_to_the_last_bit(tmp_path: Path, travelling, sent):
    # Strong enough at every load, so that limits hold at scenarios.
    problem = al.Problem(bar_problem().system, minimize=MASS.mean, subject_to=[STRESS.at_most(0.5, worst_case=True)])
    here = al.solve(problem, SEARCH)
    with al.journal(tmp_path):
        there = al.solve(problem, SEARCH, executor=travelling)
    assert there.ok
    assert bits(there) == bits(here)
    # Every evaluation was sent, of one problem, in calls of one size.
    assert evaluations(sent) == there.effort.searched.evaluations
    assert len({(call["made_of"], call["size"]) for call in sent}) == 1
    assert len(sent) > there.effort.searched.evaluations / 16
    # A journal does not ask who evaluates.
    calls = len(sent)
    with al.journal(tmp_path):
        for executor in (None, travelling):
            assert bits(al.solve(problem, SEARCH, executor=executor)) == bits(here)
    assert len(sent) == calls


def test_ctrl_c_in_a_worker_keeps_the_best_so_far():
    found = al.solve(valleys_problem(), SEARCH, executor=Lost(4, KeyboardInterrupt()), throw=False)
    assert found.effort.searched.end.startswith("stopped by the user")
    assert 0 < found.effort.searched.evaluations < 60
