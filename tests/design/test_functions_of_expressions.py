"""Products, quotients, powers, positive parts, maxima and a user's own functions of statistics and decisions."""

import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.design import AbstractScope, units_of
from aleator.design._statistic import statistic
from aleator.statistics import Quantile
from tiny_models import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, SPREAD, Decay, Gain

VARIANCE = SPREAD**2
WAYS = {"shooting": al.Sequential(), "collocation": al.Simultaneous(al.schemes.GaussLegendre(1))}


class Numbers(AbstractScope):
    """Numbers of a model, by name."""

    def __init__(self, **numbers):
        self.numbers = numbers

    def statistic(self, functionals, kind):
        raise NotImplementedError

    def time_integral(self, expression):
        raise NotImplementedError

    def value(self, name):
        return self.numbers[name]


def distance(first, second):
    return jnp.hypot(first, second)


A, B = al.value("a"), al.value("b")
FUNCTIONS = {
    "product": ((2 * A + 1) * B, lambda a, b: (2 * a + 1) * b, "(2 a + 1)·b"),
    "quotient": ((A - 3) / (A * B), lambda a, b: (a - 3) / (a * b), "(a − 3)/(a·b)"),
    "one over": (2 / (B + 1), lambda a, b: 2 / (b + 1), "2/(b + 1)"),
    "below the line": (A / (2 * B), lambda a, b: a / (2 * b), "a/(2 b)"),
    "a quotient below the line": (A / (B / A), lambda a, b: a * a / b, "a/(b/a)"),
    "a multiple": (A * (2 * B), lambda a, b: 2 * a * b, "a·(2 b)"),
    "a power of a power": ((A**2) ** 3, lambda a, b: a**6, "(a²)³"),
    "a root of a power": ((A**2) ** 0.5, lambda a, b: a, "(a²)^0.5"),
    "magnitude": (abs(A - B), lambda a, b: abs(a - b), "‖a − b‖"),
    "rounded": (
        2 * al.expressions.positive_part(A, smoothing=0.1),
        lambda a, b: a + np.hypot(a, 0.1),
        "2 max(a, 0) (smoothed by 0.1)",
    ),
    "square": ((A - 1.5) ** 2 + B, lambda a, b: (a - 1.5) ** 2 + b, "(a − 1.5)² + b"),
    "cube": (A**3, lambda a, b: a**3, "a³"),
    "inverse": (A**-2, lambda a, b: a**-2.0, "a⁻²"),
    "root": ((A * B) ** 0.5, lambda a, b: np.sqrt(a * b), "(a·b)^0.5"),
    "positive": (al.expressions.positive_part(A - 1), lambda a, b: max(a - 1, 0), "max(a − 1, 0)"),
    "negative": (al.expressions.positive_part(1 - A), lambda a, b: max(1 - a, 0), "max(−a + 1, 0)"),
    "largest": (al.expressions.maximum(A, 2 * B, 1.0), lambda a, b: max(a, 2 * b, 1), "max(a, 2 b, 1)"),
    "smallest": (al.expressions.minimum(A, 2 * B), lambda a, b: min(a, 2 * b), "min(a, 2 b)"),
    "own": (3 * al.expressions.function(distance, A, B), lambda a, b: 3 * np.hypot(a, b), "3 distance(a, b)"),
    "nested": (-((A * B) ** 2) / (1 + A), lambda a, b: -((a * b) ** 2) / (1 + a), "(−(a·b)²)/(a + 1)"),
    "numbers alone": ((al.value("a") * 0 + 2) ** 2, lambda a, b: 4.0, "2²"),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_slopes_and_texts_are_those_of_the_formula(name):
    expression, formula, text = FUNCTIONS[name]
    assert str(expression) == text
    for a, b in ((1.7, 0.4), (0.6, 2.5)):
        found, slopes = jax.value_and_grad(lambda at: expression.evaluate(Numbers(a=at[0], b=at[1])))(jnp.array([a, b]))
        assert float(found) == pytest.approx(formula(a, b), rel=1e-14)
        h = 1e-6
        differences = (
            (formula(a + h, b) - formula(a - h, b)) / (2 * h),
            (formula(a, b + h) - formula(a, b - h)) / (2 * h),
        )
        np.testing.assert_allclose(slopes, differences, rtol=1e-7, atol=1e-8)


SMOOTHED = {
    "positive part": (lambda s: al.expressions.positive_part(A - B, smoothing=s), lambda a, b: max(a - b, 0), 0.0, 0.5),
    "maximum": (lambda s: al.expressions.maximum(A, B, smoothing=s), max, 0.0, np.log(2)),
    "minimum": (lambda s: al.expressions.minimum(A, B, smoothing=s), min, -np.log(2), 0.0),
    "norm": (lambda s: al.objectives.norm(A, B, smoothing=s), np.hypot, -1.0, 0.0),
}


@pytest.mark.parametrize("name", SMOOTHED)
def test_smoothed_functions_stay_within_their_bounds_and_have_second_derivatives_where_they_had_kinks(name):
    smoothed, exact, below, above = SMOOTHED[name]
    for s in (0.1, 1e-3):
        for a, b in ((0.3, 0.3), (0.0, 0.0), (0.3, 0.3001), (2.0, -1.0), (-4.0, 50.0)):
            found = float(smoothed(s).evaluate(Numbers(a=a, b=b)))
            assert below * s - 1e-12 <= found - exact(a, b) <= above * s + 1e-12
        bends = jax.hessian(lambda at, s=s: smoothed(s).evaluate(Numbers(a=at[0], b=at[1])))(jnp.zeros(2))
        assert np.isfinite(bends).all()
        assert np.abs(bends).max() == pytest.approx(1 / s, rel=0.8)


def gain(objective, **options):
    theta = al.Uniform(1.0, half_width=HALF_WIDTH)
    system = Gain(al.Decision(0.5, 0.01, 10.0), theta)
    return al.Problem(system, grid=ONE_STEP, minimize=objective, **options)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_target_with_a_variance_is_written_as_it_stands(way):
    """E[g θ] = g, Var[g θ] = g² s²: (g - 2)² + g² s² is least at 2 / (1 + s²)."""
    solution = al.solve(gain((RESPONSE.mean - 2) ** 2 + RESPONSE.variance), transcription=way)
    assert solution.decisions["gain"] == pytest.approx(2 / (1 + VARIANCE), rel=1e-6)
    assert solution.objective == pytest.approx(4 * VARIANCE / (1 + VARIANCE), rel=1e-9)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_limit_on_a_quotient_and_an_own_objective_have_their_closed_forms(way):
    """Least g s / g² = s / g under g <= 3 - s g: all as statistics of the response."""
    relative = al.expressions.function(jnp.divide, RESPONSE.std, RESPONSE.mean**2)
    problem = gain(relative, subject_to=[RESPONSE.mean / (3 - RESPONSE.std) <= 1.0])
    solution = al.solve(problem, transcription=way)
    assert solution.decisions["gain"] == pytest.approx(3 / (1 + SPREAD), rel=1e-6)
    assert solution.objective == pytest.approx(SPREAD * (1 + SPREAD) / 3, rel=1e-6)


def test_a_soft_limit_by_the_positive_part_has_the_optimum_of_its_closed_form():
    """(g - 3)² + w (g - 2)₊², whose derivative vanishes at (3 + 2 w) / (1 + w)."""
    weight = 4.0
    excess = al.expressions.positive_part(RESPONSE.mean - 2.0)
    solution = al.solve(gain(LOSS.mean - 1.0 + weight * excess**2))
    assert solution.decisions["gain"] == pytest.approx((3 + 2 * weight) / (1 + weight), rel=1e-6)


def test_a_smooth_error_at_the_end_is_least_where_it_vanishes():
    error = al.objectives.terminal_mean_error({"response": 2.0}, smoothing=0.01)
    for solver in (al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp()):
        assert al.solve(gain(error), solver).decisions["gain"] == pytest.approx(2.0, abs=1e-4)


class WithUnits(Gain):
    units: ClassVar = {"response": "N", "loss": "m"}


def test_units_follow_products_quotients_and_powers():
    force, length = RESPONSE.mean, LOSS.mean
    system = WithUnits(al.Decision(1.0), al.Uniform(1.0, half_width=HALF_WIDTH))
    problem = al.Problem(system, grid=ONE_STEP, minimize=force)
    expected = {
        "N m": force * length,
        "N/m": force / length,
        "-": force / RESPONSE.std,
        "1/m": 1 / length,
        "m³": length**3,
        "N²": (force - 3) ** 2 + RESPONSE.variance,
        "N": al.expressions.maximum(force, RESPONSE.std),
        "m": al.expressions.positive_part(length),
        "": al.expressions.function(distance, force, length),
    }
    for unit, expression in expected.items():
        assert expression.unit(units_of(expression, problem)) == unit


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: A * "b", "Only numbers can multiply an expression by"),
        (lambda: A**np.inf, "Only finite numbers can be an exponent"),
        (lambda: A**B, "Only numbers can be an exponent"),
        (lambda: A / 0, "cannot be divided by zero"),
        (lambda: al.expressions.maximum(A), "expected at least two expressions or numbers; received 1"),
        (lambda: al.expressions.positive_part(A, smoothing=-1.0), "positive_part: expected a smoothing of at least 0"),
        (lambda: al.expressions.function(3.0, A), "function: expected a function of the values of expressions"),
        (lambda: al.expressions.function(distance), "expected the expressions that it is a function of"),
        (lambda: al.expressions.maximum(A, al.rms("x")), "differs between realisations: take a statistic of it"),
    ],
)
def test_what_is_no_expression_is_refused_in_words(wrong, message):
    with pytest.raises(al.ProblemError, match=message):
        wrong()


def test_one_statistic_of_several_outputs_is_that_of_each():
    kind, gains = Quantile(0.9), al.terminal("gain")
    problem = gain(
        statistic(kind, RESPONSE) ** 2, subject_to=[statistic(kind, gains) >= 2, statistic(kind, RESPONSE) <= 9]
    )
    solution = al.solve(problem)
    assert solution.decisions["gain"] == pytest.approx(2.0, rel=1e-6)
    assert solution.objective == pytest.approx((2 * (1 + 0.8 * HALF_WIDTH)) ** 2, rel=1e-6)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_an_own_function_is_asked_for_each_instant_by_itself(way):
    """A sum over instants would grow with every finer grid that judges the answer."""
    clipped = al.expressions.function(lambda now: jnp.max(now), al.path("response").mean)
    assert al.solve(gain(LOSS.mean, subject_to=[clipped <= 2.0]), transcription=way).decisions["gain"] == pytest.approx(
        2.0, rel=1e-6
    )
    flat = al.expressions.function(lambda now: 3.0, RESPONSE.mean)
    assert al.solve(gain(flat), transcription=way).objective == 3.0


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (jnp.cumsum, r"'cumsum' of expressions: expected one number .* received an array of shape \(1,\)"),
        (np.exp, "'exp' converts a number that is only known at run time to plain Python or NumPy: use jax.numpy"),
        (lambda now: 1 / 0, "'f' raised ZeroDivisionError"),
        (lambda now: now + 1j, "'f' of expressions: expected real numbers; received complex ones"),
        (lambda now: None, "'f' of expressions: expected real numbers; received None"),
        (lambda one, other: one, "'f' raised TypeError"),
        (lambda now: max(now, 0.0), "'f' branches on a number that is only known at run time"),
    ],
)
def test_an_own_function_that_is_no_function_of_numbers_is_refused_by_name(function, message):
    with pytest.raises(al.ProblemError, match=message):
        gain(LOSS.mean, subject_to=[al.expressions.function(function, al.path("response").mean) <= 1.0])


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
@pytest.mark.parametrize("functional", [al.path("response"), al.peak("response")], ids=["path", "peak"])
def test_a_limit_on_a_ratio_to_a_spread_holds_though_no_single_system_has_one(functional, way):
    """The mean of g θ + b over its spread: (g + b) / (g s) <= 20, with b = 1 and g at least its root."""
    theta = al.Uniform(1.0, half_width=HALF_WIDTH)
    system = Gain(al.Decision(3.0, 0.01, 10.0), theta, 1.0)
    limit = functional.mean / functional.std <= 20.0
    found = al.solve(
        al.Problem(system, grid=ONE_STEP, minimize=al.terminal("gain").mean, subject_to=[limit]), transcription=way
    )
    assert found.decisions["gain"] == pytest.approx(1 / (20 * SPREAD - 1), rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", [al.schemes.GaussLegendre(3), al.schemes.Radau(3)], ids=["Gauss", "Radau"])
def test_an_objective_that_is_flat_at_its_minimum_is_solved(scheme):
    """States that move give the constraints multipliers of nothing but rounding."""
    system = Decay(al.Uniform(1.0, half_width=0.2), al.Decision(2.0, -5.0, 5.0))
    excess = al.expressions.positive_part(al.terminal("x").mean - 3.0)
    for objective in (0 * al.terminal("x").mean + 1.0, excess, excess**2):
        problem = al.Problem(system, grid=al.Grid(1.0, 10), minimize=objective)
        assert al.solve(problem, transcription=al.Simultaneous(scheme)).status is al.Status.SOLVED


@pytest.mark.parametrize(
    "use",
    [
        lambda x: 2**x,
        lambda x: x % 2,
        lambda x: 5 % x,
        lambda x: x // 2,
        lambda x: 5 // x,
        math.sqrt,
        float,
        int,
        round,
    ],
)
def test_what_expressions_cannot_do_is_told_with_a_remedy(use):
    with pytest.raises(al.ProblemError, match=r"'μ\[x\(t_f\)\]' has no value yet.*al\.expressions\.function"):
        use(al.terminal("x").mean)
