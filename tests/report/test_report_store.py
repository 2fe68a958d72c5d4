import json
import os
from dataclasses import replace

import numpy as np
import pytest
import report_problems as given
import xarray

from aleator import Front, ProblemError
from aleator.report import check_writable, json_text, report, save
from aleator.report._files import write_text, write_whole


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("store")
    return save(
        folder,
        designs={"uOpt": given.solution(), "never": given.infeasible()},
        evidence={"uOpt": given.evidence()},
        fronts={"uOpt": given.front()},
        calibration=given.calibration(),
        missing=None,
    )


@pytest.fixture(scope="module")
def tree(stored):
    with xarray.open_datatree(stored[0], engine="h5netcdf") as opened:
        yield opened.load()


def test_a_solution_reopens_with_equal_numbers_and_units(tree):
    data, one = tree["designs/uOpt"].to_dataset(), given.solution()
    assert float(data["decision c.mean"]) == float(one.decisions["c.mean"])
    assert data["decision c.mean"].attrs["units"] == "N s/m"
    (limit,) = one.constraints
    np.testing.assert_array_equal(data[f"constraint 0 {given.NAME}"], limit.values)
    np.testing.assert_array_equal(data[f"constraint 0 {given.NAME} multiplier"], limit.multipliers)
    np.testing.assert_array_equal(data["mean back(t)"], one.moments["back(t)"].mean)
    np.testing.assert_array_equal(data["time"], np.asarray(one.problem.grid.times))
    assert data["time"].attrs["units"] == "s"
    assert data["mean back(t)"].attrs["units"] == "m"
    assert data["objective"].attrs["units"] == "m²/s³"
    assert data.attrs["status"] == one.status.value


def test_evidence_reopens_with_equal_numbers(tree):
    data, one = tree["evidence/uOpt"].to_dataset(), given.evidence()
    share = one.violations[given.NAME]
    assert float(data["violation_upper"].sel(limit=given.NAME)) == share.upper
    assert float(data["violation"].sel(limit="any")) == one.joint.estimate
    np.testing.assert_array_equal(data[f"trajectory 0 {given.NAME}"], one.trajectories[0].values)
    np.testing.assert_array_equal(data["percentiles ∫effort dt"], one.functionals["∫effort dt"].percentiles)


def test_a_front_reopens_along_its_bound(tree):
    data, front = tree["fronts/uOpt"].to_dataset(), given.front()
    np.testing.assert_array_equal(data["bound"], front.values)
    np.testing.assert_array_equal(data["objective"], front.objectives)
    np.testing.assert_array_equal(data["price"], front.prices)
    assert list(data["status"].values) == [one.status.name for one in front.solutions]
    assert data["bound"].attrs["units"] == "m"


def test_a_calibration_reopens_with_its_choice(tree):
    data, one = tree["calibration"].to_dataset(), given.calibration()
    assert data.attrs["chosen"] == one.sigmas
    assert set(data["sigmas"].values) == {trial.sigmas for trial in one.trials}


def test_the_json_is_strict_and_says_what_was_found(stored):
    def refuse(constant):
        raise AssertionError(constant)

    document = json.loads(stored[1].read_text(encoding="utf-8"), parse_constant=refuse)
    design = document["designs/uOpt"]
    assert design["decisions"]["c.mean"]["value"] == float(given.solution().decisions["c.mean"])
    assert design["constraints"][0]["lower"] is None
    assert design["constraints"][0]["price"] == given.solution().multiplier(given.NAME)
    share = given.evidence().violations[given.NAME]
    assert design["evidence"]["violations"][given.NAME]["lower"] == share.lower
    assert document["designs/never"]["why"] == given.infeasible().why()


def test_numbers_that_are_not_finite_become_null():
    assert json.loads(json_text({"a": np.nan, "b": [np.inf, np.float32(1.5)], "c": np.arange(2)})) == {
        "a": None,
        "b": [None, 1.5],
        "c": [0, 1],
    }


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = write_text(tmp_path / "page.html", "old")

    def half(file):
        file.write_text("half", encoding="utf-8")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        write_whole(path, half)
    assert path.read_text(encoding="utf-8") == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]


def test_a_folder_in_place_of_a_file_is_refused(tmp_path):
    with pytest.raises(ProblemError, match="is a folder"):
        write_text(tmp_path, "text")


def test_a_folder_that_cannot_be_made_is_a_problem_that_names_it(tmp_path):
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    with pytest.raises(ProblemError, match="taken/results"):
        check_writable(tmp_path / "taken" / "results")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the superuser may write anywhere")
def test_a_folder_without_permission_is_a_problem_that_names_it(tmp_path):
    folder = tmp_path / "closed"
    folder.mkdir(mode=0o500)
    with pytest.raises(ProblemError, match="closed"):
        check_writable(folder)


def test_a_missing_folder_is_made(tmp_path):
    assert check_writable(tmp_path / "a" / "b").is_dir()


def test_a_name_with_a_slash_stays_one_variable(tmp_path):
    named = replace(given.solution().constraints[0], name="a/b")
    path, _ = save(tmp_path, **{"design": replace(given.solution(), constraints=(named,))})
    with xarray.open_datatree(path, engine="h5netcdf") as opened:
        assert "constraint 0 a∕b" in opened["design"].to_dataset()


def test_a_front_that_was_interrupted_at_once_is_left_out(tmp_path):
    nothing = Front(given.NAME, np.array([]), (), interrupted=True)
    path, _ = save(tmp_path, design=given.solution(), front=nothing)
    with xarray.open_datatree(path, engine="h5netcdf") as opened:
        assert list(opened.children) == ["design"]
    report(given.solution(), fronts=nothing, path=tmp_path / "report.html")
