import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.design import AbstractScope, Taken, functionals_of
from compiling import compiled

GRID = al.Grid(3.0, 7, t_start=0.5)
T = np.linspace(0.5, 3.0, 8)
HISTORY = {"y": np.sin(3 * T) - 0.2 * T, "q": np.stack([T**2, -np.exp(T)], axis=1), "zero": np.zeros(8)}


def test_functionals_agree_with_numpy_on_outputs_of_any_shape():
    expected = {al.terminal: lambda y: y[-1], al.path: lambda y: y, al.peak: lambda y: np.abs(y).max(axis=0)}
    cases = [(functional(name), of(HISTORY[name])) for functional, of in expected.items() for name in ("y", "q")]
    found = compiled(lambda history: [one.evaluate(Taken(history, {}), GRID) for one, _ in cases])(HISTORY)
    for values, (_, exact) in zip(found, cases, strict=True):
        np.testing.assert_allclose(values, exact, rtol=1e-13)


def test_an_output_that_stays_zero_has_rms_zero_and_a_finite_derivative():
    def rms(scale):
        functional = al.rms("zero")
        return functional.evaluate(Taken({}, {functional: functional.integrand({"zero": scale * jnp.zeros(())})}), GRID)

    assert tuple(map(float, compiled(jax.value_and_grad(rms))(1.0))) == (0.0, 0.0)


class Numbers(AbstractScope):
    """Statistics and values that are given."""

    def __init__(self, **numbers):
        self.numbers = numbers

    def statistic(self, functionals, kind):
        return self.numbers["_".join([type(kind).__name__.lower(), *(one.output for one in functionals)])]

    def realised(self, functional):
        raise NotImplementedError

    def time_integral(self, expression):
        raise NotImplementedError

    def value(self, name):
        return self.numbers[name.replace(".", "_")]


SCOPE = Numbers(mean_y=2.0, std_y=0.5, variance_y=0.25, mean_w=-7.0, std_w=3.0, k_std=0.1)
Y, W = al.rms("y"), al.integral("w")


@pytest.mark.parametrize(
    ("expression", "expected", "text"),
    [
        (Y.mean + Y.std, 2.5, "μ[rms(y)] + σ[rms(y)]"),
        (Y.mean - 2 * Y.std, 1.0, "μ[rms(y)] − 2 σ[rms(y)]"),
        (-Y.mean, -2.0, "−μ[rms(y)]"),
        (3 - Y.mean * 2, -1.0, "−2 μ[rms(y)] + 3"),
        ((Y.mean + W.mean) / 2 + 1, -1.5, "0.5 μ[rms(y)] + 0.5 μ[∫w dt] + 1"),
        (2 * (Y.variance - 1) - (W.std - Y.mean), -2.5, "2 Var[rms(y)] − σ[∫w dt] + μ[rms(y)] − 2"),
        (sum([Y.mean, W.mean]), -5.0, "μ[rms(y)] + μ[∫w dt]"),
        (np.float64(4) * al.value("k.std") + Y.mean, 2.4, "4 k.std + μ[rms(y)]"),
        (0 * Y.std + Y.mean, 2.0, "μ[rms(y)]"),
        (0 * Y.std, 0.0, "0"),
    ],
)
def test_expressions_compute_what_they_say(expression, expected, text):
    assert float(expression.evaluate(SCOPE)) == pytest.approx(expected, rel=1e-14)
    assert str(expression) == text


def test_functionals_of_expressions_come_once_each_in_order_of_appearance():
    assert functionals_of((W.mean + Y.std, Y.mean, al.value("k"))) == (W, Y)


def test_functionals_are_shown_as_mathematics():
    shown = [functional("y").text() for functional in (al.integral, al.rms, al.terminal, al.path, al.peak)]
    assert shown == ["∫y dt", "rms(y)", "y(t_f)", "y(t)", "max|y(t)|"]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: Y.mean <= W, r"'∫w dt' differs between realisations"),
        (lambda: Y.mean * True, "received bool"),
        (lambda: bool(Y.mean), "An expression has no truth value"),
        (lambda: 0 <= Y.mean <= 1, "chain such as 'lower <= y <= upper' does not work"),
        (lambda: (Y.mean <= 1) and (W.mean <= 1), "A constraint has no truth value"),
        (lambda: Y.mean.with_sigmas(2.0), r"no standard deviation to scale in 'μ\[rms\(y\)\]'"),
    ],
)
def test_expressions_refuse_what_makes_no_sense(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_sigmas_are_scaled_to_the_largest_multiple_and_the_rest_in_proportion():
    expression = Y.mean + 2 * Y.std - 0.5 * W.std + 3
    assert expression.sigmas == 2.0
    assert float(expression.with_sigmas(3.0).evaluate(SCOPE)) == pytest.approx(2 + 3 * 0.5 - 0.75 * 3 + 3)
    assert Y.mean.sigmas is None
