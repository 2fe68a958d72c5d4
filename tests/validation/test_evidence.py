"""Fresh simulations of a design: shares, moments and percentiles against closed forms, and systems that have none."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from decaying_problems import decaying_problem
from scipy import stats

import aleator as al
from aleator.ensemble import draw
from aleator.uncertainty import LegendreGerm
from aleator.validation import PERCENTILES, Proportion
from zoo import HALF_WIDTH, SPREAD, Decay, gain_problem


def test_the_interval_of_a_proportion_is_that_of_clopper_and_pearson():
    for samples, confidence in ((1, 0.95), (2, 0.9), (10, 0.99), (1000, 0.95), (100_000, 0.9)):
        for count in sorted({0, 1, samples // 100, samples // 7, samples // 2, samples - 1, samples}):
            ours = Proportion(count, samples, confidence)
            exact = stats.binomtest(count, samples).proportion_ci(confidence, method="exact")
            # SciPy brackets the ends to about 1e-12.
            assert (ours.lower, ours.upper) == pytest.approx((exact.low, exact.high), rel=1e-9, abs=1e-11)
            assert ours.estimate == count / samples


@pytest.fixture(scope="module")
def solution():
    return al.solve(gain_problem(upper=2.0, sigmas=1.0))


@pytest.fixture(scope="module")
def decaying():
    return al.solve(decaying_problem())


def test_evidence_agrees_with_closed_forms(solution):
    evidence = al.validate(solution, 20_000, seed=3)
    gain = 2.0 / (1 + SPREAD)
    # gain * theta > 2 where theta > 1 + SPREAD, for theta uniform in 1 ± HALF_WIDTH
    truth = (1 - SPREAD / HALF_WIDTH) / 2
    violation = evidence.violations["response"]
    assert violation.samples == 20_000
    assert violation.lower <= truth <= violation.upper
    assert evidence.joint == violation
    response = evidence.functionals["response(t_f)"]
    assert float(response.standard_error) == pytest.approx(gain * SPREAD / np.sqrt(20_000), rel=0.02)
    assert abs(float(response.mean) - gain) < 4 * gain * SPREAD / np.sqrt(20_000)
    # The standard error of a sampled std, from the uniform distribution's kurtosis of 1.8.
    assert abs(float(response.std) - gain * SPREAD) < 4 * gain * SPREAD * np.sqrt(0.8 / 4 / 20_000)
    assert (float(response.expanded_mean), float(response.expanded_std)) == pytest.approx((gain, gain * SPREAD))
    levels = gain * (1 + HALF_WIDTH * (2 * np.array(PERCENTILES) / 100 - 1))
    np.testing.assert_allclose(response.percentiles, levels, atol=4 * gain * HALF_WIDTH / np.sqrt(20_000))


def test_systems_are_the_physics_at_the_drawn_parameters_told_batch_by_batch(solution):
    told = []
    evidence = al.validate(solution, 1000, seed=7, batch=400, progress=lambda *words: told.append(words))
    assert told == [("Monte Carlo", done, 1000) for done in (0, 400, 800, 1000)]
    theta = 1 + HALF_WIDTH * draw((LegendreGerm(),), 1000, np.random.default_rng(7))[:, 0]
    response = solution.decisions["gain"] * theta
    assert float(evidence.functionals["response(t_f)"].mean) == pytest.approx(response.mean(), rel=1e-12)
    assert evidence.violations["response"].count == np.sum(response > 2.0)
    assert "1000 fresh samples, seed 7" in str(evidence)


def test_moments_of_paths_and_kept_systems_are_those_of_the_samples_themselves(decaying):
    # As many kept as sampled: the paths themselves are at hand.
    evidence = al.validate(decaying, 230, batch=64, keep=230)
    (low, *_) = evidence.trajectories
    paths = low.values
    assert paths.shape == (230, 11)
    sampled = evidence.functionals["x(t)"]
    np.testing.assert_allclose(sampled.mean, paths.mean(axis=0), rtol=1e-11, atol=1e-15)
    np.testing.assert_allclose(sampled.std, paths.std(axis=0, ddof=1), rtol=1e-9, atol=1e-13)
    broken = (paths < 0.5).any(axis=1)
    assert 0 < broken.sum() < 230
    np.testing.assert_array_equal(low.violating, broken)
    assert evidence.violations["low"].count == broken.sum()
    few = al.validate(decaying, 230, batch=64, keep=7)
    assert {(one.values.shape, one.violating.shape) for one in few.trajectories} == {((7, 11), (7,))}


def test_a_deterministic_design_is_validated_on_the_uncertain_systems():
    # The nominal gain puts the mean at the bound: half of all systems are beyond it.
    nominal = al.solve(al.deterministic(gain_problem(upper=2.0, sigmas=1.0)))
    assert nominal.decisions["gain"] == pytest.approx(2.0, rel=1e-7)
    evidence = al.validate(nominal, 20_000)
    assert evidence.agrees  # it is not accused of an expansion that it does not have
    violation = evidence.violations["response"]
    assert violation.lower <= 0.5 <= violation.upper
    assert float(evidence.functionals["response(t_f)"].std) == pytest.approx(2.0 * SPREAD, rel=0.05)
    assert float(evidence.functionals["response(t_f)"].expanded_std) == 0.0


# --- Grids -----------------------------------------------------------------------------------------------------------


def test_what_is_certain_is_simulated_on_a_finer_grid_which_finds_out_a_coarse_one():
    evidence = al.validate(al.solve(gain_problem(theta=1.0)))
    assert evidence.agrees
    assert evidence.joint.count == 0
    decay = Decay(5.0, al.Decision(2.0, 1.0, 3.0))
    low = al.path("x").at_most(1.5).named("low")
    coarse = al.Problem(decay, grid=al.Grid(1.0, 2), minimize=al.terminal("x").mean, subject_to=[low])
    solution = al.solve(coarse, throw=False)
    with pytest.warns(al.ExpansionWarning, match="contradict the solution.*Use more steps"):
        evidence = al.validate(solution)
    assert not evidence.agrees
    start = solution.decisions["start"]
    np.testing.assert_allclose(
        evidence.functionals["x(t)"].mean, start * np.exp(-5.0 * np.array([0.0, 0.5, 1.0])), rtol=1e-3
    )
    assert evidence.violations == {"low": Proportion(int(start > 1.5), 1)}
    assert evidence.instants == 21


# --- Systems without a number ----------------------------------------------------------------------------------------


class Fragile(al.System):
    """Beyond 1.29, which only a sample reaches, not a number from an instant on."""

    states = ("x",)
    gain: al.Number
    theta: al.Number
    until: al.Number

    def rhs(self, t, z):
        return (0.0 * z.x,)

    def outputs(self, t, z):
        broken = 1.0 + jnp.sqrt(self.until - t)
        return {"x": self.gain * jnp.where(self.theta > 1.29, broken, self.theta), "gain": self.gain}


@cache
def fragile(until):
    """The solution, of which fresh systems in a tail tell that some have no result."""
    x = al.path("x")
    problem = al.Problem(
        Fragile(al.Decision(1.0, 0.5, 2.0), al.Uniform(1.0, half_width=HALF_WIDTH), until),
        grid=al.Grid(1.0, 10),
        minimize=al.terminal("gain").mean,
        subject_to=[x.at_most(100.0), al.terminal("x").std <= 100.0, x.std <= 100.0, al.rms("x").mean <= 100.0],
        expansion=al.Expansion(1),
    )
    with pytest.warns(al.ExpansionWarning, match=r"is not finite in about \d\S* % of all systems, .*theta=1\.29"):
        return al.solve(problem, throw=False)


def test_a_sample_that_is_not_finite_is_named_with_its_instant():
    with pytest.raises(al.SimulationError, match=r"theta=1\.29\d* is not finite: output 'x' from t = 0\.6 s on"):
        al.validate(fragile(0.55), 2000)


def test_a_broken_system_beyond_the_samples_asked_for_is_no_matter():
    theta = 1 + HALF_WIDTH * draw((LegendreGerm(),), 400, np.random.default_rng(0))[:, 0]
    first = int(np.argmax(theta > 1.29))
    # The batch before the break is larger than what is asked for, so the broken system is simulated and dropped.
    batch = first // 2 + 2
    assert batch < first < 2 * batch
    evidence = al.validate(fragile(-1.0), first, batch=batch)
    assert np.isfinite(evidence.functionals["x(t)"].std).all()
    assert float(evidence.functionals["x(t)"].mean[0]) == pytest.approx(np.mean(theta[:first]) / 2)


class Rod(al.System):
    """Temperatures as one array, heated and cooled alike."""

    states = ("T",)
    cooling: al.Number
    heat: al.Number

    def initial(self):
        return {"T": jnp.zeros(2)}

    def rhs(self, t, z):
        return (self.heat - self.cooling * z.T,)

    def outputs(self, t, z):
        return {"T": z.T}


@pytest.mark.slow
@pytest.mark.parametrize("samples", [101, 240])  # as many as there are instants, and more
def test_moments_of_a_path_of_arrays_are_taken_over_the_systems(samples):
    limit = al.path("T").at_most(5.0, sigmas=2)
    rod = Rod(al.Uniform(0.5, half_width=0.1), al.Decision(1.0, 0.1, 30.0))
    solution = al.solve(al.Problem(rod, grid=al.Grid(3.0, 100), minimize=-al.value("heat"), subject_to=[limit]))
    evidence = al.validate(solution, samples)
    assert evidence.agrees
    nodes, weights = np.polynomial.legendre.leggauss(20)
    rate = 0.5 + 0.1 * nodes
    ends = float(solution.decisions["heat"]) / rate * (1 - np.exp(-3.0 * rate))
    std = np.sqrt(weights @ ends**2 / 2 - (weights @ ends / 2) ** 2)
    np.testing.assert_allclose(evidence.functionals["T(t)"].std[-1], std, rtol=0.2)
