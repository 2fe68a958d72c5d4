"""Supremum and infimum: bounds that hold, that are tight, and what is said of unbounded distributions."""

import numpy as np
import pytest
from scipy import optimize
from small_expansions import basis_of, coefficients_of_polynomial, prepare, random_coefficients

from aleator._core.errors import ProblemError
from aleator.statistics import Infimum, Supremum
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from compiling import compiled

of = compiled(lambda statistic, c, constants: statistic.of(c, constants))


def bound(statistic, coefficients, basis):
    return np.asarray(of(statistic, coefficients, prepare([statistic], basis).of(statistic)))


def test_extremes_of_one_variable_are_those_found_by_scipy_and_a_constant_is_its_own():
    basis = basis_of([LegendreGerm()], 6)

    def polynomial(a):
        return a - 3 * a**2 + 0.5 * a**5 - a**6

    found = optimize.minimize_scalar(
        lambda a: -polynomial(a), bounds=(-1, 1), method="bounded", options={"xatol": 1e-10}
    )
    constant = 3.0 * np.eye(basis.terms)[0]
    several = np.stack([coefficients_of_polynomial(basis, polynomial), constant], axis=1)
    upper, lower = (bound(one, several, basis) for one in (Supremum(), Infimum()))
    assert -found.fun <= upper[0] <= -found.fun + 1e-3
    assert upper[1] == pytest.approx(3.0, rel=1e-12)
    assert polynomial(-1.0) - 1e-3 <= lower[0] <= polynomial(-1.0)
    assert lower[1] == pytest.approx(3.0, rel=1e-12)


@pytest.mark.slow
def test_bounds_of_two_variables_enclose_what_is_sampled_and_are_exact_at_a_corner():
    basis = basis_of([LegendreGerm(), JacobiGerm(2.0, 3.0)], 3)
    monotone = coefficients_of_polynomial(basis, lambda a, b: 2 + a - b + 0.1 * a**3)
    path = np.stack([monotone, *(random_coefficients(basis, seed, decay=0.8) for seed in (0, 1))], axis=1)
    grid = np.linspace(-1.0, 1.0, 401)  # of the germs, the ends among them
    values = basis.matrix(np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)) @ np.asarray(path)
    for sign in (1, -1):
        upper, high = bound(Supremum(), sign * path, basis), (sign * values).max(axis=0)
        assert np.all(high - 1e-9 <= upper)
        assert np.max((upper - high) / np.ptp(values, axis=0)) < 1e-3
        assert upper[0] == pytest.approx(4.1 if sign > 0 else 0.1, rel=1e-10)


def test_an_unbounded_support_is_refused_with_a_remedy():
    basis = basis_of([LegendreGerm(), HermiteGerm(), LaguerreGerm(2.0)], 2)
    for statistic in (Supremum(), Infimum()):
        with pytest.raises(ProblemError, match=r"'b', 'c' have no bounds.*bounded, independent ones.*quantile"):
            prepare([statistic], basis)


def test_the_extremes_of_a_sample_are_its_largest_and_smallest_values():
    sample = np.random.default_rng(0).normal(size=(100, 2))
    assert np.asarray(Supremum().of_sample(sample)).tolist() == sample.max(axis=0).tolist()
    assert np.asarray(Infimum().of_sample(sample)).tolist() == sample.min(axis=0).tolist()
