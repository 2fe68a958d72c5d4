"""Supremum and infimum: bounds that hold, that are tight, and what is said of unbounded distributions."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize
from small_expansions import basis_of, coefficients_of_polynomial, random_coefficients

from aleator._core.errors import ProblemError
from aleator.expansion import Basis
from aleator.statistics import Infimum, Supremum, _branch_and_bound, _enclosure, prepare
from aleator.uncertainty import HermiteGerm, JacobiGerm, LaguerreGerm, LegendreGerm
from compiling import compiled

both = compiled(lambda statistic, c, constants: (statistic.of(c, constants), statistic.attained(c, constants)))


def ends(statistic, coefficients, basis):
    """The guaranteed bound and an attained value."""
    return [np.asarray(one) for one in both(statistic, coefficients, prepare([statistic], basis).of(statistic))]


CASES = {
    "one variable": ([LegendreGerm()], 7),
    "two variables": ([LegendreGerm(), JacobiGerm(2.0, 3.0)], 5),
    "three variables": ([JacobiGerm(0.5, 1.5), LegendreGerm(), LegendreGerm()], 3),
    "five variables": ([LegendreGerm()] * 5, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_attained_and_guaranteed_values_enclose_the_extremes_of_random_expansions(case):
    germs, order = CASES[case]
    basis = basis_of(germs, order)
    # More than are searched together, where that takes little time.
    path = random_coefficients(basis, shape=(20,) if basis.variables < 3 else (6,), decay=0.8)
    levels = np.random.default_rng(1).uniform(size=(100_000, basis.variables))
    values = basis.matrix(basis.map_to_germ(levels)) @ np.asarray(path)
    spread = np.ptp(values, axis=0)
    upper, high = ends(Supremum(), path, basis)
    lower, low = (-one for one in ends(Supremum(), -path, basis))
    assert np.all(values.max(axis=0) <= upper)
    assert np.all(values.min(axis=0) >= lower)
    assert np.all((values.max(axis=0) - 1e-9 <= high) & (high <= upper))
    assert np.all((values.min(axis=0) + 1e-9 >= low) & (low >= lower))
    assert np.max((upper - high) / spread) < 1e-3
    assert np.max((low - lower) / spread) < 1e-3


def test_the_infimum_is_the_supremum_of_the_negative_output():
    basis = basis_of([LegendreGerm(), JacobiGerm(2.0, 3.0)], 3)
    path = random_coefficients(basis, shape=(3,), decay=0.8)
    for found, of_negative in zip(ends(Infimum(), path, basis), ends(Supremum(), -path, basis), strict=True):
        assert found == pytest.approx(-of_negative, rel=1e-13)


def test_the_bound_of_one_variable_is_the_maximum_found_by_scipy():
    basis = basis_of([LegendreGerm()], 6)
    coefficients = coefficients_of_polynomial(basis, lambda a: a - 3 * a**2 + 0.5 * a**5 - a**6)
    found = optimize.minimize_scalar(
        lambda a: -(a - 3 * a**2 + 0.5 * a**5 - a**6), bounds=(-1, 1), method="bounded", options={"xatol": 1e-10}
    )
    upper, high = ends(Supremum(), coefficients, basis)
    assert high == pytest.approx(-found.fun, rel=1e-9)
    assert -found.fun <= upper <= -found.fun + 1e-3


def test_a_monotone_function_is_bounded_by_its_value_at_a_corner():
    basis = basis_of([LegendreGerm()] * 4, 3)
    coefficients = coefficients_of_polynomial(basis, lambda a, b, c, d: 2 + a - b + 0.1 * a**3 + 0.1 * c * d + c + d)
    upper, high = ends(Supremum(), coefficients, basis)
    lower, low = (-one for one in ends(Supremum(), -coefficients, basis))
    assert (upper, high) == pytest.approx((6.2, 6.2), rel=1e-10)
    assert (lower, low) == pytest.approx((-2.0, -2.0), rel=1e-10)


def test_the_gap_falls_with_the_square_of_the_width_of_the_boxes(monkeypatch):
    monkeypatch.setattr(_branch_and_bound, "_CLOSE", -1.0)
    basis = basis_of([LegendreGerm()], 3)
    coefficients = coefficients_of_polynomial(basis, lambda a: -((a - 0.2137) ** 2) + 0.1 * a**3)
    constants = prepare([Supremum()], basis).of(Supremum())
    gaps = []
    for most in (1, 8, 64):
        monkeypatch.setattr(_branch_and_bound, "_FEWEST_BOXES", 1)
        monkeypatch.setattr(_branch_and_bound, "_MOST_BOXES", most)
        gaps.append(compiled(lambda c: Supremum().of(c, constants) - Supremum().attained(c, constants))(coefficients))
    assert gaps[1] < gaps[0] / 20
    assert gaps[2] < gaps[1] / 20


def test_eight_variables_of_order_four_are_within_reach():
    basis = basis_of([LegendreGerm()] * 8, 4)
    coefficients = random_coefficients(basis, decay=0.2)
    upper, high = ends(Supremum(), coefficients, basis)
    levels = np.random.default_rng(1).uniform(size=(2000, 8))
    assert (basis.matrix(basis.map_to_germ(levels)) @ np.asarray(coefficients)).max() <= high <= upper


def test_an_unbounded_support_is_refused_with_a_remedy():
    basis = basis_of([LegendreGerm(), HermiteGerm(), LaguerreGerm(2.0)], 2)
    for statistic in (Supremum(), Infimum()):
        with pytest.raises(
            ProblemError, match=r"'b', 'c' can take values without bound.*bounded distributions.*quantile"
        ):
            prepare([statistic], basis)


def test_too_many_bernstein_coefficients_are_refused_with_a_remedy(monkeypatch):
    monkeypatch.setattr(_enclosure, "_MOST_COEFFICIENTS", 10)
    with pytest.raises(ProblemError, match="lower order or fewer variables"):
        prepare([Supremum()], basis_of([LegendreGerm()] * 2, 3))


def test_a_certain_output_is_its_own_supremum():
    certain = jnp.array([3.0])
    assert ends(Supremum(), certain, Basis({}, np.zeros((1, 0), dtype=int))) == [3.0, 3.0]
    basis = basis_of([LegendreGerm()], 2)
    upper, high = ends(Supremum(), jnp.array([3.0, 0.0, 0.0]), basis)
    assert (upper, high) == pytest.approx((3.0, 3.0), rel=1e-12)


def test_the_extremes_of_a_sample_are_its_largest_and_smallest_values():
    sample = np.random.default_rng(0).normal(size=(100, 2))
    assert np.asarray(Supremum().of_sample(sample)).tolist() == sample.max(axis=0).tolist()
    assert np.asarray(Infimum().of_sample(sample)).tolist() == sample.min(axis=0).tolist()
