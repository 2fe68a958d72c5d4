"""Executables: one for each structure of the arguments, and the same numbers however they travel."""

import json
import os
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator._core import programs
from aleator._core.compilation import Compiled, Use
from aleator._core.equations import loop_while_any
from aleator._core.programs import Programs


def _results(tree, kind, x):
    products = {name: part * x.sum() for name, part in tree["parts"].items()}
    return products, jnp.arange(3) + tree["shift"], (x.sum() > 0, jnp.zeros((0, 2))), kind


TREE = {"parts": {"a": np.arange(6.0).reshape(3, 2), "b": np.asarray(2.5)}, "shift": np.asarray(4)}
SEVEN = np.asarray(7)


def test_bound_functions_give_every_array_its_shape_kind_and_numbers_back_and_share_an_executable():
    compiled = Compiled(_results)
    x = np.array([0.5, -3.0])
    found = compiled.bound(TREE, SEVEN)(x)
    products = {"a": -2.5 * TREE["parts"]["a"], "b": -2.5 * 2.5}
    expected = products, np.arange(3) + 4, (np.asarray(False), np.zeros((0, 2))), SEVEN
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert isinstance(one, np.ndarray)
        assert one.dtype == np.asarray(other).dtype
        np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match="read-only"):
        found[0]["a"][0, 0] = 1.0
    second = compiled.bound(jax.tree.map(lambda leaf: 2 * leaf, TREE), SEVEN)(x)
    assert compiled.compilations == 1
    np.testing.assert_array_equal(second[0]["a"], 2 * found[0]["a"])
    compiled.bound(TREE | {"parts": {"a": TREE["parts"]["a"]}}, SEVEN)(x)
    assert compiled.compilations == 2


@pytest.mark.parametrize("use", Use)
def test_elementary_functions_are_those_of_numpy_however_they_are_compiled(use):
    """With vectors of 512 bits XLA's arctangent is off by 1: what options make of a function is to be tested."""
    x = np.random.default_rng(0).normal(scale=3.0, size=1001)
    y = np.abs(x)
    names = ("sin", "cos", "tan", "exp", "expm1", "tanh", "sinh", "cosh", "arctan", "arcsinh", "cbrt", "floor", "sign")
    others = ("log", "log1p", "log10", "log2", "sqrt", "square", "reciprocal")

    def every(numpy, x, y):
        found = {name: getattr(numpy, name)(x) for name in names} | {name: getattr(numpy, name)(y) for name in others}
        found |= {"arctan2": numpy.arctan2(x, y), "power": y**1.7, "arcsin": numpy.arcsin(x / 20)}
        return found | {"arccos": numpy.arccos(x / 20), "arctanh": numpy.arctanh(x / 20), "hypot": numpy.hypot(x, y)}

    found = Compiled(lambda x, y: every(jnp, x, y), use=use)(jnp.asarray(x), jnp.asarray(y))
    for name, values in every(np, x, y).items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12, atol=1e-14, err_msg=name)


def test_what_a_check_of_a_library_stops_gives_no_number_in_the_right_shape():
    def checked(tree, x):
        return eqx.error_if(x, x.sum() > 1, "too large") * tree["parts"]["b"], jnp.arange(3), x.sum() > 0

    compiled = Compiled(checked)
    for call in (compiled.bound(TREE), lambda x: compiled(TREE, x)):
        good, which, sign = call(np.array([0.25, 0.5]))
        np.testing.assert_array_equal(good, 2.5 * np.array([0.25, 0.5]))
        bad, still, none = call(np.array([2.0, 0.5]))
        assert np.isnan(bad).all()
        assert bad.shape == (2,)
        np.testing.assert_array_equal(which, still)
        assert (bool(sign), bool(none)) == (True, False)
    assert compiled.compilations == 2


def test_other_errors_of_a_program_are_not_taken_for_numbers():
    def failing(x):
        return jax.pure_callback(lambda _: 1 / 0, jax.ShapeDtypeStruct((), float), x)

    with pytest.raises(jax.errors.JaxRuntimeError, match="division by zero"):
        Compiled(failing)(jnp.asarray(1.0))


def test_what_is_prepared_is_not_compiled_again():
    compiled = Compiled(lambda scale, x: scale["by"] * x)
    compiled.prepare({"by": jnp.asarray(1.0)}, np.zeros(3))
    np.testing.assert_array_equal(compiled({"by": jnp.asarray(2.0)}, np.arange(3.0)), [0.0, 2.0, 4.0])
    assert compiled.compilations == 1


def test_only_so_many_programs_are_kept():
    kept = Programs(most=2)
    assert [kept.get(key, key.upper) for key in "abac"] == ["A", "B", "A", "C"]
    assert [key in kept for key in "abc"] == [True, False, True]


def _until(x):
    return jax.lax.while_loop(lambda y: jnp.sum(y**2) > 1.0, lambda y: y / 2, x)


def test_a_loop_of_many_realisations_that_ends_by_a_condition_is_compiled_with_some_optimisation():
    x = np.ones(3)
    assert Use.BRIEF.of(jax.make_jaxpr(jax.vmap(jax.jit(_until)))(np.ones((2, 3)))) is Use.ONCE
    assert Use.BRIEF.of(jax.make_jaxpr(jax.jit(_until))(x)) is Use.BRIEF
    assert Use.BRIEF.of(jax.make_jaxpr(lambda x: jax.lax.fori_loop(0, 9, lambda _, y: y / 2, x))(x)) is Use.BRIEF
    np.testing.assert_allclose(Compiled(_until, use=Use.BRIEF)(x), 0.5)


def _halved(x, times):
    """`x / 2**times`, in a loop that leaves what is finished as it is."""

    def advance(state):
        x, left = state
        return jnp.where(left > 0, x / 2, x), jnp.maximum(left - 1, 0)

    return loop_while_any(lambda state: state[1] > 0, advance, (x, times))[0]


def test_a_loop_that_many_take_together_lasts_until_all_have_finished():
    x, times = np.array([3.0, 5.0, 7.0, 9.0]), np.array([3, 0, 1, 7])
    both = jax.vmap(lambda x, times: jax.jvp(lambda x: _halved(x, times), (x,), (1.0,)))
    values, slopes = map(np.asarray, Compiled(both, use=Use.BRIEF)(x, times))
    assert (values == x / 2.0**times).all()
    assert (slopes == 1 / 2.0**times).all()
    # Whether it goes on is known from the step before, so that no two answers can differ.
    assert Use.BRIEF.of(jax.make_jaxpr(both)(x, times)) is Use.BRIEF


# --- What an earlier run has compiled is used again, and never where anything that it was made of has changed ---------


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
    for age, name in enumerate(["newest-cache", "new-cache", "old-cache", "oldest-cache", "of a user"]):
        (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    programs._forget_oldest(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new-cache", "newest-cache", "of a user"]
