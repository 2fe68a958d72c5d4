"""Samples in the journal of a run: what was ended goes on from there, with the same digits."""

from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator._core import journalled
from aleator.ensemble import CalledEnsemble
from executors import AsProcesses

MODEL = {"off": al.Uniform(0.0, half_width=1.0), "more": al.Normal(2.0, 0.1)}


def scattered(model):
    """A sum, and a row of numbers."""
    return {"sum": model["off"] + model["more"], "row": jnp.stack([model["off"] ** 2, jnp.sin(model["more"])])}


METHODS = [al.references.monte_carlo, al.references.quasi_monte_carlo]


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts are kept as soon as they are there."""
    monkeypatch.setattr(journalled, "_OFTEN", 0.0)


@pytest.fixture
def travelling() -> Iterator[Executor]:
    with AsProcesses(2) as executor:
        yield executor


def bits(sample: al.references.RandomSample) -> list[bytes]:
    return [sample.values[name].tobytes() for name in ("sum", "row")]


def ended(done_before: float):
    """Ctrl-C as soon as this part of the sample is done."""

    def end(task: str, done: int, total: int) -> None:
        if done >= done_before * total:
            raise KeyboardInterrupt

    return end


@pytest.mark.parametrize(("method", "by"), list(zip(METHODS, ["here", "an executor"], strict=True)))
def test_a_sample_that_was_ended_goes_on_from_its_parts(
    method, by: str, travelling: Executor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    executor = travelling if by == "an executor" else None
    undisturbed = method(scattered, MODEL, 2048, batch=100)
    with al.journal(tmp_path), pytest.raises(KeyboardInterrupt):
        method(scattered, MODEL, 2048, batch=100, executor=executor, progress=ended(0.5))
    assert len(list((tmp_path / "finished").glob("*.part"))) == 11
    told = []
    with al.journal(tmp_path) as kept:
        monkeypatch.setattr("aleator._core.journalled._Keeping.add", lambda self, result: told.append(result))
        resumed = method(scattered, MODEL, 2048, batch=100, executor=executor)
        assert kept.recalled == 0
    assert bits(resumed) == bits(undisturbed)
    assert len(told) == 21 - 11
    assert not list((tmp_path / "finished").glob("*.part"))
    with al.journal(tmp_path) as kept:
        again = method(scattered, MODEL, 2048, batch=100)
        assert kept.recalled == 1
    assert bits(again) == bits(undisturbed)
    assert str(again) == str(undisturbed)
    assert bits(al.load(tmp_path)[f"{method.__name__} scattered 1"]) == bits(undisturbed)


def called(model):
    return {"sum": model["off"] + model["more"], "row": np.stack([model["off"] ** 2, np.sin(model["more"])])}


def test_called_functions_are_kept_from_a_few_calls_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    own = {"samples": 256, "traced": False}
    undisturbed = al.references.monte_carlo(called, MODEL, **own)
    calls = []
    call = CalledEnsemble._call
    monkeypatch.setattr(CalledEnsemble, "_call", lambda self, point: calls.append(point) or call(self, point))
    with al.journal(tmp_path), pytest.raises(KeyboardInterrupt):
        al.references.monte_carlo(called, MODEL, **own, progress=ended(0.7))
    assert len(calls) == 180
    with al.journal(tmp_path):
        resumed = al.references.monte_carlo(called, MODEL, **own)
    assert len(calls) == 256
    assert bits(resumed) == bits(undisturbed)


FACTOR = 1.0


def scaled(model):
    return FACTOR * model["off"]


def test_a_changed_function_model_or_argument_gives_a_new_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def drawn(model=MODEL, **how):
        with al.journal(tmp_path) as kept:
            sample = al.references.monte_carlo(scaled, model, **{"samples": 64, "seed": 1} | how)
            return sample.values, kept.recalled

    first, _ = drawn()
    again, recalled = drawn()
    assert recalled == 1
    assert again.tobytes() == first.tobytes()
    for how in ({"seed": 2}, {"samples": 128}, {"traced": False}, {"batch": 7}, {"model": MODEL | {"more": 1.0}}):
        assert drawn(**how)[1] == 0
    monkeypatch.setattr(f"{__name__}.FACTOR", 3.0)
    with pytest.warns(al.JournalWarning, match="because the model's code has changed since"):
        changed, recalled = drawn()
    assert recalled == 0
    np.testing.assert_allclose(changed, 3.0 * first, rtol=1e-15)


def test_the_whole_sample_of_a_black_box_is_kept_unless_it_may_drop_some(tmp_path: Path):
    samples = []
    for drop in (0.0, 0.0, 0.1, 0.1):
        with al.journal(tmp_path) as kept:
            box = al.foreign.BlackBox(called, drop=drop)
            samples.append((bits(al.references.monte_carlo(box, MODEL, 64)), kept.recalled, kept.begun))
    assert [one[1:] for one in samples] == [(0, 1), (1, 0), (0, 0), (0, 0)]
    assert all(one[0] == samples[0][0] for one in samples)
    assert samples[0][0] == bits(al.references.monte_carlo(called, MODEL, 64, traced=False))
