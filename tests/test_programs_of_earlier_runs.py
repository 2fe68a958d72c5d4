"""What an earlier run has compiled is used again, and never where anything that it was made of has changed."""

import json
import os
import subprocess
import sys

import pytest

from aleator._core import programs

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

# The objective is (2 scale x - 6)², and x is decided.
MODEL = """
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import aleator as al
import numbers_of_a_model

@jax.custom_jvp
def square(x):
    return x**2


square.defjvp(lambda x, dx: (square(*x), 2.0 * x[0] * dx[0]))


class Gain(al.AlgebraicSystem):
    x: Any
    noise: Any

    def outputs(self):
        y = numbers_of_a_model.SCALE * (2.0 * self.x) * (1.0 + self.noise)
        return {"miss": square(y - 6.0)}


problem = al.Problem(
    Gain(x=al.Decision(1.0, 0.0, 10.0), noise=al.Uniform(0.0, half_width=1e-3)),
    minimize=al.output("miss").mean,
    expansion=al.Expansion(order=2),
)
solution = al.solve(problem, throw=False)
"""


EDITS = {
    "rule of differentiation": (("2.0 * x[0]", "1.5 * x[0]"), 2.0),
    "method": (("square(y - 6.0)", "square(y - 3.0)"), 4.0),
}
WIDER = ("half_width=1e-3", "half_width=0.1")
CALLED = (
    "(2.0 * self.x)",
    '(jax.pure_callback(np.asarray, jax.ShapeDtypeStruct((), float), 1.0, vmap_method="sequential") * 2.0 * self.x)',
)


def edited(before="", after=""):
    assert before in MODEL
    return MODEL.replace(before, after) if before else MODEL, "SCALE = 1.0"


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


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The folder, a run that fills it, and one of the same model and edited ones, with sets in another order."""
    folder = tmp_path_factory.mktemp("programs")
    models = {name: edited(*edit) for name, (edit, _) in EDITS.items()}
    models |= {"module": (MODEL, "SCALE = 0.5"), "called": edited(*CALLED), "wider": edited(*WIDER)}
    first = ran(folder, {"model": edited()})
    return folder, first, ran(folder, {"model": edited()} | models, PYTHONHASHSEED="1")


def test_another_run_traces_what_has_changed_alone(runs):
    _, first, second = runs
    answer, traced = first["model"]
    assert answer == pytest.approx(3.0, rel=1e-5)
    assert traced >= 2
    assert second["model"] == [answer, 0]
    for name, factor in [*((name, factor) for name, (_, factor) in EDITS.items()), ("module", 1.0), ("called", 2.0)]:
        answer, traced = second[name]
        assert answer == pytest.approx(6.0 / factor, rel=1e-5), name
        assert traced >= 1, name
    answer, traced = second["wider"]
    # Numbers alone trace nothing. The mean of (2 x (1 + n) - 6)² is least at x = 3 / (1 + var n).
    assert answer == pytest.approx(3.0 / (1.0 + 0.1**2 / 3.0), rel=1e-5)
    assert traced == 0


@pytest.mark.slow
def test_files_that_are_lost_or_damaged_are_made_anew_and_what_calls_python_is_never_kept(runs):
    folder, first, _ = runs
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    assert len(files) >= 2
    for i, path in enumerate(files):
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]) if i % 2 else path.unlink()
    models = {"model": edited(), "called": edited(*CALLED)}
    third, fourth = (ran(folder, models) for _ in range(2))
    assert [run["model"][0] for run in (third, fourth)] == [first["model"][0]] * 2
    assert fourth["model"][1] == 0
    assert min(run["called"][1] for run in (third, fourth)) >= 1


def test_the_programs_unused_for_longest_are_forgotten_and_other_files_are_spared(tmp_path, monkeypatch):
    monkeypatch.setattr(programs, "_MOST_BYTES", 250)
    folder = tmp_path / programs._kind()
    other = tmp_path / "of a user" / "aleator_a-cache"
    for age, path in enumerate([*(folder / f"{name}-cache" for name in ("newest", "new", "old", "oldest")), other]):
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(bytes(100))
        os.utime(path, (1e9 - age, 1e9 - age))
    programs._forget_oldest(folder)
    assert sorted(path.name for path in folder.iterdir()) == ["new-cache", "newest-cache"]
    assert other.exists()
