"""The commands that compute: run, resume, sweep and validate; what they say, keep and take from an earlier run."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import aleator as al
from aleator.cli._run import Record, staleness
from aleator.studies import load
from command_line import EDITED, NEEDED, NEEDED_NOW, STUDY, aleator, document
from command_line import finished as finished
from command_line import here as here
from command_line import interrupted_at as interrupted_at
from command_line import nothing_solved as nothing_solved

SWEEP = ("sweep", "bar.py", "--bound", "stress")


def objectives(result) -> list[float]:
    return [point["objective"] for point in document(result)["fronts"]["fronts/robust"]["points"]]


def states(folder: str) -> dict[str, str]:
    return {row["name"]: row["state"] for row in document(aleator("list", folder, "--json"))["results"]}


# --- Before anything is imported -------------------------------------------------------------------------------------


NEW = [["new", "bracket.py"], ["new", "."], ["new", "x.toml"]]


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["list"], *NEW])
def test_help_and_a_new_study_do_not_wait_for_jax(tmp_path: Path, arguments: list[str]):
    script = "import sys, atexit, aleator_command\natexit.register(lambda: print('jax' in sys.modules))\n"
    command = [sys.executable, "-c", f"{script}aleator_command.main()", *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "False", done.stderr
    assert done.returncode == (2 if arguments in NEW[1:] else 0)


# --- Run and resume --------------------------------------------------------------------------------------------------


@pytest.mark.slow
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
    assert "wrote" in result.stderr
    for name, design in before.items():
        assert told["designs"][name]["objective"] == design["objective"]
    # The front's first point is the design, under the same bound: a result asked for twice is counted once.
    assert told["recalled"] == 2


def test_designs_that_are_infeasible_are_told_among_those_that_are_solved(here: Path):
    text = STUDY[: STUDY.index("study =")] + "weak = problem.with_bound('stress', 0.01)\n"
    (here / "bar.py").write_text(text + "study = al.Study({'impossible': weak, 'robust': problem}, samples=200)\n")
    result = aleator("run", "bar.py", "--json")
    assert result.exit_code == 1, result.output
    assert document(result)["verdict"].startswith("Not solved: 1 of 2 designs are solved; 'impossible' is infeasible: ")
    assert "1 of 2 designs are solved" in (here / "results/bar/report.html").read_text()
    sampled = aleator("validate", "bar.py", "--samples", "200", "--design", "impossible", "--json")
    assert sampled.exit_code == 1
    assert "infeasible" in document(sampled)["designs"]["impossible"]["why"]


# --- Sweep -----------------------------------------------------------------------------------------------------------


def test_a_sweep_that_was_interrupted_tells_what_waits_and_is_resumed_from_its_folder(here: Path, interrupted_at):
    values = [0.5, 0.55, 0.6, 0.8]
    interrupted_at(3)
    result = aleator(*SWEEP, "--values", ",".join(map(str, values)), "--out", "there", "--json")
    assert result.exit_code == 130, result.output
    (told,) = document(result)["errors"]
    assert told.startswith("Interrupted during 'front over stress': ")
    assert "2 results are kept in 'there'" in told
    names = [f"pareto, at stress = {value}" for value in values]
    assert states("there") == dict(zip(names, ["done", "done", "interrupted"], strict=False))
    assert "'front over stress' is not finished" in document(aleator("report", "there", "--json"))["missing"][0]
    assert "2 of 4 points are available" in (here / "there/report-so-far.html").read_text()

    interrupted_at(0)
    resumed = aleator("resume", "there", "--json")
    assert resumed.exit_code == 0, resumed.output
    assert document(resumed)["recalled"] == 2
    np.testing.assert_allclose(objectives(resumed), NEEDED / np.array(values), rtol=1e-6)
    undisturbed = al.pareto(load("bar.py").problems["robust"], "stress", values)
    assert objectives(resumed) == undisturbed.objectives.tolist()
    assert set(states("there").values()) == {"done"}


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
    assert not designs["robust"]["solved_anew"]
    assert designs["nominal"]["status"].startswith("solved"), "however often its limit breaks"
    assert document(aleator(*arguments))["designs"] == designs


@pytest.mark.filterwarnings("ignore::aleator.JournalWarning")
def test_a_design_that_the_folder_has_lost_is_solved_beside_the_others(here: Path, finished: Path):
    lost = next(one for one in al.load("results").entries if one.name == "designs/robust")
    (here / "results" / lost.file).unlink()
    designs = document(aleator("validate", "results", "--samples", "200", "--json"))["designs"]
    assert {name: one["solved_anew"] for name, one in designs.items()} == {"nominal": False, "robust": True}


def test_a_run_is_stale_when_a_module_that_its_study_imports_was_edited(here: Path):
    (here / "bar.toml").write_text('problem = "bar:problem"\n')
    record = Record("bar.toml")
    record.made()
    (here / "results").mkdir()
    record.write(here / "results")
    assert not staleness(here / "results")
    (here / "bar.py").write_text(EDITED)
    assert "is stale" in staleness(here / "results")


def test_a_run_whose_study_was_edited_is_stale_until_it_runs_again(here: Path, finished: Path, interrupted_at):
    arguments = ("validate", "results", "--samples", "200", "--json")
    assert not document(aleator("list", "results", "--json"))["stale"]
    (here / "bar.py").write_text(EDITED)
    assert document(aleator("list", "results", "--json"))["stale"]
    refused = aleator(*arguments)
    assert refused.exit_code == 2
    assert "'results' is stale" in document(refused)["errors"][0]
    interrupted_at(1)
    assert aleator("resume", "results").exit_code == 130
    interrupted_at(0)
    robust = document(aleator(*arguments))["designs"]["robust"]
    assert robust["solved_anew"], "no design of the earlier form goes by the name of this one"
    assert robust["decisions"]["width"]["value"] == pytest.approx(NEEDED_NOW / 0.5, rel=1e-6)
    assert aleator("resume", "results").exit_code == 0
    again = document(aleator(*arguments))["designs"]
    assert list(again) == ["robust"]
    assert not again["robust"]["solved_anew"]


def test_results_of_a_study_that_is_edited_back_have_their_names_again(here: Path, finished: Path):
    def names():
        return {one["name"] for one in document(aleator("list", "results", "--json"))["results"]} - {""}

    before = names()
    assert {"designs/robust", "evidence/robust"} <= before
    first = (here / "bar.py").read_text()
    for text in (EDITED, first):
        (here / "bar.py").write_text(text)
        assert aleator("resume", "results").exit_code == 0
    assert names() >= before
