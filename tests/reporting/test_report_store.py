"""Results in files: what was found reopens with its numbers and units, and files are whole however a process ends."""

import contextlib
import errno
import json
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import report_problems as given
import xarray

from aleator import ProblemError
from aleator.reporting import _files, check_writable, designs_document, json_text, save
from aleator.reporting._files import has_writer, only_writer, write_text, write_together, write_whole
from aleator.results import Front, Refused


def reopened(folder):
    with xarray.open_datatree(folder / "results.nc", engine="h5netcdf") as opened:
        return opened.load()


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder, front = tmp_path_factory.mktemp("store"), given.front()
    refused = Refused(front.solutions[0].problem, "No decision can meet it.")
    save(
        folder,
        designs={"uOpt": given.solution(), "never": given.infeasible(), "a/b": given.collocated()},
        evidence={"uOpt": given.evidence()},
        fronts={"uOpt": Front(front.bound, np.append(front.values, -1.0), (*front.points, refused))},
        calibration=given.calibration(),
        bar=given.bar(),
        missing=None,
    )
    return folder


@pytest.fixture(scope="module")
def tree(stored):
    return reopened(stored)


def test_a_solution_reopens_with_equal_numbers_and_units(tree):
    data, one = tree["designs/uOpt"].to_dataset(), given.solution()
    assert float(data["decision c.mean"]) == float(one.decisions["c.mean"])
    (limit,) = one.constraints
    np.testing.assert_array_equal(data[f"constraint 0 {given.NAME}"], limit.values)
    np.testing.assert_array_equal(data[f"constraint 0 {given.NAME} multiplier"], limit.multipliers)
    np.testing.assert_array_equal(data["mean back(t)"], one.moments["back(t)"].mean)
    np.testing.assert_array_equal(data["time"], np.asarray(one.problem.grid.times))
    names = ("decision c.mean", "time", "mean back(t)", "objective")
    assert [data[name].attrs["units"] for name in names] == ["N s/m", "s", "m", "m²/s³"]
    assert data.attrs["status"] == one.status.value


def test_evidence_and_a_calibration_reopen_with_equal_numbers(tree):
    data, one = tree["evidence/uOpt"].to_dataset(), given.evidence()
    assert float(data["violation_upper"].sel(limit=given.NAME)) == one.violations[given.NAME].upper
    assert float(data["violation"].sel(limit="any")) == one.joint.estimate
    np.testing.assert_array_equal(data[f"trajectory 0 {given.NAME}"], one.trajectories[0].values)
    np.testing.assert_array_equal(data["percentiles ∫effort dt"], one.functionals["∫effort dt"].percentiles)
    data, one = tree["calibration"].to_dataset(), given.calibration()
    assert data.attrs["chosen"] == one.sigmas
    assert (data.attrs["confirmed"], data.attrs["interrupted"]) == (1, 0)
    assert data.attrs["verdict"] == one.sentence()
    assert data.attrs["fresh_upper"] == one.confirmation.upper <= one.target
    assert set(data["sigmas"].values) == {trial.sigmas for trial in one.trials}


def test_a_front_reopens_along_its_bound_and_with_why_points_are_missing(tree):
    data, front = tree["fronts/uOpt"].to_dataset(), given.front()
    np.testing.assert_array_equal(data["bound"], [*front.values, -1.0])
    np.testing.assert_array_equal(data["objective"], [*front.objectives, np.nan])
    np.testing.assert_array_equal(data["shadow_price"], [*front.shadow_prices, np.nan])
    assert list(data["status"].values)[:4] == [one.status.name for one in front.solutions]
    whys = ["" if one.ok else one.why() for one in front.points]
    assert list(data["why"].values)[:4] == whys
    assert "No decision can meet it." in str(data["why"].values[-1])
    assert data["bound"].attrs["units"] == "m"


def test_the_json_is_strict_and_says_what_was_found(stored):
    def refuse(constant):
        raise AssertionError(constant)

    document = json.loads((stored / "designs.json").read_text(encoding="utf-8"), parse_constant=refuse)
    design = document["designs/uOpt"]
    assert design["decisions"]["c.mean"]["value"] == float(given.solution().decisions["c.mean"])
    assert design["constraints"][0]["lower"] is None
    assert design["constraints"][0]["shadow_price"] == given.solution().multiplier(given.NAME)
    share = given.evidence().violations[given.NAME]
    assert design["evidence"]["violations"][given.NAME]["lower"] == share.lower
    assert document["designs/never"]["why"] == given.infeasible().why()
    numbers = json_text({"a": np.nan, "b": [np.inf, np.float32(1.5)], "c": np.arange(2)})
    assert json.loads(numbers) == {"a": None, "b": [None, 1.5], "c": [0, 1]}


def test_evidence_stands_with_the_very_same_design_also_where_both_were_read_from_files():
    one, evidence = given.solution(), pickle.loads(pickle.dumps(given.evidence()))
    designs = {"one": one, "with another limit": replace(one, problem=given.problem(0.3))}
    found = designs_document({**designs, "evidence": evidence})
    assert [name for name, design in found.items() if "evidence" in design] == ["one"]


# --- Whole files -----------------------------------------------------------------------------------------------------

NEW = {"a": b"new", "b": b"new", "c": b"new"}


def contents(folder):
    return {one.name: one.read_bytes() for one in folder.iterdir() if one.name != ".aleator-lock"}


@pytest.fixture
def old(tmp_path):
    write_together(tmp_path, {"a": b"old", "b": b"old", "c": b"old"})
    return tmp_path


def test_files_that_belong_together_are_replaced_and_taken_away_together(old):
    write_together(old, {"a": b"new", "b": b"new", "c": None})
    assert contents(old) == {"a": b"new", "b": b"new"}


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = write_text(tmp_path / "page.html", "old")

    def half(file):
        file.write_text("half", encoding="utf-8")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        write_whole(path, half)
    assert contents(tmp_path) == {"page.html": b"old"}


@pytest.mark.parametrize("name", ["taken/results", "a\0b"], ids=["a file", "null"])
def test_a_place_that_cannot_be_written_to_is_a_problem_that_names_it(tmp_path, name):
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    with pytest.raises(ProblemError, match="cannot be written"):
        write_text(tmp_path / name, "text")
    with pytest.raises(ProblemError, match="cannot be written"):
        check_writable(tmp_path / name)


@pytest.mark.parametrize("fails", ["write_bytes", "replace", "chmod"])
def test_a_disk_that_refuses_leaves_every_file_as_it_was(old, monkeypatch, fails):
    before, calls, genuine = contents(old), 0, getattr(Path, fails)

    def refuse(path, *arguments):
        nonlocal calls
        calls += 1
        # Of the moves, the third is the first that brings something new.
        if calls == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return genuine(path, *arguments)

    monkeypatch.setattr(Path, fails, refuse)
    with pytest.raises(ProblemError, match="No space left on device"):
        write_together(old, NEW)
    assert contents(old) == before


@pytest.mark.parametrize("step", range(12))
def test_a_process_killed_between_two_steps_leaves_no_mixed_files(old, monkeypatch, step):
    class KilledError(BaseException):
        pass

    taken = 0

    def once_more(genuine):
        def stepwise(*arguments):
            nonlocal taken
            taken += 1
            if taken > step:
                raise KilledError
            return genuine(*arguments)

        return stepwise

    # Neither does anything that follows happen, such as putting back what was moved aside.
    monkeypatch.setattr(Path, "replace", once_more(Path.replace))
    monkeypatch.setattr(Path, "unlink", once_more(Path.unlink))
    monkeypatch.setattr(_files, "_sync", once_more(lambda folder: None))
    with pytest.raises(KilledError) if step < 10 else contextlib.nullcontext():
        write_together(old, NEW)
    monkeypatch.undo()
    left = {name: content for name, content in contents(old).items() if not name.startswith(".aleator")}
    assert "a" in left
    assert len(set(left.values())) == 1
    write_together(old, {"a": b"newer", "b": b"newer", "c": None})
    assert contents(old) == {"a": b"newer", "b": b"newer"}


def test_a_writer_within_a_writer_leaves_the_folder_locked(tmp_path):
    with only_writer(tmp_path):
        with only_writer(tmp_path):
            assert has_writer(tmp_path)
        assert has_writer(tmp_path)
    assert not has_writer(tmp_path)


def test_threads_that_write_into_one_folder_leave_files_of_one_of_them(tmp_path):
    def write(i):
        for _ in range(20):
            write_together(tmp_path, {name: str(i).encode() for name in ("a", "b", "c")})

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(write, range(4)))
    assert len(set(contents(tmp_path).values())) == 1
    assert set(contents(tmp_path)) == {"a", "b", "c"}
