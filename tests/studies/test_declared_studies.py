"""What every study has by its declaration: stages that count once they end, files, and a page that is honest."""

import json
from dataclasses import dataclass
from functools import cache

import pytest

import aleator as al
from aleator import extending as ext
from aleator.studies import STUDIES, load
from zoo import bar_problem


@cache
def solved():
    return al.solve(bar_problem())


@dataclass
class Sweep:
    interrupted: bool


class Two(ext.AbstractStudy):
    """A design, and a sweep that may be cut short."""

    title = "Two stages"
    glossary = (("x", "What decays."),)

    def __init__(self, sweep=None, left_out=""):
        self.sweep, self.spared = sweep or Sweep(interrupted=False), left_out
        self.design = self.swept = None

    @property
    def stages(self):
        return {"design": ext.Stage(self.find, 1.0), "sweep": ext.Stage(self.go_on, 2.0)}

    @property
    def left_out(self):
        return self.spared

    def find(self, progress):
        progress("solving", 0, 1)
        self.design = solved()

    def go_on(self, progress):
        self.swept = self.sweep
        ext.stop_if_interrupted(self.swept)

    def cut_short(self):
        if self.swept is not None and self.swept.interrupted:
            yield "Of the sweep, half is kept."

    def results(self):
        return {"design": self.design}

    def verdict(self):
        return ext.Verdict("good", "Build", "It decays.")

    def tables(self):
        return []

    def sections(self):
        return [ext.Section("The decay", [ext.Text(["It decays."])] if self.design else []), ext.Section("Nothing", [])]


def finished(**options):
    study = Two(**options)
    for stage in study.stages:
        study.run(stage)
    return study


def headings(study):
    return [one.heading for one in study.page().sections]


def unfinished(study):
    (text,) = next(one for one in study.page().sections if one.heading == "This run").blocks
    return text.paragraphs


def test_a_study_that_came_to_its_end_has_its_sections_and_the_glossary():
    study = finished()
    assert study.finished == ("design", "sweep")
    assert headings(study) == ["The decay", "Where this comes from", "How to read this"]
    assert study.page().sections[-1].blocks[-1].rows == study.glossary
    assert study.headline() == "Build: It decays."


def test_a_study_that_has_not_begun_names_all_its_stages_whatever_others_have_finished():
    assert finished().finished
    assert Two().finished == ()
    assert unfinished(Two()) == ["Not reached or not completed: design and sweep."]
    assert headings(Two()) == ["This run", "How to read this"]


def test_a_stage_that_was_cut_short_keeps_what_it_found_and_is_not_finished():
    study = Two(sweep=Sweep(interrupted=True))
    study.run("design")
    with pytest.raises(KeyboardInterrupt):
        study.run("sweep")
    assert study.swept is study.sweep
    assert study.finished == ("design",)
    assert unfinished(study) == ["Not reached or not completed: sweep.", "Of the sweep, half is kept."]


def test_a_quick_run_says_what_it_leaves_out_in_its_verdict():
    study = finished(left_out="the sweep")
    assert study.page().verdict.headline == "It decays. This was a quick run, without the sweep."
    assert study.headline().endswith("without the sweep.")


def test_results_and_page_are_written_side_by_side_and_an_old_page_goes_with_its_results(tmp_path):
    study = finished()
    study.save(tmp_path)
    page = study.write_page(tmp_path)
    assert "It decays." in page.read_text(encoding="utf-8")
    saved = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert saved["design"]["objective"]["value"] == study.design.objective
    study.save(tmp_path)
    assert not page.exists()


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
