"""Penalties that grow until limits hold: closed forms of each step, and the hard optimum at the end."""

import numpy as np
import pytest

import aleator as al
from zoo import MASS, bar_problem

LIMIT = 2.0
LOW = (MASS.mean <= LIMIT).named("low")


def problem(*limits):
    """Choose a width close to 3, subject to limits."""
    return al.Problem(bar_problem().system, minimize=(MASS.mean - 3.0) ** 2 + 1.0, subject_to=limits)


def test_the_excess_falls_with_the_weight_as_the_closed_form_says_and_ctrl_c_keeps_what_was_found():
    found = al.harden(problem(LOW), weight=1.0, factor=10.0, tolerance=1e-3)
    weights = np.array(found.weights)
    # Least by (a - 3)² + w (a - 2)², up to terms without a.
    widths = [one.decisions["width"] for one in found.solutions]
    np.testing.assert_allclose(widths, (3 + 2 * weights) / (1 + weights), rtol=1e-5)
    np.testing.assert_allclose([one["low"] for one in found.excesses], 1 / (1 + weights) / LIMIT, rtol=1e-4)
    assert found.weights[-1] == 1000.0
    assert found.holds
    assert "all hold, to 1e-03" in str(found)

    def stop(stage, done, total):
        if done == 2:
            raise KeyboardInterrupt

    found = al.harden(problem(LOW), weight=1.0, factor=10.0, progress=stop)
    assert found.interrupted
    assert len(found.solutions) == len(found.weights) == len(found.excesses) == 2
    assert str(found).endswith("interrupted by the user")


@pytest.mark.slow
def test_an_exact_penalty_holds_once_its_weight_is_above_the_shadow_price():
    price = 2.0  # of `(a - 3)²` at the limit
    found = al.harden(problem(LOW), weight=0.3 * price, factor=2.0, exact=True)
    assert found.weights == pytest.approx([0.3 * price, 0.6 * price, 1.2 * price])
    assert found.best.decisions["width"] == pytest.approx(LIMIT, rel=1e-5)


def test_of_several_limits_of_one_name_the_worst_excess_counts():
    found = al.harden(problem((MASS.mean <= LIMIT).named("band"), (MASS.mean >= 1.0).named("band")), weight=1.0, most=1)
    # Least by (a - 3)² + (a - 2)²: at 2.5.
    assert found.excesses[0]["band"] == pytest.approx(0.5 / LIMIT, rel=1e-4)
    assert not found.holds
