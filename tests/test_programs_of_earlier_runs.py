"""What an earlier run has compiled is used again, and never where anything that it was made of has changed."""

import json
import os
import subprocess
import sys

import pytest

# Solves models, each a module of the same name with a module of numbers, and tells the decision of each and how many
# programs of ours were traced for it.
RUN = """
import json
import sys
import types

import jax

traced = []
jax.monitoring.register_event_duration_secs_listener(
    lambda name, _, fun_name="", **__: traced.append(fun_name) if name.endswith("jaxpr_trace_duration") else None
)


def module(name, text):
    sys.modules[name] = types.ModuleType(name)
    exec(compile(text, name, "exec"), vars(sys.modules[name]))
    return sys.modules[name]


answers = []
for model, numbers in json.load(sys.stdin):
    traced.clear()
    module("numbers_of_a_model", numbers)
    solution = module("model", model).solution
    answers.append((float(solution.vector[0]), sum(name.startswith("flat") for name in traced)))
print(json.dumps(answers))
"""

# The objective is (gain * scale * (1 + shift) * x - 6)², and x is decided.
MODEL = """
from typing import Any, ClassVar

import jax
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
"""


NUMBERS = "SCALE = 1.0"
EDITS = {
    "global": (("SHIFT = 0.0", "SHIFT = 1.0"), 4.0),
    "table": (('{"unit": 1.0}', '{"unit": 0.5}'), 1.0),
    "default": (("by=1.0", "by=2.0"), 4.0),
    "function": (("return lambda x: x * (1.0 + amount)", "return lambda x: x / (2.0 + amount)"), 1.0),
    "class attribute": (("gain: ClassVar[float] = 2.0", "gain: ClassVar[float] = 4.0"), 4.0),
    "method": (("(rho.y - 6.0)", "(rho.y - 3.0)"), 4.0),
}
UNUSED = ("def guess(self):", "unused = 1\n\n    def guess(self):")
WIDER = ("half_width=1e-3", "half_width=0.1")
CALLED = (
    "self.gain * self.x)",
    'jax.pure_callback(np.asarray, jax.ShapeDtypeStruct((), float), 1.0, vmap_method="sequential")'
    " * self.gain * self.x)",
)


def edited(*edit):
    if not edit:
        return MODEL, NUMBERS
    before, after = edit
    assert before in MODEL
    return MODEL.replace(before, after), NUMBERS


def ran(folder, models, **more):
    """The decision of each model, and how many programs were traced for it, in one run that keeps them in a folder."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "ALEATOR_"))}
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", RUN],
        env=kept | {"ALEATOR_CACHE": str(folder)} | more,
        input=json.dumps(list(models.values())),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    return dict(zip(models, json.loads(run.stdout), strict=True))


# Runs one after another in one folder; each begins with the model as it is.


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("programs")


@pytest.fixture(scope="module")
def first(folder):
    """The answer that the programs in the folder were compiled for."""
    answer, traced = ran(folder, {"model": edited()})["model"]
    assert answer == pytest.approx(3.0, rel=1e-5)
    assert traced >= 2
    return answer


@pytest.fixture(scope="module")
def second(first, folder):
    """A run of the same model, and then of edited ones."""
    models = {name: edited(*edit) for name, (edit, _) in EDITS.items()}
    models |= {"module": (MODEL, "SCALE = 0.5"), "unused": edited(*UNUSED), "called": edited(*CALLED)}
    return ran(folder, {"model": edited(), "wider": edited(*WIDER)} | models, PYTHONHASHSEED="1")


@pytest.fixture(scope="module")
def third(second, folder):
    """A run after some files were lost and others damaged, whose programs JAX may have."""
    files = sorted(folder.glob("*/aleator_*-cache"))
    assert len(files) >= 2
    for i, path in enumerate(files):
        path.write_bytes(path.read_bytes()[:1000]) if i % 2 else path.unlink()
    return ran(folder, {"model": edited(), "unused": edited(*UNUSED)})


@pytest.fixture(scope="module")
def fourth(third, folder):
    return ran(folder, {"model": edited(), "unused": edited(*UNUSED), "called": edited(*CALLED)})


def test_another_run_traces_no_program_and_gives_the_same_digits(first, second):
    assert second["model"] == [first, 0]


@pytest.mark.parametrize(
    ("name", "factor"), [*((name, factor) for name, (_, factor) in EDITS.items()), ("module", 1.0)]
)
def test_whatever_the_code_reads_may_change_between_two_runs(second, name, factor):
    answer, traced = second[name]
    assert answer == pytest.approx(6.0 / factor, rel=1e-5)
    assert traced >= 2


def test_numbers_alone_trace_nothing(second):
    answer, traced = second["wider"]
    # The mean of (2 x (1 + n) - 6)² is least at x = 3 / (1 + var n).
    assert answer == pytest.approx(3.0 / (1 + 0.1**2 / 3), rel=1e-5)
    assert traced == 0


def test_what_calls_python_is_never_taken_from_an_earlier_run(second, fourth):
    runs = [second["called"], fourth["called"]]
    assert [answer for answer, _ in runs] == pytest.approx([3.0, 3.0], rel=1e-5)
    assert runs[1][1] >= 2


def test_files_that_are_lost_or_damaged_are_made_anew(first, third, fourth):
    assert third["model"][0] == first
    assert third["model"][1] >= 2
    assert fourth["model"] == [first, 0]


def test_code_that_changes_without_a_change_of_the_program_is_traced_once(first, second, fourth):
    assert second["unused"][0] == first
    assert second["unused"][1] > 0
    assert fourth["unused"] == [first, 0]


def test_on_several_devices_every_run_gives_the_answer(first, folder):
    two = {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    runs = [ran(folder, {"model": edited()}, **two)["model"] for _ in range(2)]
    assert [answer for answer, _ in runs] == pytest.approx([first] * 2, rel=1e-12)
