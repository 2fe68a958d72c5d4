"""What an earlier run has compiled is used again, and never where anything that it was made of has changed."""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# A model, its answer, and how many programs of ours were traced for it. The objective is
# (gain * scale * (1 + shift) * x - 6)², and x is decided.
MODEL = """
import functools
import sys
from typing import Any, ClassVar

import jax

traced = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, _, fun_name="", **__: traced.append(fun_name) if name.endswith("jaxpr_trace_duration") else None
)
import numpy as np

import aleator as al
import numbers_of_a_model

SHIFT = 0.0
TABLE = {"unit": 1.0}


def scaled(x, by=1.0):
    return by * numbers_of_a_model.SCALE * x


def shifted(amount):
    return lambda x: x * (1.0 + amount)


class Gain(al.AlgebraicSystem):
    unknowns = ("y",)
    gain: ClassVar[float] = 2.0

    x: Any
    noise: Any

    def guess(self):
        return {"y": 0.0}

    def residual(self, rho):
        return (rho.y - TABLE["unit"] * shifted(SHIFT)(scaled(self.gain * self.x)) * (1.0 + self.noise),)

    def outputs(self, rho):
        return {"miss": (rho.y - 6.0) ** 2}


problem = al.Problem(
    Gain(x=al.Decision(1.0, 0.0, 10.0), noise=al.Uniform(0.0, half_width=1e-3)),
    minimize=al.output("miss").mean,
    expansion=al.Expansion(order=2),
)
solution = al.solve(problem, throw=False)
print(solution.vector[0], sum(name.startswith("flat") for name in traced))
"""


@pytest.fixture(scope="module")
def first_run(tmp_path_factory):
    """A folder of programs and the answer that they were compiled for."""
    place = tmp_path_factory.mktemp("first")
    answer, traced = ran(place)
    assert answer == pytest.approx(3.0, rel=1e-5)
    assert traced >= 2
    return place, answer


def ran(place, *edits, numbers="SCALE = 1.0", **more):
    """The decision that a model in a folder gives, edited, and how many programs were traced for it."""
    text = MODEL
    for before, after in edits:
        assert before in text
        text = text.replace(before, after)
    (place / "model.py").write_text(text)
    (place / "numbers_of_a_model.py").write_text(numbers)
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "ALEATOR_"))}
    own = kept | {"ALEATOR_CACHE": str(place / "programs"), "PYTHONDONTWRITEBYTECODE": "1"} | more
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "model.py"], cwd=place, env=own, capture_output=True, text=True, timeout=300
    )
    assert run.returncode == 0, run.stderr
    answer, traced = run.stdout.split()
    return float(answer), int(traced)


def test_another_run_traces_no_program_and_gives_the_same_digits(first_run):
    place, answer = first_run
    assert ran(place, PYTHONHASHSEED="1") == (answer, 0)


@pytest.mark.parametrize(
    ("edit", "numbers", "factor"),
    [
        (("SHIFT = 0.0", "SHIFT = 1.0"), "SCALE = 1.0", 4.0),
        (('{"unit": 1.0}', '{"unit": 0.5}'), "SCALE = 1.0", 1.0),
        (("by=1.0", "by=2.0"), "SCALE = 1.0", 4.0),
        (("return lambda x: x * (1.0 + amount)", "return lambda x: x / (2.0 + amount)"), "SCALE = 1.0", 1.0),
        (("gain: ClassVar[float] = 2.0", "gain: ClassVar[float] = 4.0"), "SCALE = 1.0", 4.0),
        (("(rho.y - 6.0)", "(rho.y - 3.0)"), "SCALE = 1.0", 4.0),
        (("SHIFT = 0.0", "SHIFT = 0.0"), "SCALE = 0.5", 1.0),
    ],
    ids=["global", "table", "default", "function", "class attribute", "method", "module"],
)
def test_whatever_the_code_reads_may_change_between_two_runs(first_run, tmp_path, edit, numbers, factor):
    shutil.copytree(first_run[0], tmp_path, dirs_exist_ok=True)
    answer, traced = ran(tmp_path, edit, numbers=numbers)
    assert answer == pytest.approx(6.0 / factor, rel=1e-5)
    assert traced >= 2


def test_what_calls_python_is_never_taken_from_an_earlier_run(tmp_path):
    called = (
        "self.gain * self.x)",
        'jax.pure_callback(np.asarray, jax.ShapeDtypeStruct((), float), 1.0, vmap_method="sequential")'
        " * self.gain * self.x)",
    )
    runs = [ran(tmp_path, called) for _ in range(2)]
    assert [answer for answer, _ in runs] == pytest.approx([3.0, 3.0], rel=1e-5)
    assert runs[1][1] >= 2


def test_files_that_are_damaged_or_cannot_be_loaded_are_traced_again(first_run, tmp_path):
    shutil.copytree(first_run[0], tmp_path, dirs_exist_ok=True)
    files = sorted(Path(tmp_path).glob("programs/*/aleator_*-cache"))
    assert len(files) >= 2
    rubbish = b"of another version"
    for i, path in enumerate(files):
        whole = path.read_bytes()
        path.write_bytes([whole[: len(whole) // 2], hashlib.sha256(rubbish).digest() + rubbish][i % 2])
    answer, traced = ran(tmp_path)
    assert answer == first_run[1]
    assert traced >= len(files)


def test_what_jax_found_in_its_own_cache_is_not_written_again(first_run, tmp_path):
    shutil.copytree(first_run[0], tmp_path, dirs_exist_ok=True)
    for path in tmp_path.glob("programs/*/aleator_*-cache"):
        path.unlink()
    assert [ran(tmp_path)[0] for _ in range(2)] == [first_run[1]] * 2


def test_code_that_changes_without_a_change_of_the_program_is_traced_once(first_run, tmp_path):
    shutil.copytree(first_run[0], tmp_path, dirs_exist_ok=True)
    edit = ("def guess(self):", "unused = 1\n\n    def guess(self):")
    runs = [ran(tmp_path, edit) for _ in range(2)]
    assert [answer for answer, _ in runs] == [first_run[1]] * 2
    assert runs[0][1] > 0
    assert runs[1][1] == 0


def test_numbers_alone_trace_nothing(first_run, tmp_path):
    shutil.copytree(first_run[0], tmp_path, dirs_exist_ok=True)
    answer, traced = ran(tmp_path, ("half_width=1e-3", "half_width=0.1"))
    # The mean of (2 x (1 + n) - 6)² is least at x = 3 / (1 + var n).
    assert answer == pytest.approx(3.0 / (1 + 0.1**2 / 3), rel=1e-5)
    assert traced == 0
