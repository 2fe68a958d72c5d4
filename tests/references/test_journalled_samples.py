"""Samples in the journal of a run: the same work is the same sample. `test_kept_work.py` ends and resumes them."""

from pathlib import Path

import numpy as np
import pytest

import aleator as al

MODEL = {"off": al.Uniform(0.0, half_width=1.0), "more": al.Normal(2.0, 0.1)}


def bits(sample: al.references.RandomSample) -> list[bytes]:
    return [sample.values[name].tobytes() for name in ("sum", "row")]


def called(model):
    return {"sum": model["off"] + model["more"], "row": np.stack([model["off"] ** 2, np.sin(model["more"])])}


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
