"""The commands that compute nothing: list, report and compare; whose folder it is, and what is refused."""

import json
import sys
from pathlib import Path

import pytest

import aleator as al
from aleator import extending, studies
from aleator.cli._record import Record
from aleator.journalling import FILE, Entry
from aleator.reporting import Section, Table, only_writer
from aleator.studies import Stage
from command_line import EDITED, NEEDED, NEEDED_NOW, STUDY, aleator, document, said
from command_line import begun as begun
from command_line import finished as finished
from command_line import here as here
from command_line import interrupted_at as interrupted_at
from command_line import nothing_solved as nothing_solved
from test_cli import Rehearsal
from zoo import bar_problem

# --- List ------------------------------------------------------------------------------------------------------------


def test_the_list_tells_names_the_dead_and_what_is_lost(finished: Path):
    told, loaded = said(aleator("list", "results")), al.load("results")
    for name in ("designs/nominal", "designs/robust", "evidence/nominal", "evidence/robust"):
        assert name in told
    for row in document(aleator("list", "results", "--json"))["results"]:
        assert row["load"] in told
        assert type(loaded[row["load"]]) is type(loaded[row["name"] or row["load"]])
    assert loaded["designs/robust"].ok
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
    assert "its file cannot be read: No such file" in told
    assert "its file is not what was written" in told
    assert f"{len(entries) - 2} results" in told
    with only_writer(finished):
        assert states()[-1] == "running"
    assert (finished / FILE).read_bytes() == before


# --- Report ----------------------------------------------------------------------------------------------------------


def test_the_page_of_a_folder_is_written_without_computing_or_noting_anything(finished: Path, nothing_solved):
    before = (finished / FILE).read_bytes()
    result = aleator("report", "results", "--out", "page.html", "--json")
    assert result.exit_code == 0, result.output
    assert document(result)["missing"] == []
    assert (finished / FILE).read_bytes() == before
    page = Path("page.html").read_text()
    assert "Optimum against the limit of stress" in page
    assert "Systems that violate stress" in page


def test_a_report_of_a_run_that_was_stopped_says_what_is_missing(here: Path, interrupted_at):
    interrupted_at(1)
    result = aleator("run", "bar.py", "--json")
    assert result.exit_code == 130, result.output
    assert document(result)["verdict"].startswith("Interrupted: No design was finished")
    assert document(result)["errors"][0].startswith("Interrupted during 'design nominal'")
    result = aleator("report", "results/bar", "--json")
    assert result.exit_code == 2, result.output
    told = document(result)
    assert "nothing is finished yet in 'results/bar'" in told["errors"][0]
    assert "'design nominal' is not finished" in told["missing"][0]
    assert "'evidence on nominal' is not finished: what it follows from is missing." in told["missing"]
    assert told["files"] == []

    interrupted_at(1)
    swept = aleator("sweep", "bar.py", "--bound", "stress", "--values", "0.5", "--out", "there", "--json")
    assert document(swept)["verdict"].startswith("Interrupted: No point over stress")
    assert "'front over stress' is not finished" in document(aleator("report", "there", "--json"))["missing"][0]

    interrupted_at(2)
    assert aleator("run", "bar.py").exit_code == 130
    complete = (here / "results/bar/report.html").read_bytes()
    result = aleator("report", "results/bar", "--json")
    assert result.exit_code == 0, result.output
    told = document(result)
    assert told["files"] == ["results/bar/report-so-far.html"]
    assert [missing.partition(" is not")[0] for missing in told["missing"]] == [
        *("'design robust'", "'evidence on nominal'", "'evidence on robust'"),
        *("'front over stress'", "'evidence along the front over stress'"),
    ]
    assert "nominal" in (here / "results/bar/report-so-far.html").read_text()
    assert (here / "results/bar/report.html").read_bytes() == complete


def test_after_an_edit_the_page_is_written_beside_the_complete_one(here: Path, finished: Path, nothing_solved):
    complete = (finished / "report.html").read_bytes()
    for text, told in (
        (EDITED, "an earlier form of the study"),
        (STUDY.replace("=4000", "=6000"), "evidence on robust"),
    ):
        (here / "bar.py").write_text(text)
        result = aleator("report", "results", "--json")
        assert result.exit_code == 0, result.output
        assert told in " ".join(document(result)["missing"])
        assert document(result)["files"] == ["results/report-so-far.html"]
        assert "report.html stays as it is" in said(result)
        assert (finished / "report.html").read_bytes() == complete
    assert document(aleator("report", "results", "--out", "results/report.html", "--json"))["exit_code"] == 0
    assert (finished / "report.html").read_bytes() != complete


@pytest.mark.parametrize("workers", [0, 2])
def test_a_front_without_one_of_its_points_is_on_the_page_with_the_others(
    finished: Path, begun: list[int], nothing_solved, workers: int
):
    # By workers, all points start where the design does: the second is not that of a single process.
    Record("bar.py", workers=workers).write(finished)
    (lost,) = (entry.file for entry in al.load("results").entries if entry.name == "stress = 0.6")
    (finished / lost).write_bytes(b"") if workers else (finished / lost).unlink()
    result = aleator("report", "results", "--json")
    assert result.exit_code == 0, result.output
    (missing,) = document(result)["missing"]  # the evidence on the other points is there
    why = "is not what was written there" if workers else "cannot be read (No such file or directory)"
    assert missing == f"'front over stress' is not finished: 'results/{lost}' {why}."
    page = (finished / "report-so-far.html").read_text()
    assert "1 of 2 points of the front over stress are available" in page
    assert "Optimum against the limit of stress" in page


def thrice(number: float, progress) -> float:
    progress("thrice", 0, 1)
    return 3.0 * number


class Further(Rehearsal):
    """A study with work of its own, after a design."""

    title = "With work of its own"

    def __init__(self) -> None:
        super().__init__()
        self.found: dict[str, al.Solution] = {}
        self.others, self.thrice = 0, 0.0

    @property
    def problems(self):
        return {"robust": bar_problem()}

    @property
    def stages(self):
        return {"design": Stage(self.solve, 1.0), "other": Stage(self.other, 1.0)}

    def solve(self, progress):
        self.found["robust"] = al.solve(self.problems["robust"])

    def other(self, progress):
        self.thrice = extending.kept("thrice", thrice, self.found["robust"].objective, progress=self.noted)

    def noted(self, task, done, total):
        self.others += 1

    def results(self):
        return {"designs": self.found}

    def sections(self):
        return [Section("Own", [Table("Own", ["a"], [[f"thrice {self.thrice:.4f}"]])])]

    save, write_page = studies.AbstractStudy.save, studies.AbstractStudy.write_page


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
    assert [study.others for study in made] == [1, 0]
    lines = (here / "there" / FILE).read_text().splitlines(keepends=True)
    (here / "there" / FILE).write_text("".join(line for line in lines if "work thrice" not in line))
    result = aleator("report", "there", "--json")
    assert document(result)["missing"] == ["'other' is not finished: work thrice is missing."]
    assert "Not reached or not completed: other." in (here / "there/report-so-far.html").read_text()
    checked = aleator("check", "further", "--json")
    assert checked.exit_code == 0, checked.output
    robust = document(checked)["problems"]["robust"]
    assert robust["points"] >= 4
    assert robust["samples"] is None


def test_where_the_study_has_gone_the_page_shows_what_the_folder_keeps(here: Path, finished: Path):
    study = here / "bar.py"
    for lose, why in (
        (lambda: study.write_text("raise ValueError('no more')"), "ValueError: no more"),
        (study.unlink, "The study of 'results' has gone"),
    ):
        lose()
        result = aleator("report", "results", "--json")
        assert result.exit_code == 0, result.output
        told = document(result)
        assert why in told["missing"][0]
        assert "the study's title, chapters, fronts and tables are missing" in told["missing"][0]
        assert told["files"] == ["results/report-so-far.html"]
        page = (finished / "report-so-far.html").read_text()
        assert "Systems that violate stress" in page
        assert why.split("'")[0] in page
    assert aleator("validate", "results", "--samples", "200").exit_code == 0
    (finished / "designs.json").unlink()
    assert aleator("compare", "results", "results/../results").exit_code == 0


OWN_MODEL = """import aleator as al

class Bar(al.AlgebraicSystem):
    width: al.Number

    def outputs(self):
        return {"mass": self.width}

problem = al.Problem(Bar(al.Uniform(al.Decision(4.0, 0.1, 10.0), half_width=0.1)), minimize=al.output("mass").mean)
study = al.Study({"robust": problem}, samples=200)
"""


@pytest.mark.filterwarnings("default::aleator.JournalWarning")
def test_where_the_model_has_gone_too_the_page_shows_the_numbers_that_were_written(here: Path):
    (here / "bar.py").write_text(OWN_MODEL)
    assert aleator("run", "bar.py", "--out", "results").exit_code == 0
    (here / "bar.py").unlink()
    sys.modules.pop("bar", None)
    result = aleator("report", "results", "--json")
    assert result.exit_code == 0, result.output
    missing = " ".join(document(result)["missing"])
    assert "The study of 'results' has gone" in missing
    assert "needs the module 'bar', in which its model is written" in missing
    assert "the page shows what designs.json says" in missing
    objective = json.loads((here / "results/designs.json").read_text())["designs/robust"]["objective"]["value"]
    assert f"{objective:.6g}" in (here / "results/report-so-far.html").read_text()
    (here / "results/designs.json").unlink()
    refused = aleator("report", "results", "--json")
    assert refused.exit_code == 2
    assert "no design in 'results' can be read" in document(refused)["errors"][0]
    sampled = aleator("validate", "results")
    assert sampled.exit_code == 2
    assert "has gone" in said(sampled)


def test_what_a_script_has_kept_needs_no_study(here: Path):
    with al.journal("kept"):
        al.solve(bar_problem())
    found = document(aleator("validate", "kept", "--samples", "200", "--json"))["designs"]
    assert found["solve Bar 1"]["samples"] == 200
    page = aleator("report", "kept", "--out", "kept.html")
    assert page.exit_code == 0, page.output
    assert "solve Bar 1" in (here / "kept.html").read_text()
    (here / "empty").mkdir()
    assert "there is no finished design in 'empty'" in said(aleator("validate", "empty"))
    assert "there is no journal in 'empty'" in said(aleator("report", "empty"))


# --- Compare ---------------------------------------------------------------------------------------------------------


def test_runs_are_compared_design_by_design_and_by_what_they_follow_from(here: Path, finished: Path):
    (here / "bar.py").write_text(EDITED)
    assert aleator("run", "bar.py", "--out", "other").exit_code == 0
    result = aleator("compare", "results", "other", "--json")
    assert result.exit_code == 0, result.output
    robust = document(result)["designs"]["designs/robust"]
    assert robust["other"]["objective"]["value"] == pytest.approx(NEEDED_NOW / 0.5, rel=1e-6)
    assert robust["results"]["objective"]["value"] == pytest.approx(NEEDED / 0.5, rel=1e-6)
    assert document(result)["differences"]["designs/robust"] == {"other": ["numbers of the problem"]}
    told = said(aleator("compare", "results", "other"))
    assert "designs/robust: results and other differ in numbers of the problem." in told
    assert "Systems that violate stress" in told
    assert "follow from the same equations, code, numbers and versions" in said(aleator("compare", "other", "other"))
    assert "two folders or more" in said(aleator("compare", "other"))
    (here / "empty").mkdir()
    assert "there are no results in 'empty'" in said(aleator("compare", "other", "empty"))


def test_a_run_is_compared_with_a_sweep_by_what_their_designs_are(here: Path, finished: Path):
    sweep = ("sweep", "bar.py", "--bound", "stress", "--values", "0.5,0.6", "--out", "sweep")
    assert aleator(*sweep).exit_code == 0
    result = aleator("compare", "results", "sweep", "--json")
    assert result.exit_code == 0, result.output
    told = document(result)
    objectives = {
        name: [design and design["objective"]["value"] for design in each.values()]
        for name, each in told["designs"].items()
    }
    assert objectives == {
        "designs/nominal": [pytest.approx(2.0, rel=1e-6), None],
        "designs/robust": [pytest.approx(NEEDED / 0.5, rel=1e-6)] * 2,
        "stress = 0.6": [pytest.approx(NEEDED / 0.6, rel=1e-6)] * 2,
    }
    differences = told["differences"]
    assert [differences[name]["sweep"] for name in objectives] == [None, [], []]
    assert told["designs"]["stress = 0.6"]["results"]["evidence"]["samples"] == 4000
    assert "There as" in said(result)
    swapped = document(aleator("compare", "sweep", "results", "--json"))
    assert list(swapped["designs"])[:2] == ["stress = 0.5", "stress = 0.6"]
    assert swapped["differences"]["stress = 0.5"] == {"results": []}


# --- Whose folder it is ----------------------------------------------------------------------------------------------


def test_a_folder_belongs_to_what_began_it(here: Path):
    run, swept = Record("bar.py"), Record("bar.py", bound="stress", values=(1.0,))
    for number, (first, other, is_its_own) in enumerate(
        [
            (run, Record("bar.py", quick=True), True),
            (run, Record("./bar.py"), True),
            (run, Record("bar.toml"), False),
            (run, Record("bar"), False),
            (Record("suspension"), Record("suspension"), True),
            (run, swept, False),
            (swept, Record("bar.py", bound="stress", values=(2.0,)), True),
            (swept, Record("bar.py", bound="mass", values=(1.0,)), False),
        ]
    ):
        folder = here / f"{number}"
        folder.mkdir()
        first.write(folder)
        if is_its_own:
            other.check_owns(folder)
        else:
            with pytest.raises(al.ProblemError, match="name another folder"):
                other.check_owns(folder)
    (here / "moved").mkdir()
    (here / "bar.py").rename(here / "moved/bar.py")
    Record("moved/bar.py").check_owns(here / "0")


def test_neither_a_sweep_nor_a_run_nor_another_study_replaces_what_a_folder_has(
    here: Path, finished: Path, nothing_solved
):
    sweep = ("sweep", "bar.py", "--bound", "stress", "--values", "0.5", "--out")
    for name, record in (
        ("results-over-stress", Record("bar.py", bound="stress", values=(0.5,))),
        ("results/bar", Record("bar.toml")),
    ):
        (here / name).mkdir()
        record.write(here / name)
    (here / "bar.toml").write_text("")
    files = {file: file.read_bytes() for file in here.rglob("res*/**/*") if file.is_file()}
    for command, advice in (
        ((*sweep, "results"), "--out results-over-stress"),
        ((*sweep, "results", "--afresh"), "--out results-over-stress"),
        (("run", "bar.py", "--out", "results-over-stress"), "--out results-over-stress-py"),
        (("run", "bar.py"), "--out results/bar-py"),
        (("run", "bar.py", "--afresh"), "--out results/bar-py"),
        (("validate", "bar.py"), "The results of `aleator run bar.toml` are in 'results/bar'"),
    ):
        result = aleator(*command)
        assert result.exit_code == 2, result.output
        assert advice in said(result)
    assert {file: file.read_bytes() for file in files} == files


# --- Refusals --------------------------------------------------------------------------------------------------------

LIMITS = "al.Problem(problem.system, minimize=MASS.mean, subject_to=[STRESS.mean <= 0.4, STRESS.mean >= 0.1])"
RANGE = LIMITS.replace("STRESS.mean <= 0.4", '(STRESS.mean <= 0.4).named("range")').replace(
    "STRESS.mean >= 0.1", '(STRESS.mean >= 0.1).named("range"), (STRESS.mean <= 0.4).named("stress")'
)
BOUND = ("sweep", "bar.py", "--bound")


@pytest.mark.parametrize(
    ("command", "word"),
    [
        ((*BOUND, "strain", "--values", "1"), "strain"),
        ((*BOUND, "stress", "--values", "1;2"), "expected numbers with commas between them"),
        ((*BOUND, "stress", "--values", ","), "one finite value of the bound at least"),
        ((*BOUND, "stress", "--values", "1", "--design", "robot"), "Did you mean 'robust'"),
        ((*BOUND, "range", "--values", "0.2,0.3"), "0.2 alone cannot be the bound of 'range'"),
        ((*BOUND, "range", "--values", "0.2"), "sweep a limit of one side, or write each side"),
        (("run", "bar.py", "--workers", "2"), "nothing to share among processes: expected `sweeps` or `wishes`"),
        (("run", "suspension", "--workers", "2"), "`aleator sweep` takes --workers for a front of any study"),
    ],
)
def test_what_a_study_does_not_have_is_refused_before_any_work(here: Path, command: tuple[str, ...], word: str):
    text = STUDY.replace("= bar_problem()", f"= bar_problem()\nproblem = {RANGE}")
    (here / "bar.py").write_text(text.replace('sweeps={"stress": [0.5, 0.6]},', ""))
    result = aleator(*command)
    assert result.exit_code == 2
    assert word in said(result)
    assert not (here / "results").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("run",), "Missing argument 'study'"),
        (("validate", "bar.py", "--samples", "1"), "Invalid value for '--samples'"),
        (("new", "bar.py"), "No such option: --json"),
        (("runn", "bar.py"), "No such command 'runn'"),
        ((), "No such option: --json"),
        (("run", "suspention"), "There is no study 'suspention'"),
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
    refusal = document(result)
    assert refusal["exit_code"] == 2
    assert refusal["command"] == (arguments[0] if arguments else "")
    assert told in refusal["errors"][0]
    assert " ".join(told.split()[:2]) in " ".join(result.stderr.split())
    assert aleator(*arguments, "--json-not").stdout == ""


def test_a_study_without_proper_problems_is_refused_where_they_are_needed(monkeypatch: pytest.MonkeyPatch, here: Path):
    monkeypatch.setattr(studies, "load", lambda name, quick=False: Further())
    for problems, told in (
        ({}, "'With work of its own' declares no problems"),
        ([1], "problems by their names"),
        ({"a": 1}, "'a': expected Problem"),
    ):
        monkeypatch.setattr(Further, "problems", problems)
        for command in (("check",), ("validate",), ("sweep", "--bound", "stress", "--values", "1")):
            result = aleator(command[0], "partial", *command[1:])
            assert result.exit_code == 2
            assert told in said(result)
