"""What every study has by its declaration: stages that count once they end, files, and a page that is honest.

A study whose members are of the wrong kind, or fail, ends with one sentence, and nothing found is lost.
"""

import json
import math
from functools import cache
from types import SimpleNamespace

import pytest
import xarray

import aleator as al
from aleator import extending as ext
from aleator.studies import STUDIES, load
from zoo import bar_problem


@cache
def solved():
    return al.solve(bar_problem())


def nothing():
    """A second stage that finds nothing."""


class Two(ext.AbstractStudy):
    """A design, and a second stage that does what it is given."""

    title = "Two stages"
    glossary = (("x", "What decays."),)
    left_out = ""

    def __init__(self, second=nothing):
        self.second, self.ran, self.design = second, [], None

    @property
    def stages(self):
        return {"design": ext.Stage(self.find, 1.0), "second": ext.Stage(self.go_on, 2.0)}

    def find(self, progress):
        progress("solving", 0, 1)
        self.ran.append("design")
        self.design = solved()

    def go_on(self, progress):
        self.ran.append("second")
        self.second()

    def cut_short(self):
        if "second" in self.ran and "second" not in self.finished:
            yield "Of the second, half is kept."

    def results(self):
        return {"design": self.design}

    def verdict(self):
        return ext.Verdict("good", "Build", "It decays.", ["Build it."], [ext.Card("Rate", "1.1 1/s")])

    def tables(self):
        return [ext.Table("Found", ["what"], [["design"]])] if self.design else []

    def sections(self):
        return [ext.Section("The decay", self.tables()), ext.Section("Nothing", [])]


def failing(error):
    def fail():
        raise error

    return fail


def finished(study):
    for stage in study.stages:
        study.run(stage)
    return study


def headings(study):
    return [one.heading for one in study.page().sections]


def unfinished(study):
    (text,) = next(one for one in study.page().sections if one.heading == "This run").blocks
    return text.paragraphs


def run(study, folder, capsys):
    """The exit code, and what is said on the way and at the end."""
    code = ext.run_study(study, folder)
    captured = capsys.readouterr()
    return code, " ".join(captured.err.split()), " ".join(captured.out.split())


def page_of(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def saved_objective(folder):
    return json.loads((folder / "designs.json").read_text(encoding="utf-8"))["design"]["objective"]["value"]


# --- Studies that are right ------------------------------------------------------------------------------------------


def test_a_study_that_came_to_its_end_has_its_sections_its_files_and_the_glossary(tmp_path):
    study = finished(Two())
    assert study.finished == ("design", "second")
    assert headings(study) == ["The decay", "Where this comes from", "How to read this"]
    assert study.page().sections[-1].blocks[-1].rows == study.glossary
    assert study.headline() == "Build: It decays."
    study.left_out = "the sweep"
    assert study.page().verdict.headline == "It decays. This was a quick run, without the sweep."
    study.save(tmp_path)
    page = study.write_page(tmp_path)
    assert "It decays." in page.read_text(encoding="utf-8")
    assert saved_objective(tmp_path) == study.design.objective
    # An old page goes with its results.
    study.save(tmp_path)
    assert not page.exists()
    assert unfinished(Two()) == ["Not reached or not completed: design and second."]


def test_a_stage_that_was_cut_short_keeps_what_it_found_and_is_not_finished():
    study = Two(lambda: ext.stop_if_interrupted(SimpleNamespace(interrupted=True)))
    study.run("design")
    with pytest.raises(KeyboardInterrupt):
        study.run("second")
    assert study.finished == ("design",)
    assert unfinished(study) == ["Not reached or not completed: second.", "Of the second, half is kept."]


@pytest.mark.parametrize("name", STUDIES)
def test_every_study_of_the_list_begins_with_nothing_and_a_quick_run_does_less(name):
    for quick in (False, True):
        study = load(name, quick=quick)
        assert study.tables() == []
        assert study.headline().startswith("Incomplete: ")
        assert all(stage.share > 0 for stage in study.stages.values())
        assert unfinished(study)[0].startswith(f"Not reached or not completed: {next(iter(study.stages))}, ")
        assert bool(study.left_out) == (quick and name != "clutch")
    assert set(load(name, quick=True).stages) <= set(load(name).stages)


# --- Studies that are wrong ------------------------------------------------------------------------------------------


SHOWN = {
    "no verdict": ("verdict", ("good", "Done", "It decays."), "expected"),
    "blocks as sections": ("sections", [ext.Text(["It decays."])], "expected"),
    "a number among results": ("results", {"more": {"other": math.sin}}, "'more': 'other'"),
    "what netCDF cannot hold": ("results", {"other": xarray.Dataset({"x": ("a", [object()])})}, "'other'"),
}


@pytest.mark.parametrize("what", SHOWN)
def test_what_cannot_be_shown_or_saved_is_told_on_a_page_that_keeps_the_rest(what, tmp_path, capsys):
    member, value, words = SHOWN[what]
    if isinstance(value, dict):
        value = {**value, "design": solved()}
    code, said, printed = run(type("Wrong", (Two,), {member: lambda self: value})(), tmp_path, capsys)
    assert code == 1
    assert said.count(f"Wrong.{member}") == 1
    assert words in said
    assert len(said) < 400
    page = page_of(tmp_path)
    assert f"Wrong.{member}" in page
    assert "No recommendation after an error in" in page
    assert "Build" not in page
    assert "Failed: No recommendation after an error in" in printed
    assert saved_objective(tmp_path) == solved().objective


@pytest.mark.parametrize("error", [al.SolveError("no point"), ValueError("a slip")], ids=repr)
def test_after_a_failure_chapters_and_numbers_are_kept_and_nothing_is_recommended(error, tmp_path, capsys):
    study = Two(failing(error))
    if isinstance(error, ValueError):  # raised with its place once everything is written
        with pytest.raises(ValueError, match="a slip"):
            ext.run_study(study, tmp_path)
        assert "error during 'second': ValueError: a slip" in capsys.readouterr().err
    else:
        assert run(study, tmp_path, capsys)[0] == 1
    page = page_of(tmp_path)
    for kept in ("The decay", "1.1 1/s", str(error), "Not reached or not completed: second."):
        assert kept in page
    assert "Build" not in page
    assert {path.name for path in tmp_path.iterdir()} >= {"results.nc", "designs.json", "report.html"}
    assert study.headline() == "Failed: No recommendation after an error in the stage 'second'."


@pytest.mark.parametrize("member", ["verdict", "sections", "tables", "results", "cut_short"])
def test_a_slip_in_what_a_study_says_is_raised_once_a_page_is_written(member, tmp_path):
    study = type("Slips", (Two,), {member: lambda self: failing(KeyError("a slip"))()})(failing(al.SolveError("no")))
    with pytest.raises(KeyError, match="a slip"):
        ext.run_study(study, tmp_path)
    assert "No recommendation after an error in " in page_of(tmp_path)
    assert "KeyError" in page_of(tmp_path)
