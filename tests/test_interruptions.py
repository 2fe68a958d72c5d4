"""SIGINT and SIGTERM at any moment of `aleator run`: what was finished is kept, and said."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are sent as on Unix")

MOMENTS = {
    "while the package is imported": "",
    "while the study is loaded": "",
    "in the second stage": "first",
    "in a callback of JAX": "first",
    "in a library that does not listen": "first",
    "in work that swallows exceptions": "first",
    "twice": "first",
    "while results are saved": "first second third",
    "at the last word": "first second third",
}
WITHOUT_PAGE = ("in a library that does not listen", "in work that swallows exceptions", "twice")


@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)],
    ids=["SIGINT", "SIGTERM"],
)
def test_a_signal_leaves_every_finished_stage_and_a_word(tmp_path: Path, number: signal.Signals, code: int):
    script = Path(__file__).with_name("rehearsed_runs.py")
    command = [sys.executable, str(script), str(tmp_path), *(f"{moment}:{int(number)}" for moment in MOMENTS)]
    environment = os.environ | {"COLUMNS": "200"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, env=environment)
    for (key, run), (moment, finished) in zip(json.loads(done.stdout).items(), MOMENTS.items(), strict=True):
        kept = finished.split()
        assert run["status"] == code, (moment, run["output"])
        assert "Traceback" not in run["output"], moment
        assert "Exception" not in run["output"], moment
        (word,) = [line for line in run["output"].splitlines() if line.startswith("Interrupted")]
        assert all(f"'{stage}'" in word for stage in kept), moment
        # Where the process has to end at once there is neither: what was found is in the journal.
        page, written = tmp_path / key / "report.html", bool(kept) and moment not in WITHOUT_PAGE
        assert (page.exists(), (tmp_path / key / "results.nc").exists()) == (written, written), moment
        if written:
            text = page.read_text(encoding="utf-8")
            assert [stage for stage in ("first", "second", "third") if f"{stage} is done" in text] == kept, moment
