"""Counting, sampling and local searches by executors: the same as here, and kept by a journal."""

from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from bars import Bar, bar, scattered, two_valleys
from executors import AsProcesses

CALIBRATED = {"target": 0.05, "samples": 2000, "max_trials": 6}


@pytest.fixture
def travelling() -> Iterator[Executor]:
    with AsProcesses(2) as executor:
        yield executor


def test_a_calibration_that_counts_by_an_executor_is_that_of_this_process(travelling: Executor):
    here, there = (al.calibrate(bar(), "stress", executor=executor, **CALIBRATED) for executor in (None, travelling))
    assert here.confirmed
    assert there.confirmed
    assert [(one.sigmas, one.violation) for one in here.trials] == [(one.sigmas, one.violation) for one in there.trials]
    assert here.confirmation == there.confirmation


@pytest.mark.parametrize("traced", [True, False])
@pytest.mark.parametrize("method", [al.references.monte_carlo, al.references.quasi_monte_carlo])
def test_samples_by_an_executor_are_those_of_this_process_to_the_last_bit(travelling: Executor, method, traced: bool):
    model = {"off": al.Uniform(0.0, half_width=1.0), "more": al.Normal(2.0, 0.1)}
    here, there = (
        method(scattered, model, 2048, batch=60, traced=traced, executor=executor) for executor in (None, travelling)
    )
    assert here.values.keys() == there.values.keys() == {"sum", "row"}
    for name, values in here.values.items():
        assert values.tobytes() == there.values[name].tobytes()
    assert here["sum"].mean.value == pytest.approx(2.0, abs=0.1)


def test_a_portfolio_by_an_executor_is_that_of_this_process(travelling: Executor):
    problem = two_valleys()
    search = al.solvers.DifferentialEvolution(evaluations=60)
    here, there = (al.portfolio(problem, 6, search=search, executor=executor) for executor in (None, travelling))
    assert [(one.objective, one.starts) for one in here.optima] == [(one.objective, one.starts) for one in there.optima]
    assert here.best.vector.tobytes() == there.best.vector.tobytes()
    assert len(here.optima) == 2


def test_local_searches_that_a_journal_has_are_not_repeated(
    tmp_path: Path, travelling: Executor, monkeypatch: pytest.MonkeyPatch
):
    problem = two_valleys()
    search = al.solvers.DifferentialEvolution(evaluations=60)

    def end(task: str, done: int, total: int) -> None:
        if task == "local searches" and done == 4:
            raise RuntimeError("ended")

    with al.journal(tmp_path), pytest.raises(RuntimeError, match="ended"):
        al.portfolio(problem, 6, search=search, progress=end)
    undisturbed = al.portfolio(problem, 6, search=search)
    monkeypatch.setattr(type(search), "seek", lambda *_: pytest.fail("the global search is known"))
    sent = []
    submit = travelling.submit
    monkeypatch.setattr(travelling, "submit", lambda *given: sent.append(given) or submit(*given))
    with al.journal(tmp_path):
        resumed = al.portfolio(problem, 6, search=search, executor=travelling)
    assert len(sent) == 2
    assert resumed.optima == undisturbed.optima
    assert resumed.best.vector.tobytes() == undisturbed.best.vector.tobytes()


@pytest.mark.parametrize(
    "work",
    [
        lambda executor: al.calibrate(bar(), "stress", executor=executor),
        lambda executor: al.portfolio(two_valleys(), 6, executor=executor),
        lambda executor: al.references.monte_carlo(scattered, {"off": al.Normal(0, 1)}, executor=executor),
        lambda executor: al.references.quasi_monte_carlo(scattered, {"off": al.Normal(0, 1)}, executor=executor),
        lambda executor: al.validate(al.solve(bar()), executor=executor),
    ],
)
def test_what_is_no_executor_is_refused_everywhere(work):
    with pytest.raises(al.ProblemError, match=r"executor: expected an executor, such as al.workers\(2\)"):
        work(2)


def test_functions_that_other_processes_do_not_have_are_refused(travelling: Executor):
    with pytest.raises(al.ProblemError, match="Write its classes and functions in a module"):
        al.references.monte_carlo(lambda model: model["off"], {"off": al.Normal(0, 1)}, executor=travelling)


def test_a_black_box_has_an_executor_of_its_own(travelling: Executor):
    box = al.foreign.BlackBox(scattered)
    with pytest.raises(al.ProblemError, match="give the executor to the black box"):
        al.references.monte_carlo(box, {"off": al.Normal(0, 1), "more": 1.0}, 8, executor=travelling)


@pytest.mark.slow
def test_evidence_and_searches_of_processes_are_those_of_threads_to_the_last_bit(travelling: Executor):
    solution, problem = al.solve(bar()), two_valleys()
    with al.workers(2) as processes:
        counted = [al.validate(solution, 5000, executor=executor) for executor in (None, travelling, processes)]
        found = [al.portfolio(problem, 4, search=None, executor=executor) for executor in (None, processes)]
    assert isinstance(solution.problem.system, Bar)
    stresses = [one.functionals["stress"].values for one in counted]
    assert len({np.ascontiguousarray(one).tobytes() for one in stresses}) == 1
    assert len({str({**vars(one), "seconds": 0, "solution": 0}) for one in counted}) == 1
    assert found[0].best.vector.tobytes() == found[1].best.vector.tobytes()
