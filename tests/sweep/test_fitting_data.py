"""Models fitted to data: the best fit and its spread against SciPy's, and as distributions of the next design."""

from typing import Any

import numpy as np
import pytest
import scipy

import aleator as al
from aleator.uncertainty import correlations_at, placements
from zoo import Decay, Gain

GRID = al.Grid(3.0, 120)
TIMES = np.sort(np.random.default_rng(0).uniform(0.0, 3.0, 25))
NOISE = 0.02 * np.random.default_rng(1).normal(size=25)
DECAYED = 2.0 * np.exp(-0.7 * TIMES) + NOISE
SPREAD = np.linspace(0.01, 0.03, 25)


def decay_problem(times: Any = TIMES, data: Any = DECAYED, **options: Any) -> al.Problem:
    model = Decay(rate=al.Decision(1.5, 0.01, 10.0), start=al.Decision(1.0, -10.0, 10.0))
    return al.Problem(model, grid=GRID, minimize=al.residuals("x", times, data, **options))


def curve_fit(function, data, start, jacobian, **options):
    tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14)
    return scipy.optimize.curve_fit(function, TIMES, data, start, jac=jacobian, **tight, **options)


def by_name(posterior, *names):
    order = [posterior.names.index(name) for name in names]
    return posterior.mean[order], posterior.covariance[np.ix_(order, order)]


@pytest.fixture(scope="module")
def decay():
    return al.solve(decay_problem(std=SPREAD))


@pytest.mark.parametrize("known_std", [False, True])
def test_a_decay_measured_between_the_instants_is_fitted_as_scipy_fits_it(decay, known_std):
    found = al.posterior(decay, known_std=known_std)
    mean, covariance = by_name(found, "start", "rate")
    expected = curve_fit(
        lambda t, a, b: a * np.exp(-b * t),
        DECAYED,
        (1.0, 1.5),
        lambda t, a, b: np.stack([np.exp(-b * t), -a * t * np.exp(-b * t)], axis=1),
        sigma=SPREAD,
        absolute_sigma=known_std,
    )
    np.testing.assert_allclose(mean, expected[0], rtol=1e-6)
    np.testing.assert_allclose(covariance, expected[1], rtol=1e-6)
    assert "correlation" in str(found)


def test_the_spread_of_a_fit_is_ready_for_the_next_design(decay):
    found = al.posterior(decay)
    places = placements(found.system)
    assert isinstance(places.distributions["rate"], al.LogNormal)
    assert isinstance(places.distributions["start"], al.Normal)
    for i, name in enumerate(found.names):
        assert float(places.distributions[name].mean()) == pytest.approx(found.mean[i])
        assert float(places.distributions[name].std()) == pytest.approx(found.std[i])
    (correlation,) = correlations_at(places, np.zeros(0)).values()
    assert correlation == pytest.approx(found.correlation[0, 1], abs=1e-10)


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda: decay_problem(data=np.where(np.arange(25) == 4, np.nan, DECAYED)), "nan at index 4, t = 0.122921 s"),
        (lambda: decay_problem(times=TIMES[:-1]), "each of the 24 times; received data of shape .25"),
        (lambda: decay_problem(times=TIMES + 1.0), "from 0 to 3 s; received 3.01187 s at index 16"),
        (lambda: decay_problem(std=np.ones(3)), "one positive number, one for each time"),
        (lambda: al.Problem(Decay(al.Decision(1.0)), grid=GRID, minimize=al.residuals("y", [1], [1])), "output .* 'y'"),
    ],
)
def test_data_that_no_model_has_are_refused(declare, message):
    with pytest.raises(al.ProblemError, match=message):
        declare()


def test_each_phase_has_data_at_its_own_times():
    """After 0.4 s at one rate, the other phase begins with what is left."""
    rates, times = (1.3, 0.6), np.array([0.1, 0.3])
    data = np.exp(-rates[0] * times), np.exp(-rates[0] * 0.4 - rates[1] * times)
    each = {name: Decay(al.Decision(1.0, 0.3, 3.0), 1.0) for name in ("first", "last")}
    phases = al.Phases(**{name: al.Phase(system, al.Grid(0.4, 20)) for name, system in each.items()})
    first, last = (al.residuals("x", times, one, phase=name) for name, one in zip(each, data, strict=True))
    decisions = al.solve(al.Problem(phases, minimize=first + last)).decisions
    assert [float(decisions[f"{name}.rate"]) for name in each] == pytest.approx(rates, abs=1e-6)


@pytest.mark.parametrize(
    ("output", "times", "message"),
    [
        pytest.param("gain", [0.0, 0.3, 0.6], "received 'shift', by which no residual changes", marks=pytest.mark.slow),
        ("response", [0.0, 0.3, 0.6], "received 'gain' and 'shift', which can change together"),
        pytest.param("response", [0.0, 0.3], "received 2 data and 2 numbers: gain, shift", marks=pytest.mark.slow),
    ],
)
def test_numbers_that_the_data_do_not_tell_are_named(output, times, message):
    model = Gain(gain=al.Decision(1.0, 0.0, 10.0), theta=1.0, shift=al.Decision(0.5, -3.0, 3.0))
    fit = al.solve(al.Problem(model, grid=al.Grid(1.0, 6), minimize=al.residuals(output, times, times)), throw=False)
    with pytest.raises(al.ProblemError, match=message):
        al.posterior(fit)


@pytest.mark.slow
def test_a_spread_is_refused_where_it_would_not_be_normal_or_is_none_of_a_fit():
    bounded = Decay(rate=al.Decision(1.5, 1.0, 10.0), start=2.0)
    fit = al.solve(al.Problem(bounded, grid=GRID, minimize=al.residuals("x", TIMES, DECAYED)))
    with pytest.raises(al.ProblemError, match="at that of 'rate'"):
        al.posterior(fit)
    with pytest.raises(al.ProblemError, match="expected a `std`"):
        al.posterior(fit, known_std=True)
    other = al.solve(al.Problem(bounded, grid=GRID, minimize=al.terminal("x").mean))
    with pytest.raises(al.ProblemError, match="posterior: expected an objective"):
        al.posterior(other)
