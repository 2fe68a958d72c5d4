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
from zoo import Bar, bar_problem, valleys_problem

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


def bits(solution: al.Solution) -> tuple[bytes, bytes, bytes]:
    searched = solution.effort.searched
    assert searched is not None
    return solution.vector.tobytes(), searched.objectives.tobytes(), searched.violations.tobytes()


def roofed() -> al.Problem:
    """A bar that is strong enough at every load, so that limits hold at scenarios."""
    strong = al.output("stress").at_most(0.5, worst_case=True)
    return al.Problem(bar_problem().system, minimize=al.output("mass").mean, subject_to=[strong])


@pytest.mark.parametrize("problem", [valleys_problem, roofed])
def test_a_search_by_an_executor_is_that_of_this_process_to_the_last_bit(
    problem, travelling: Executor, sent: list[dict]
):
    here, there = (al.solve(problem(), SEARCH, executor=executor) for executor in (None, travelling))
    assert bits(here) == bits(there)
    assert there.ok
    # Every evaluation was sent, of one problem, in calls of one size.
    assert there.effort.searched is not None
    assert sum(len(one) for call in sent for one in call["items"]) == there.effort.searched.evaluations
    assert len({(call["made_of"], call["size"]) for call in sent}) == 1
    assert len(sent) > there.effort.searched.evaluations / 16


def test_a_worker_makes_a_population_once_for_all_generations(travelling: Executor, monkeypatch: pytest.MonkeyPatch):
    made, kind = [], _population_elsewhere.Population
    monkeypatch.setattr(_population_elsewhere, "refuse_other_code", made.append)
    program = transcribe(al.deterministic(valleys_problem())).program
    shared = valued_by(travelling, program, "here")
    assert isinstance(program.values, kind)
    assert shared.values is not None
    for number in (40, 17, 1, 100):
        points = np.linspace(-2.0, 2.0, number)[:, None]
        objectives, constraints = shared.values(points)
        np.testing.assert_array_equal(objectives, program.values(points)[0])
        np.testing.assert_allclose(objectives, (points[:, 0] ** 2 - 1.0) ** 2 + 0.2 * points[:, 0], atol=1e-14)
        assert constraints.shape == (number, 0)
    assert len(made) == 1


def test_a_journal_does_not_ask_who_evaluates(tmp_path: Path, travelling: Executor, sent: list[dict]):
    with al.journal(tmp_path):
        first = al.solve(valleys_problem(), SEARCH, executor=travelling)
    calls = len(sent)
    with al.journal(tmp_path):
        assert bits(al.solve(valleys_problem(), SEARCH)) == bits(first)
        assert bits(al.solve(valleys_problem(), SEARCH, executor=travelling)) == bits(first)
    assert len(sent) == calls > 0


def test_the_global_search_of_a_portfolio_is_shared_as_well(travelling: Executor, sent: list[dict]):
    here, there = (al.portfolio(valleys_problem(), 4, search=SEARCH, executor=one) for one in (None, travelling))
    assert here.searched is not None
    assert there.searched is not None
    assert here.searched.objectives.tobytes() == there.searched.objectives.tobytes()
    assert here.best.vector.tobytes() == there.best.vector.tobytes()
    assert sum(len(one) for call in sent if "items" in call for one in call["items"]) == 150


def test_one_point_after_the_other_is_searched_here(travelling: Executor, sent: list[dict]):
    search = al.solvers.NelderMead(evaluations=60)
    here, there = (
        al.portfolio(valleys_problem(), 4, search=search, executor=executor) for executor in (None, travelling)
    )
    assert here.best.vector.tobytes() == there.best.vector.tobytes()
    assert not [call for call in sent if "items" in call]


def test_values_of_another_kind_are_refused(travelling: Executor):
    program = transcribe(valleys_problem()).program
    others = type(program)(**{**vars(program), "values": lambda points: (points[:, 0], points[:, :0])})
    with pytest.raises(al.ProblemError, match=r"executor: expected transcription=al.Sequential\(\)"):
        valued_by(travelling, others, "solve")
    assert valued_by(None, others, "solve") is others


def test_lost_workers_end_a_search_with_their_place():
    with pytest.raises(al.SimulationError, match="solve: its worker died or was lost"):
        al.solve(valleys_problem(), SEARCH, executor=Lost(4, OSError("gone")))


def test_ctrl_c_in_a_worker_keeps_the_best_so_far():
    found = al.solve(valleys_problem(), SEARCH, executor=Lost(6, KeyboardInterrupt()), throw=False)
    searched = found.effort.searched
    assert searched is not None
    assert searched.end.startswith("stopped by the user")
    assert 0 < searched.evaluations < 150


class Odd(al.AlgebraicSystem):
    """A model whose outputs no worker can compute, though its start can be."""

    place: al.Number

    def outputs(self):
        return {"far": jnp.where(self.place > 0.0, self.place, jnp.nan) ** 2}


def test_designs_that_cannot_be_evaluated_are_none_there_either(travelling: Executor):
    problem = al.Problem(Odd(al.Decision(1.0, -1.0, 2.0)), minimize=al.output("far").mean)
    search = al.solvers.DifferentialEvolution(evaluations=80, population=20, polish=False)
    here, there = (al.solve(problem, search, executor=executor, throw=False) for executor in (None, travelling))
    assert bits(here) == bits(there)
    searched = there.effort.searched
    assert searched is not None
    assert np.isnan(searched.objectives).any()


def test_a_front_of_a_population_by_an_executor_is_that_of_this_process(
    travelling: Executor, sent: list[dict], monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("pymoo")
    model = Bar(al.Decision(4.0, 1.0, 10.0), al.Uniform(1.0, half_width=0.3))
    problem = al.Problem(model, minimize=al.output("mass").mean)
    wishes = {"mass": al.output("mass").mean, "stress": al.output("stress").mean}
    crowds, crowd = [], _crowd._population

    def noted(*given):
        crowds.append(crowd(*given))
        return crowds[-1]

    monkeypatch.setattr(_crowd, "_population", noted)
    own = {"method": "population", "evaluations": 160}
    here, there = (al.trade_off(problem, wishes, 4, executor=executor, **own) for executor in (None, travelling))
    assert here.values.tobytes() == there.values.tobytes()
    # Stress times mass is the mean load, one.
    np.testing.assert_allclose(there.values[:, 0] * there.values[:, 1], 1.0, rtol=1e-6)
    assert crowds[0][0].tobytes() == crowds[1][0].tobytes()
    assert sum(len(one) for call in sent for one in call["items"]) >= 160
