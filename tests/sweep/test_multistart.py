"""Local optima from several starts of a wave whose minima are known."""

import dataclasses
import warnings

import jax.numpy as jnp
import pytest

import aleator as al


class Wells(al.AlgebraicSystem):
    """`x⁴/4 - x³/3 - x²`, whose slope is `(x + 1) x (x - 2)`: minima -5/12 at -1 and -8/3 at 2. No number below -3."""

    x: al.Number

    def outputs(self):
        x = self.x
        return {
            "depth": x**4 / 4 - x**3 / 3 - x**2 + 0.0 * jnp.sqrt(x + 3),
            "bowls": (x * (x - 2.0)) ** 2,
            "x": x,
        }


def wells(output="depth", constraints=()):
    """Every output is a structure of its own."""
    return al.Problem(Wells(al.Decision(-0.7, -4.0, 4.0)), minimize=al.output(output).mean, subject_to=constraints)


def test_both_optima_are_found_and_listed_in_order_with_how_often_and_a_start_that_fails_is_kept():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.ExpansionWarning)
        starts = al.multistart(wells(), [{"x": x} for x in (-1.3, 1.6, -3.9, -0.8, 2.3, 2.0)])
    (deep, often), (shallow, seldom) = starts.optima
    assert (often, seldom) == (3, 2)
    assert (deep.objective, shallow.objective) == pytest.approx((-8 / 3, -5 / 12), rel=1e-8)
    assert (deep.decisions["x"], shallow.decisions["x"]) == pytest.approx((2.0, -1.0), rel=1e-5)
    assert starts.best is deep
    assert [one.ok and round(one.decisions["x"]) for one in starts.solutions] == [-1, 2, False, -1, 2, 2]
    assert not starts.interrupted
    assert str(dataclasses.replace(starts, interrupted=True)).endswith("interrupted by the user")
    for said in ("from 3 of 6 starts", "1 starts failed", "local optima (equal objectives count as one)"):
        assert said in str(starts)
    assert str(starts).index("-2.666") < str(starts).index("-0.416")


def test_random_starts_begin_with_the_problem_s_own_and_are_told_by_their_seed():
    seen = []
    starts = al.multistart(wells(), 5, seed=3, spread=0.25, progress=lambda *one: seen.append(one))
    again = al.multistart(wells(), 5, seed=3, spread=0.25)
    assert starts.solutions[0].objective == pytest.approx(al.solve(wells()).objective, rel=1e-12)
    assert [one.objective for one in starts.solutions] == [one.objective for one in again.solutions]
    assert {round(one.objective, 6) for one in starts.solutions} == {round(-8 / 3, 6), round(-5 / 12, 6)}
    assert sum(count for _, count in starts.optima) == 5
    assert (seen[0][1:], seen[-1][1:]) == ((0, 5), (5, 5))


def test_optima_at_one_place_and_mirrored_ones_count_as_one():
    starts = al.multistart(wells("bowls"), [{"x": 0.3}, {"x": 1.7}, {"x": 1.6}])
    assert [round(one.decisions["x"], 4) for one in starts.solutions] == [0.0, 2.0, 2.0]
    assert [count for _, count in starts.optima] == [3]
