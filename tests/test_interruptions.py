"""SIGINT, SIGTERM and SIGKILL at any moment of `aleator run`: what was finished is kept, and said."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import xarray

from aleator.studies import load

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


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rehearsals")
    wanted = [f"{moment}:{int(number)}" for moment in MOMENTS for number, _ in SIGNALS.values()]
    command = [sys.executable, str(HERE / "rehearsed_runs.py"), str(folder), *wanted]
    environment = os.environ | {"COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, env=environment)
    return folder, json.loads(done.stdout)


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_signal_leaves_every_finished_stage_and_a_word(runs, moment, name):
    folder, found = runs
    number, code = SIGNALS[name]
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


# What stands in `results.nc` once a stage is finished.
GROUPS = {
    "decay": {"design": "design", "evidence": "evidence", "front": "front"},
    "clutch": {"methods": "methods", "tolerances": "analyses", "allocation": "allocation", "front": "front"},
}
# How often each study is interrupted: twelve times in all, four times by each signal.
TIMES = {"decay": 9, "clutch": 3}
MOMENTS_AT_RANDOM = [(study, time_) for study, times in TIMES.items() for time_ in range(times)]
STOPS = [*SIGNALS.values(), (signal.SIGKILL, -9)]


def test_the_stages_that_are_interrupted_are_those_of_the_study():
    assert list(load("clutch").stages) == list(GROUPS["clutch"])


class Ended(NamedTuple):
    """What became of an interrupted run."""

    code: int
    output: str
    errors: str
    folder: Path


def begun(study: str, folder: Path, cache: Path) -> subprocess.Popen:
    """A run of a study as the command line starts it, once it minds signals."""
    script = [sys.executable, str(HERE / "interrupted_studies.py"), "run", study, "--out", str(folder)]
    kept = {"JAX_COMPILATION_CACHE_DIR": str(cache), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    run = subprocess.Popen(
        script, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | kept | {"COLUMNS": "200"}
    )
    assert run.stdout is not None
    if run.stdout.readline() != "begun\n":
        pytest.fail(run.communicate()[1])
    return run


def lifetime(study: str, folder: Path, cache: Path) -> float:
    """How long a study takes that is run to its end with compiled programs at hand, s."""
    started = 0.0
    for name in ("first", "again"):
        started = time.perf_counter()
        run = begun(study, folder / name, cache)
        output, errors = run.communicate(timeout=900)
        assert run.returncode == 0, output + errors
    return time.perf_counter() - started


def interrupted(study: str, time_: int, folder: Path, cache: Path, lasts: float) -> Ended:
    """A run that is sent a signal at a moment anywhere between its first import and its last word."""
    run = begun(study, folder, cache)
    stratum = np.random.default_rng([len(study), time_]).uniform(time_, time_ + 1.0) / TIMES[study]
    with contextlib.suppress(subprocess.TimeoutExpired):
        run.wait(stratum * lasts)
    run.send_signal(STOPS[time_ % 3][0])
    output, errors = run.communicate(timeout=120)
    return Ended(run.returncode, output, errors, folder)


def random_runs(cache: Path, folder: Path) -> dict[tuple[str, int], Ended]:
    """All interrupted runs, two at a time."""
    with ThreadPoolExecutor(2) as pool:
        lasts = {study: pool.submit(lifetime, study, folder / study, cache) for study in reversed(TIMES)}
        lives = {study: one.result() for study, one in lasts.items()}
        runs = {
            one: pool.submit(interrupted, *one, folder / f"{one[0]} {one[1]}", cache, lives[one[0]])
            for one in MOMENTS_AT_RANDOM
        }
        return {one: run.result() for one, run in runs.items()}


@pytest.mark.slow
def test_an_interruption_at_a_random_moment_loses_no_finished_stage(tmp_path):
    # One test, since two processes that share tests would each begin all of these runs.
    for (study, time_), ended in random_runs(tmp_path / "cache", tmp_path / "interrupted").items():
        check_kept(study, time_, ended)


def check_kept(study: str, time_: int, ended: Ended) -> None:
    code, output, errors, folder = ended
    number, expected = STOPS[time_ % 3]
    assert code in (expected, 0), (study, time_, output + errors)
    assert "Traceback" not in output + errors
    if code > 0:
        assert "Interrupted" in errors
    finished = re.findall(r"^([a-z ]+): [0-9.]+ s *$", output, re.MULTILINE)
    if code == 0:
        assert finished == list(GROUPS[study])
    if not finished:
        return
    with xarray.open_datatree(folder / "results.nc", engine="h5netcdf") as stored:
        kept, generation = set(stored.load().children), stored.attrs["generation"]
    assert {GROUPS[study][stage] for stage in finished} <= kept
    designs = folder / "designs.json"
    # A process that is killed between two moves leaves the first file alone; a run that ends itself, never.
    with_design = kept & {"design", "allocation"}
    assert designs.exists() or not with_design or number == signal.SIGKILL
    if designs.exists():
        document = json.loads(designs.read_text(encoding="utf-8"))
        assert {one["generation"] for one in document.values()} == {generation}
