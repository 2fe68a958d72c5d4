"""Journals of runs: what is kept, what is taken from there, and what is not."""

import configparser
import json
import os
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
import xarray

import aleator as al
from aleator import solving
from aleator.journalling import FILE, Entry
from aleator.journalling._journal import identity
from zoo import SPREAD, Bar, bar_problem

NEEDED = 1.0 + 3.0 * SPREAD


@pytest.fixture
def solved(monkeypatch: pytest.MonkeyPatch) -> list[al.Problem]:
    """The problems that are really solved, in order."""
    done, solve = [], solving._solve._solved

    def noted(call):
        done.append(call.problem)
        return solve(call)

    monkeypatch.setattr(solving._solve, "_solved", noted)
    return done


def states(folder: Path) -> list[str]:
    return [one.state for one in al.load(folder).entries]


def test_a_front_is_taken_from_its_journal_down_to_the_last_bit(tmp_path: Path, solved: list):
    fronts = []
    for values in ([0.4, 0.5], [0.4, 0.5, 0.6], [0.4, 0.5, 0.6]):
        with al.journal(tmp_path):
            fronts.append(al.pareto(bar_problem(), "stress", values))
    assert len(solved) == 3, "what was not finished is computed from what was"
    whole = al.pareto(bar_problem(), "stress", [0.4, 0.5, 0.6])
    np.testing.assert_allclose(whole.objectives, NEEDED / np.array([0.4, 0.5, 0.6]), rtol=1e-6)
    for front in fronts[1:]:
        assert front.objectives.tobytes() == whole.objectives.tobytes()
        assert front.shadow_prices.tobytes() == whole.shadow_prices.tobytes()
    path = (tmp_path / al.load(tmp_path).entries[0].file).with_suffix(".nc")
    with xarray.open_datatree(path, engine="h5netcdf") as nodes:
        assert float(nodes["result/objective"]) == whole.objectives[0], "other programs can read it"


def test_other_numbers_limits_solvers_and_starts_are_other_results(tmp_path: Path, solved: list):
    others = [
        lambda: al.solve(bar_problem(load=1.1)),
        lambda: al.solve(bar_problem(highest=11.0)),
        lambda: al.solve(bar_problem(), al.solvers.Slsqp()),
        lambda: al.solve(bar_problem().with_bound("stress", 0.6)),
        lambda: al.solve(bar_problem(), start={"width": 5.0}),
        lambda: al.solve(bar_problem(), accuracy=1e-4),
        lambda: al.solve(al.deterministic(bar_problem())),
        lambda: al.solve(bar_problem(expansion=al.Expansion(order=1))),
    ]
    with al.journal(tmp_path):
        al.solve(bar_problem())
        al.solve(bar_problem())
        assert len(solved) == 1
        for number, solve in enumerate(others, 2):
            solve()
            assert len(solved) == number
        for _ in range(2):
            assert al.solve(bar_problem(highest=4.1, stress=0.3), throw=False).status is al.Status.INFEASIBLE
    assert len(solved) == 2 + len(others)
    assert states(tmp_path) == ["done"] * (1 + len(others)) + ["infeasible"]


def test_code_that_changed_makes_results_stale_and_says_so(tmp_path: Path, solved: list, monkeypatch):
    with al.journal(tmp_path):
        al.validate(al.solve(bar_problem()), 2000)
    monkeypatch.setattr(Bar, "outputs", lambda self: {"stress": 2 * self.load / self.width, "mass": self.width})
    with al.journal(tmp_path), pytest.warns(al.JournalWarning, match="the model's code has changed"):
        found = al.solve(bar_problem())
    assert found.objective == pytest.approx(4 * NEEDED, rel=1e-6)
    assert states(tmp_path) == ["stale", "stale", "done"]  # with the evidence on it
    monkeypatch.undo()
    with al.journal(tmp_path):
        assert al.solve(bar_problem()).objective == pytest.approx(2 * NEEDED, rel=1e-6)
    assert states(tmp_path) == ["done", "stale", "done"]


def test_evidence_is_kept_with_its_seed_and_belongs_to_its_solution(tmp_path: Path):
    for _ in range(2):
        with al.journal(tmp_path):
            solution = al.solve(bar_problem())
            assert al.validate(solution, 2000).solution is solution
            al.validate(solution, 2000, seed=1)
    found = al.load(tmp_path)
    assert list(found) == ["solve Bar 1", "validate Bar 1", "validate Bar 2"]
    assert found["validate Bar 2"].seed == 1


def test_a_cut_line_is_ignored_and_a_broken_one_is_named(tmp_path: Path, solved: list):
    with al.journal(tmp_path):
        al.solve(bar_problem())
    path = tmp_path / FILE
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"key": "cut o')
    with al.journal(tmp_path):
        al.solve(bar_problem())
        al.solve(bar_problem(load=1.1))
    assert len(solved) == 2
    assert states(tmp_path) == ["done", "done"]
    for line in (b'{"key": "nonsense"}\n', b"[" * 100_000 + b"\n"):
        path.write_bytes(line + whole)
        with pytest.raises(al.ProblemError, match=r"journal.jsonl', line 1: expected an entry"):
            al.load(tmp_path)


def test_a_file_that_is_damaged_is_told_and_computed_again(tmp_path: Path, solved: list):
    damages = (
        Path.unlink,
        lambda path: path.chmod(0o666),
        lambda path: path.write_bytes(path.read_bytes()[:-100]),
        lambda path: path.write_bytes(path.read_bytes().replace(b"width", b"widht")),
    )
    with al.journal(tmp_path):
        al.solve(bar_problem())
    for number, damage in enumerate(damages, 2):
        path = tmp_path / al.load(tmp_path).entries[-1].file
        path.chmod(path.stat().st_mode | 0o200)
        damage(path)
        with al.journal(tmp_path), pytest.warns(al.JournalWarning, match="computed again"):
            found = al.solve(bar_problem())
        assert found.objective == pytest.approx(2 * NEEDED, rel=1e-6)
        assert len(solved) == number


def test_results_whose_places_were_exchanged_are_told_and_computed_again(tmp_path: Path, solved: list):
    with al.journal(tmp_path):
        for load in (1.0, 1.1):
            al.solve(bar_problem(load=load))
    lines = [json.loads(line) for line in (tmp_path / FILE).read_text().splitlines()]
    one, other = (line for line in lines if line["state"] == "done")
    one["file"], other["file"] = other["file"], one["file"]
    (tmp_path / FILE).write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(al.ProblemError, match="is not what was written there"):
        al.load(tmp_path)["solve Bar 1"]
    with al.journal(tmp_path), pytest.warns(al.JournalWarning, match="not what was written .* computed again"):
        found = al.solve(bar_problem())
    assert found.objective == pytest.approx(2 * NEEDED, rel=1e-6)
    assert len(solved) == 3


def test_what_was_running_is_told_as_interrupted_where_no_process_writes_any_more(tmp_path: Path):
    with al.journal(tmp_path) as kept:
        kept.append(Entry.begun("1", "solve Bar", {}))
        assert states(tmp_path) == ["running"]
    assert states(tmp_path) == ["interrupted"]


def test_names_that_a_study_gives_are_names_of_results_and_double_ones_are_told(tmp_path: Path):
    with pytest.raises(al.ProblemError, match="There is no journal"):
        al.load(tmp_path)
    with al.journal(tmp_path) as kept:
        front = al.pareto(bar_problem(), "stress", [0.5, 0.6])
        kept.call({"designs/robust": front.points[0]})
        al.pareto(al.deterministic(bar_problem()), "stress", [0.6])
    found = al.load(tmp_path)
    assert list(found) == [f"solve Bar {number}" for number in range(1, 4)]
    assert found["designs/robust"].objective == front.points[0].objective == found["solve Bar 1"].objective
    assert "pareto, at stress = 0.7" not in found
    with pytest.raises(al.ProblemError, match=r"several results .* ask for one of 'solve Bar 2' and 'solve Bar 3'"):
        _ = found["pareto, at stress = 0.6"]
    with pytest.raises(al.ProblemError, match="Did you mean 'designs/robust'"):
        _ = found["designs/robost"]


def test_computing_afresh_keeps_each_earlier_result_until_its_replacement_is_there(tmp_path: Path, solved: list):
    with al.journal(tmp_path):
        before = al.pareto(bar_problem(), "stress", [0.4, 0.5])
    files = [tmp_path / one.file for one in al.load(tmp_path).entries]
    contents = [file.read_bytes() for file in files]
    with al.journal(tmp_path, afresh=True) as kept:
        al.solve(bar_problem().with_bound("stress", 0.4))
        assert (len(kept.taken), kept.begun) == (0, 1)
    assert states(tmp_path) == ["done"] * 2
    same = [file.read_bytes() == content for file, content in zip(files, contents, strict=True)]
    assert same == [False, True], "one is replaced, the other is as it was"
    done = len(solved)
    with al.journal(tmp_path):
        again = al.pareto(bar_problem(), "stress", [0.4, 0.5])
    assert len(solved) == done
    assert again.objectives.tobytes() == before.objectives.tobytes()


def test_an_earlier_result_outlives_the_death_of_the_run_that_computes_it_afresh(
    tmp_path: Path, solved: list, monkeypatch: pytest.MonkeyPatch
):
    with al.journal(tmp_path):
        before = al.solve(bar_problem())

    def dies(call):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, al.journal(tmp_path, afresh=True):
        patch.setattr(solving._solve, "_solved", dies)
        with pytest.raises(KeyboardInterrupt):
            al.solve(bar_problem())
    assert states(tmp_path) == ["done"]
    with al.journal(tmp_path):
        assert al.solve(bar_problem()).vector.tobytes() == before.vector.tobytes()
    assert len(solved) == 1


SWEPT = """
    import sys
    import numpy as np
    import zoo
    import aleator as al

    with al.journal(sys.argv[1]):
        problem = zoo.bar_problem()
        front = al.pareto(problem, "stress", np.linspace(0.4, 0.9, 6))
        calibrated = al.calibrate(problem, "stress", target=0.05, samples=2000)
    np.save(sys.argv[2], np.concatenate([front.objectives, front.shadow_prices, [calibrated.solution.objective]]))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_a_run_that_is_killed_ends_as_an_undisturbed_one(tmp_path: Path):
    (tmp_path / "swept.py").write_text(textwrap.dedent(SWEPT))
    places = [str(Path(__file__).parent), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, places))}

    def begun(folder: str, result: str) -> subprocess.Popen:
        return subprocess.Popen([sys.executable, "swept.py", folder, result], cwd=tmp_path, env=environment)

    def results() -> int:
        path = tmp_path / "killed" / FILE
        return path.read_bytes().count(b'"state": "done"') if path.exists() else 0

    assert begun("undisturbed", "whole.npy").wait() == 0
    run = begun("killed", "resumed.npy")
    while run.poll() is None and results() < 2:
        pass
    run.kill()
    assert run.wait() == -signal.SIGKILL
    assert begun("killed", "resumed.npy").wait() == 0
    whole, resumed = np.load(tmp_path / "whole.npy"), np.load(tmp_path / "resumed.npy")
    assert whole.tobytes() == resumed.tobytes()


PLACE: list[str] = []


class Mapped(al.AlgebraicSystem):
    width: al.Number

    def outputs(self):
        table = configparser.ConfigParser()
        table.read(PLACE)
        return {"mass": float(table["bar"]["density"]) * self.width}


def test_equations_that_change_without_the_code_are_another_result(tmp_path: Path):
    PLACE[:], keys = [str(tmp_path / "table.ini")], set()
    for density in (1.0, 3.0):
        (tmp_path / "table.ini").write_text(f"[bar]\ndensity = {density}\n")
        problem = al.Problem(Mapped(al.Decision(4.0, 0.1, 10.0)), minimize=al.output("mass").mean)
        keys.add(identity("solve", {"problem": problem})[0])
    assert len(keys) == 2


def test_models_of_equal_equations_are_told_apart_by_the_names_of_their_outputs_and_states():
    def declared(first: str, second: str) -> al.Problem:
        class Model(al.System):
            states = (first, second)
            rate: al.Number = al.Decision(1.0, 0.5, 2.0)

            def initial(self):
                return dict.fromkeys(self.states, 1.0)

            def rhs(self, t, z):
                return (-self.rate * z[0], -10.0 * self.rate * z[1])

            def outputs(self, t, z):
                return dict(zip(self.states, z, strict=True))

        return al.Problem(Model(), grid=al.Grid(1.0, 40), minimize=al.terminal("x").mean)

    one, other = declared("x", "y"), declared("y", "x")
    assert one.simulation.equations != other.simulation.equations
    keys = {identity("solve", {"problem": problem})[0] for problem in (one, other)}
    assert len(keys) == 2
