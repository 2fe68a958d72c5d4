"""Evidence in stretches: folded or not, it is the same."""

import numpy as np
import pytest
from decaying_problems import decaying_problem

import aleator as al
from aleator.ensemble import draw, drawn_from
from aleator.solution import Solution
from aleator.uncertainty import HermiteGerm, LegendreGerm
from aleator.validation import _validate

SAMPLES = 3000


@pytest.fixture(scope="module")
def solution() -> Solution:
    return al.solve(decaying_problem())


def test_each_system_has_its_own_place_in_one_stream_of_random_numbers():
    germs = LegendreGerm(), HermiteGerm(), HermiteGerm()
    generator = np.random.default_rng(7)
    whole = np.concatenate([draw(germs, count, generator) for count in (10, 3, 30)])
    parts = [drawn_from(germs, 7, first, count) for first, count in ((0, 7), (7, 30), (37, 6))]
    assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_stretches_are_the_whole_sample_in_order():
    for samples, batch, before in ((1000, 250, 1000), (10**6, 250, 250), (1003, 10, 20), (7, 250, 7)):
        stretches = _validate.stretches(samples, min(batch, samples), before)
        assert len(stretches) < 260
        ends = [one.stop for one in stretches]
        assert [0, *ends[:-1]] == [one.start for one in stretches]
        assert ends[-1] == samples
        assert before in {*ends, 0}


@pytest.mark.slow
def test_folded_evidence_is_that_of_stored_histories(solution: Solution, monkeypatch: pytest.MonkeyPatch):
    stored = al.validate(solution, SAMPLES, batch=100, keep=150)
    monkeypatch.setattr(_validate, "_MANY", 0)
    folded = al.validate(solution, SAMPLES, batch=100, keep=150)
    assert folded.functionals.keys() == stored.functionals.keys()
    for one, other in zip(folded.functionals.values(), stored.functionals.values(), strict=True):
        for name in ("mean", "std", "std_error"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-12)
    assert any(0 < share.count < SAMPLES for share in stored.violations.values())
    assert folded.violations == stored.violations
    assert all((folded.broken[name] == mask).all() for name, mask in stored.broken.items())
    assert [one.values.tobytes() for one in folded.trajectories] == [
        one.values.tobytes() for one in stored.trajectories
    ]
