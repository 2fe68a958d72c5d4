"""Collocation points in parts, on as many threads as may be: the numbers of one system after the other."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription import transcribe
from aleator.transcription.sequential import _evaluator
from aleator.transcription.sequential._evaluator import Evaluator
from zoo import Decay

POINTS, STEPS, HALF_RATE, HALF_START = 37, 10, 0.4, 0.1


def decaying(model: Any = Decay):
    rate = al.Uniform(al.Decision(1.0, 0.5, 9.0), half_width=HALF_RATE)
    start = al.Uniform(al.Decision(0.5, 0.1, 2.0), half_width=HALF_START)
    amount = al.integral("x")
    return al.Problem(
        model(rate, start),
        grid=al.Grid(1.0, STEPS),
        minimize=amount.mean + amount.std,
        subject_to=[al.path("x").at_most(2.0, sigmas=2.0), al.time_integral(al.path("x").std) <= 3.0],
        expansion=al.Expansion(order=3, points=POINTS),
    )


@pytest.fixture(autouse=True)
def small_problems_in_parts(monkeypatch):
    monkeypatch.setattr(_evaluator, "_FEWEST_NUMBERS", 0)


@pytest.fixture
def all_threads_again():
    yield
    al.threads(None)


def evaluated(problem, x):
    transcription = transcribe(problem)
    return transcription, transcription.evaluator._evaluate(np.asarray(x))


def numbers_of(found):
    return jax.tree.leaves((found.meaning, found.derivatives, found.times))


@pytest.mark.usefixtures("all_threads_again")
def test_parts_agree_with_all_points_at_once_and_digits_do_not_depend_on_threads(monkeypatch):
    transcription, parts = evaluated(decaying(), [1.1, 0.6])
    assert len(transcription.evaluator._programs) == 2
    monkeypatch.setattr(_evaluator, "_FEWEST_POINTS", POINTS)
    evaluator = transcription.evaluator
    whole = Evaluator(transcription.traced, transcription.discretised, evaluator.anchors)(np.array([1.1, 0.6]))
    for one, other in zip(numbers_of(parts), numbers_of(whole), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-12)
    monkeypatch.undo()
    al.threads(1)
    again = evaluator._evaluate(np.array([1.1, 0.6]))
    for one, same in zip(numbers_of(parts), numbers_of(again), strict=True):
        np.testing.assert_array_equal(one, same)


class Bursting(Decay):
    """Decays, but at rates beyond one: those are not a number."""

    def outputs(self, t, z):
        return {"x": jnp.where(self.rate > 1.37, jnp.nan, z.x)}


def test_a_system_that_is_not_a_number_in_any_part_leaves_no_number():
    beyond = 1.0 + HALF_RATE * np.asarray(transcribe(decaying()).collocation.points)[:, 0] > 1.37
    assert 0 < beyond.sum() < POINTS
    evaluation = transcribe(decaying(model=Bursting)).program.evaluate(np.array([1.0, 0.5]))
    assert np.isnan(evaluation.objective)
    assert np.isnan(evaluation.constraints).all()
