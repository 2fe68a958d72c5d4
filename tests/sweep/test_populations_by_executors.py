"""Generations of a search by executors: the same designs as here, whatever becomes of a worker."""

from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.sweep import _crowd
from aleator.transcription import transcribe, valued_by
from aleator.transcription.sequential import _population_elsewhere
from executors import AsProcesses, Lost
from zoo import MASS, STRESS, bar_problem, valleys_problem

SEARCH = al.solvers.DifferentialEvolution(evaluations=150, population=40)


@pytest.fixture
def travelling() -> Iterator[Executor]:
    with AsProcesses(2) as executor:
        yield executor


@pytest.fixture
def sent(travelling: Executor, monkeypatch: pytest.MonkeyPatch) -> list[dict]:
    """What the executor was given, in order."""
    given, submit = [], travelling.submit

    def noted(work, pack):
        given.append(pack.opened()[1])
        return submit(work, pack)

    monkeypatch.setattr(travelling, "submit", noted)
    return given


def bits(searched: al.results.Searched) -> tuple[bytes, bytes]:
    return searched.objectives.tobytes(), searched.violations.tobytes()


def evaluations(sent: list[dict]) -> int:
    return sum(len(one) for call in sent if "items" in call for one in call["items"])


def test_a_search_by_an_executor_is_that_of_this_process_to_the_last_bit(tmp_path: Path, travelling, sent):
    # Strong enough at every load, so that limits hold at scenarios.
    problem = al.Problem(bar_problem().system, minimize=MASS.mean, subject_to=[STRESS.at_most(0.5, worst_case=True)])
    here = al.solve(problem, SEARCH)
    with al.journal(tmp_path):
        there = al.solve(problem, SEARCH, executor=travelling)
    assert there.ok
    assert there.vector.tobytes() == here.vector.tobytes()
    assert bits(there.effort.searched) == bits(here.effort.searched)
    # Every evaluation was sent, of one problem, in calls of one size.
    assert evaluations(sent) == there.effort.searched.evaluations
    assert len({(call["made_of"], call["size"]) for call in sent}) == 1
    assert len(sent) > there.effort.searched.evaluations / 16
    # A journal does not ask who evaluates.
    calls = len(sent)
    with al.journal(tmp_path):
        for executor in (None, travelling):
            assert bits(al.solve(problem, SEARCH, executor=executor).effort.searched) == bits(here.effort.searched)
    assert len(sent) == calls


def test_a_worker_makes_a_population_once_for_all_generations(travelling: Executor, monkeypatch: pytest.MonkeyPatch):
    made = []
    monkeypatch.setattr(_population_elsewhere, "refuse_other_code", made.append)
    program = transcribe(valleys_problem()).program
    shared = valued_by(travelling, program, "here")
    for number in (40, 17, 1, 100):
        points = np.linspace(-2.0, 2.0, number)[:, None]
        objectives, constraints = shared.values(points)
        np.testing.assert_array_equal(objectives, program.values(points)[0])
        np.testing.assert_allclose(objectives, (points[:, 0] ** 2 - 1.0) ** 2 + 0.2 * points[:, 0], atol=1e-14)
        assert constraints.shape == (number, 0)
    assert len(made) == 1
    others = type(program)(**{**vars(program), "values": lambda points: (points[:, 0], points[:, :0])})
    with pytest.raises(al.ProblemError, match=r"executor: expected transcription=al.Sequential\(\)"):
        valued_by(travelling, others, "solve")
    assert valued_by(None, others, "solve") is others


def test_the_global_search_of_a_portfolio_is_shared_as_well(travelling: Executor, sent: list[dict]):
    here, there = (al.portfolio(valleys_problem(), 4, search=SEARCH, executor=one) for one in (None, travelling))
    assert bits(here.searched) == bits(there.searched)
    assert here.best.vector.tobytes() == there.best.vector.tobytes()
    assert evaluations(sent) == 150


def test_lost_workers_end_a_search_with_their_place_and_ctrl_c_in_one_keeps_the_best_so_far():
    with pytest.raises(al.SimulationError, match="solve: its worker died or was lost"):
        al.solve(valleys_problem(), SEARCH, executor=Lost(4, OSError("gone")))
    found = al.solve(valleys_problem(), SEARCH, executor=Lost(6, KeyboardInterrupt()), throw=False)
    assert found.effort.searched.end.startswith("stopped by the user")
    assert 0 < found.effort.searched.evaluations < 150


class Odd(al.AlgebraicSystem):
    """A model that is finite on one side alone."""

    place: al.Number

    def outputs(self):
        return {"far": jnp.where(self.place > 0.0, self.place, jnp.nan) ** 2}


def test_designs_that_cannot_be_evaluated_are_none_there_either(travelling: Executor):
    problem = al.Problem(Odd(al.Decision(1.0, -1.0, 2.0)), minimize=al.output("far").mean)
    search = al.solvers.DifferentialEvolution(evaluations=80, population=20, polish=False)
    here, there = (al.solve(problem, search, executor=executor, throw=False) for executor in (None, travelling))
    assert bits(here.effort.searched) == bits(there.effort.searched)
    assert np.isnan(there.effort.searched.objectives).any()


def test_a_front_of_a_population_by_an_executor_is_that_of_this_process(travelling, sent, monkeypatch):
    pytest.importorskip("pymoo")
    problem = al.Problem(bar_problem().system, minimize=MASS.mean)
    crowds, crowd = [], _crowd._population

    def noted(*given):
        crowds.append(crowd(*given))
        return crowds[-1]

    monkeypatch.setattr(_crowd, "_population", noted)
    own = {"method": "population", "evaluations": 80}
    wishes = {"mass": MASS.mean, "stress": STRESS.mean}
    here, there = (al.trade_off(problem, wishes, 3, executor=executor, **own) for executor in (None, travelling))
    assert here.values.tobytes() == there.values.tobytes()
    # Stress times mass is the mean load, one.
    np.testing.assert_allclose(there.values[:, 0] * there.values[:, 1], 1.0, rtol=1e-6)
    assert crowds[0][0].tobytes() == crowds[1][0].tobytes()
    assert evaluations(sent) >= 80
