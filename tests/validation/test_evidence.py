"""Fresh simulations of a design: shares, moments and percentiles against closed forms, and systems that have none."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from decaying_problems import decaying_problem
from scipy import stats

import aleator as al
from aleator._core import parallel
from aleator.ensemble import draw
from aleator.uncertainty import LegendreGerm
from aleator.validation import PERCENTILES, Proportion
from zoo import HALF_WIDTH, LOSS, ONE_STEP, RESPONSE, SPREAD, Decay, Gain, gain_problem


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


@pytest.mark.slow
def test_the_same_seed_gives_the_same_evidence_whatever_the_batch_and_the_cores(decaying, monkeypatch):
    one, other = (al.validate(decaying, 230, seed=5, batch=batch, keep=37) for batch in (230, 64))
    assert one.violations == other.violations
    for name, sampled in one.functionals.items():
        np.testing.assert_allclose(sampled.std, other.functionals[name].std, rtol=1e-11, atol=1e-14)
    for ours, theirs in zip(one.trajectories, other.trajectories, strict=True):
        np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(ours.violating, theirs.violating)
    monkeypatch.setattr(parallel, "CORES", 1)
    alone = al.validate(decaying, 230, seed=5, batch=64)
    assert alone.violations == other.violations
    for name, sampled in other.functionals.items():
        np.testing.assert_array_equal(sampled.std, alone.functionals[name].std)


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


@pytest.mark.slow
def test_constraints_on_moments_alone_are_left_out_and_joint_counts_a_system_once():
    problem = al.Problem(
        Gain(al.Decision(0.5, 0.0, 10.0), al.Uniform(1.0, half_width=HALF_WIDTH)),
        grid=ONE_STEP,
        minimize=LOSS.mean,
        subject_to=[
            (RESPONSE.std <= 0.3).named("spread"),
            (RESPONSE.mean <= 2.5).named("high"),
            (RESPONSE.mean >= 1.0).named("low"),
            (RESPONSE.mean <= 1.5).named("low"),
        ],
    )
    solution = al.solve(problem)
    evidence = al.validate(solution, 2000, keep=0)
    assert set(evidence.violations) == {"high", "low"}
    theta = 1 + HALF_WIDTH * draw((LegendreGerm(),), 2000, np.random.default_rng(0))[:, 0]
    response = solution.decisions["gain"] * theta
    low, high = (response < 1.0) | (response > 1.5), response > 2.5
    assert evidence.violations["low"].count == low.sum()
    assert evidence.violations["high"].count == high.sum()
    assert evidence.joint.count == (low | high).sum()
    assert evidence.violation("low", "high") == evidence.joint
    assert evidence.violation("high") == evidence.violations["high"]
    with pytest.raises(al.ProblemError, match=r"which systems are counted, \['high', 'low'\]"):
        evidence.violation("spread")


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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_systems_are_simulated_on_a_grid_whose_error_is_an_order_below_what_is_tolerated():
    problem = al.Problem(
        Decay(al.Uniform(2.0, half_width=0.01), al.Decision(0.5, 0.1, 1.0)),
        grid=al.Grid(2.0, 4),
        minimize=-al.value("start"),
        subject_to=[al.terminal("x").mean <= 1.0, al.path("x").at_most(3.0, sigmas=1.0)],
    )
    solution = al.solve(problem)
    evidence = al.validate(solution, 2000)
    exact = (np.exp(-2 * 1.99) - np.exp(-2 * 2.01)) / (2 * 0.02)
    sampled = evidence.functionals["x(t_f)"]
    # Four steps of RK4 are off by two per cent; what is sampled, by chance alone.
    assert abs(float(solution.moments["x(t_f)"].mean) - exact) > 20 * float(sampled.standard_error)
    assert abs(float(sampled.mean) - exact) < 4 * float(sampled.standard_error)
    assert evidence.functionals["x(t)"].mean.shape == (5,)
    assert evidence.instants == 4 * solution.certificate.grid_error.factor + 1


# --- Systems without a number ----------------------------------------------------------------------------------------


class Fragile(al.System):
    """Beyond 1.29, which only a sample reaches, a large number, and not a number from an instant on."""

    states = ("x",)
    gain: al.Number
    theta: al.Number
    large: al.Number
    until: al.Number

    def rhs(self, t, z):
        return (0.0 * z.x,)

    def outputs(self, t, z):
        broken = self.large + jnp.sqrt(self.until - t)
        return {"x": self.gain * jnp.where(self.theta > 1.29, broken, self.theta), "gain": self.gain}


@cache
def fragile(large, until):
    """The solution, of which fresh systems in a tail tell that some have no result."""
    x = al.path("x")
    problem = al.Problem(
        Fragile(al.Decision(1.0, 0.5, 2.0), al.Uniform(1.0, half_width=HALF_WIDTH), large, until),
        grid=al.Grid(1.0, 10),
        minimize=al.terminal("gain").mean,
        subject_to=[x.at_most(100.0), al.terminal("x").std <= 100.0, x.std <= 100.0, al.rms("x").mean <= 100.0],
        expansion=al.Expansion(1),
    )
    with pytest.warns(al.ExpansionWarning, match=r"is not finite in about \d\S* % of all systems, .*theta=1\.29"):
        return al.solve(problem, throw=False)


@pytest.mark.parametrize(
    ("large", "until", "said"),
    [
        (1.0, 0.55, r"output 'x' from t = 0\.6 s on"),
        pytest.param(1e200, 9.0, r"rms\(x\); \d+ of 250 systems fail\.", marks=pytest.mark.slow),
    ],
    ids=["on the way", "its square"],
)
def test_a_sample_that_is_not_finite_is_named_with_its_instant(large, until, said):
    with pytest.raises(al.SimulationError, match=r"theta=1\.29\d* is not finite: " + said):
        al.validate(fragile(large, until), 2000)


def test_a_broken_system_beyond_the_samples_asked_for_is_no_matter():
    theta = 1 + HALF_WIDTH * draw((LegendreGerm(),), 400, np.random.default_rng(0))[:, 0]
    first = int(np.argmax(theta > 1.29))
    # The batch before the break is larger than what is asked for, so the broken system is simulated and dropped.
    batch = first // 2 + 2
    assert batch < first < 2 * batch
    evidence = al.validate(fragile(1.0, -1.0), first, batch=batch)
    assert np.isfinite(evidence.functionals["x(t)"].std).all()
    assert float(evidence.functionals["x(t)"].mean[0]) == pytest.approx(np.mean(theta[:first]) / 2)
