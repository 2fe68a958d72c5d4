"""The commands on a run's folder: resume, sweep, validate, report, compare and list."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import aleator as al
import bars
from aleator import cli, extending, solving, studies
from aleator.cli._record import Record
from aleator.journalling import FILE, Entry
from aleator.reporting import Section, Table, Verdict, only_writer
from aleator.studies import AbstractStudy, Stage, _swept, load
from bars import NEEDED

BAR = (
    bars.FILE
    + """study = al.Study(
    {"nominal": al.deterministic(problem), "robust": problem},
    title="Bar",
    samples=2000,
    sweeps={"stress": [0.5, 0.6, 0.8]},
)
"""
)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a study to work in, whose module is forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bar.py").write_text(BAR)
    path = list(sys.path)
    yield tmp_path
    sys.modules.pop("bar", None)
    sys.path[:] = path


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a quick run, complete, which no test changes; `bar.py` stands beside it."""
    place = tmp_path_factory.mktemp("finished")
    (place / "bar.py").write_text(BAR)
    result = aleator("run", str(place / "bar.py"), "--quick", "--out", str(place / "results"))
    assert result.exit_code == 0, result.output
    return place / "results"


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with its front, complete, which no test changes; `bar.py` stands beside it."""
    place = tmp_path_factory.mktemp("front")
    (place / "bar.py").write_text(BAR.replace("samples=2000", "samples=200"))
    path = list(sys.path)
    result = aleator("run", str(place / "bar.py"), "--out", str(place / "results"))
    assert result.exit_code == 0, result.output
    sys.modules.pop("bar", None)
    sys.path[:] = path
    return place / "results"


def aleator(*arguments: str):
    return CliRunner().invoke(cli.application, list(arguments))


def document(result) -> dict:
    """The one JSON document on stdout, whose numbers are finite."""

    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    return json.loads(result.stdout, parse_constant=refuse)


def said(result) -> str:
    return " ".join(result.output.split())


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch, python_interrupts) -> Iterator[pytest.MonkeyPatch]:
    """Ctrl-C in the second solve of this process, until undone."""
    solve, done = solving._solve._solved, list[object]()

    def stopped(call):
        done.append(call)
        if len(done) == 2:
            raise KeyboardInterrupt
        return solve(call)

    with monkeypatch.context() as patch:
        patch.setattr(solving._solve, "_solved", stopped)
        yield patch


@pytest.fixture
def nothing_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """No solve may happen."""

    def never(call):
        raise AssertionError("something was computed")

    monkeypatch.setattr(solving._solve, "_solved", never)


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many workers were begun each time; they are threads here."""
    counts = list[int]()

    def threads(count: int) -> ThreadPoolExecutor:
        counts.append(count)
        return ThreadPoolExecutor(count)

    monkeypatch.setattr(_swept, "workers", threads)
    return counts


def test_a_sweep_that_was_interrupted_tells_what_waits_and_is_resumed_from_its_folder(here: Path, interrupted):
    values = [0.5, 0.6, 0.8]
    result = aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.5,0.6,0.8", "--out", "there")
    assert result.exit_code == 130, result.output
    listed = {one["name"]: one for one in document(aleator("list", "there", "--json"))["results"]}
    assert {name: one["state"] for name, one in listed.items()} == {
        "stress = 0.5": "done",
        "stress = 0.6": "interrupted",
        "stress = 0.8": "waiting",
    }
    assert all(one["host"] and one["process"] for one in listed.values())
    assert "waiting solve Bar stress = 0.8" in said(aleator("list", "there"))

    page = aleator("report", "there", "--json")
    assert page.exit_code == 0, page.output
    assert "'front over stress' is not finished" in document(page)["missing"][0]
    text = (here / "there/report-so-far.html").read_text()
    assert "1 of 3 points are available" in text

    interrupted.undo()
    resumed = aleator("resume", "there", "--json")
    assert resumed.exit_code == 0, resumed.output
    found = document(resumed)
    assert found["recalled"] == 1
    points = found["fronts"]["fronts/robust"]["points"]
    np.testing.assert_allclose([one["objective"] for one in points], NEEDED / np.array(values), rtol=1e-6)
    undisturbed = al.pareto(load("bar.py").problems["robust"], "stress", values)
    assert [one["objective"] for one in points] == undisturbed.objectives.tolist()
    assert [one["state"] for one in document(aleator("list", "there", "--json"))["results"]] == ["done"] * 3
    assert document(aleator("report", "there", "--json"))["missing"] == []


def test_a_run_is_resumed_as_it_was_begun_wherever_its_project_has_moved(here: Path, finished: Path, tmp_path: Path):
    moved = tmp_path / "moved"
    finished.parent.rename(moved)
    try:
        before = json.loads((moved / "results/designs.json").read_text())
        result = aleator("resume", str(moved / "results"), "--json")
        assert result.exit_code == 0, result.output
        found = document(result)
    finally:
        moved.rename(finished.parent)
    assert found["designs"]["designs/robust"]["evidence"]["samples"] == 100
    assert found["recalled"] == 4, "two designs with evidence, of which one is the front's point too"
    for name, one in before.items():
        assert found["designs"][name]["objective"] == one["objective"]


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda folder: (folder / "command.json").unlink(), "There is no 'command.json'"),
        (lambda folder: (folder / "command.json").write_text("{"), "does not say what began the run"),
        (lambda folder: (folder / "command.json").write_text('{"study": 3}'), "does not say what began the run"),
        (lambda folder: (folder.parent / "bar.py").unlink(), "The study of 'results' has gone: there is no file"),
    ],
)
def test_a_folder_that_does_not_say_how_to_go_on_is_refused(here: Path, damage, told: str):
    (here / "results").mkdir()
    cli._record.Record("bar.py").write(here / "results")
    damage(here / "results")
    result = aleator("resume", "results")
    assert result.exit_code == 2
    assert told in said(result)


def test_a_script_that_runs_its_own_study_leaves_no_command_to_resume(here: Path):
    cli._record.Record("bar.py").write(here)
    assert cli.run_study(Further(), here) == 0
    assert "There is no 'command.json'" in said(aleator("resume", str(here)))


def test_a_front_is_printed_kept_and_written_as_a_page(here: Path):
    result = aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.5,0.04", "--design", "robust")
    assert result.exit_code == 0, result.output
    told = said(result)
    assert f"stress = 0.5, objective {NEEDED / 0.5:.6g}, feasible, 1 of 2, about" in told
    assert "stress = 0.04, infeasible, violation" in told
    assert "1 of 2 points over stress are solved" in told
    assert (here / "results/bar-over-stress" / FILE).is_file()
    sampled = document(aleator("validate", "results/bar-over-stress", "--samples", "100", "--json"))
    assert list(sampled["designs"]) == ["stress = 0.5"]
    page = (here / "results/bar-over-stress/report.html").read_text()
    assert "Bar: robust over stress" in page
    assert f"objective {NEEDED / 0.5:.6g}" in page


def test_a_front_by_several_workers_is_that_of_pareto_with_an_executor(here: Path, begun: list[int]):
    result = aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.5,0.6,0.8", "--workers", "2", "--json")
    assert result.exit_code == 0, result.output
    points = document(result)["fronts"]["fronts/robust"]["points"]
    with ThreadPoolExecutor(2) as executor:
        front = al.pareto(load("bar.py").problems["robust"], "stress", [0.5, 0.6, 0.8], executor=executor)
    assert begun == [2]
    assert [one["objective"] for one in points] == front.objectives.tolist()


def test_the_command_line_says_how_many_workers_share_a_run_before_the_study_does(here: Path, begun: list[int]):
    (here / "bar.py").write_text(BAR.replace("samples=2000,", "samples=200, workers=2,"))
    assert aleator("run", "bar.py", "--quick").exit_code == 0
    assert begun == [2, 2], "the front, and the evidence along it"
    result = aleator("run", "bar.py", "--quick", "--workers", "3", "--out", "there", "--json")
    assert result.exit_code == 0, result.output
    assert begun == [2, 2, 3, 3]
    assert aleator("resume", "there").exit_code == 0
    assert aleator("resume", "there", "--workers", "4").exit_code == 0
    assert begun[4:] == [3, 3, 4, 4]
    assert aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.5").exit_code == 0
    assert begun[8:] == [2]
    points = document(result)["fronts"]["fronts/stress"]["points"]
    with ThreadPoolExecutor(2) as executor:
        front = al.pareto(load("bar.py").problems["robust"], "stress", [0.5], executor=executor)
    assert [one["objective"] for one in points] == front.objectives.tolist()


def test_evidence_by_workers_is_that_of_this_process(here: Path, finished: Path, begun: list[int]):
    shutil.copytree(finished, here / "one")
    shutil.copytree(finished, here / "two")
    arguments = ("--samples", "300", "--seed", "11", "--json")
    alone, shared = (aleator("validate", *one, *arguments) for one in (["one"], ["two", "--workers", "2"]))
    assert begun == [2]
    assert document(alone)["designs"] == document(shared)["designs"]


@pytest.mark.parametrize(
    ("study", "told"),
    [
        ("bar.py", "nothing to share among processes: expected `sweeps` or `wishes`"),
        ("suspension", "`aleator sweep` takes --workers for a front of any study"),
    ],
)
def test_workers_without_work_are_refused(here: Path, study: str, told: str):
    (here / "bar.py").write_text(BAR.replace('sweeps={"stress": [0.5, 0.6, 0.8]},', ""))
    result = aleator("run", study, "--workers", "2")
    assert result.exit_code == 2
    assert told in said(result)
    assert not (here / "results").exists()


@pytest.mark.slow
def test_processes_share_a_run_and_what_they_found_is_recalled_without_them(here: Path):
    command = [sys.executable, "-m", "aleator", "run", "bar.py", "--workers", "2", "--json"]
    done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    points = json.loads(done.stdout)["fronts"]["fronts/stress"]["points"]
    np.testing.assert_allclose([one["objective"] for one in points], NEEDED / np.array([0.5, 0.6, 0.8]), rtol=1e-6)
    again = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False, timeout=300)
    assert json.loads(again.stdout)["fronts"] == json.loads(done.stdout)["fronts"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--bound", "strain", "--values", "1"), "strain"),
        (("--bound", "stress", "--values", "1;2"), "expected numbers with commas between them"),
        (("--bound", "stress", "--values", ","), "one finite value of the bound at least"),
        (("--bound", "stress", "--values", "nan"), "sweep: values"),
        (("--bound", "stress", "--values", "1", "--design", "robot"), "Did you mean 'robust'"),
        (("--bound", "stress", "--values", "1", "--workers", "0"), "workers"),
        (("--bound", "range", "--values", "0.2,0.3"), "0.2 alone cannot be the bound of 'range'"),
        (("--bound", "range", "--values", "0.2"), "sweep a limit of one side, or write each side"),
    ],
)
def test_a_sweep_that_cannot_be_is_refused_before_any_work(here: Path, options: tuple[str, ...], told: str):
    two_sided = 'subject_to=[strong, (stress.mean <= 0.4).named("range"), (stress.mean >= 0.1).named("range")]'
    (here / "bar.py").write_text(BAR.replace("subject_to=[strong]", two_sided))
    result = aleator("sweep", "bar.py", *options)
    assert result.exit_code == 2
    assert told in said(result)
    assert not (here / "results").exists()


def test_fresh_evidence_is_counted_on_the_designs_of_a_folder(finished: Path, nothing_solved):
    arguments = ("validate", str(finished), "--samples", "4000", "--seed", "5", "--json")
    result = aleator(*arguments)
    assert result.exit_code == 0, result.output
    found = document(result)["designs"]
    shares = {name: one["violations"]["stress"] for name, one in found.items()}
    # The nominal bar carries the mean load at its limit: half of the symmetric loads are beyond it.
    assert shares["nominal"]["lower"] < 0.5 < shares["nominal"]["upper"]
    assert shares["robust"]["count"] == 0
    before = (finished / FILE).read_bytes()
    again = aleator(*arguments)
    assert document(again)["designs"] == found
    assert (finished / FILE).read_bytes() == before
    one = document(aleator("validate", str(finished), "--samples", "200", "--design", "robust", "--json"))
    assert list(one["designs"]) == ["robust"]
    told = (found["robust"]["solved"], found["robust"]["origin"], found["robust"]["differs"])
    assert told == (False, "taken from the folder.", None)
    assert "design nominal: taken from the folder." in said(result)


def test_designs_that_are_not_there_are_solved_before_they_are_sampled(here: Path):
    result = aleator("validate", "bar.py", "--samples", "200", "--design", "robust")
    assert result.exit_code == 0, result.output
    assert "Systems that violate limits" in result.output
    assert "design robust: solved, because the folder does not have it." in said(result)
    assert f"objective {NEEDED / 0.5:.6g}" in aleator("run", "bar.py").output
    named = [one["name"] for one in document(aleator("list", "results/bar", "--json"))["results"]]
    assert named.count("designs/robust") == 1


@pytest.fixture
def edited(here: Path, front: Path) -> Path:
    """A folder whose study has been edited since its run."""
    shutil.copytree(front, here / "results")
    (here / "bar.py").write_text((front.parent / "bar.py").read_text().replace("half_width=0.3", "half_width=0.4"))
    Record("bar.py").write(here / "results")
    return here / "results"


def test_evidence_on_designs_of_an_edited_study_says_that_they_are_not_those_of_the_run(edited: Path, front: Path):
    arguments = ("validate", "results", "--samples", "200", "--design", "robust")
    first, again = aleator(*arguments, "--json"), aleator(*arguments)
    other = "it is not the design that the run found."
    told = "(numbers of the problem): " + other
    assert (
        f"design robust: solved anew, because what it follows from has changed since the folder's run {told}"
        in said(first)
    )
    assert "look at: design robust: taken from the folder, where it was solved after" in said(again)
    assert other in said(again)
    found = document(first)["designs"]["robust"]
    assert found["solved"] is True
    assert found["origin"].endswith(told)
    assert found["differs"] == ["numbers of the problem"]
    width = (1 + 3 * 0.4 / np.sqrt(3)) / 0.5
    assert found["decisions"]["width"]["value"] == pytest.approx(width, rel=1e-6)
    assert f"width │ {width:.5f} mm" in said(again)
    assert al.load("results")["designs/robust"].objective == pytest.approx(NEEDED / 0.5, rel=1e-6)
    assert al.load("results")["robust"].objective == pytest.approx(width, rel=1e-6)

    compared = aleator("compare", str(front), "results", "--json")
    (before, now) = document(compared)["later"].values()
    assert before == {}
    assert now == {"designs/robust": ["numbers of the problem"]}
    assert "has a later design of this name, which `aleator validate` has solved" in said(compared)

    # Once the study has run again, its designs are those of the run.
    assert aleator("run", "bar.py", "--out", "results").exit_code == 0
    assert "design robust: taken from the folder. " in said(aleator(*arguments))
    later = document(aleator("compare", str(front), "results", "--json"))["later"]
    assert list(later.values()) == [{}, {}]


@pytest.mark.filterwarnings("always::aleator._core.errors.JournalWarning")
def test_a_design_whose_file_has_gone_is_told_to_be_solved_again(here: Path, front: Path):
    shutil.copytree(front, here / "results")
    shutil.copy(front.parent / "bar.py", here)
    Record("bar.py").write(here / "results")
    (lost,) = (one.file for one in al.load("results").entries if one.name == "designs/robust")
    (here / "results" / lost).unlink()
    result = aleator("validate", "results", "--samples", "200", "--design", "robust", "--json")
    found = document(result)["designs"]["robust"]
    assert found["origin"] == "solved again, because its file in the folder has gone or is damaged."
    assert (found["solved"], found["differs"]) == (True, None)


def test_a_point_taken_from_the_folder_of_an_edited_study_is_told_as_the_run_s(here: Path):
    name, told = "stress = 0.5", "taken from the folder, where the run found it. The study declares another problem"
    assert aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.5", "--out", "there").exit_code == 0
    arguments = ("validate", "there", "--samples", "100", "--json")
    before = document(aleator(*arguments))["designs"][name]
    (here / "bar.py").write_text(BAR.replace("half_width=0.3", "half_width=0.2"))
    result = aleator(*arguments)
    after = document(result)["designs"][name]
    assert before["origin"] == "taken from the folder."
    assert after["origin"].startswith(told)
    assert f"look at: design {name}: taken" in said(result)
    assert after["objective"] == before["objective"]


def test_a_sweep_of_an_edited_study_takes_the_names_of_the_earlier_points(here: Path):
    sweep = ("sweep", "bar.py", "--bound", "stress", "--values", "0.5,0.6", "--out", "there")
    narrow = (1 + 3 * 0.2 / np.sqrt(3)) / 0.5
    for half_width, needed in (("0.3", NEEDED / 0.5), ("0.2", narrow), ("0.3", NEEDED / 0.5)):
        (here / "bar.py").write_text(BAR.replace("half_width=0.3", f"half_width={half_width}"))
        assert aleator(*sweep).exit_code == 0
        sampled = document(aleator("validate", "there", "--samples", "100", "--json"))["designs"]
        assert list(sampled) == ["stress = 0.5", "stress = 0.6"]
        assert sampled["stress = 0.5"]["objective"]["value"] == pytest.approx(needed, rel=1e-6)
        compared = document(aleator("compare", "there", "there", "--json"))["designs"]["stress = 0.5"]
        assert compared["there"]["objective"]["value"] == pytest.approx(needed, rel=1e-6)
        assert al.load("there")["stress = 0.5"].objective == pytest.approx(needed, rel=1e-6)


def test_evidence_on_what_a_script_has_kept_needs_no_study(here: Path):
    problem = load("bar.py").problems["robust"]
    with al.journal("kept"):
        al.solve(problem)
    found = document(aleator("validate", "kept", "--samples", "300", "--json"))["designs"]
    assert found["solve Bar 1"]["samples"] == 300
    page = aleator("report", "kept", "--out", "kept.html")
    assert page.exit_code == 0, page.output
    assert "solve Bar 1" in (here / "kept.html").read_text()
    (here / "empty").mkdir()
    assert "there is no finished design in 'empty'" in said(aleator("validate", "empty"))
    assert "there is no journal in 'empty'" in said(aleator("report", "empty"))


def test_a_design_that_cannot_be_solved_has_no_evidence_and_exits_with_one(here: Path):
    (here / "bar.py").write_text(BAR.replace("<= 0.5", "<= 0.05"))
    result = aleator("validate", "bar.py", "--samples", "100", "--json")
    assert result.exit_code == 1
    found = document(result)
    assert "infeasible" in found["designs"]["robust"]["why"]
    assert len(found["errors"]) == 2


def test_the_page_of_a_folder_is_written_without_computing_or_noting_anything(
    finished: Path, nothing_solved, tmp_path: Path
):
    before = (finished / FILE).read_bytes()
    result = aleator("report", str(finished), "--out", str(tmp_path / "page.html"), "--json")
    assert result.exit_code == 0, result.output
    assert document(result)["missing"] == []
    assert (finished / FILE).read_bytes() == before
    page = (tmp_path / "page.html").read_text()
    assert "Optimum against the limit of stress" in page
    assert "Systems that violate stress" in page


def interrupt_in_the_first_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(call):
        raise KeyboardInterrupt

    monkeypatch.setattr(solving._solve, "_solved", stopped)


def test_before_the_first_design_is_finished_a_report_says_that_nothing_is(
    here: Path, monkeypatch: pytest.MonkeyPatch, python_interrupts
):
    with monkeypatch.context() as patch:
        interrupt_in_the_first_solve(patch)
        result = aleator("run", "bar.py", "--json")
    assert result.exit_code == 130, result.output
    assert document(result)["verdict"].startswith("Interrupted: No design was finished")
    assert document(result)["errors"][0].startswith("Interrupted during 'design nominal'")
    result = aleator("report", "results/bar", "--json")
    assert result.exit_code == 2, result.output
    found = document(result)
    assert "nothing is finished yet in 'results/bar'" in found["errors"][0]
    assert "'design nominal' is not finished" in found["missing"][0]
    assert "'evidence on nominal' is not finished: what it follows from is missing." in found["missing"]
    assert found["files"] == []


def test_a_run_stopped_in_its_second_design_has_a_page_of_the_first(here: Path, interrupted):
    assert aleator("run", "bar.py").exit_code == 130
    complete = (here / "results/bar/report.html").read_bytes()
    result = aleator("report", "results/bar", "--json")
    assert result.exit_code == 0, result.output
    found = document(result)
    assert found["files"] == ["results/bar/report-so-far.html"]
    assert [one.partition(" is not")[0] for one in found["missing"]] == [
        *("'design robust'", "'evidence on nominal'", "'evidence on robust'"),
        *("'front over stress'", "'evidence along the front over stress'"),
    ]
    assert "nominal" in (here / "results/bar/report-so-far.html").read_text()
    assert (here / "results/bar/report.html").read_bytes() == complete


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent as on Unix")
@pytest.mark.parametrize(
    ("begun", "command"),
    [
        ("aleator_command.main()", ["run", "waiting.py", "--json"]),
        ("aleator_command.main()", ["check", "waiting.py", "--json"]),
        ("aleator_command.mind_signals(); os.kill(os.getpid(), signal.SIGINT)", ["report", "there", "--json"]),
    ],
)
def test_an_early_signal_leaves_a_document(here: Path, begun: str, command: list[str]):
    """While the study is loaded, and while the package is imported."""
    (here / "waiting.py").write_text(
        "import os, signal, threading\nos.kill(os.getpid(), signal.SIGINT)\nthreading.Event().wait()\n"
    )
    program = (
        "import os, signal; signal.signal(signal.SIGINT, signal.default_int_handler); import aleator_command; " + begun
    )
    done = subprocess.run([sys.executable, "-c", program, *command], capture_output=True, text=True, timeout=120)
    assert done.returncode == 130, done.stderr
    found = document(done)
    assert (found["command"], found["exit_code"]) == (command[0], 130)
    assert found["errors"][0].startswith("Interrupted")
    assert "Interrupted" in done.stderr


def test_a_sweep_stopped_in_its_first_point_has_a_report_or_a_reason(
    here: Path, monkeypatch: pytest.MonkeyPatch, python_interrupts
):
    arguments = ("sweep", "bar.py", "--bound", "stress", "--values", "0.5", "--out", "there", "--json")
    interrupt_in_the_first_solve(monkeypatch)
    result = aleator(*arguments)
    assert result.exit_code == 130, result.output
    assert document(result)["verdict"].startswith("Interrupted: No point over stress")
    found = document(aleator("report", "there", "--json"))
    assert "nothing is finished yet" in found["errors"][0]
    assert "'front over stress' is not finished" in found["missing"][0]


def test_what_an_unfinished_stage_has_found_is_counted_where_it_is_interrupted(
    here: Path, monkeypatch: pytest.MonkeyPatch, python_interrupts
):
    solved, calls = solving._solve._solved, []

    def stopped(call):
        calls.append(call)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return solved(call)

    monkeypatch.setattr(solving._solve, "_solved", stopped)
    result = aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.5,0.45,0.4", "--out", "there", "--json")
    assert result.exit_code == 130, result.output
    told = document(result)["errors"][0]
    assert told.startswith("Interrupted during 'front over stress': ")
    assert "2 results of 'front over stress'" in told
    assert "are kept in there" in told
    there = [one for one in aleator("list", "there").output.splitlines() if " solve " in one and "done" in one]
    assert len(there) == 2


def test_after_an_edit_the_page_is_written_beside_the_complete_one(here: Path, finished: Path, nothing_solved):
    shutil.copytree(finished, here / "results")
    Record("bar.py", quick=True).write(here / "results")
    complete = (here / "results/report.html").read_bytes()
    edited = BAR.replace("half_width=0.3", "half_width=0.2")
    for text, told in ((edited, "an earlier form of the study"), (BAR.replace("2000", "6000"), "evidence on robust")):
        (here / "bar.py").write_text(text)
        result = aleator("report", "results", "--json")
        assert result.exit_code == 0, result.output
        found = document(result)
        assert told in " ".join(found["missing"])
        assert found["files"] == ["results/report-so-far.html"]
        assert "report.html stays as it is" in said(result)
        assert (here / "results/report.html").read_bytes() == complete
    assert document(aleator("report", "results", "--out", "results/report.html", "--json"))["exit_code"] == 0
    assert (here / "results/report.html").read_bytes() != complete


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (Path.unlink, r"cannot be read \(No such file or directory\)"),
        (lambda path: path.write_bytes(b""), "is not what was written there"),
    ],
)
def test_a_front_without_one_of_its_points_is_on_the_page_with_the_others(
    here: Path, front: Path, begun: list[int], nothing_solved, damage, told: str, workers: int
):
    shutil.copytree(front, here / "results")
    shutil.copy(front.parent / "bar.py", here)
    Record("bar.py", workers=workers).write(here / "results")
    (lost,) = (one.file for one in al.load(here / "results").entries if one.name == "stress = 0.6")
    damage(here / "results" / lost)
    result = aleator("report", "results", "--json")
    assert result.exit_code == 0, result.output
    missing = document(result)["missing"]
    assert re.fullmatch(rf"'front over stress' is not finished: 'results/{lost}' {told}\.", missing[0])
    assert len(missing) == 1, "the evidence on the other points is there"
    page = (here / "results/report-so-far.html").read_text()
    assert "2 of 3 points of the front over stress are available" in page
    assert "Optimum against the limit of stress" in page


def thrice(number: float, progress) -> float:
    progress("thrice", 0, 1)
    return 3.0 * number


class Further(AbstractStudy):
    """A study with work of its own, after a design."""

    title = "With work of its own"

    def __init__(self) -> None:
        self.found: dict[str, al.Solution] = {}
        self.others, self.thrice = 0, 0.0

    @property
    def problems(self):
        return {"robust": load("bar.py").problems["robust"]}

    @property
    def stages(self):
        return {"design": Stage(self.solve, 1.0), "other": Stage(self.other, 1.0)}

    def solve(self, progress):
        self.found["robust"] = al.solve(self.problems["robust"])

    def other(self, progress):
        mass = self.found["robust"].objective
        self.thrice = extending.kept("thrice", thrice, mass, progress=self.noted)

    def noted(self, task, done, total):
        self.others += 1

    def results(self):
        return {"designs": self.found}

    def verdict(self):
        return Verdict("good", "Done", "as far as it went.")

    def sections(self):
        return [Section("Own", [Table("Own", ["a"], [[f"thrice {self.thrice:.4f}"]])])]

    def tables(self):
        return []


def test_work_of_a_studys_own_is_on_its_page_without_being_done_again(here: Path, monkeypatch: pytest.MonkeyPatch):
    made = list[Further]()

    def fresh(name, quick=False):
        made.append(Further())
        return made[-1]

    monkeypatch.setattr(studies, "load", fresh)
    assert aleator("run", "further", "--out", "there").exit_code == 0
    told = f"thrice {3 * NEEDED / 0.5:.4f}"
    assert told in (here / "there/report.html").read_text()
    (here / "there/report.html").unlink()
    result = aleator("report", "there", "--json")
    assert result.exit_code == 0, result.output
    assert document(result)["missing"] == []
    assert told in (here / "there/report.html").read_text()
    assert [one.others for one in made] == [1, 0]
    lines = (here / "there" / FILE).read_text().splitlines(keepends=True)
    (here / "there" / FILE).write_text("".join(line for line in lines if "work thrice" not in line))
    result = aleator("report", "there", "--json")
    assert document(result)["missing"] == ["'other' is not finished: work thrice is missing."]
    assert "Not reached or not completed: other." in (here / "there/report-so-far.html").read_text()
    checked = aleator("check", "further", "--json")
    assert checked.exit_code == 0, checked.output
    assert document(checked)["problems"]["robust"]["points"] >= 4
    assert document(checked)["problems"]["robust"]["samples"] is None


@pytest.mark.parametrize(
    ("problems", "told"),
    [
        ({}, "'With work of its own' declares no problems"),
        ([1], "problems by their names"),
        ({"a": 1}, "'a': expected Problem"),
    ],
)
def test_a_study_without_proper_problems_is_refused_where_they_are_needed(
    here: Path, monkeypatch: pytest.MonkeyPatch, problems, told: str
):
    monkeypatch.setattr(Further, "problems", problems)
    monkeypatch.setattr(studies, "load", lambda name, quick=False: Further())
    for command in (("check",), ("validate",), ("sweep", "--bound", "stress", "--values", "1")):
        result = aleator(command[0], "partial", *command[1:])
        assert result.exit_code == 2
        assert told in said(result)


def test_runs_are_compared_design_by_design_and_by_what_they_follow_from(here: Path, finished: Path):
    changed = BAR.replace("half_width=0.3", "half_width=0.2")
    (here / "bar.py").write_text(changed)
    assert aleator("run", "bar.py", "--quick", "--out", "narrow").exit_code == 0
    result = aleator("compare", str(finished), "narrow", "--json")
    assert result.exit_code == 0, result.output
    found = document(result)
    narrow = found["designs"]["designs/robust"]["narrow"]
    assert narrow["objective"]["value"] == pytest.approx((1 + 3 * 0.2 / np.sqrt(3)) / 0.5, rel=1e-6)
    assert found["designs"]["designs/robust"]["results"]["objective"]["value"] == pytest.approx(NEEDED / 0.5, rel=1e-6)
    assert found["differences"]["designs/robust"] == {"narrow": ["numbers of the problem"]}
    told = said(aleator("compare", str(finished), "narrow"))
    assert "designs/robust: results and narrow differ in numbers of the problem." in told
    assert "Systems that violate stress" in told
    same = said(aleator("compare", "narrow", "narrow"))
    assert "follow from the same equations, code, numbers and versions" in same
    assert "two folders or more" in said(aleator("compare", "narrow"))
    (here / "empty").mkdir()
    assert "there are no results in 'empty'" in said(aleator("compare", "narrow", "empty"))


def test_a_run_is_compared_with_a_sweep_by_what_their_designs_are(here: Path):
    (here / "bar.py").write_text(BAR.replace("samples=2000", "samples=100"))
    assert aleator("run", "bar.py", "--out", "run").exit_code == 0
    sweep = ("sweep", "bar.py", "--bound", "stress", "--values", "0.5,0.6", "--out", "sweep")
    assert aleator(*sweep).exit_code == 0
    result = aleator("compare", "run", "sweep", "--json")
    assert result.exit_code == 0, result.output
    found = document(result)
    objectives = {
        name: [one and one["objective"]["value"] for one in each.values()] for name, each in found["designs"].items()
    }
    assert objectives == {
        "designs/nominal": [pytest.approx(2.0, rel=1e-6), None],
        "designs/robust": [pytest.approx(NEEDED / 0.5, rel=1e-6)] * 2,
        "stress = 0.6": [pytest.approx(NEEDED / 0.6, rel=1e-6)] * 2,
    }
    assert found["differences"]["designs/nominal"] == {"sweep": None}
    assert found["differences"]["designs/robust"] == {"sweep": []}
    assert found["differences"]["stress = 0.6"] == {"sweep": []}
    assert found["designs"]["stress = 0.6"]["run"]["evidence"]["samples"] == 100
    assert "There as" in said(result)
    swapped = document(aleator("compare", "sweep", "run", "--json"))
    assert list(swapped["designs"]) == ["stress = 0.5", "stress = 0.6", "designs/nominal"]
    assert swapped["differences"]["stress = 0.5"] == {"run": []}


def test_a_run_tells_programs_its_verdict_designs_and_fronts(finished: Path):
    result = aleator("resume", str(finished), "--json")
    found = document(result)
    assert set(found) == {
        *("command", "folder", "finished", "files", "title", "verdict", "designs", "fronts", "recalled"),
        *("exit_code", "errors"),
    }
    assert found["finished"][0] == "design nominal"
    assert "stress" in found["fronts"]["fronts/stress"]["bound"]
    assert "wrote" in result.stderr


def test_a_refusal_is_a_document_too():
    result = aleator("run", "suspention", "--json")
    assert result.exit_code == 2
    assert document(result)["exit_code"] == 2
    assert "There is no study 'suspention'" in document(result)["errors"][0]


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("run",), "Missing argument 'study'"),
        (("run", "bar.py", "more"), "unexpected extra argument"),
        (("run", "bar.py", "--ut", "x"), "No such option: --ut"),
        (("validate", "bar.py", "--samples", "1"), "Invalid value for '--samples'"),
        (("validate", "bar.py", "--seed", "few"), "Invalid value for '--seed'"),
        (("sweep", "bar.py", "--bound", "stress"), "Missing option '--values'"),
        (("compare",), "Missing argument 'FOLDER"),
        (("new", "bar.py"), "No such option: --json"),
        (("runn", "bar.py"), "No such command 'runn'"),
        ((), "No such option: --json"),
        (("run", "bar.toml"), "There is no file 'bar.toml'"),
        (("check", "nowhere"), "There is no study 'nowhere'"),
        (("resume", "nowhere"), "There is no 'command.json' in 'nowhere'"),
        (("report", "nowhere"), "there is no journal in 'nowhere'"),
        (("list", "nowhere"), "there is no journal in 'nowhere'"),
        (("compare", "nowhere", "there"), "there are no results in 'nowhere'"),
    ],
)
def test_whatever_is_refused_stdout_is_a_document(
    arguments: tuple[str, ...], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    result = aleator(*arguments, "--json")
    assert result.exit_code == 2
    found = document(result)
    assert found["exit_code"] == 2
    assert found["command"] == (arguments[0] if arguments else "")
    assert told in found["errors"][0]
    assert " ".join(told.split()[:2]) in " ".join(result.stderr.split())
    assert aleator(*arguments, "--json-not").stdout == ""


@pytest.mark.parametrize("name", list(studies.STUDIES))
def test_every_case_study_declares_its_problems(name: str):
    study = load(name, quick=True)
    assert type(study).problems is not AbstractStudy.problems
    if name not in ("four-bar", "swing-up"):  # whose problems take long to trace; their own tests solve them
        assert study.problems
        assert all(isinstance(one, al.Problem) for one in study.problems.values())


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_a_sweep_that_is_killed_is_resumed_from_its_folder_down_to_the_last_bit(here: Path):
    values = "0.5,0.55,0.6,0.65,0.7,0.75,0.8,0.85"
    arguments = ["sweep", "bar.py", "--bound", "stress", "--values", values, "--out", "there"]
    journal = here / "there" / FILE
    with subprocess.Popen([sys.executable, "-m", "aleator", *arguments], stdout=subprocess.DEVNULL) as run:
        while run.poll() is None and not (journal.exists() and b'"state": "done"' in journal.read_bytes()):
            pass
        run.send_signal(signal.SIGKILL)
    assert run.returncode == -signal.SIGKILL
    states = [one["state"] for one in document(aleator("list", "there", "--json"))["results"]]
    assert "waiting" in states
    found = document(aleator("resume", "there", "--json"))
    assert found["recalled"] >= 1
    whole = document(aleator("sweep", "bar.py", "--bound", "stress", "--values", values, "--out", "whole", "--json"))
    assert found["fronts"] == whole["fronts"]


def test_the_list_tells_names_the_dead_and_what_is_lost(here: Path, finished: Path):
    place = here / "copy"
    shutil.copytree(finished, place)
    told = said(aleator("list", str(place)))
    for name in ("designs/nominal", "designs/robust", "evidence/nominal", "evidence/robust"):
        assert name in told
    entries = al.load(place).entries
    (place / entries[0].file).unlink()
    (place / entries[1].file).write_bytes(b"")
    begun = Entry.begun("1", "solve Bar", {})
    with (place / FILE).open("a") as file:
        file.write(begun.line())
    before = (place / FILE).read_bytes()

    def states() -> list[str]:
        return [one["state"] for one in document(aleator("list", str(place), "--json"))["results"]]

    assert states() == ["lost", "lost", *["done"] * (len(entries) - 2), "interrupted"]
    told = said(aleator("list", str(place)))
    assert "its file cannot be read: No such file" in told
    assert "its file is not what was written" in told
    assert f"{len(entries) - 2} results" in told
    with only_writer(place):
        assert states()[-1] == "running"
    assert (place / FILE).read_bytes() == before


def test_every_name_that_the_list_shows_is_one_of_load(finished: Path):
    loaded = al.load(finished)
    for one in document(aleator("list", str(finished), "--json"))["results"]:
        assert one["load"] in said(aleator("list", str(finished)))
        assert type(loaded[one["load"]]) is type(loaded[one["name"] or one["load"]])  # a sample of `validate` has none
    assert loaded["designs/robust"].ok


def test_a_result_that_is_asked_for_twice_is_counted_once(here: Path):
    # The front's first point starts where the design does, with the same bound: the same result.
    (here / "bar.py").write_text(BAR.replace("[0.5, 0.6, 0.8]", "[0.5, 0.6]"))
    assert aleator("run", "bar.py").exit_code == 0
    again = aleator("run", "bar.py", "--json")
    listed = document(aleator("list", "results/bar", "--json"))["results"]
    assert document(again)["recalled"] == len(listed)
    assert f"{len(listed)} results were taken from an earlier run" in said(again)
    assert f"{len(listed)} results" in said(aleator("list", "results/bar"))


def test_another_study_of_the_same_name_does_not_share_a_folder(here: Path):
    (here / "results/bar").mkdir(parents=True)
    (here / "results/bar/report.html").write_text("kept")
    cli._record.Record("bar.toml").write(here / "results/bar")
    (here / "bar.toml").write_text("")
    for command in (("run", "bar.py"), ("run", "bar.py", "--afresh"), ("validate", "bar.py")):
        result = aleator(*command)
        assert result.exit_code == 2, result.output
        assert "The results of `aleator run bar.toml` are in 'results/bar'" in said(result)
        assert "--out results/bar-py" in said(result)
    assert (here / "results/bar/report.html").read_text() == "kept"
    assert not (here / "results/bar" / FILE).exists()


@pytest.mark.parametrize(
    ("begun", "other", "is_its_own"),
    [
        (Record("bar.py"), Record("bar.py", quick=True), True),
        (Record("bar.py"), Record("./bar.py"), True),
        (Record("bar.py"), Record("bar.toml"), False),
        (Record("bar.py"), Record("bar"), False),
        (Record("suspension"), Record("suspension"), True),
        (Record("bar.py"), Record("bar.py", bound="stress", values=(1.0,)), False),
        (Record("bar.py", bound="stress", values=(1.0,)), Record("bar.py", bound="stress", values=(2.0,)), True),
        (Record("bar.py", bound="stress", values=(1.0,)), Record("bar.py", bound="mass", values=(1.0,)), False),
    ],
)
def test_a_folder_belongs_to_what_began_it(here: Path, begun: Record, other: Record, is_its_own: bool):
    (here / "there").mkdir()
    begun.write(here / "there")
    if is_its_own:
        other.check_owns(here / "there")
    else:
        with pytest.raises(al.ProblemError, match="name another folder"):
            other.check_owns(here / "there")


def test_neither_a_sweep_nor_a_run_replaces_what_the_other_has_found(here: Path, finished: Path, nothing_solved):
    shutil.copytree(finished, here / "results")
    Record("bar.py", quick=True).write(here / "results")
    sweep = ("sweep", "bar.py", "--bound", "stress", "--values", "0.5", "--out")
    (here / "results-over-stress").mkdir()
    Record("bar.py", bound="stress", values=(0.5,)).write(here / "results-over-stress")
    files = {one: one.read_bytes() for one in here.glob("res*/*") if one.is_file()}
    for command, advice in (
        ((*sweep, "results"), "--out results-over-stress"),
        ((*sweep, "results", "--afresh"), "--out results-over-stress"),
        (("run", "bar.py", "--out", "results-over-stress"), "--out results-over-stress-py"),
    ):
        result = aleator(*command)
        assert result.exit_code == 2, result.output
        assert advice in said(result)
    assert {one: one.read_bytes() for one in here.glob("res*/*") if one.is_file() and one in files} == files


def test_a_sweep_counts_each_bound_once_and_names_the_range_that_is_solved(here: Path):
    arguments = ("sweep", "bar.py", "--bound", "stress", "--out", "there", "--json", "--values")
    assert document(aleator(*arguments, "0.6,0.5,0.6"))["verdict"] == (
        f"Swept: 2 of 2 points over stress are solved; the objective is {NEEDED / 0.5:.4g} at stress = 0.5 and "
        f"{NEEDED / 0.6:.4g} at stress = 0.6."
    )
    again = aleator(*arguments, "0.6,0.001", "--afresh")
    assert document(again)["recalled"] == 0
    assert document(again)["verdict"] == (
        f"Partly solved: 1 of 2 points over stress are solved; the objective is {NEEDED / 0.6:.4g} at stress = 0.6."
    )
    told = said(aleator("resume", "there"))
    assert "taken from an earlier run." in told
    assert "--afresh" not in told
    assert "--afresh computes anew" in said(aleator(*arguments, "0.6"))


def test_a_folder_goes_on_belonging_to_a_study_that_has_moved(here: Path):
    Record("bar.py").write(here)
    (here / "moved").mkdir()
    (here / "bar.py").rename(here / "moved/bar.py")
    Record("moved/bar.py").check_owns(here)


def test_recalled_results_are_told_as_such(here: Path):
    arguments = ("sweep", "bar.py", "--bound", "stress", "--out", "there")
    assert "recalled" not in said(aleator(*arguments, "--values", "0.5"))
    told = said(aleator(*arguments, "--values", "0.5,0.6"))
    assert re.search(r"front over stress: [\d.]+ s, 1 of 2 recalled", told)
    assert "1 result was taken from an earlier run" in told
    assert "front over stress: recalled from an earlier run" in said(aleator(*arguments, "--values", "0.5,0.6"))


def test_one_infeasible_design_is_told_among_those_that_are_solved(here: Path):
    (here / "bar.py").write_text(
        BAR[: BAR.index("study =")]
        + "study = al.Study({'impossible': problem.with_bound('stress', 0.01), 'robust': problem}, samples=100)\n"
    )
    result = aleator("run", "bar.py", "--json")
    assert result.exit_code == 1, result.output
    found = document(result)
    assert found["verdict"].startswith("Not solved: 1 of 2 designs are solved; 'impossible' is infeasible: ")
    assert found["errors"] == [one for one in found["errors"] if one.startswith("'impossible' is not solved")]
    page = (here / "results/bar/report.html").read_text()
    assert "1 of 2 designs are solved" in page
    for wrong in ("stopped early", "summary'", "No recommendation after an error"):
        assert wrong not in page + result.output


def test_a_front_without_a_design_says_why_and_exits_with_one(here: Path):
    result = aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.01", "--json")
    assert result.exit_code == 1, result.output
    assert "No point over stress is solved" in document(result)["verdict"]
    assert "No recommendation" not in result.output


DIVERGING = """import aleator as al
import jax.numpy as jnp


class Rod(al.System):
    states = ("x",)
    k: al.Number

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z):
        return (-jnp.sqrt(z.x - 0.5 * self.k),)

    def outputs(self, t, z):
        return {"x": z.x}


rod = Rod(al.Uniform(al.Decision(1.0, 0.5, 2.0), half_width=0.1))
problem = al.Problem(rod, grid=al.Grid(5.0, 50), minimize=al.terminal("x").mean)
"""


def test_a_model_that_diverges_ends_with_its_reason_and_a_page(here: Path):
    (here / "bar.py").write_text(DIVERGING)
    result = aleator("run", "bar.py")
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit), "no traceback of ours"
    told = said(result)
    assert "is not finite: output 'x' from t = 1.3 s on" in told
    assert "cannot convert" not in told
    assert "model failed" in (here / "results/bar/report.html").read_text()


MODEL_BESIDE = """import aleator as al
from bars import bar

study = al.Study(bar(), title="Bar", samples=500)
"""


@pytest.fixture
def run_of_a_module(here: Path) -> Path:
    """The folder of a run whose study stands in `bar.py`, and its model in another module, which stays."""
    (here / "bar.py").write_text(MODEL_BESIDE)
    result = aleator("run", "bar.py")
    assert result.exit_code == 0, result.output
    return here / "results/bar"


@pytest.mark.parametrize(
    ("lose", "why"),
    [
        (Path.unlink, "The study of 'results/bar' has gone"),
        (lambda file: file.write_text("import nowhere_to_be_found"), "No module named 'nowhere_to_be_found'"),
        (lambda file: file.write_text("raise ValueError('no more')"), "ValueError: no more"),
        (lambda file: file.write_text("study ="), "invalid syntax"),
    ],
)
def test_where_the_study_has_gone_the_page_shows_what_the_folder_keeps(run_of_a_module: Path, lose, why: str):
    lose(Path("bar.py"))
    result = aleator("report", "results/bar", "--json")
    assert result.exit_code == 0, result.output
    found = document(result)
    assert why in found["missing"][0]
    assert "the study's title, chapters, fronts and tables are missing" in found["missing"][0]
    assert found["files"] == ["results/bar/report-so-far.html"]
    page = (run_of_a_module / "report-so-far.html").read_text()
    assert "Systems that violate stress" in page
    assert why.split("'")[0] in page
    assert aleator("validate", "results/bar", "--samples", "100").exit_code == 0
    (run_of_a_module / "designs.json").unlink()
    assert aleator("compare", "results/bar", "results/bar/../bar").exit_code == 0


@pytest.mark.filterwarnings("default::aleator.JournalWarning")
def test_where_the_model_has_gone_too_the_page_shows_the_numbers_that_were_written(here: Path, finished: Path):
    shutil.copytree(finished, here / "results")
    Record("bar.py", quick=True).write(here / "results")
    (here / "bar.py").unlink()
    sys.modules.pop("bar", None)
    sys.path[:] = [one for one in sys.path if one != str(finished.parent)]
    result = aleator("report", "results", "--json")
    assert result.exit_code == 0, result.output
    missing = " ".join(document(result)["missing"])
    assert "The study of 'results' has gone" in missing
    assert "needs the module 'bar', in which its model is written" in missing
    assert "the page shows what designs.json says" in missing
    page = (here / "results/report-so-far.html").read_text()
    objective = json.loads((here / "results/designs.json").read_text())["designs/robust"]["objective"]["value"]
    assert f"{objective:.6g}" in page
    assert "Systems that violate stress" in page
    (here / "results/designs.json").unlink()
    refused = aleator("report", "results", "--json")
    assert refused.exit_code == 2
    assert "no design in 'results' can be read" in document(refused)["errors"][0]
    sampled = aleator("validate", "results")
    assert sampled.exit_code == 2
    assert "has gone" in said(sampled)
