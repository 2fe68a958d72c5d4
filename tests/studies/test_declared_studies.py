"""What every study has by its declaration: a page that only grows, files, and no recommendation after a failure.

A study whose members are of the wrong kind, or fail, ends with one sentence, and nothing found is lost.
"""

import json
import math
from functools import cache

import pytest
import xarray

import aleator as al
from aleator import extending as ext
from aleator.studies import STUDIES, load
from zoo import bar_problem, cases


@cache
def solved():
    return al.solve(bar_problem())


def nothing(page):
    """A second section that finds nothing."""


class Two(ext.AbstractStudy):
    """A design, and a second section that does what it is given."""

    title = "Two sections"
    glossary = (("x", "What decays."),)
    left_out = ""

    def __init__(self, second=nothing):
        self.second = second

    def chapter(self, page):
        page.section("The decay")
        page.progress("solving", 0, 1)
        page.keep("design", solved())
        page.add("It has a rate of 1.1 1/s.", ext.Table("Found", ["what"], [["design"]]), printed=True)
        page.recommend(ext.Verdict("good", "Build", "It decays.", ["Build it."]))
        page.section("Nothing")
        self.second(page)


def failing(error):
    def fail(page):
        raise error

    return fail


def filled(study):
    page = ext.Draft(study)
    page.fill()
    return page


def headings(page):
    return [one.heading for one in page.page().sections]


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
    study = Two()
    page = filled(study)
    assert page.finished == ["The decay", "Nothing"]
    assert headings(page) == ["The decay", "Where this comes from", "How to read this"]
    assert page.page().sections[-1].blocks[-1].rows == study.glossary
    assert page.headline() == "Build: It decays."
    study.left_out = "the sweep"
    assert page.headline() == "Build: It decays. This was a quick run, without the sweep."
    assert page.page().verdict.headline == "It decays."
    assert page.page().verdict.rows[-1] == ("Left out", "This was a quick run, without the sweep.")
    page.save(tmp_path)
    written = page.write(tmp_path)
    assert "It decays." in written.read_text(encoding="utf-8")
    assert saved_objective(tmp_path) == solved().objective
    # An old page goes with its results.
    page.save(tmp_path)
    assert not written.exists()


def test_a_result_that_was_cut_short_is_kept_and_ends_the_chapter():
    front = al.results.Front("mass", math.nan * solved().vector[:1], (solved(),), interrupted=True)
    page = ext.Draft(Two(lambda page: page.keep("front", front)))
    with pytest.raises(KeyboardInterrupt):
        page.fill()
    assert page.finished == ["The decay"]
    assert page.kept["front"] is front
    assert headings(page)[:2] == ["This run", "The decay"]
    (text,) = page.page().sections[0].blocks
    assert "stopped early in 'Nothing'" in text.paragraphs[0]
    # It was made before, of results that are complete.
    assert page.headline() == "Build: It decays."


# The four-bar takes half a minute to declare, its own tests do so; the studies of motions take seconds.
@pytest.mark.parametrize("name", cases([name for name in STUDIES if name != "four-bar"], first=2))
def test_every_study_of_the_list_has_problems_and_a_quick_run_says_what_it_skips(name):
    for quick in (False, True):
        study = load(name, quick=quick)
        study.check_declaration()
        assert study.problems
        assert bool(study.left_out) == (quick and name != "clutch")
        assert ext.Draft(study).headline().startswith("No recommendation: ")


# --- Studies that are wrong ------------------------------------------------------------------------------------------


WRONG = {
    "no verdict": (lambda page: page.recommend(("good", "Done", "It decays.")), "page.recommend: expected"),
    "what netCDF cannot hold": (
        lambda page: page.keep("other", xarray.Dataset({"x": ("a", [object()])})),
        "'other': expected data that netCDF can hold",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_be_shown_or_saved_is_told_on_a_page_that_keeps_the_rest(what, tmp_path, capsys):
    second, words = WRONG[what]
    code, said, printed = run(Two(second), tmp_path, capsys)
    assert code == 1
    assert said.count("error: In 'Nothing': page.") == 1
    assert words in said
    assert len(said) < 400
    page = page_of(tmp_path)
    assert "In &#39;Nothing&#39;: page." in page
    assert "rate of 1.1 1/s" in page
    assert "Build" not in page
    assert "Failed: No recommendation, because of an error." in printed
    assert saved_objective(tmp_path) == solved().objective


@pytest.mark.parametrize("error", [al.SolveError("no point"), ValueError("a slip")], ids=repr)
def test_after_a_failure_sections_and_numbers_are_kept_and_nothing_is_recommended(error, tmp_path, capsys):
    study = Two(failing(error))
    if isinstance(error, ValueError):  # raised with its place once everything is written
        with pytest.raises(ValueError, match="a slip"):
            ext.run_study(study, tmp_path)
        assert "error: In 'Nothing': ValueError: a slip" in capsys.readouterr().err
    else:
        assert run(study, tmp_path, capsys)[0] == 1
    page = page_of(tmp_path)
    for kept in ("The decay", "1.1 1/s", str(error), "An error ended the study in"):
        assert kept in page
    assert "Build" not in page
    assert {path.name for path in tmp_path.iterdir()} >= {"results.nc", "designs.json", "report.html"}


def test_a_member_of_the_wrong_kind_is_refused_by_name_before_anything_is_computed(tmp_path, capsys):
    code, said, _ = run(type("Wrong", (Two,), {"glossary": 7})(), tmp_path, capsys)
    assert code == 2
    assert "Wrong.glossary" in said
    assert not (tmp_path / "results.nc").exists()
