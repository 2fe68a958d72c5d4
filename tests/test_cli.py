"""The command line: how it exits, what it keeps and what it prints."""

from pathlib import Path

import pytest

import aleator as al
from aleator import studies
from aleator.cli._terminal import table_text
from aleator.reporting import Table, Verdict, values_text
from aleator.studies import Draft
from command_line import aleator, said
from rehearsed_runs import STAGES, Rehearsal

BRACKETS, PARTS = "[bold]a[/] [/wrong] [0] :smile: \\[x] {task}", ("caption", "head", "cell", "note", "headline")


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch):
    """A run of a study as the command begins it."""

    def run(study: Rehearsal, *arguments: str):
        monkeypatch.setattr(studies, "load", lambda name, quick: study)
        return aleator("run", "rehearsal", *arguments)

    return run


def stopped(accident: BaseException, where: str = "in the second stage") -> Rehearsal:
    """A study that goes wrong somewhere."""

    def at(moment: str) -> None:
        if moment == where:
            raise accident

    return Rehearsal(at)


@pytest.mark.parametrize(
    ("study", "code", "word", "finished"),
    [
        (Rehearsal(), 0, "as far as it went", "first second third"),
        (stopped(al.SolveError("'travel' is violated at t = 1.2 s")), 1, "'second': 'travel' is violated", "first"),
        (stopped(MemoryError("Unable to allocate 48 GiB")), 1, "48 GiB", "first"),
        (stopped(KeyboardInterrupt()), 130, "kept", "first"),
    ],
    ids=["finished", "unsolved", "memory", "interrupted"],
)
def test_the_exit_code_tells_what_went_wrong_and_what_was_finished_is_kept(
    run, tmp_path: Path, study, code, word, finished
):
    result = run(study, "--out", str(tmp_path / "new" / "folder"))
    assert result.exit_code == code
    assert word in said(result)
    page = (tmp_path / "new" / "folder" / "report.html").read_text(encoding="utf-8")
    assert [stage for stage in STAGES if f"{stage} is done" in page] == finished.split()
    assert ("as far as it went" in page) == (code == 0)
    assert (tmp_path / "new" / "folder" / "results.nc").exists()


class Bracketed(Rehearsal):
    """A study whose texts look like markup, or like an emoji."""

    def chapter(self, page: Draft) -> None:
        page.section(BRACKETS)
        page.progress(BRACKETS, 0, 2)
        page.tables.append(
            Table(f"caption {BRACKETS}", [f"head {BRACKETS}"], [[f"cell {BRACKETS}"]], f"note {BRACKETS}")
        )
        page.recommend(Verdict("good", "Done", f"headline {BRACKETS}"))


def test_text_in_square_brackets_is_printed_as_it_is(run, monkeypatch, tmp_path: Path):
    monkeypatch.setenv("COLUMNS", "300")
    monkeypatch.chdir(tmp_path)
    told = run(Bracketed(), "--out", BRACKETS).output
    for text in (f"{BRACKETS}: 0.0 s", f"wrote {BRACKETS}/", *(f"{part} {BRACKETS}" for part in PARTS)):
        assert text in told
    failed = run(stopped(al.SolveError(f"message {BRACKETS}")), "--out", BRACKETS)
    assert f"message {BRACKETS}" in failed.output


def test_a_folder_that_another_run_writes_to_is_refused_before_any_work(run, monkeypatch, tmp_path: Path):
    def taken(folder: Path):
        raise al.ProblemError(f"Another process writes into '{folder}'.")

    monkeypatch.setattr("aleator.journalling._journal.only_writer", taken)
    result = run(study := Rehearsal(), "--out", str(tmp_path))
    assert result.exit_code == 2
    assert study.begun == []
    assert "Another process" in said(result)


@pytest.mark.parametrize("width", [36, 60, 90, 200])
def test_a_table_takes_the_width_that_there_is_and_no_number_is_cut(width):
    names = ["nominal", "robust", "robust, with tolerances", "cheapest"]
    numbers = [[values_text(10.0**i * (1 + j / 7), 6, "N s/m") for j in range(len(names))] for i in range(3)]
    labels = ["damping.half_width", "Objective", "Systems that violate any limit"]
    table = Table(
        "Designs", ["", *names], [[label, *row] for label, row in zip(labels, numbers, strict=True)], "A note."
    )
    text = table_text(table, width)
    assert max(map(len, text.splitlines())) <= width
    assert all(number in text for row in numbers for number in row)
    assert (text.count("Designs"), text.count("A note.")) == (1, 1)
    assert text.count("Objective") == {36: 4, 60: 2, 90: 1, 200: 1}[width]
