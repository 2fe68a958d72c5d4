"""Studies of one's own whose members are of the wrong kind, or fail: one sentence, and nothing found is lost."""

import json
import math

import numpy as np
import pytest
import xarray

import aleator as al
from aleator import extending as ext
from zoo import bar_problem

LONGEST = 400


@pytest.fixture(scope="module")
def design():
    return al.solve(bar_problem())


class Plain(ext.AbstractStudy):
    """Two stages: one finds a design, one does as it is told."""

    def __init__(self, design, second=lambda: None):
        self.known, self.second = design, second
        self.ran, self.design = [], None

    @property
    def stages(self):
        return {"design": ext.Stage(self.find, 1.0), "second": ext.Stage(self.go_on, 2.0)}

    def find(self, progress):
        self.ran.append("design")
        self.design = self.known

    def go_on(self, progress):
        self.ran.append("second")
        self.second()

    def results(self):
        return {"design": self.design}

    def verdict(self):
        return ext.Verdict("good", "Build", "It decays.", ["Build it."], [ext.Card("Rate", "1.1 1/s")])

    def tables(self):
        return [ext.Table("Found", ["what"], [["design"]])] if self.design else []

    def sections(self):
        return [ext.Section("The decay", self.tables())]


def run(study, folder, capsys):
    """The exit code and what is said on the way."""
    code = ext.run_study(study, folder)
    captured = capsys.readouterr()
    return code, " ".join(captured.err.split()), " ".join(captured.out.split())


def page_of(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


STAGES = {
    "a list": ([ext.Stage(print, 1.0)], "Stage"),
    "none of them": ({}, "{}"),
    "pairs": ({"design": (print, 1.0)}, "'design': expected Stage"),
    "numbers as names": ({1: ext.Stage(print, 1.0)}, "received 1"),
    "no work": ({"design": ext.Stage(3, 1.0)}, "'design': work: expected a function"),
    "work without progress": ({"design": ext.Stage(lambda: None, 1.0)}, "'design': work: expected a function"),
    "no share": ({"design": ext.Stage(print, "much")}, "'design': share"),
    "a negative share": ({"design": ext.Stage(print, -1.0)}, "'design': share"),
}


@pytest.mark.parametrize("name", STAGES)
def test_stages_of_another_kind_are_refused_before_anything_is_computed(name, design, tmp_path, capsys):
    value, words = STAGES[name]
    study = type("Wrong", (Plain,), {"stages": property(lambda self: value)})(design)
    code, said, _ = run(study, tmp_path, capsys)
    assert code == 2
    assert said.startswith("error: Wrong.stages")
    assert words in said
    assert len(said) < LONGEST
    assert not study.ran


def test_stages_that_are_a_method_are_told_to_be_a_property(design, tmp_path, capsys):
    study = type("Wrong", (Plain,), {"stages": lambda self: {}})(design)
    code, said, _ = run(study, tmp_path, capsys)
    assert code == 2
    assert "Wrong.stages: expected a mapping of names to Stages, as a property; received" in said


@pytest.mark.parametrize(
    ("member", "value"), [("title", None), ("subtitle", 3.5), ("glossary", [("only a term",)]), ("left_out", None)]
)
def test_a_frame_of_another_kind_is_refused_before_anything_is_computed(member, value, design, tmp_path, capsys):
    study = type("Wrong", (Plain,), {member: value})(design)
    code, said, _ = run(study, tmp_path, capsys)
    assert code == 2
    assert f"Wrong.{member}" in said
    assert not study.ran
    for other in (None, Plain):
        code, said, _ = run(other, tmp_path, capsys)
        assert code == 2
        assert "expected AbstractStudy" in said


SHOWN = {
    "verdict": [None, ("good", "Done", "It decays.")],
    "sections": [None, [ext.Text(["It decays."])], {"a": 1}],
    "tables": [None, [["a", "b"]]],
}


@pytest.mark.parametrize(
    ("member", "value"), [(member, value) for member, values in SHOWN.items() for value in values], ids=str
)
def test_what_a_page_cannot_show_is_told_on_a_page_that_keeps_the_rest(member, value, design, tmp_path, capsys):
    study = type("Wrong", (Plain,), {member: lambda self: value})(design)
    code, said, printed = run(study, tmp_path, capsys)
    assert code == 1
    assert f"Wrong.{member}" in said
    assert "expected" in said
    assert "received" in said
    assert len(said) < LONGEST
    saved = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert saved["design"]["objective"]["value"] == design.objective
    page = page_of(tmp_path)
    assert f"Wrong.{member}" in page
    assert "No recommendation after an error in" in page
    assert "Build" not in page
    if member == "verdict":
        assert "The decay" in page
    assert "Failed: No recommendation after an error in" in printed


BLOCKS = {
    "a verdict of no level": lambda: ext.Verdict("great", "Build", "It decays."),
    "a verdict whose sentences are a text": lambda: ext.Verdict("good", "Build", "It decays.", "It decays."),
    "a card with a number": lambda: ext.Card("Rate", 1.1),
    "text that is no list": lambda: ext.Text("It decays."),
    "a table with numbers": lambda: ext.Table("Found", ["what"], [[1.0]]),
    "a table of texts": lambda: ext.Table("Found", ["what"], ["design"]),
    "a table with a short row": lambda: ext.Table("Found", ["what", "how"], [["design"]]),
    "a drawing of nothing": lambda: ext.Drawing([np.zeros(3)], "Nothing"),
    "a drawing that is one figure": lambda: ext.Drawing(3.0, "Nothing"),
    "a section of text": lambda: ext.Section("The decay", "It decays."),
    "a section of texts": lambda: ext.Section("The decay", ["It decays."]),
    "code that is a number": lambda: ext.Code("The problem", 3.0),
    "a schematic of numbers": lambda: ext.Schematic([1.0], "The system"),
}


def test_a_block_of_a_page_is_checked_where_it_is_made():
    for make in BLOCKS.values():
        with pytest.raises(al.ProblemError, match=r"expected .*received"):
            make()


def test_what_a_block_refuses_names_the_study_and_the_member(design, tmp_path, capsys):
    study = type("Wrong", (Plain,), {"tables": lambda self: [ext.Table("Found", ["what"], ["design"])]})(design)
    code, said, _ = run(study, tmp_path, capsys)
    assert code == 1
    assert "Wrong.tables: Table 'Found': row 0: expected a list of texts; received 'design'." in said


RESULTS = {
    "an object": ({"other": object()}, "'other'"),
    "a list of designs": ({"other": [1, 2]}, "'other'"),
    "a number": ({"other": 3.5}, "'other'"),
    "nested": ({"more": {"other": math.sin}}, "'more': 'other'"),
    "no name": ({None: None}, "None"),
    "a name that is a place": ({"..": None}, "'..'"),
    "data that netCDF cannot hold": ({"other": xarray.Dataset({"x": ("a", [object()])})}, "'other'"),
}


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_that_cannot_be_saved_costs_no_other(name, design, tmp_path, capsys):
    wrong, words = RESULTS[name]
    study = type("Wrong", (Plain,), {"results": lambda self: {**wrong, "design": self.design}})(design)
    code, said, _ = run(study, tmp_path, capsys)
    assert code == 1
    assert "Wrong.results" in said
    assert words in said
    assert said.count("Wrong.results") == 1
    saved = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert saved["design"]["objective"]["value"] == design.objective
    assert "Wrong.results" in page_of(tmp_path)


@pytest.mark.parametrize("value", [None, [1.0]], ids=str)
def test_results_without_names_are_told_and_a_page_is_written(value, design, tmp_path, capsys):
    study = type("Wrong", (Plain,), {"results": lambda self: value})(design)
    code, said, _ = run(study, tmp_path, capsys)
    assert code == 1
    assert "Wrong.results: expected results by name: a mapping; received" in said
    assert "Wrong.results" in page_of(tmp_path)


def test_a_result_may_have_any_name(design, tmp_path):
    study = type("Right", (Plain,), {"results": lambda self: {"folder": self.design, "self": self.design}})(design)
    assert ext.run_study(study, tmp_path) == 0
    assert set(json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))) == {"folder", "self"}


def failing(error):
    def fail():
        raise error

    return fail


@pytest.mark.parametrize("error", [al.SimulationError("'x' is not finite."), OSError("no such road")], ids=repr)
def test_a_study_that_fails_in_its_first_stage_writes_a_page_that_says_so(error, design, tmp_path, capsys):
    class Fails(Plain):
        def find(self, progress):
            raise error

    code, said, printed = run(Fails(design), tmp_path, capsys)
    assert code == 1
    assert f"error during 'design': {error}" in said
    page = page_of(tmp_path)
    assert "No recommendation after an error in the stage &#39;design&#39;." in page
    assert str(error).replace("'", "&#39;") in page
    assert "Not reached or not completed: design and second." in page
    assert "Build" not in page
    assert "Build" not in printed


def test_a_page_after_a_failure_keeps_its_chapters_and_numbers_and_recommends_nothing(design, tmp_path, capsys):
    code, _, printed = run(Plain(design, failing(al.SolveError("no point"))), tmp_path, capsys)
    page = page_of(tmp_path)
    assert code == 1
    assert "Failed: No recommendation after an error in the stage 'second'." in printed
    assert "Build" not in page
    assert "The decay" in page
    assert "1.1 1/s" in page
    assert "In the stage &#39;second&#39;: no point" in page
    assert {path.name for path in tmp_path.iterdir()} >= {"results.nc", "designs.json", "report.html"}
    assert "Not reached or not completed: second." in page


def test_a_stage_that_failed_is_remembered_by_a_study_that_is_run_by_hand(design):
    study = Plain(design, failing(al.SolveError("no point")))
    study.run("design")
    with pytest.raises(al.SolveError):
        study.run("second")
    assert study.headline() == "Failed: No recommendation after an error in the stage 'second'."
    assert study.page().verdict.level == "bad"


def test_a_stage_that_there_is_not_is_refused_by_name(design):
    with pytest.raises(al.ProblemError, match="expected one of the stages design and second; received 'third'"):
        Plain(design).run("third")


def test_a_slip_in_a_stage_is_raised_with_its_place_once_everything_is_written(design, tmp_path, capsys):
    with pytest.raises(ValueError, match="a slip"):
        ext.run_study(Plain(design, failing(ValueError("a slip"))), tmp_path)
    assert "error during 'second': ValueError: a slip" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} >= {"results.nc", "designs.json", "report.html"}


@pytest.mark.parametrize("member", ["verdict", "sections", "tables", "results", "cut_short"])
def test_a_slip_in_what_a_study_says_is_raised_once_a_page_is_written(member, design, tmp_path):
    def slip(self):
        raise KeyError("a slip")

    study = type("Slips", (Plain,), {member: slip})(design, failing(al.SolveError("no point")))
    with pytest.raises(KeyError, match="a slip"):
        ext.run_study(study, tmp_path)
    page = page_of(tmp_path)
    assert "No recommendation after an error in " in page
    assert "KeyError" in page


def test_saving_what_is_no_result_names_its_place(design, tmp_path):
    with pytest.raises(al.ProblemError, match="save: 'more': 'other': expected Solution"):
        ext.save(tmp_path, design=design, more={"other": 3.5})
    assert list(tmp_path.iterdir()) == []
