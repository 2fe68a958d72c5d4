"""The commands that compute nothing: list, report and compare; whose folder it is, and what is refused."""

import json
import shutil
from pathlib import Path

import pytest

import aleator as al
from aleator.cli._run import Record
from aleator.journalling import FILE, Entry
from aleator.reporting import only_writer
from command_line import EDITED, NEEDED, NEEDED_NOW, STUDY, aleator, document, said
from command_line import finished as finished
from command_line import here as here
from command_line import interrupted_at as interrupted_at
from command_line import nothing_solved as nothing_solved

SWEEP = ("sweep", "bar.py", "--bound", "stress", "--values")


def test_the_list_tells_names_the_dead_and_what_is_lost(finished: Path):
    told, loaded = said(aleator("list", "results")), al.load("results")
    for row in document(aleator("list", "results", "--json"))["results"]:
        assert row["load"] in told
        assert type(loaded[row["load"]]) is type(loaded[row["name"] or row["load"]])
    entries = loaded.entries
    (finished / entries[0].file).unlink()
    (finished / entries[1].file).write_bytes(b"")
    with (finished / FILE).open("a") as file:
        file.write(Entry.begun("1", "solve Bar", {}).line())
    before = (finished / FILE).read_bytes()

    def states() -> list[str]:
        return [row["state"] for row in document(aleator("list", "results", "--json"))["results"]]

    assert states() == ["lost", "lost", *["done"] * (len(entries) - 2), "interrupted"]
    told = said(aleator("list", "results"))
    assert "cannot be read (No such file" in told
    assert "is not what was written there" in told
    with only_writer(finished):
        assert states()[-1] == "running"
    assert (finished / FILE).read_bytes() == before


# --- Report ----------------------------------------------------------------------------------------------------------


def test_a_report_of_a_run_that_was_stopped_says_what_is_missing(here: Path, interrupted_at):
    interrupted_at(1)
    result = aleator("run", "bar.py", "--json")
    assert result.exit_code == 130, result.output
    assert document(result)["verdict"].startswith("Stopped early: Nothing to build yet.")
    result = aleator("report", "results/bar", "--json")
    assert result.exit_code == 2, result.output
    assert "nothing is finished yet in 'results/bar'" in document(result)["errors"][0]

    interrupted_at(2)
    assert aleator("run", "bar.py").exit_code == 130
    told = document(aleator("report", "results/bar", "--json"))
    assert told["files"] == ["results/bar/report-so-far.html"]
    assert [missing.partition(" is not")[0] for missing in told["missing"]] == ["'design robust'"]
    assert "nominal" in (here / "results/bar/report-so-far.html").read_text()


def test_a_page_is_written_without_computing_or_noting_anything_and_after_an_edit_beside_the_complete_one(
    here: Path, finished: Path, nothing_solved
):
    noted = (finished / FILE).read_bytes()
    assert document(aleator("report", "results", "--out", "page.html", "--json"))["missing"] == []
    page = Path("page.html").read_text()
    assert "Optimum against the limit of stress" in page
    assert "Systems that violate stress" in page
    complete = (finished / "report.html").read_bytes()
    (here / "bar.py").write_text(STUDY.replace("=4000", "=16000"))
    result = aleator("report", "results", "--json")
    stale, absent = document(result)["missing"]
    assert "'results' is stale" in stale
    assert "evidence on nominal" in absent
    assert document(result)["files"] == ["results/report-so-far.html"]
    assert "report.html stays as it is" in said(result)
    (here / "bar.py").write_text(EDITED)
    assert "'results' is stale" in document(aleator("report", "results", "--json"))["errors"][0]
    assert (finished / "report.html").read_bytes() == complete
    assert (finished / FILE).read_bytes() == noted


def test_a_run_that_was_killed_is_compared_by_what_its_journal_has(here: Path, finished: Path):
    shutil.copytree(finished, here / "killed")
    (here / "killed/designs.json").unlink()
    differences = document(aleator("compare", "results", "killed", "--json"))["differences"]
    assert differences["designs/robust"] == differences["designs/nominal"] == {"killed": []}


@pytest.mark.slow
def test_runs_are_compared_by_their_numbers(here: Path, finished: Path):
    shutil.copytree(finished, here / "copy")
    for module in ("bar", "zoo_again"):  # a study of the same text in another file has the same numbers
        (here / f"{module}.py").write_text(STUDY)
    assert aleator("run", "zoo_again.py", "--out", "again").exit_code == 0
    (here / "bar.py").write_text(EDITED)
    assert aleator("run", "bar.py", "--out", "other").exit_code == 0
    result = document(aleator("compare", "results", "copy", "again", "other", "--json"))
    robust = result["designs"]["designs/robust"]
    assert robust["other"]["objective"]["value"] == pytest.approx(NEEDED_NOW / 0.5, rel=1e-6)
    assert robust["results"]["objective"]["value"] == pytest.approx(NEEDED / 0.5, rel=1e-6)
    differences = result["differences"]["designs/robust"]
    assert (differences["copy"], differences["again"]) == ([], [])
    assert {"width", "Objective", "the problem"} <= set(differences["other"])
    assert result["differences"]["designs/nominal"] == {"copy": [], "again": [], "other": None}
    told = said(aleator("compare", "results", "copy"))
    assert "designs/robust: results and copy are equal." in told
    assert "Systems that violate stress" in told
    designs = json.loads((here / "copy/designs.json").read_text())
    designs["designs/robust"]["digest"] = "of other equations"
    (here / "copy/designs.json").write_text(json.dumps(designs))
    told = said(aleator("compare", "results", "copy", "other"))
    assert "designs/robust: results and copy differ in the equations of the model." in told
    assert "designs/nominal: other names no such design." in told


def test_neither_a_sweep_nor_a_run_nor_another_study_replaces_what_a_folder_has(
    here: Path, finished: Path, nothing_solved
):
    for name, record in (
        ("results-over-stress", Record("bar.py", bound="stress", values=(0.5,))),
        ("results/bar", Record("bar.toml")),
    ):
        (here / name).mkdir()
        record.write(here / name)
    (here / "bar.toml").write_text("")
    files = {file: file.read_bytes() for file in here.rglob("res*/**/*") if file.is_file()}
    for command, advice in (
        ((*SWEEP, "0.5", "--out", "results"), "name another folder by --out"),
        (("run", "bar.py"), "name another folder by --out"),
        (("validate", "bar.py"), "bar.toml` are in 'results/bar'"),
    ):
        result = aleator(*command)
        assert result.exit_code == 2, result.output
        assert advice in said(result)
    assert {file: file.read_bytes() for file in files} == files


# --- Refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("run", "bar.py", "--workers", "2"), "nothing to share among processes: expected `sweeps` or `wishes`"),
        ((*SWEEP, "1;2"), "expected numbers with commas between them"),
        ((*SWEEP, "1", "--design", "robot"), "Did you mean 'robust'"),
        (("runn", "bar.py"), "invalid choice: 'runn'"),
        (("resume", "nowhere"), "There is no 'command.json' in 'nowhere'"),
        (("validate", "empty"), "there is no finished design in 'empty'"),
        (("compare", "empty"), "two folders or more"),
        (("compare", "empty", "empty"), "each once; received empty and empty"),
    ],
)
def test_whatever_is_refused_is_told_and_stdout_is_a_document(here: Path, arguments: tuple[str, ...], told: str):
    (here / "empty").mkdir()
    (here / "bar.py").write_text(EDITED)
    result = aleator(*arguments, "--json")
    assert result.exit_code == 2
    refusal = document(result)
    assert (refusal["exit_code"], refusal["command"]) == (2, arguments[0])
    assert told in refusal["errors"][0]
    assert " ".join(told.split()[:2]) in " ".join(result.stderr.split())
