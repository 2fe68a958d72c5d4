"""Eigenpairs of covariances against closed forms and special functions."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import pro_rad1

import aleator as al
from aleator.uncertainty import realise
from compiling import compiled
from zoo import cases

# Few modes, on purpose: what they leave out is what these tests ask about.
pytestmark = pytest.mark.filterwarnings("ignore:RandomProcess:aleator.ExpansionWarning")

T = 2.0
TIMES = np.array([0.0, 0.13, 0.5, 0.999, 1.37, 1.8, 2.0])
EXPONENTIAL = al.processes.ExponentialCovariance(0.8)
SMOOTH = [
    al.processes.SquaredExponentialCovariance(0.5),
    al.processes.BandLimitedCovariance.from_psd([0.0, 0.5, 1.0, 2.0], [1.0, 3.0, 0.5, 0.0]),
]
by_name = pytest.mark.parametrize("covariance", cases([EXPONENTIAL, *SMOOTH]), ids=str)


def unit(covariance: al.processes.AbstractCovariance, **size: Any) -> al.processes.RandomProcess:
    return al.processes.RandomProcess(covariance, t_final=T, std=1.0, **size)


def at(process: al.processes.RandomProcess, times: Any) -> np.ndarray:
    """`sqrt(λ_k) φ_k(t)`, shape (times, modes): the signal where one coefficient is one and the others are zero."""

    def path(xi):
        return jax.vmap(realise({"noise": process}, xi, jnp.zeros(0))["noise"])(jnp.asarray(times))

    return np.asarray(compiled(jax.vmap(path))(np.eye(len(process.xi)))).T


def test_eigenvalues_of_a_band_from_zero_are_those_of_the_prolate_spheroidal_functions():
    # Slepian and Pollak (1961): the share of each mode is that of energy in the interval, (2c/π) R² over 2 B T.
    bandwidth = 2.0
    c = np.pi * bandwidth * T
    concentration = [2 * c / np.pi * pro_rad1(0, n, c, 1 + 1e-13)[0] ** 2 for n in range(6)]
    process = unit(al.processes.BandLimitedCovariance(0.0, bandwidth), modes=6)
    np.testing.assert_allclose(process.eigenvalues, np.array(concentration) / (2 * bandwidth), atol=1e-9)


@by_name
def test_modes_solve_the_eigenvalue_problem_and_leave_out_no_more_than_the_tail(covariance):
    process, middle = unit(covariance, modes=6), 0.37
    fewest = unit(covariance, energy=0.6)
    assert fewest.share - fewest.eigenvalues[-1] / T < 0.6 <= fewest.share
    nodes, weights = np.polynomial.legendre.leggauss(40)
    # Apart before and after the kink of the covariance.
    points = np.concatenate([middle * (nodes + 1) / 2, middle + (T - middle) * (nodes + 1) / 2])
    weights = np.concatenate([middle / 2 * weights, (T - middle) / 2 * weights])
    values, here, modes = np.split(at(process, np.concatenate([TIMES, [middle], points])), [len(TIMES), len(TIMES) + 1])
    kernel = weights * covariance.correlation(np.abs(middle - points))
    np.testing.assert_allclose(kernel @ modes, process.eigenvalues * here[0], atol=1e-10)
    np.testing.assert_allclose(modes.T @ (weights[:, None] * modes), np.diag(process.eigenvalues), atol=1e-11)
    # Mercer: what is left out is a covariance itself, so that |C(t, s)| <= sqrt(C(t, t) C(s, s)).
    left_out = covariance.correlation(np.abs(TIMES[:, None] - TIMES[None, :])) - values @ values.T
    deficit = np.asarray(compiled(process.deficit)(TIMES))
    np.testing.assert_allclose(np.diag(left_out), deficit, atol=1e-12)
    assert deficit.min() > -1e-12
    bound = np.sqrt(np.maximum(deficit[:, None] * deficit[None, :], 0.0))
    assert np.all(np.abs(left_out) <= bound + 1e-9)


def test_the_covariance_of_a_table_is_the_cosine_transform_of_its_density():
    frequencies, psd = np.array([0.2, 0.5, 1.0, 2.0]), np.array([1.0, 3.0, 0.5, 0.25])
    covariance = al.processes.BandLimitedCovariance.from_psd(frequencies, psd)
    lags, transforms = np.array([0.0, 1e-9, 0.02, 0.7, 3.1]), []
    for lag in lags:
        wave = lambda f, lag=lag: np.interp(f, frequencies, psd) * np.cos(2 * np.pi * f * lag)  # noqa: E731
        transforms.append(quad(wave, 0.2, 2.0, points=frequencies[1:-1], epsabs=1e-13)[0])
    assert covariance.std**2 == pytest.approx(transforms[0], rel=1e-12)
    assert covariance.correlation(lags) == pytest.approx(np.array(transforms) / transforms[0], abs=1e-12)


@pytest.mark.filterwarnings("default::aleator.ExpansionWarning")
def test_modes_that_leave_out_a_tenth_of_the_variance_are_warned_of(recwarn):
    few = al.processes.RandomProcess(al.processes.ExponentialCovariance(0.5), t_final=10.0, std=0.2, modes=3)
    (warned,) = recwarn
    assert warned.category is al.ExpansionWarning
    assert "3 modes" in str(warned.message)
    assert f"{100 * few.share:.4g}% of the variance" in str(warned.message)
    al.processes.RandomProcess(al.processes.SquaredExponentialCovariance(0.5), t_final=5.0, std=0.2)
    assert len(recwarn) == 1
