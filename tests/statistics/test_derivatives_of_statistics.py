"""Every statistic's derivative in the coefficients, and in its own number, against central differences."""

import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_expansions import basis_of, random_coefficients

from aleator import statistics
from aleator.statistics import (
    AbstractStatistic,
    CoefficientProduct,
    ConditionalValueAtRisk,
    CornishFisher,
    Correlation,
    Covariance,
    Infimum,
    Kurtosis,
    Mean,
    Probability,
    Quantile,
    Skewness,
    Sobol,
    Std,
    Supremum,
    TotalSobol,
    Variance,
    _lines,
    lines_through,
    pdf,
    prepare,
)
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from compiling import compiled

BOUNDED = basis_of([LegendreGerm(), JacobiGerm(2.0, 3.0)], 3)
MIXED = basis_of([HermiteGerm(), LegendreGerm(), HermiteGerm(), LaguerreGerm(3.0)], 2)
NORMAL = basis_of([HermiteGerm()] * 3, 3)

STATISTICS = [
    Mean(),
    Variance(),
    Std(),
    Skewness(),
    Kurtosis(),
    Covariance(),
    CoefficientProduct(),
    Correlation(),
    Sobol("a"),
    Sobol(("a", "b")),
    TotalSobol("b"),
    Quantile(0.9),
    CornishFisher(0.99),
    Probability(above=0.3),
    Probability(below=0.2),
    Probability(above=-0.2, below=0.5),
    ConditionalValueAtRisk(0.9),
    ConditionalValueAtRisk(0.2, lower=True),
    Supremum(),
    Infimum(),
]
BY_LINES = [Quantile(0.9), Probability(above=0.3), ConditionalValueAtRisk(0.9)]
CASES = [
    *(pytest.param(one, BOUNDED, id=f"{one.text('y')} bounded") for one in STATISTICS),
    *(pytest.param(one, MIXED, id=f"{one.text('y')} mixed") for one in BY_LINES),
    *(pytest.param(one, NORMAL, id=f"{one.text('y')} normal", marks=pytest.mark.slow) for one in BY_LINES),
]


@pytest.fixture(autouse=True)
def few_lines(monkeypatch):
    """What is differentiated is the average over the lines that there are."""
    monkeypatch.setattr(_lines, "_LINES", 2**8)


def central_difference(function, x, step):
    moves = step * jnp.eye(x.size)
    ahead, behind = (jnp.stack([function((x.ravel() + s * m).reshape(x.shape)) for m in moves]) for s in (1, -1))
    return jnp.moveaxis((ahead - behind) / (2 * step), 0, -1).reshape(*ahead.shape[1:], *x.shape)


def test_no_statistic_is_left_out_of_these_tests():
    exported = [getattr(statistics, name) for name in dir(statistics)]
    kinds = {one for one in exported if isinstance(one, type) and issubclass(one, AbstractStatistic)}
    assert {one for one in kinds if not inspect.isabstract(one)} == {type(one) for one in STATISTICS}


@pytest.mark.slow
@pytest.mark.parametrize(("statistic", "basis"), CASES)
def test_forward_and_reverse_derivatives_are_those_of_finite_differences(statistic, basis):
    shape = (2,) if isinstance(statistic, Covariance | Correlation | CoefficientProduct) else ()
    coefficients = random_coefficients(basis, seed=4, shape=shape, decay=0.15).at[0].set(0.1)
    constants = prepare([statistic], basis).of(statistic)

    def function(c):
        return statistic.of(c, constants)

    # Backwards once for each statistic. One program for all, since compiling is what takes time here.
    derivatives = (jax.jacfwd(function), jax.jacrev(function)) if basis is BOUNDED else (jax.jacfwd(function),)
    program = compiled(lambda c: (function(c), [derivative(c) for derivative in derivatives]))
    expected = np.asarray(central_difference(lambda c: program(c)[0], coefficients, 1e-6))
    largest = np.abs(expected).max()
    for exact in program(coefficients)[1]:
        assert np.abs(exact - expected).max() < 1e-6 * max(largest, 1.0)


NUMBERS = [
    (Quantile(0.9), lambda one: one.level),
    (CornishFisher(0.9), lambda one: one.level),
    (ConditionalValueAtRisk(0.9), lambda one: one.level),
    (ConditionalValueAtRisk(0.2, lower=True), lambda one: one.level),
    (Probability(above=0.3), lambda one: one.above),
    (Probability(below=0.3), lambda one: one.below),
]


@pytest.mark.parametrize(("statistic", "where"), NUMBERS, ids=[one.text("y") for one, _ in NUMBERS])
def test_derivatives_in_levels_and_thresholds_are_those_of_finite_differences(statistic, where):
    coefficients = random_coefficients(MIXED, seed=4, decay=0.15)
    constants = prepare([statistic], MIXED).of(statistic)
    function = jax.value_and_grad(lambda x: eqx.tree_at(where, statistic, x).of(coefficients, constants))
    at = jnp.asarray(where(statistic))
    (above, _), (below, _), (_, exact) = map(compiled(function), (at + 1e-6, at - 1e-6, at))
    assert exact == pytest.approx(float(above - below) / 2e-6, rel=1e-6)


def test_the_density_has_the_derivative_of_finite_differences():
    coefficients, lines = random_coefficients(NORMAL, seed=4, decay=0.15), lines_through(NORMAL)

    def function(c):
        return pdf(jnp.array([0.3]), c, lines)

    exact = np.asarray(compiled(jax.jacfwd(function))(coefficients))
    assert exact == pytest.approx(np.asarray(central_difference(compiled(function), coefficients, 1e-6)), abs=1e-6)


VECTORISED = [Kurtosis(), Probability(above=0.3), Supremum()]


@pytest.mark.parametrize("statistic", VECTORISED, ids=lambda one: one.text("y"))
def test_statistics_work_under_vmap_with_traced_constants(statistic):
    several = jnp.stack([random_coefficients(BOUNDED, seed=s) for s in range(3)])
    constants = prepare([statistic], BOUNDED).of(statistic)
    together = compiled(jax.vmap(statistic.of, in_axes=(0, None)))(several, constants)
    alone = [compiled(statistic.of)(one, constants) for one in several]
    assert np.asarray(together) == pytest.approx(np.asarray(jnp.stack(alone)), rel=1e-8)
