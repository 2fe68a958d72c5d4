"""Sweeps by executors: the same results as anywhere, whatever becomes of a worker."""

import pickle
import sys
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from executors import AsProcesses, Inline, scattered
from zoo import SPREAD, Wave, bar_problem, valleys_problem

VALUES = [0.5, 0.4, 0.6, 0.7, 0.45]
NEEDED = 1.0 + 3.0 * SPREAD
SEARCH = al.solvers.DifferentialEvolution(evaluations=60)


@pytest.fixture
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.fixture
def travelling() -> Iterator[Executor]:
    with AsProcesses(2) as executor:
        yield executor


def test_a_front_by_an_executor_is_that_of_the_closed_form_and_its_evidence_that_of_this_process(travelling: Executor):
    front = al.pareto(bar_problem(), "stress", VALUES, executor=travelling)
    assert front.values.tolist() == VALUES
    np.testing.assert_allclose(front.objectives, NEEDED / np.array(VALUES), rtol=1e-6)
    assert all(point.problem.with_bound("stress", 0.5) == bar_problem() for point in front.points)
    here = al.pareto(bar_problem(), "stress", VALUES)
    assert here.objectives.tobytes() == front.objectives.tobytes()
    assert here.shadow_prices.tobytes() == front.shadow_prices.tobytes()
    counted = [al.validate_all(front, 1000, executor=executor) for executor in (None, travelling)]
    assert str(counted[0]) == str(counted[1])
    assert all(one.solution is point for one, point in zip(counted[1].evidence, counted[1].designs, strict=True))


def test_starts_by_an_executor_are_those_of_this_process(travelling: Executor):
    here, there = (al.multistart(bar_problem(), 4, executor=executor) for executor in (None, travelling))
    assert [one.objective for one in here.solutions] == [one.objective for one in there.solutions]
    assert [one.vector.tolist() for one in here.solutions] == [one.vector.tolist() for one in there.solutions]


def test_a_calibration_that_counts_by_an_executor_is_that_of_this_process(travelling: Executor):
    how = {"target": 0.05, "samples": 2000, "max_trials": 6}
    here, there = (al.calibrate(bar_problem(), "stress", executor=one, **how) for one in (None, travelling))
    assert here.confirmed
    assert there.confirmed
    assert [(one.sigmas, one.violation) for one in here.trials] == [(one.sigmas, one.violation) for one in there.trials]
    assert here.confirmation == there.confirmation


@pytest.mark.parametrize(("method", "traced"), [("monte_carlo", True), ("quasi_monte_carlo", False)])
def test_samples_by_an_executor_are_those_of_this_process_to_the_last_bit(travelling: Executor, method, traced: bool):
    model = {"off": al.Uniform(0.0, half_width=1.0), "more": al.Normal(2.0, 0.1)}
    sample = getattr(al.references, method)
    how = {"batch": 60, "traced": traced}
    here, there = (sample(scattered, model, 1024, executor=executor, **how) for executor in (None, travelling))
    assert here.values.keys() == there.values.keys() == {"sum", "row"}
    for name, values in here.values.items():
        assert values.tobytes() == there.values[name].tobytes()
    assert here["sum"].mean.value == pytest.approx(2.0, abs=0.1)


def test_local_searches_of_a_portfolio_by_an_executor_that_a_journal_has_are_not_repeated(
    tmp_path: Path, travelling: Executor, monkeypatch: pytest.MonkeyPatch
):
    def end(task: str, done: int, total: int) -> None:
        if task == "local searches" and done == 4:
            raise RuntimeError("ended")

    with al.journal(tmp_path), pytest.raises(RuntimeError, match="ended"):
        al.portfolio(valleys_problem(), 6, search=SEARCH, progress=end)
    undisturbed = al.portfolio(valleys_problem(), 6, search=SEARCH)
    assert len(undisturbed.optima) == 2
    monkeypatch.setattr(type(SEARCH), "seek", lambda *_: pytest.fail("the global search is known"))
    sent, submit = [], travelling.submit
    monkeypatch.setattr(travelling, "submit", lambda *given: sent.append(given) or submit(*given))
    with al.journal(tmp_path):
        resumed = al.portfolio(valleys_problem(), 6, search=SEARCH, executor=travelling)
    assert len(sent) == 2
    assert resumed.optima == undisturbed.optima
    assert resumed.best.vector.tobytes() == undisturbed.best.vector.tobytes()


def test_what_a_journal_has_begins_no_worker(tmp_path: Path, travelling: Executor, monkeypatch: pytest.MonkeyPatch):
    with al.journal(tmp_path):
        first = al.pareto(bar_problem(), "stress", VALUES[:2], executor=travelling)
    executor = al.workers(3)
    monkeypatch.setattr(executor, "submit", lambda *_: pytest.fail("nothing is left to do"))
    with al.journal(tmp_path):
        again = al.pareto(bar_problem(), "stress", VALUES[:2], executor=executor)
    assert again.objectives.tobytes() == first.objectives.tobytes()


def test_warnings_and_failures_of_workers_are_told_with_their_place(travelling: Executor):
    rough = al.Problem(
        Wave(al.Decision(2.0, 1.0, 4.0), al.Uniform(0.0, half_width=1.0)),
        minimize=al.output("wave").std,
        subject_to=[(al.output("width").mean >= 1.5).named("width")],
        expansion=al.Expansion(order=2),
    )
    with pytest.warns(al.ExpansionWarning) as heard:
        al.pareto(rough, "width", [1.5, 3.0], executor=travelling)
    assert {str(one.message).split(":")[0] for one in heard} == {f"pareto, at width = {at}" for at in (1.5, 3)}
    front = al.pareto(bar_problem(), "stress", [0.5, -1.0], executor=travelling)
    assert [one.ok for one in front.points] == [True, False]
    assert front.points[1].status is al.Status.INFEASIBLE


def raises(results: list):
    raise OSError("queue is full")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda results: results[0], "at stress = 0.6: the executor gave the result of other work, which is not used"),
        (lambda results: b"nonsense", "expected what a worker has found; received b'nonsense' from the executor"),
        (lambda results: pickle.dumps((1, 2)), "expected what a worker has found; received b'"),
        (raises, r"the executor did not take the work \(OSError: queue is full\)"),
    ],
)
def test_what_is_no_result_of_the_work_that_was_sent_is_never_believed(tmp_path: Path, given, said: str):
    with al.journal(tmp_path), pytest.raises(al.SimulationError, match=said) as refused:
        al.pareto(bar_problem(), "stress", [0.5, 0.6], executor=Inline(given))
    assert "Finished results are kept within al.journal(folder)" in str(refused.value)
    for one in al.load(tmp_path).values():
        assert one.objective == pytest.approx(NEEDED / float(one.problem.named("stress")[0].upper), rel=1e-6)


def copied(future: Future) -> Future:
    again = Future()
    again.set_result(future.result())
    return again


def test_a_thread_that_gives_the_result_of_other_work_is_not_believed(
    threads: Executor, monkeypatch: pytest.MonkeyPatch
):
    first, submit = list[Future](), threads.submit
    monkeypatch.setattr(threads, "submit", lambda *given: first.append(submit(*given)) or copied(first[0]))
    with pytest.raises(al.SimulationError, match=r"start 2.*the result of other work"):
        al.multistart(bar_problem(), 2, executor=threads)


def test_an_executor_that_gives_no_futures_or_one_twice_is_refused(
    travelling: Executor, monkeypatch: pytest.MonkeyPatch
):
    one = Future()
    for given, said in ((lambda *_: 5, "expected a future of concurrent.futures"), (lambda *_: one, "the same future")):
        monkeypatch.setattr(travelling, "submit", given)
        with pytest.raises(al.SimulationError, match=f"start .*{said}"):
            al.multistart(bar_problem(), 2, executor=travelling)
    assert one.cancelled()


def test_what_was_sent_is_cancelled_where_an_executor_takes_no_more(
    travelling: Executor, monkeypatch: pytest.MonkeyPatch
):
    taken = [Future()]

    def submit(*_):
        if len(taken) > 2:
            raise RuntimeError("cannot schedule new futures after shutdown")
        taken.append(Future())
        return taken[-1]

    monkeypatch.setattr(travelling, "submit", submit)
    with pytest.raises(al.SimulationError, match="cannot schedule new futures after shutdown"):
        al.multistart(bar_problem(), 3, executor=travelling)
    assert [one.cancelled() for one in taken] == [False, True, True]


class Local(al.AlgebraicSystem):
    """In a module that is called `__main__` below."""

    a: al.Number

    def outputs(self):
        return {"y": (self.a - 1.0) ** 2}


def of_the_script_itself(monkeypatch: pytest.MonkeyPatch) -> type:
    monkeypatch.setattr(Local, "__module__", "__main__")
    monkeypatch.setattr(sys.modules["__main__"], "Local", Local, raising=False)
    return Local


def within_a_function(monkeypatch: pytest.MonkeyPatch) -> type:
    square = lambda number: number**2  # noqa: E731 -- has no name that a pickle could tell

    class Inner(al.AlgebraicSystem):
        a: al.Number

        def outputs(self):
            return {"y": square(self.a - 1.0)}

    return Inner


UNTRAVELLED = [
    (of_the_script_itself, "Move them into a module"),
    (within_a_function, "Write its classes and functions in a module"),
]


@pytest.mark.parametrize(("kind", "told"), UNTRAVELLED)
def test_processes_are_refused_classes_that_they_would_not_have(kind, told: str, monkeypatch: pytest.MonkeyPatch):
    problem = al.Problem(kind(monkeypatch)(al.Decision(3.0, -5.0, 5.0)), minimize=al.output("y").mean)
    with al.workers(2) as executor, pytest.raises(al.ProblemError, match=told):
        al.multistart(problem, 2, executor=executor)


def test_threads_of_this_process_take_any_model(threads: Executor, monkeypatch: pytest.MonkeyPatch):
    model = within_a_function(monkeypatch)(al.Uniform(al.Decision(3.0, -5.0, 5.0), half_width=0.5))
    limit = al.output("y").at_most(9.0, sigmas=1.0).named("most")
    problem = al.Problem(model, minimize=al.output("y").mean, subject_to=[limit])
    here, there = (al.multistart(problem, 3, executor=executor) for executor in (None, threads))
    assert here.best.vector == pytest.approx(1.0, abs=1e-6)
    assert [one.vector.tolist() for one in here.solutions] == [one.vector.tolist() for one in there.solutions]
    counted = [al.validate(there.best, 500, executor=executor) for executor in (None, threads)]
    assert counted[0].joint == counted[1].joint
    sought = [al.solve(problem, SEARCH, executor=executor) for executor in (None, threads)]
    assert sought[0].vector.tobytes() == sought[1].vector.tobytes()


WISHES = {"depth": al.output("depth").mean, "spread": al.output("depth").std}
REFUSED = r"executor: expected an executor, such as al.workers\(2\)"
NORMAL = {"off": al.Normal(0, 1)}


@pytest.mark.parametrize(
    ("work", "said"),
    [
        (lambda _: al.pareto(bar_problem(), "stress", VALUES, executor="dask"), REFUSED),
        (lambda _: al.multistart(bar_problem(), 2, executor=2), REFUSED),
        (lambda _: al.calibrate(bar_problem(), "stress", executor=2), REFUSED),
        (lambda _: al.portfolio(valleys_problem(), 6, executor=2), REFUSED),
        (lambda _: al.references.monte_carlo(scattered, NORMAL, executor=2), REFUSED),
        (lambda _: al.references.quasi_monte_carlo(scattered, NORMAL, executor=2), REFUSED),
        (lambda _: al.solve(valleys_problem(), SEARCH, executor=2), "solve: " + REFUSED),
        (lambda _: al.trade_off(valleys_problem(), WISHES, method="population", executor=2), "trade_off: " + REFUSED),
        (lambda given: al.trade_off(valleys_problem(), WISHES, executor=given), "expected method=.population. or"),
        (
            lambda given: al.solve(valleys_problem(), al.solvers.NelderMead(), executor=given),
            "executor: expected a solver that evaluates many designs at once",
        ),
        (
            lambda given: al.references.monte_carlo(lambda model: model["off"], NORMAL, executor=given),
            "Write its classes and functions in a module",
        ),
        (
            lambda given: al.references.monte_carlo(al.foreign.BlackBox(scattered), NORMAL, 8, executor=given),
            "give the executor to the black box",
        ),
    ],
)
def test_executors_that_cannot_do_the_work_are_refused(work, said: str, travelling: Executor):
    with pytest.raises(al.ProblemError, match=said):
        work(travelling)


def test_workers_outside_their_block_are_refused_with_the_place():
    with al.workers(2) as executor:
        pass
    with pytest.raises(al.SimulationError, match=r"at stress = 0.5: .*the workers have been shut down"):
        al.pareto(bar_problem(), "stress", [0.5, 0.6], executor=executor)
