"""The objectives of motion planning, against closed forms: a response `gain θ (1 + t)` and others, `θ` uniform."""

from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate

import aleator as al
from aleator.statistics import CoefficientProduct
from aleator.transcription import transcribe
from compiling import compiled

HALF = 0.3
VARIANCE = HALF**2 / 3
T = np.linspace(0.0, 0.8, 17)  # the instants and the middles between them: Simpson's rule


class Joint(al.System):
    """Torques and rates as functions of time and of one uncertain number."""

    states = ("nothing",)

    gain: Any
    theta: Any

    def rhs(self, t, z):
        return (0.0 * z.nothing,)

    def outputs(self, t, z):
        return {
            "torque": self.gain * self.theta * (1 + t),
            "torque_rate": self.gain * self.theta + 3 * t,
            "certain": jnp.sin(3 * t) + 0.0 * self.gain,
            "rate": 1 - 2 * t,
            "against": (2 - self.theta) * (1 - 2 * t),
            "zero": 0.0 * self.theta,
        }


def integral(values):
    return integrate.simpson(values, x=T)


# At the start the gain is 2 and the final time 0.8 s.
SECOND = 1 + VARIANCE
WORK = integral(2 * (1 + T) * np.abs(1 - 2 * T))
EXPECTED = {
    "effort": (al.objectives.effort("torque"), 4 * SECOND * integral((1 + T) ** 2)),
    "jerk": (al.objectives.torque_rate("torque"), integral((2 + 3 * T) ** 2 + 4 * VARIANCE)),
    # E|θ (2 - θ)| is 1 minus the variance; from coefficients one by one it is 1 plus the variance.
    "power": (al.objectives.power({"torque": "against"}), (1 - VARIANCE) * WORK),
    "coefficient": (al.objectives.coefficient_power({"torque": "against"}), (1 + VARIANCE) * WORK),
    "sum of powers": (
        al.objectives.power({"torque": "rate", "certain": "rate"}, weights=[1.0, 0.1]),
        WORK + 0.1 * integral(np.abs(np.sin(3 * T) * (1 - 2 * T))),
    ),
    "mean error": (
        al.objectives.terminal_mean_error({"torque": 5.0, "rate": 0.2}),
        np.hypot(2 * 1.8 - 5.0, (1 - 1.6) - 0.2),
    ),
    "variance": (al.objectives.terminal_variance("torque", "against"), VARIANCE * np.hypot((2 * 1.8) ** 2, 0.6**2)),
    "no variance": (al.objectives.terminal_variance("zero"), 0.0),
    "norm": (al.objectives.norm(al.value("gain"), al.terminal("rate").mean - 1.0), np.hypot(2.0, -1.6)),
    "spread over time": (al.time_integral(al.path("torque").std), 2 * np.sqrt(VARIANCE) * integral(1 + T)),
    "norm over time": (
        al.time_integral(al.objectives.norm(al.path("rate").mean, al.path("certain").mean)),
        integral(np.hypot(1 - 2 * T, np.sin(3 * T))),
    ),
    "time": (al.objectives.final_time(), 0.8),
}


def problem(constraints=()):
    """Starts at a gain of 2 and a final time of 0.8 s."""
    return al.Problem(
        Joint(al.Decision(2.0, 1.0, 5.0), al.Uniform(1.0, half_width=HALF)),
        grid=al.Grid(al.Decision(0.8, 0.5, 2.0), 8),
        minimize=al.value("gain") + al.objectives.final_time(),
        subject_to=constraints,
    )


def rows_at_the_start(declared):
    program = transcribe(declared).program
    return program.evaluate(program.start).constraints


def test_objectives_have_the_values_of_their_closed_forms():
    limits = [(expression >= -100.0).named(name) for name, (expression, _) in EXPECTED.items()]
    exact = [value for _, value in EXPECTED.values()]
    np.testing.assert_allclose(rows_at_the_start(problem(limits)), exact, rtol=1e-7, atol=1e-9)


def means(number):
    """A scope in which every statistic is one number."""
    return SimpleNamespace(statistic=lambda functionals, kind: number)


def test_the_norm_of_what_is_zero_has_derivative_zero():
    variance, error = al.objectives.terminal_variance("a", "b"), al.objectives.terminal_mean_error({"a": 0.0})

    @compiled
    def slopes():
        at = (variance, 0.0), (error, 0.0), (variance, 3.0)
        return [jax.grad(lambda x, one=one: one.evaluate(means(x)))(x) for one, x in at]

    np.testing.assert_allclose(slopes(), [0.0, 0.0, np.sqrt(2.0)], rtol=1e-14)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: al.objectives.effort("a", "b", weights=[1.0]), "expected 2 weights, one per term; received 1"),
        (lambda: al.time_integral(al.terminal("x").mean), "expected statistics of a path; received 'μ"),
    ],
    ids=["weights", "no path"],
)
def test_objectives_that_make_no_sense_are_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_no_sample_estimates_the_printed_power():
    coefficients = np.random.default_rng(0).normal(size=(4, 3, 2))
    expected = np.abs(coefficients[..., 0] * coefficients[..., 1]).sum(axis=0)
    kind = CoefficientProduct()
    found, sampled = compiled(lambda terms: (kind.of(terms, None), kind.of_sample(terms)))(coefficients)
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert np.isnan(sampled).all()
    with pytest.raises(al.ProblemError, match="of two outputs"):
        CoefficientProduct().of(np.ones((4, 3)), None)
