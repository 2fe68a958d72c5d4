"""The commands that compute: run, resume, sweep and validate; what they say, keep and take from an earlier run."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from aleator import cli, studies
from aleator.cli._record import Record
from aleator.journalling import FILE
from aleator.studies import AbstractStudy, load
from command_line import EDITED, NEEDED, NEEDED_NOW, STUDY, aleator, document, said
from command_line import begun as begun
from command_line import finished as finished
from command_line import here as here
from command_line import interrupted_at as interrupted_at
from command_line import nothing_solved as nothing_solved
from test_cli import Rehearsal

SWEEP = ("sweep", "bar.py", "--bound", "stress")


def objectives(result, front: str = "fronts/robust") -> list[float]:
    return [point["objective"] for point in document(result)["fronts"][front]["points"]]


def states(folder: str) -> dict[str, str]:
    return {row["name"]: row["state"] for row in document(aleator("list", folder, "--json"))["results"]}


# --- Run and resume --------------------------------------------------------------------------------------------------


def test_a_run_is_resumed_as_it_was_begun_wherever_its_project_has_moved(here: Path, finished: Path, nothing_solved):
    Record("bar.py", quick=True).write(finished)
    before = json.loads((finished / "designs.json").read_text())
    (here / "moved").mkdir()
    for name in ("bar.py", "results"):
        (here / name).rename(here / "moved" / name)
    result = aleator("resume", "moved/results", "--json")
    assert result.exit_code == 0, result.output
    told = document(result)
    assert set(told) == {
        *("command", "folder", "finished", "files", "title", "verdict", "designs", "fronts", "recalled"),
        *("exit_code", "errors"),
    }
    assert told["designs"]["designs/robust"]["evidence"]["samples"] == 200, "a quick run, as it was begun"
    assert told["finished"][0] == "design nominal"
    assert "stress" in told["fronts"]["fronts/stress"]["bound"]
    assert "wrote" in result.stderr
    for name, design in before.items():
        assert told["designs"][name]["objective"] == design["objective"]
    # The front's first point is the design, under the same bound: a result asked for twice is counted once.
    assert told["recalled"] == 2
    assert "2 results were taken from an earlier run" in said(result)


def test_a_folder_that_does_not_say_how_to_go_on_is_refused(here: Path):
    record = here / "results/command.json"
    record.parent.mkdir()
    for text, words in (
        (None, "There is no 'command.json'"),
        ("{", "does not say what began the run"),
        ('{"study": 3}', "does not say what began the run"),
        ("", "The study of 'results' has gone: there is no file"),
    ):
        if text is None:
            assert cli.run_study(Rehearsal(), here / "results") == 0, "a script that runs its own study"
        elif text:
            record.write_text(text)
        else:
            Record("bar.py").write(here / "results")
            (here / "bar.py").unlink()
        result = aleator("resume", "results")
        assert result.exit_code == 2
        assert words in said(result)


def test_designs_that_are_infeasible_are_told_among_those_that_are_solved(here: Path):
    text = STUDY[: STUDY.index("study =")] + "weak = problem.with_bound('stress', 0.01)\n"
    (here / "bar.py").write_text(text + "study = al.Study({'impossible': weak, 'robust': problem}, samples=200)\n")
    result = aleator("run", "bar.py", "--json")
    assert result.exit_code == 1, result.output
    told = document(result)
    assert told["verdict"].startswith("Not solved: 1 of 2 designs are solved; 'impossible' is infeasible: ")
    assert told["errors"] == [error for error in told["errors"] if error.startswith("'impossible' is not solved")]
    page = (here / "results/bar/report.html").read_text()
    assert "1 of 2 designs are solved" in page
    for wrong in ("stopped early", "summary'", "No recommendation after an error"):
        assert wrong not in page + result.output
    sampled = aleator("validate", "bar.py", "--samples", "200", "--design", "impossible", "--json")
    assert sampled.exit_code == 1
    assert "infeasible" in document(sampled)["designs"]["impossible"]["why"]


BROKEN = """import aleator as al
import jax.numpy as jnp


class Root(al.AlgebraicSystem):
    width: al.Number

    def outputs(self):
        return {"root": jnp.sqrt(self.width - 5.0)}


problem = al.Problem(Root(al.Decision(1.0, 0.0, 2.0)), minimize=al.output("root").mean)
"""


def test_a_model_without_finite_numbers_ends_with_its_reason_and_a_page(here: Path):
    (here / "bar.py").write_text(BROKEN)
    result = aleator("run", "bar.py")
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit), "no traceback of ours"
    assert "is not finite: output 'root'" in said(result)
    assert "cannot convert" not in said(result)
    assert "model failed" in (here / "results/bar/report.html").read_text()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent as on Unix")
@pytest.mark.parametrize(
    ("begun", "command"),
    [
        ("aleator_command.main()", ["run", "waiting.py", "--json"]),
        ("aleator_command.mind_signals(); os.kill(os.getpid(), signal.SIGINT)", ["report", "there", "--json"]),
    ],
)
def test_an_early_signal_leaves_a_document(here: Path, begun: str, command: list[str]):
    """While the study is loaded, and while the package is imported."""
    (here / "waiting.py").write_text(
        "import os, signal, threading\nos.kill(os.getpid(), signal.SIGINT)\nthreading.Event().wait()\n"
    )
    program = "import os, signal; signal.signal(signal.SIGINT, signal.default_int_handler); import aleator_command; "
    done = subprocess.run(
        [sys.executable, "-c", program + begun, *command], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 130, done.stderr
    told = document(done)
    assert (told["command"], told["exit_code"]) == (command[0], 130)
    assert told["errors"][0].startswith("Interrupted")
    assert "Interrupted" in done.stderr


@pytest.mark.parametrize("name", list(studies.STUDIES))
def test_every_case_study_declares_its_problems(name: str):
    study = load(name, quick=True)
    assert type(study).problems is not AbstractStudy.problems
    if name == "clutch":  # those of the others take long to trace; their own tests solve them
        assert study.problems
        assert all(isinstance(problem, al.Problem) for problem in study.problems.values())


# --- Sweep -----------------------------------------------------------------------------------------------------------


def test_a_sweep_that_was_interrupted_tells_what_waits_and_is_resumed_from_its_folder(here: Path, interrupted_at):
    interrupted_at(3)
    result = aleator(*SWEEP, "--values", "0.5,0.55,0.6,0.8", "--out", "there", "--json")
    assert result.exit_code == 130, result.output
    told = document(result)["errors"][0]
    assert told.startswith("Interrupted during 'front over stress': ")
    assert "2 results of 'front over stress'" in told
    assert "are kept in there" in told
    rows = document(aleator("list", "there", "--json"))["results"]
    assert {row["name"]: row["state"] for row in rows} == {
        "stress = 0.5": "done",
        "stress = 0.55": "done",
        "stress = 0.6": "interrupted",
        "stress = 0.8": "waiting",
    }
    assert all(row["host"] and row["process"] for row in rows)
    assert "waiting solve Bar stress = 0.8" in said(aleator("list", "there"))
    page = aleator("report", "there", "--json")
    assert page.exit_code == 0, page.output
    assert "'front over stress' is not finished" in document(page)["missing"][0]
    assert "2 of 4 points are available" in (here / "there/report-so-far.html").read_text()

    interrupted_at(0)
    resumed = aleator("resume", "there", "--json")
    assert resumed.exit_code == 0, resumed.output
    assert document(resumed)["recalled"] == 2
    np.testing.assert_allclose(objectives(resumed), NEEDED / np.array([0.5, 0.55, 0.6, 0.8]), rtol=1e-6)
    undisturbed = al.pareto(load("bar.py").problems["robust"], "stress", [0.5, 0.55, 0.6, 0.8])
    assert objectives(resumed) == undisturbed.objectives.tolist()
    assert set(states("there").values()) == {"done"}
    assert document(aleator("report", "there", "--json"))["missing"] == []


def test_a_front_is_printed_kept_and_written_as_a_page_and_its_points_are_recalled(here: Path):
    result = aleator(*SWEEP, "--values", "0.5,0.04,0.5", "--design", "robust")
    assert result.exit_code == 0, result.output
    told = said(result)
    assert f"stress = 0.5, objective {NEEDED / 0.5:.6g}, feasible, 1 of 2, about" in told, "each bound counts once"
    assert "stress = 0.04, infeasible, violation" in told
    assert "Partly solved: 1 of 2 points over stress are solved" in told
    assert "recalled" not in told
    folder = here / "results/bar-over-stress"
    assert (folder / FILE).is_file()
    page = (folder / "report.html").read_text()
    assert "Bar: robust over stress" in page
    assert f"objective {NEEDED / 0.5:.6g}" in page
    sampled = document(aleator("validate", str(folder), "--samples", "200", "--json"))["designs"]
    assert list(sampled) == ["stress = 0.5"]

    more = aleator(*SWEEP, "--values", "0.6,0.5", "--design", "robust")
    assert re.search(r"front over stress: [\d.]+ s, 1 of 2 recalled", said(more))
    assert "1 result was taken from an earlier run; --afresh computes anew" in said(more)
    assert f"objective is {NEEDED / 0.5:.4g} at stress = 0.5 and {NEEDED / 0.6:.4g} at stress = 0.6." in said(more)
    again = said(aleator("resume", str(folder)))
    assert "front over stress: recalled from an earlier run" in again
    assert "taken from an earlier run." in again
    assert "--afresh" not in again
    afresh = document(aleator(*SWEEP, "--values", "0.6,0.001", "--design", "robust", "--afresh", "--json"))
    assert afresh["recalled"] == 0
    none = aleator(*SWEEP, "--values", "0.01", "--json", "--out", "none")
    assert none.exit_code == 1, none.output
    assert "No point over stress is solved" in document(none)["verdict"]
    assert "No recommendation" not in none.output


def test_the_command_line_says_how_many_workers_share_the_work_before_the_study_does(
    here: Path, finished: Path, begun: list[int]
):
    result = aleator(*SWEEP, "--values", "0.5,0.6", "--out", "there", "--workers", "2", "--json")
    assert result.exit_code == 0, result.output
    with ThreadPoolExecutor(2) as executor:
        front = al.pareto(load("bar.py").problems["robust"], "stress", [0.5, 0.6], executor=executor)
    assert objectives(result) == front.objectives.tolist()
    assert aleator("resume", "there").exit_code == 0
    assert aleator("resume", "there", "--workers", "4").exit_code == 0
    assert begun == [2, 2, 4]
    (here / "bar.py").write_text(STUDY.replace("samples=4000,", "samples=4000, workers=3,"))
    assert aleator(*SWEEP, "--values", "0.5", "--out", "there").exit_code == 0
    assert begun[3:] == [3]
    assert Record("bar.py").made().workers == 3
    assert Record("bar.py", workers=5).made().workers == 5
    arguments = ("--samples", "200", "--seed", "11", "--json")
    shutil.copytree(finished, here / "other")
    alone = aleator("validate", "results", *arguments)
    shared = aleator("validate", "other", *arguments, "--workers", "2")
    assert begun[4:] == [2]
    assert document(alone)["designs"] == document(shared)["designs"]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal")
def test_a_sweep_that_is_killed_is_resumed_from_its_folder_by_processes_down_to_the_last_bit(
    here: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(__file__).parent), *sys.path]))
    arguments = [*SWEEP, "--values", "0.5,0.55,0.6,0.65,0.7,0.75,0.8,0.85", "--workers", "2"]
    journal = here / "there" / FILE
    command = [sys.executable, "-m", "aleator", *arguments, "--out", "there"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as run:
        while run.poll() is None and not (journal.exists() and b'"state": "done"' in journal.read_bytes()):
            pass
        run.send_signal(signal.SIGKILL)
    assert run.returncode == -signal.SIGKILL
    resumed = aleator("resume", "there", "--json")
    assert document(resumed)["recalled"] >= 1
    assert objectives(resumed) == objectives(aleator(*arguments, "--out", "whole", "--json"))


# --- Validate --------------------------------------------------------------------------------------------------------


def test_fresh_evidence_is_counted_on_the_designs_of_a_folder(finished: Path, nothing_solved):
    arguments = ("validate", "results", "--samples", "4000", "--seed", "5", "--json")
    result = aleator(*arguments)
    assert result.exit_code == 0, result.output
    designs = document(result)["designs"]
    # The nominal bar carries the mean load at its limit: half of the symmetric loads are beyond it.
    share = designs["nominal"]["violations"]["stress"]
    assert share["lower"] < 0.5 < share["upper"]
    assert designs["robust"]["violations"]["stress"]["count"] == 0
    told = tuple(designs["robust"][name] for name in ("solved", "origin", "differs"))
    assert told == (False, "taken from the folder.", None)
    assert "design nominal: taken from the folder." in said(result)
    before = (finished / FILE).read_bytes()
    assert document(aleator(*arguments))["designs"] == designs
    assert (finished / FILE).read_bytes() == before
    alone = document(aleator("validate", "results", "--samples", "200", "--design", "robust", "--json"))
    assert list(alone["designs"]) == ["robust"]


def test_designs_that_are_not_there_are_solved_before_they_are_sampled(here: Path):
    result = aleator("validate", "bar.py", "--samples", "200", "--design", "robust")
    assert result.exit_code == 0, result.output
    assert "Systems that violate limits" in result.output
    assert "design robust: solved, because the folder does not have it." in said(result)
    assert states("results/bar")["robust"] == "done"


@pytest.mark.filterwarnings("always::aleator._core.errors.JournalWarning")
def test_a_design_whose_file_has_gone_is_told_to_be_solved_again(finished: Path):
    (lost,) = (entry.file for entry in al.load("results").entries if entry.name == "designs/robust")
    (finished / lost).unlink()
    found = document(aleator("validate", "results", "--samples", "200", "--design", "robust", "--json"))
    design = found["designs"]["robust"]
    assert design["origin"] == "solved again, because its file in the folder has gone or is damaged."
    assert (design["solved"], design["differs"]) == (True, None)


def test_evidence_on_designs_of_an_edited_study_says_that_they_are_not_those_of_the_run(here: Path, finished: Path):
    shutil.copytree(finished, here / "before")
    (here / "bar.py").write_text(EDITED)
    arguments = ("validate", "results", "--samples", "200", "--design", "robust")
    first, again = aleator(*arguments, "--json"), said(aleator(*arguments))
    other = "it is not the design that the run found."
    told = "(numbers of the problem): " + other
    changed = f"solved anew, because what it follows from has changed since the folder's run {told}"
    assert f"design robust: {changed}" in said(first)
    assert "look at: design robust: taken from the folder, where it was solved after" in again
    assert other in again
    design = document(first)["designs"]["robust"]
    assert (design["solved"], design["differs"]) == (True, ["numbers of the problem"])
    assert design["origin"].endswith(told)
    assert design["decisions"]["width"]["value"] == pytest.approx(NEEDED_NOW / 0.5, rel=1e-6)
    assert f"width │ {NEEDED_NOW / 0.5:.5f}" in again
    assert al.load("results")["designs/robust"].objective == pytest.approx(NEEDED / 0.5, rel=1e-6)
    assert al.load("results")["robust"].objective == pytest.approx(NEEDED_NOW / 0.5, rel=1e-6)
    compared = aleator("compare", "before", "results", "--json")
    assert list(document(compared)["later"].values()) == [{}, {"designs/robust": ["numbers of the problem"]}]
    assert "has a later design of this name, which `aleator validate` has solved" in said(compared)

    # Once the study has run again, its designs are those of the run.
    assert aleator("run", "bar.py", "--out", "results").exit_code == 0
    assert "design robust: taken from the folder. " in said(aleator(*arguments))
    later = document(aleator("compare", "before", "results", "--json"))["later"]
    assert list(later.values()) == [{}, {}]


def test_points_of_an_edited_study_are_told_as_the_run_s_until_it_is_swept_again(here: Path):
    name, sampling = "stress = 0.5", ("validate", "there", "--samples", "200", "--json")
    for text, needed in ((STUDY, NEEDED), (EDITED, NEEDED_NOW)):
        (here / "bar.py").write_text(text)
        if needed == NEEDED_NOW:
            early = aleator(*sampling)
            told = "taken from the folder, where the run found it. The study declares another problem"
            assert document(early)["designs"][name]["origin"].startswith(told)
            assert f"look at: design {name}: taken" in said(early)
            assert document(early)["designs"][name]["objective"]["value"] == pytest.approx(NEEDED / 0.5, rel=1e-6)
        assert aleator(*SWEEP, "--values", "0.5", "--out", "there").exit_code == 0
        sampled = document(aleator(*sampling))["designs"]
        assert list(sampled) == [name]
        assert sampled[name]["origin"] == "taken from the folder."
        compared = document(aleator("compare", "there", "there", "--json"))["designs"][name]["there"]
        told = sampled[name]["objective"]["value"], compared["objective"]["value"], al.load("there")[name].objective
        assert told == pytest.approx((needed / 0.5,) * 3, rel=1e-6)
