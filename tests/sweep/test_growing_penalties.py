"""Penalties that grow until limits hold: closed forms of each step, and the hard optimum at the end."""

import numpy as np
import pytest

import aleator as al
from tiny_models import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, Gain

LIMIT = 2.0


def problem(*limits):
    """Choose a gain close to 3, the mean of the response, subject to limits."""
    theta = al.Uniform(1.0, half_width=HALF_WIDTH)
    return al.Problem(Gain(al.Decision(1.0, 0.01, 10.0), theta), grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits)


def test_the_excess_falls_with_the_weight_as_the_closed_form_says():
    found = al.harden(problem((RESPONSE.mean <= LIMIT).named("low")), weight=1.0, factor=10.0, tolerance=1e-3)
    weights = np.array(found.weights)
    # Least by (g - 3)² + w (g - 2)², up to terms without g.
    np.testing.assert_allclose(
        [one.decisions["gain"] for one in found.solutions], (3 + 2 * weights) / (1 + weights), rtol=1e-5
    )
    np.testing.assert_allclose([one["low"] for one in found.excesses], 1 / (1 + weights) / LIMIT, rtol=1e-4)
    assert found.weights[-1] == 1000.0
    assert found.holds
    assert "all hold, to 1e-03" in str(found)


def test_an_exact_penalty_holds_once_its_weight_is_above_the_shadow_price():
    hard = al.solve(problem((RESPONSE.mean <= LIMIT).named("low")))
    price = hard.multiplier("low")
    found = al.harden(problem((RESPONSE.mean <= LIMIT).named("low")), weight=0.3 * price, factor=2.0, exact=True)
    assert found.weights == pytest.approx([0.3 * price, 0.6 * price, 1.2 * price])
    assert found.best.decisions["gain"] == pytest.approx(hard.decisions["gain"], rel=1e-5)


def test_only_named_constraints_grow_and_the_others_hold():
    limits = (RESPONSE.mean <= LIMIT).named("low"), (RESPONSE.mean >= 2.5).named("high")
    found = al.harden(problem(*limits), "low", most=3)
    assert not found.holds
    assert len(found.solutions) == 3
    assert found.best.decisions["gain"] == pytest.approx(2.5, rel=1e-5)
    assert "not all hold" in str(found)


def test_ctrl_c_keeps_what_was_found():
    def stop(stage, done, total):
        del stage, total
        if done == 2:
            raise KeyboardInterrupt

    found = al.harden(problem(RESPONSE.mean <= LIMIT), progress=stop)
    assert found.interrupted
    assert len(found.solutions) == len(found.weights) == len(found.excesses) == 2


def test_a_factor_that_does_not_grow_is_refused():
    with pytest.raises(al.ProblemError, match="harden: factor: expected a number above 1"):
        al.harden(problem(RESPONSE.mean <= LIMIT), factor=1.0)


def test_what_is_printed_is_a_sentence_and_tells_of_an_interruption():
    limits = (RESPONSE.mean <= LIMIT).named("low")
    found = al.harden(problem(limits), most=2)
    heading, *_, end = str(found).splitlines()
    assert heading.endswith("largest excess, relative to its limit's magnitude")
    assert end == "not all hold to 1e-04 of their magnitudes: allow larger weights, or see al.conflict"

    def stop(stage, done, total):
        if done == 1:
            raise KeyboardInterrupt

    stopped = al.harden(problem(limits), progress=stop)
    assert str(stopped).endswith("not all hold to 1e-04 of their magnitudes: interrupted by the user")


def test_weights_beyond_all_numbers_are_refused():
    with pytest.raises(al.ProblemError, match=r"harden: expected weights below 1e\+100.*smaller factor"):
        al.harden(problem(RESPONSE.mean <= LIMIT), weight=1e150, factor=1e200)
