"""SIGINT, SIGTERM and SIGKILL at any moment of `aleator run`: what was finished is kept, and said."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are sent as on Unix")

HERE = Path(__file__).parent
NOTHING, FIRST, ALL = "", "first", "first second third"
MOMENTS = {
    "while the package is imported": NOTHING,
    "while the study is loaded": NOTHING,
    "in the first stage": NOTHING,
    "in the second stage": FIRST,
    "in a callback of JAX": FIRST,
    "in a library that does not listen": FIRST,
    "in work that swallows exceptions": FIRST,
    "in a destructor": FIRST,
    "twice": FIRST,
    "while a stage is saved": FIRST,
    "in the third stage": "first second",
    "while the page is written": ALL,
    "while the tables are printed": ALL,
    "at the last word": ALL,
}
SIGNALS = {"SIGINT": (signal.SIGINT, 130), "SIGTERM": (signal.SIGTERM, 143)}
AT_ONCE = ("in a library", "in work", "in a destructor", "twice")


@pytest.fixture(scope="module", params=["SIGINT", pytest.param("SIGTERM", marks=pytest.mark.slow)])
def runs(request, tmp_path_factory):
    folder, (number, code) = tmp_path_factory.mktemp("rehearsals"), SIGNALS[request.param]
    wanted = [f"{moment}:{int(number)}" for moment in MOMENTS]
    command = [sys.executable, str(HERE / "rehearsed_runs.py"), str(folder), *wanted]
    environment = os.environ | {"COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, env=environment)
    return folder, json.loads(done.stdout), number, code


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_signal_leaves_every_finished_stage_and_a_word(runs, moment):
    folder, found, number, code = runs
    key = f"{moment}:{int(number)}"
    run, kept = found[key], MOMENTS[moment].split()
    assert run["status"] == code, run["output"]
    assert "Traceback" not in run["output"]
    assert "Exception" not in run["output"]
    (word,) = [line for line in run["output"].splitlines() if line.startswith("Interrupted")]
    assert all(f"'{stage}'" in word for stage in kept)
    for file in ("results.nc", "designs.json"):
        path = folder / key / file
        assert (path.read_text().split() if path.exists() else []) == kept
    assert (folder / key / "report.html").exists() == (bool(kept) and not moment.startswith(AT_ONCE))


# What stands in `results.nc` once a stage is finished, and how often the study is interrupted: twice by each signal.
GROUPS = ("design", "evidence", "front")
TIMES = 6
STOPS = [*SIGNALS.values(), (signal.SIGKILL, -9)]


def begun(folder: Path, cache: Path) -> subprocess.Popen:
    """A run of a study as the command line starts it, once it minds signals."""
    script = [sys.executable, str(HERE / "interrupted_studies.py"), "run", "decay", "--out", str(folder)]
    kept = {"JAX_COMPILATION_CACHE_DIR": str(cache), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    run = subprocess.Popen(
        script, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | kept | {"COLUMNS": "200"}
    )
    assert run.stdout is not None
    if run.stdout.readline() != "begun\n":
        pytest.fail(run.communicate()[1])
    return run


def lifetime(folder: Path, cache: Path) -> float:
    """How long the study takes that is run to its end with compiled programs at hand, s."""
    started = 0.0
    for name in ("first", "again"):
        started = time.perf_counter()
        run = begun(folder / name, cache)
        output, errors = run.communicate(timeout=900)
        assert run.returncode == 0, output + errors
    return time.perf_counter() - started


@pytest.mark.slow
def test_an_interruption_at_a_random_moment_loses_no_finished_stage(tmp_path):
    cache = tmp_path / "cache"
    lasts = lifetime(tmp_path, cache)
    for number in range(TIMES):
        folder = tmp_path / f"{number}"
        run = begun(folder, cache)
        moment = np.random.default_rng(number).uniform(number, number + 1.0) / TIMES
        with contextlib.suppress(subprocess.TimeoutExpired):
            run.wait(moment * lasts)
        stop, expected = STOPS[number % 3]
        run.send_signal(stop)
        output, errors = run.communicate(timeout=120)
        assert run.returncode in (expected, 0), (number, output + errors)
        assert "Traceback" not in output + errors
        if run.returncode > 0:
            assert "Interrupted" in errors
        check_kept(folder, output, run.returncode, stop)


def check_kept(folder: Path, output: str, code: int, stop: int) -> None:
    finished = re.findall(r"^([a-z ]+): [0-9.]+ s *$", output, re.MULTILINE)
    if code == 0:
        assert tuple(finished) == GROUPS
    if not finished:
        return
    with xarray.open_datatree(folder / "results.nc", engine="h5netcdf") as stored:
        kept, generation = set(stored.load().children), stored.attrs["generation"]
    assert set(finished) <= kept
    designs = folder / "designs.json"
    # A process that is killed between two moves leaves the first file alone; a run that ends itself, never.
    assert designs.exists() or "design" not in kept or stop == signal.SIGKILL
    if designs.exists():
        document = json.loads(designs.read_text(encoding="utf-8"))
        assert {design["generation"] for design in document.values()} == {generation}
