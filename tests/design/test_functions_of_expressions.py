"""Functionals, and functions of their statistics: values, slopes, texts and units, and designs that they shape."""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.design import Taken
from compiling import compiled
from zoo import (
    HALF_WIDTH,
    LOSS,
    ONE_STEP,
    RESPONSE,
    SPREAD,
    Gain,
    optimum,
)

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


def numbers(**known):
    """A scope of statistics and values that are known."""
    return SimpleNamespace(
        statistic=lambda functionals, kind: known["_".join([type(kind).__name__.lower(), functionals[0].output])],
        value=lambda name: known[name.replace(".", "_")],
    )


SCOPE = numbers(mean_y=2.0, std_y=0.5, variance_y=0.25, mean_w=-7.0, std_w=3.0, k_std=0.1)
Y, W = al.rms("y"), al.integral("w")


@pytest.mark.parametrize(
    ("expression", "expected", "text"),
    [
        (Y.mean - 2 * Y.std, 1.0, "μ[rms(y)] − 2 σ[rms(y)]"),
        (3 - Y.mean * 2, -1.0, "−2 μ[rms(y)] + 3"),
        ((Y.mean + W.mean) / 2 + 1, -1.5, "0.5 μ[rms(y)] + 0.5 μ[∫w dt] + 1"),
        (2 * (Y.variance - 1) - (W.std - Y.mean), -2.5, "2 Var[rms(y)] − σ[∫w dt] + μ[rms(y)] − 2"),
        (np.float64(4) * al.value("k.std") + Y.mean, 2.4, "4 k.std + μ[rms(y)]"),
        (0 * Y.std + Y.mean, 2.0, "μ[rms(y)]"),
    ],
)
def test_expressions_compute_what_they_say(expression, expected, text):
    assert float(expression.evaluate(SCOPE)) == pytest.approx(expected, rel=1e-14)
    assert str(expression) == text


# --- Products, quotients, powers, positive parts, maxima, costs and own functions ------------------------------------


VARIANCE = SPREAD**2
WAYS = {"shooting": al.Sequential(), "collocation": al.Simultaneous(al.schemes.GaussLegendre(1))}
BOTH = [WAYS["shooting"], pytest.param(WAYS["collocation"], marks=pytest.mark.slow)]


def distance(first, second):
    return jnp.hypot(first, second)


def logarithm(spread):
    return 2.0 - jnp.log(spread)


A, B = al.value("a"), al.value("b")
FUNCTIONS = {
    "product": ((2 * A + 1) * B, lambda a, b: (2 * a + 1) * b, "(2 a + 1)·b"),
    "quotient": ((A - 3) / (A * B), lambda a, b: (a - 3) / (a * b), "(a − 3)/(a·b)"),
    "rounded": (
        2 * al.expressions.positive_part(A, smoothing=0.1),
        lambda a, b: a + np.hypot(a, 0.1),
        "2 max(a, 0) (smoothed by 0.1)",
    ),
    "root": ((A * B) ** 0.5, lambda a, b: np.sqrt(a * b), "(a·b)^0.5"),
    "negative": (al.expressions.positive_part(1 - A), lambda a, b: max(1 - a, 0), "max(−a + 1, 0)"),
    "largest": (al.expressions.maximum(A, 2 * B, 1.0), lambda a, b: max(a, 2 * b, 1), "max(a, 2 b, 1)"),
    "smallest": (al.expressions.minimum(A, 2 * B), lambda a, b: min(a, 2 * b), "min(a, 2 b)"),
    "own": (3 * al.expressions.function(distance, A, B), lambda a, b: 3 * np.hypot(a, b), "3 distance(a, b)"),
    "nested": (-((A * B) ** 2) / (1 + A), lambda a, b: -((a * b) ** 2) / (1 + a), "(−(a·b)²)/(a + 1)"),
    "a cost with a power": (
        al.cost.reciprocal_power("a", bias=0.5, scale=3.0, power=1.5),
        lambda a, b: 0.5 + 3.0 / a**1.5,
        "(3/(a^1.5) + 0.5)",
    ),
    "a cost by the square": (
        al.cost.reciprocal_squared("a", bias=0.5, scale=3.0),
        lambda a, b: 0.5 + 3.0 / a**2,
        "(3/(a²) + 0.5)",
    ),
    "an exponential cost": (
        al.cost.exponential("b", bias=0.5, scale=3.0, rate=2.0),
        lambda a, b: 0.5 + 3.0 * np.exp(-2.0 * b),
        "(3 exp(−2 b) + 0.5)",
    ),
    "a cost of one's own": (al.cost.cost_curve("a", logarithm), lambda a, b: 2.0 - np.log(a), "logarithm(a)"),
}


def values_of(expressions):
    """The values of all expressions as a function of `a` and `b`."""
    return lambda at: jnp.stack([jnp.asarray(one.evaluate(numbers(a=at[0], b=at[1])), float) for one in expressions])


def test_values_slopes_and_texts_are_those_of_the_formula():
    expressions, formulas, texts = zip(*FUNCTIONS.values(), strict=True)
    assert tuple(map(str, expressions)) == texts
    values = values_of(expressions)
    both = compiled(lambda at: (values(at), jax.jacfwd(values)(at)))
    h = 1e-6
    for a, b in ((1.7, 0.4), (0.6, 2.5)):
        found, slopes = both(np.array([a, b]))
        np.testing.assert_allclose(found, [formula(a, b) for formula in formulas], rtol=1e-14)
        differences = [
            ((one(a + h, b) - one(a - h, b)) / (2 * h), (one(a, b + h) - one(a, b - h)) / (2 * h)) for one in formulas
        ]
        np.testing.assert_allclose(slopes, differences, rtol=1e-7, atol=1e-8)


SMOOTHED = {
    "positive part": (lambda s: al.expressions.positive_part(A - B, smoothing=s), lambda a, b: max(a - b, 0), 0.0, 0.5),
    "maximum": (lambda s: al.expressions.maximum(A, B, smoothing=s), max, 0.0, np.log(2)),
    "minimum": (lambda s: al.expressions.minimum(A, B, smoothing=s), min, -np.log(2), 0.0),
    "norm": (lambda s: al.objectives.norm(A, B, smoothing=s), np.hypot, -1.0, 0.0),
}


def test_smoothed_functions_stay_within_their_bounds_and_have_second_derivatives_where_they_had_kinks():
    makers, exact, below, above = zip(*SMOOTHED.values(), strict=True)
    sizes = np.repeat([0.1, 1e-3], len(makers))
    values = values_of([smoothed(s) for s in (0.1, 1e-3) for smoothed in makers])
    found_at, bends_at = compiled(values), compiled(jax.hessian(values))
    for a, b in ((0.3, 0.3), (0.0, 0.0), (0.3, 0.3001), (2.0, -1.0), (-4.0, 50.0)):
        off = np.asarray(found_at(np.array([a, b]))) - np.tile([one(a, b) for one in exact], 2)
        assert (off >= np.tile(below, 2) * sizes - 1e-12).all()
        assert (off <= np.tile(above, 2) * sizes + 1e-12).all()
    bends = np.abs(bends_at(np.zeros(2))).max(axis=(1, 2))
    np.testing.assert_allclose(bends * sizes, 1.0, rtol=0.8)


def gain(objective, **options):
    theta = al.Uniform(1.0, half_width=HALF_WIDTH)
    system = Gain(al.Decision(0.5, 0.01, 10.0), theta)
    return al.Problem(system, grid=ONE_STEP, minimize=objective, **options)


@pytest.mark.parametrize("way", BOTH, ids=WAYS)
def test_a_target_with_a_variance_a_quotient_and_an_own_function_have_their_closed_form(way):
    """`(g - 2)² + g² s² + s / g` under `g <= 3 - s g`, all as statistics of the response: at the limit."""
    relative = al.expressions.function(jnp.divide, RESPONSE.std, RESPONSE.mean**2)
    target = (RESPONSE.mean - 4) ** 2 + RESPONSE.variance + relative
    found = optimum(gain(target, subject_to=[RESPONSE.mean / (3 - RESPONSE.std) <= 1.0]), transcription=way)
    at = 3 / (1 + SPREAD)
    assert found.decisions["gain"] == pytest.approx(at, rel=1e-6)
    assert found.objective == pytest.approx((at - 4) ** 2 + at**2 * VARIANCE + SPREAD / at, rel=1e-6)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (jnp.cumsum, r"'cumsum' of expressions: expected one number .* received an array of shape \(1,\)"),
        (lambda now: 1 / 0, "'f' raised ZeroDivisionError"),
        (lambda now: now + 1j, "'f' of expressions: expected real numbers; received complex ones"),
        (lambda now: max(now, 0.0), "'f' branches on a number that is only known at run time"),
    ],
)
def test_an_own_function_that_is_no_function_of_numbers_is_refused_by_name(function, message):
    with pytest.raises(al.ProblemError, match=message):
        gain(LOSS.mean, subject_to=[al.expressions.function(function, al.path("response").mean) <= 1.0])


def test_a_limit_on_a_ratio_to_a_spread_holds_though_no_single_system_has_one():
    """The mean of g θ + b over its spread: (g + b) / (g s) <= 20, with b = 1 and g at least its root."""
    theta = al.Uniform(1.0, half_width=HALF_WIDTH)
    system = Gain(al.Decision(3.0, 0.01, 10.0), theta, 1.0)
    limits = [one.mean / one.std <= 20.0 for one in (al.path("response"), al.peak("response"))]
    least = al.Problem(system, grid=ONE_STEP, minimize=al.terminal("gain").mean, subject_to=limits)
    assert optimum(least).decisions["gain"] == pytest.approx(1 / (20 * SPREAD - 1), rel=1e-6)


@pytest.mark.parametrize("use", [lambda x: 2**x, math.sqrt, float])
def test_what_expressions_cannot_do_is_told_with_a_remedy(use):
    with pytest.raises(al.ProblemError, match=r"'μ\[x\(t_f\)\]' has no value yet.*al\.expressions\.function"):
        use(al.terminal("x").mean)
