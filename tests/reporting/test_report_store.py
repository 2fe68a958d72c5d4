import contextlib
import errno
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import report_problems as given
import xarray

from aleator import ProblemError
from aleator.reporting import _files, _lock, check_writable, json_text, report, save
from aleator.reporting._files import write_text, write_together, write_whole
from aleator.results import Front, Refused


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
    np.testing.assert_array_equal(data["shadow_price"], front.shadow_prices)
    assert list(data["status"].values) == [one.status.name for one in front.solutions]
    assert data["bound"].attrs["units"] == "m"


def test_a_calibration_reopens_with_its_choice(tree):
    data, one = tree["calibration"].to_dataset(), given.calibration()
    assert data.attrs["chosen"] == one.sigmas
    assert (data.attrs["confirmed"], data.attrs["interrupted"]) == (1, 0)
    assert data.attrs["verdict"] == one.sentence()
    assert data.attrs["fresh_upper"] == one.confirmation.upper <= one.target
    assert set(data["sigmas"].values) == {trial.sigmas for trial in one.trials}


def test_the_json_is_strict_and_says_what_was_found(stored):
    def refuse(constant):
        raise AssertionError(constant)

    document = json.loads(stored[1].read_text(encoding="utf-8"), parse_constant=refuse)
    design = document["designs/uOpt"]
    assert design["decisions"]["c.mean"]["value"] == float(given.solution().decisions["c.mean"])
    assert design["constraints"][0]["lower"] is None
    assert design["constraints"][0]["shadow_price"] == given.solution().multiplier(given.NAME)
    share = given.evidence().violations[given.NAME]
    assert design["evidence"]["violations"][given.NAME]["lower"] == share.lower
    assert document["designs/never"]["why"] == given.infeasible().why()


def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path):
    path = write_text(tmp_path / "page.html", "old")

    def half(file):
        file.write_text("half", encoding="utf-8")
        raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        write_whole(path, half)
    assert path.read_text(encoding="utf-8") == "old"
    assert [one.name for one in tmp_path.iterdir()] == ["page.html"]


def test_a_folder_that_cannot_be_made_is_a_problem_that_names_it(tmp_path):
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    with pytest.raises(ProblemError, match="taken/results"):
        check_writable(tmp_path / "taken" / "results")


def test_a_name_with_a_slash_stays_one_variable(tmp_path):
    named = replace(given.solution().constraints[0], name="a/b")
    path, _ = save(tmp_path, **{"design": replace(given.solution(), constraints=(named,))})
    with xarray.open_datatree(path, engine="h5netcdf") as opened:
        assert "constraint 0 a∕b" in opened["design"].to_dataset()


def test_a_point_of_a_front_that_was_refused_keeps_what_was_said(tmp_path):
    front = given.front()
    refused = Refused(front.solutions[0].problem, "No decision can meet it.")
    longer = Front(front.bound, np.append(front.values, -1.0), (*front.points, refused))
    save(tmp_path, front=longer)
    data = xarray.open_datatree(tmp_path / "results.nc")["front"].to_dataset()
    assert list(data["why"].values) == [*("" if one.ok else one.why() for one in front.points), refused.why()]
    assert "No decision can meet it." in str(data["why"].values[-1])
    assert str(refused) == "Refused before it was solved: No decision can meet it."


def contents(folder):
    return {one.name: one.read_bytes() for one in folder.iterdir() if one.name != ".aleator-lock"}


@pytest.fixture
def old(tmp_path):
    write_together(tmp_path, {"a": b"old", "b": b"old", "c": b"old"})
    return tmp_path


def test_files_that_belong_together_are_replaced_and_taken_away_together(old):
    write_together(old, {"a": b"new", "b": b"new", "c": None})
    assert contents(old) == {"a": b"new", "b": b"new"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="file sizes are limited on Unix only")
def test_a_full_disk_is_one_sentence_and_leaves_earlier_results_whole(tmp_path):
    # In a process of its own, whose files may not grow: HDF5 itself would end it.
    script = f"""
import resource
import numpy as np, xarray
from pathlib import Path
from aleator import AleatorError
from aleator.reporting import _store
from aleator.reporting._files import write_text
_store.tree = lambda results: xarray.DataTree(xarray.Dataset({{"x": ("t", np.arange(5000.0))}}))
folder = Path({str(tmp_path)!r})
_store.save(folder)
before = (folder / "results.nc").read_bytes()
resource.setrlimit(resource.RLIMIT_FSIZE, (2000, resource.RLIM_INFINITY))
for write in (lambda: _store.save(folder), lambda: write_text(folder / "page.html", 5000 * "x")):
    try:
        write()
    except AleatorError as error:
        print(error)
assert (folder / "results.nc").read_bytes() == before
print(sorted(one.name for one in folder.iterdir()))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    first, second, left = done.stdout.splitlines()
    assert "File too large" in first
    assert "File too large" in second
    assert left == "['.aleator-lock', 'results.nc']"


@pytest.mark.parametrize("fails", ["write_bytes", "replace", "chmod"])
def test_a_disk_that_refuses_leaves_every_file_as_it_was(old, monkeypatch, fails):
    before = contents(old)
    calls = 0
    genuine = getattr(Path, fails)

    def refuse(path, *arguments):
        nonlocal calls
        calls += 1
        # Of the moves, the third is the first that brings something new.
        if calls == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return genuine(path, *arguments)

    monkeypatch.setattr(Path, fails, refuse)
    with pytest.raises(ProblemError, match="No space left on device"):
        write_together(old, {"a": b"new", "b": b"new", "c": b"new"})
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
        write_together(old, {"a": b"new", "b": b"new", "c": b"new"})
    monkeypatch.undo()
    left = {name: content for name, content in contents(old).items() if not name.startswith(".aleator")}
    assert "a" in left
    assert len(set(left.values())) == 1
    write_together(old, {"a": b"newer", "b": b"newer", "c": None})
    assert contents(old) == {"a": b"newer", "b": b"newer"}


HOLDER = """
import sys, time
from pathlib import Path
from aleator.reporting._lock import only_writer
with only_writer(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.mark.slow
def test_a_second_process_is_told_that_a_folder_is_being_written_to(tmp_path, monkeypatch):
    monkeypatch.setattr(_lock, "_PATIENCE", 0.1)
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(ProblemError, match="Another process is writing"):
            write_together(tmp_path, {"a": b"new"})
        assert contents(tmp_path) == {}
        holder.kill()
        holder.wait()
    # However a process ends, its folder is free again.
    write_together(tmp_path, {"a": b"new"})
    assert contents(tmp_path) == {"a": b"new"}


def test_threads_that_write_into_one_folder_leave_files_of_one_of_them(tmp_path):
    def write(i):
        for _ in range(20):
            write_together(tmp_path, {name: str(i).encode() for name in ("a", "b", "c")})

    with ThreadPoolExecutor(4) as threads:
        list(threads.map(write, range(4)))
    assert len(set(contents(tmp_path).values())) == 1
    assert set(contents(tmp_path)) == {"a", "b", "c"}


@pytest.mark.parametrize("name", ["x" * 300 + ".html", "a\0b"])
def test_a_name_that_no_file_can_have_is_a_problem(tmp_path, name):
    with pytest.raises(ProblemError, match="cannot be written"):
        write_text(tmp_path / name, "text")
    with pytest.raises(ProblemError, match="cannot be written"):
        check_writable(tmp_path / name)


def test_numbers_that_are_not_finite_become_null():
    assert json.loads(json_text({"a": np.nan, "b": [np.inf, np.float32(1.5)], "c": np.arange(2)})) == {
        "a": None,
        "b": [None, 1.5],
        "c": [0, 1],
    }


def test_a_front_that_was_interrupted_at_once_is_left_out(tmp_path):
    nothing = Front(given.NAME, np.array([]), (), interrupted=True)
    path, _ = save(tmp_path, design=given.solution(), front=nothing)
    with xarray.open_datatree(path, engine="h5netcdf") as opened:
        assert list(opened.children) == ["design"]
    report(given.solution(), fronts=nothing, path=tmp_path / "report.html")
