"""Sweeps by executors: the same results as anywhere, whatever becomes of a worker."""

import os
import pickle
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from bars import NEEDED, Wave, bar, dies, dies_once
from executors import AsProcesses

VALUES = [0.5, 0.4, 0.6, 0.7, 0.45]
posix = pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")


@pytest.fixture
def threads() -> Iterator[Executor]:
    with ThreadPoolExecutor(2) as executor:
        yield executor


@pytest.fixture
def travelling() -> Iterator[Executor]:
    with AsProcesses(2) as executor:
        yield executor


def test_a_front_by_an_executor_is_that_of_the_closed_form_in_the_order_of_its_values(travelling: Executor):
    front = al.pareto(bar(), "stress", VALUES, executor=travelling)
    assert front.values.tolist() == VALUES
    np.testing.assert_allclose(front.objectives, NEEDED / np.array(VALUES), rtol=1e-6)
    assert all(point.problem.with_bound("stress", 0.5) == bar() for point in front.points)
    here = al.pareto(bar(), "stress", VALUES)
    assert here.objectives.tobytes() == front.objectives.tobytes()
    assert here.shadow_prices.tobytes() == front.shadow_prices.tobytes()


def test_starts_and_evidence_by_an_executor_are_those_of_this_process(travelling: Executor):
    problem = bar()
    here, there = (al.multistart(problem, 4, executor=executor) for executor in (None, travelling))
    assert [one.objective for one in here.solutions] == [one.objective for one in there.solutions]
    assert [one.vector.tolist() for one in here.solutions] == [one.vector.tolist() for one in there.solutions]
    front = al.pareto(problem, "stress", VALUES[:2])
    counted = [al.validate_all(front, 1000, executor=executor) for executor in (None, travelling)]
    assert str(counted[0]) == str(counted[1])
    assert all(one.solution is point for one, point in zip(counted[1].evidence, counted[1].designs, strict=True))


def test_a_journal_keeps_what_workers_found(tmp_path: Path, travelling: Executor, monkeypatch: pytest.MonkeyPatch):
    with al.journal(tmp_path):
        first = al.pareto(bar(), "stress", VALUES, executor=travelling)
    monkeypatch.setattr(travelling, "submit", lambda *_: pytest.fail("nothing is left to do"))
    with al.journal(tmp_path):
        second = al.pareto(bar(), "stress", VALUES, executor=travelling)
    assert first.objectives.tobytes() == second.objectives.tobytes()


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
    front = al.pareto(bar(), "stress", [0.5, -1.0], executor=travelling)
    assert [one.ok for one in front.points] == [True, False]
    assert front.points[1].status is al.Status.INFEASIBLE


@pytest.mark.parametrize("executor", [2, "dask", al.pareto])
def test_what_is_no_executor_is_refused(executor):
    with pytest.raises(al.ProblemError, match=r"executor: expected an executor, such as al.workers\(2\)"):
        al.pareto(bar(), "stress", VALUES, executor=executor)


class Inline(Executor):
    """Does work at once, and gives what `given` makes of the results so far, the last of them being asked for."""

    def __init__(self, given):
        self._given, self._results, self.futures = given, [], []

    def submit(self, fn, /, *args, **kwargs):
        self._results.append(fn(*args, **kwargs))
        self.futures.append(Future())
        self.futures[-1].set_result(self._given(self._results))
        return self.futures[-1]


def raises(results: list):
    raise OSError("queue is full")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda results: results[0], "at stress = 0.6: the executor gave the result of other work, which is not used"),
        (lambda results: None, "expected what a worker has found; received None from the executor"),
        (lambda results: b"nonsense", "expected what a worker has found; received b'nonsense' from the executor"),
        (lambda results: pickle.dumps((1, 2)), "expected what a worker has found; received b'"),
        (raises, r"the executor did not take the work \(OSError: queue is full\)"),
    ],
)
def test_what_is_no_result_of_the_work_that_was_sent_is_never_believed(tmp_path: Path, given, said: str):
    with al.journal(tmp_path), pytest.raises(al.SimulationError, match=said) as refused:
        al.pareto(bar(), "stress", [0.5, 0.6], executor=Inline(given))
    assert "Finished results are kept within al.journal(folder)" in str(refused.value)
    for one in al.load(tmp_path).values():
        assert one.objective == pytest.approx(NEEDED / float(one.problem.named("stress")[0].upper), rel=1e-6)


def test_an_executor_that_gives_no_futures_or_one_twice_is_refused(
    travelling: Executor, monkeypatch: pytest.MonkeyPatch
):
    one = Future()
    for given, said in ((lambda *_: 5, "expected a future of concurrent.futures"), (lambda *_: one, "the same future")):
        monkeypatch.setattr(travelling, "submit", given)
        with pytest.raises(al.SimulationError, match=f"start .*{said}"):
            al.multistart(bar(), 2, executor=travelling)
    assert one.cancelled()


def test_workers_outside_their_block_are_refused_with_the_place():
    with al.workers(2) as executor:
        pass
    with pytest.raises(al.SimulationError, match=r"at stress = 0.5: .*the workers have been shut down"):
        al.pareto(bar(), "stress", [0.5, 0.6], executor=executor)


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
        al.multistart(bar(), 3, executor=travelling)
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


@pytest.mark.parametrize("kind", [kind for kind, _ in UNTRAVELLED])
def test_threads_of_this_process_take_any_model(kind, threads: Executor, monkeypatch: pytest.MonkeyPatch):
    model = kind(monkeypatch)(al.Uniform(al.Decision(3.0, -5.0, 5.0), half_width=0.5))
    problem = al.Problem(
        model, minimize=al.output("y").mean, subject_to=[al.output("y").at_most(9.0, sigmas=1.0).named("most")]
    )
    here, there = (al.multistart(problem, 3, executor=executor) for executor in (None, threads))
    assert here.best.vector == pytest.approx(1.0, abs=1e-6)
    assert [one.vector.tolist() for one in here.solutions] == [one.vector.tolist() for one in there.solutions]
    fronts = [al.pareto(problem, "most", [9.0, 0.02], executor=executor) for executor in (threads, threads)]
    assert fronts[0].objectives.tobytes() == fronts[1].objectives.tobytes()
    assert all(one.problem.system == model for one in fronts[0].points)
    counted = [al.validate(there.best, 500, executor=executor) for executor in (None, threads)]
    assert counted[0].joint == counted[1].joint
    samples = [
        al.references.monte_carlo(lambda one: one.outputs(), model, 64, batch=10, executor=executor)
        for executor in (None, threads)
    ]
    assert samples[0].values["y"].tobytes() == samples[1].values["y"].tobytes()
    search = al.solvers.DifferentialEvolution(evaluations=60)
    sought = [al.solve(problem, search, executor=executor) for executor in (None, threads)]
    assert sought[0].vector.tobytes() == sought[1].vector.tobytes()


def test_a_thread_that_gives_the_result_of_other_work_is_not_believed(
    threads: Executor, monkeypatch: pytest.MonkeyPatch
):
    first, submit = list[Future](), threads.submit
    monkeypatch.setattr(threads, "submit", lambda *given: first.append(submit(*given)) or copied(first[0]))
    with pytest.raises(al.SimulationError, match=r"start 2.*the result of other work"):
        al.multistart(bar(), 2, executor=threads)


def copied(future: Future) -> Future:
    again = Future()
    again.set_result(future.result())
    return again


@posix
def test_the_death_of_a_worker_is_survived(tmp_path: Path):
    with al.workers(2) as executor:
        futures = [executor.submit(dies_once, str(tmp_path / "mark"), number) for number in range(8)]
        assert [one.result() for one in futures] == [2 * number for number in range(8)]
    assert (tmp_path / "mark").exists()
    with pytest.raises(RuntimeError, match="have been shut down"):
        executor.submit(dies, 1)


@posix
def test_work_that_always_kills_its_worker_ends():
    with al.workers(1) as executor, pytest.raises(BrokenProcessPool):
        executor.submit(dies, 1).result()


AT_CTRL_C = """
    import multiprocessing
    import os
    import signal

    import aleator as al

    if __name__ == "__main__":
        signal.signal(signal.SIGINT, signal.default_int_handler)  # which a run in the background ignores
        with al.workers(2) as executor:
            try:
                print([one.result() for one in [executor.submit(abs, -number) for number in range(4)]])
                for one in multiprocessing.active_children():
                    os.kill(one.pid, signal.SIGINT)
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                print("interrupted")
"""


@posix
@pytest.mark.slow
def test_workers_without_work_end_at_ctrl_c_without_a_word(tmp_path: Path):
    (tmp_path / "script.py").write_text(textwrap.dedent(AT_CTRL_C))
    command = [sys.executable, str(tmp_path / "script.py")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, start_new_session=True, check=False)
    assert ended.stdout.split("\n") == ["[0, 1, 2, 3]", "interrupted", ""], ended.stderr
    assert ended.stderr == ""
    assert ended.returncode == 0


def test_what_a_journal_has_begins_no_worker(tmp_path: Path, travelling: Executor, monkeypatch: pytest.MonkeyPatch):
    with al.journal(tmp_path):
        first = al.pareto(bar(), "stress", VALUES[:2], executor=travelling)
    executor = al.workers(3)
    monkeypatch.setattr(executor, "submit", lambda *_: pytest.fail("nothing is left to do"))
    with al.journal(tmp_path):
        assert (
            al.pareto(bar(), "stress", VALUES[:2], executor=executor).objectives.tobytes() == first.objectives.tobytes()
        )


@pytest.mark.slow
def test_fronts_of_processes_are_those_of_threads_down_to_the_last_bit(threads: Executor):
    with al.workers(2) as two, al.workers(1) as one:
        fronts = [al.pareto(bar(), "stress", VALUES, executor=executor) for executor in (threads, one, two)]
    assert len({front.objectives.tobytes() for front in fronts}) == 1
    assert len({front.shadow_prices.tobytes() for front in fronts}) == 1


ON_A_CLUSTER = """
    import os
    import signal
    import sys

    import numpy as np
    from dask.distributed import Client, LocalCluster
    from loky import get_reusable_executor

    import aleator as al
    from bars import bar

    VALUES = [0.5, 0.4, 0.6, 0.7, 0.45, 0.55, 0.65]


    def main():
        loky = al.pareto(bar(), "stress", VALUES, executor=get_reusable_executor(2))
        cluster = LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)
        with cluster, Client(cluster) as client:
            workers = list(client.run(os.getpid).values())

            def kill(task, done, total):
                if done == 3 and workers:
                    os.kill(workers.pop(), signal.SIGKILL)

            dask = al.pareto(bar(), "stress", VALUES, executor=client.get_executor(), progress=kill)
        np.save(sys.argv[1], [loky.objectives, dask.objectives])
        assert len(workers) == 1, "no worker was killed"


    if __name__ == "__main__":
        main()
"""


@posix
@pytest.mark.slow
def test_fronts_of_loky_and_of_a_cluster_whose_worker_is_killed_are_the_same(tmp_path: Path, travelling: Executor):
    (tmp_path / "swept.py").write_text(textwrap.dedent(ON_A_CLUSTER))
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    done = subprocess.run(
        [sys.executable, "swept.py", "fronts.npy"], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    loky, dask = np.load(tmp_path / "fronts.npy")
    here = al.pareto(bar(), "stress", [0.5, 0.4, 0.6, 0.7, 0.45, 0.55, 0.65], executor=travelling)
    assert loky.tobytes() == dask.tobytes() == here.objectives.tobytes()
