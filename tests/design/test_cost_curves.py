import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.design import AbstractScope
from tiny_models import LOSS, ONE_STEP, Gain


class Spread(AbstractScope):
    def __init__(self, value):
        self.number = value

    def statistic(self, functional, kind):
        raise AssertionError("a cost curve needs no statistics")

    def realised(self, functional):
        raise NotImplementedError

    def time_integral(self, expression):
        raise NotImplementedError

    def value(self, name):
        assert name == "theta.half_width"
        return self.number


def logarithm(spread):
    return 2.0 - jnp.log(spread)


NAME = "theta.half_width"
CURVES = {
    "reciprocal power": (
        al.cost.reciprocal_power(NAME, bias=0.5, scale=3.0, power=1.5),
        lambda s: 0.5 + 3.0 / s**1.5,
        lambda s: -4.5 / s**2.5,
        "(0.5 + 3/theta.half_width^1.5)",
    ),
    "reciprocal": (
        al.cost.reciprocal(NAME, bias=0.5, scale=3.0),
        lambda s: 0.5 + 3.0 / s,
        lambda s: -3.0 / s**2,
        "(0.5 + 3/theta.half_width)",
    ),
    "reciprocal squared": (
        al.cost.reciprocal_squared(NAME, bias=0.5, scale=3.0),
        lambda s: 0.5 + 3.0 / s**2,
        lambda s: -6.0 / s**3,
        "(0.5 + 3/theta.half_width²)",
    ),
    "exponential": (
        al.cost.exponential(NAME, bias=0.5, scale=3.0, rate=2.0),
        lambda s: 0.5 + 3.0 * np.exp(-2.0 * s),
        lambda s: -6.0 * np.exp(-2.0 * s),
        "(0.5 + 3 exp(−2 theta.half_width))",
    ),
    "a function of one's own": (
        al.cost.cost_curve(NAME, logarithm),
        lambda s: 2.0 - np.log(s),
        lambda s: -1.0 / s,
        "logarithm(theta.half_width)",
    ),
}


@pytest.mark.parametrize("kind", CURVES)
def test_cost_curves_and_their_derivatives_agree_with_closed_forms(kind):
    curve, value, slope, text = CURVES[kind]
    for spread in (0.05, 0.4, 3.0):
        cost, derivative = jax.value_and_grad(lambda s: curve.evaluate(Spread(s)))(spread)
        assert float(cost) == pytest.approx(value(spread), rel=1e-14)
        assert float(derivative) == pytest.approx(slope(spread), rel=1e-13)
    assert str(curve) == text


def test_the_cheapest_spread_under_a_limit_is_found():
    # Gain 1: the response's spread is the half-width over the root of 3, and cheap spreads are wide.
    problem = al.Problem(
        Gain(gain=1.0, theta=al.Uniform(1.0, half_width=al.Decision(0.1, 0.01, 0.9))),
        grid=ONE_STEP,
        minimize=al.cost.reciprocal(NAME, bias=0.5, scale=0.2),
        subject_to=[al.terminal("response").at_most(1.25, sigmas=1.0)],
    )
    solution = al.solve(problem)
    half_width = 0.25 * np.sqrt(3.0)
    assert solution.decisions[NAME] == pytest.approx(half_width, rel=1e-7)
    assert solution.objective == pytest.approx(0.5 + 0.2 / half_width, rel=1e-7)


def test_a_curve_of_an_unknown_number_is_refused():
    with pytest.raises(
        al.ProblemError, match=r"no number of the model 'theta\.half_widht'.*Did you mean 'theta\.half_w"
    ):
        al.Problem(
            Gain(gain=1.0, theta=al.Uniform(1.0, half_width=0.1)),
            grid=ONE_STEP,
            minimize=LOSS.mean + al.cost.reciprocal("theta.half_widht", bias=0.0, scale=1.0),
        )
