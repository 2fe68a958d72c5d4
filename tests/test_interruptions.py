"""SIGINT, SIGTERM and SIGKILL at any moment of `aleator run`: what was finished is kept, and said."""

import functools
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
}
TIMES = 9


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


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """Where compiled programs are kept, and how long a study takes that is run to its end with those at hand."""
    cache = tmp_path_factory.mktemp("cache")

    @functools.cache
    def lasts(study: str) -> float:
        for _ in range(2):
            started = time.perf_counter()
            run = begun(study, tmp_path_factory.mktemp("whole"), cache)
            output, errors = run.communicate(timeout=300)
            assert run.returncode == 0, output + errors
        return time.perf_counter() - started

    return cache, lasts


@pytest.mark.slow
@pytest.mark.parametrize("time_", range(TIMES))
def test_an_interruption_at_a_random_moment_loses_no_finished_stage(undisturbed, tmp_path, time_):
    cache, lasts = undisturbed
    (study,) = GROUPS
    number, code = [*SIGNALS.values(), (signal.SIGKILL, -9)][time_ % 3]
    wait = lasts(study)
    run = begun(study, tmp_path, cache)
    time.sleep(np.random.default_rng(time_).uniform(0.0, wait))
    run.send_signal(number)
    output, errors = run.communicate(timeout=120)
    assert run.returncode in (code, 0), output + errors
    assert "Traceback" not in output + errors
    if run.returncode > 0:
        assert "Interrupted" in errors
    finished = re.findall(r"^([a-z ]+): [0-9.]+ s *$", output, re.MULTILINE)
    if not finished:
        return
    with xarray.open_datatree(tmp_path / "results.nc", engine="h5netcdf") as stored:
        kept, generation = set(stored.load().children), stored.attrs["generation"]
    assert {GROUPS[study][stage] for stage in finished if stage in GROUPS[study]} <= kept
    designs = tmp_path / "designs.json"
    # A process that is killed between two moves leaves the first file alone; a run that ends itself, never.
    assert designs.exists() or number == signal.SIGKILL
    if designs.exists():
        document = json.loads(designs.read_text(encoding="utf-8"))
        assert {one["generation"] for one in document.values()} == {generation}
