"""Every statistic's derivative in the coefficients, and in its own number, against central differences."""

import inspect
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_expansions import basis_of, prepare, random_coefficients

from aleator import statistics
from aleator.statistics import AbstractStatistic
from aleator.uncertainty import HermiteGerm, JacobiGerm, LegendreGerm
from compiling import compiled
from zoo import cases

BOUNDED = basis_of([LegendreGerm(), JacobiGerm(2.0, 3.0)], 3)

STATISTICS = [
    statistics.Mean(),
    statistics.Variance(),
    statistics.Std(),
    statistics.Skewness(),
    statistics.Kurtosis(),
    statistics.Covariance(),
    statistics.CoefficientProduct(),
    statistics.Correlation(),
    statistics.Sobol("a"),
    statistics.Sobol(("a", "b")),
    statistics.Sobol("b", total=True),
    statistics.Quantile(0.9),
    statistics.CornishFisher(0.99),
    statistics.Probability(above=0.3),
    statistics.Widened(statistics.Probability(above=0.3), 2.0),
    statistics.ConditionalValueAtRisk(0.9),
    statistics.Supremum(),
    statistics.Infimum(),
]
# Of the others all are in one program, by default.
COSTLY = (
    statistics.Quantile,
    statistics.Probability,
    statistics.ConditionalValueAtRisk,
    statistics.Supremum,
    statistics.Infimum,
)


def central_difference(function, x, step):
    moves = step * jnp.eye(x.size)
    ahead, behind = (jnp.stack([function((x.ravel() + s * m).reshape(x.shape)) for m in moves]) for s in (1, -1))
    return jnp.moveaxis((ahead - behind) / (2 * step), 0, -1).reshape(*ahead.shape[1:], *x.shape)


def test_no_statistic_is_left_out_of_these_tests():
    exported = [getattr(statistics, name) for name in dir(statistics)]
    kinds = {one for one in exported if isinstance(one, type) and issubclass(one, AbstractStatistic)}
    assert {one for one in kinds if not inspect.isabstract(one)} == {type(one) for one in STATISTICS}


@pytest.mark.slow
def test_forward_and_reverse_derivatives_of_extremes_are_those_of_finite_differences():
    statistic, basis = statistics.Infimum(), BOUNDED
    coefficients = random_coefficients(basis, seed=4, decay=0.15).at[0].set(0.1)
    constants = prepare([statistic], basis).of(statistic)

    def function(c):
        return statistic.of(c, constants)

    # One program for all, since compiling is what takes time here.
    program = compiled(lambda c: (function(c), jax.jacfwd(function)(c), jax.jacrev(function)(c)))
    expected = np.asarray(central_difference(lambda c: program(c)[0], coefficients, 1e-6))
    for exact in program(coefficients)[1:]:
        assert np.abs(exact - expected).max() < 1e-6 * max(np.abs(expected).max(), 1.0)


def shape_of(statistic):
    return (
        (2,)
        if isinstance(statistic, statistics.Covariance | statistics.Correlation | statistics.CoefficientProduct)
        else ()
    )


def test_moments_shapes_and_indices_have_the_derivatives_of_finite_differences():
    plain = [one for one in STATISTICS if not isinstance(one, COSTLY)]
    constants = prepare(plain, BOUNDED)
    at = [np.array(random_coefficients(BOUNDED, seed=4, shape=shape_of(one), decay=0.15)) for one in plain]

    @compiled
    @partial(jax.vmap, in_axes=(0, None))
    def program(move, at):
        found = []
        for one, c in zip(plain, at, strict=True):
            here = c + (move if c.ndim == 1 else jnp.stack([move, -0.5 * move], axis=1))
            function = lambda c, one=one: one.of(c, constants.of(one))  # noqa: E731
            found.append((function(here), jax.jacfwd(function)(here), jax.grad(function)(here)))
        return found

    direction = np.random.default_rng(1).normal(size=BOUNDED.terms)
    moves = 1e-6 * np.array([1.0, -1.0, 0.0])[:, None] * direction
    for one, (value, forward, reverse) in zip(plain, jax.tree.map(np.asarray, program(moves, at)), strict=True):
        along = direction if forward.ndim == 2 else np.stack([direction, -0.5 * direction], axis=1)
        expected = float(value[0] - value[1]) / 2e-6
        assert float(np.sum(np.asarray(forward[2]) * along)) == pytest.approx(expected, rel=1e-6, abs=1e-8), one
        assert np.asarray(reverse) == pytest.approx(np.asarray(forward), rel=1e-9, abs=1e-12), one


NUMBERS = cases(
    [
        (statistics.Probability(above=0.3), lambda one: one.above),
        (statistics.ConditionalValueAtRisk(0.9), lambda one: one.level),
        (statistics.Quantile(0.9), lambda one: one.level),
    ]
)
TWO = basis_of([HermiteGerm(), LegendreGerm()], 2)


@pytest.mark.parametrize(("statistic", "where"), NUMBERS)
def test_derivatives_of_tails_by_their_number_and_by_coefficients_are_those_of_differences(statistic, where):
    coefficients = random_coefficients(TWO, seed=4, decay=0.15)
    constants = prepare([statistic], TWO).of(statistic)
    direction, h = np.random.default_rng(1).normal(size=TWO.terms), 1e-6
    function = jax.value_and_grad(lambda x, c, k: eqx.tree_at(where, statistic, x).of(c, k), argnums=(0, 1))
    # Mapped, with traced constants, as problems take them; the last output is certain.
    program = compiled(jax.vmap(function, in_axes=(0, 0, None)))
    at = float(where(statistic)) + h * np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    moved = np.asarray(coefficients) + h * np.array([0.0, 0.0, 1.0, -1.0, 0.0, 0.0])[:, None] * direction
    moved[5] = 3.0 * np.eye(TWO.terms)[0]
    values, (by_number, by_coefficients) = jax.tree.map(np.asarray, program(at, moved, constants))
    assert by_number[4] == pytest.approx(float(values[0] - values[1]) / (2 * h), rel=1e-6)
    assert by_coefficients[4] @ direction == pytest.approx(float(values[2] - values[3]) / (2 * h), rel=1e-6)
    certain = statistic.above is not None if isinstance(statistic, statistics.Probability) else 3.0
    assert values[5] == float(certain)
    assert np.isfinite(by_coefficients[5]).all()
    if not isinstance(statistic, statistics.Probability):
        assert by_coefficients[5][0] == pytest.approx(1.0)
