import dataclasses
import warnings
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator._core import beside
from aleator.ensemble import draw
from aleator.uncertainty import LegendreGerm
from aleator.validation import PERCENTILES, Proportion
from aleator.validation._sampling import SIMULATE_BATCH
from tiny_models import (
    HALF_WIDTH,
    LOSS,
    ONE_STEP,
    RESPONSE,
    SPREAD,
    Gain,
    Oscillator,
    gain_problem,
    oscillator_problem,
    sine,
)


@pytest.mark.parametrize("samples", [1, 2, 10, 1000, 100_000])
@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_the_interval_of_a_proportion_is_that_of_clopper_and_pearson(samples, confidence):
    for count in sorted({0, 1, samples // 100, samples // 7, samples // 2, samples - 1, samples}):
        ours = Proportion(count, samples, confidence)
        exact = stats.binomtest(count, samples).proportion_ci(confidence, method="exact")
        # SciPy brackets the ends to about 1e-12.
        assert (ours.lower, ours.upper) == pytest.approx((exact.low, exact.high), rel=1e-9, abs=1e-11)
        # What defines them: each end leaves half of the rest to its side.
        tail = (1 - confidence) / 2
        assert count == 0 or stats.binom.sf(count - 1, samples, ours.lower) == pytest.approx(tail, rel=1e-8)
        assert count == samples or stats.binom.cdf(count, samples, ours.upper) == pytest.approx(tail, rel=1e-8)
        assert ours.estimate == count / samples


def test_a_proportion_is_shown_in_percent():
    assert str(Proportion(0, 100)) == "0 % (0 % to 3.62 %)"  # 1 - 0.025^(1/100)


@pytest.fixture(scope="module")
def solution():
    return al.solve(gain_problem(upper=2.0, sigmas=1.0))


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


def test_the_same_seed_gives_the_same_evidence_whatever_the_batch():
    solved = al.solve(oscillator_problem())
    one, other = (al.validate(solved, 230, seed=5, batch=batch, keep=37) for batch in (230, 64))
    different = al.validate(solved, 230, seed=6)
    assert one.violations == other.violations
    for name, sampled in one.functionals.items():
        for part in ("mean", "std", "standard_error"):
            ours, theirs = (getattr(each, part) for each in (sampled, other.functionals[name]))
            np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-14)
        if sampled.percentiles is not None:
            np.testing.assert_allclose(sampled.percentiles, other.functionals[name].percentiles, rtol=1e-12)
    for ours, theirs in zip(one.trajectories, other.trajectories, strict=True):
        np.testing.assert_allclose(ours.values, theirs.values, rtol=1e-12, atol=1e-15)
        np.testing.assert_array_equal(ours.violating, theirs.violating)
    assert float(different.functionals["rms(v)"].mean) != float(one.functionals["rms(v)"].mean)


def test_one_core_finds_the_same_to_the_last_digit(monkeypatch):
    solved = al.solve(oscillator_problem())
    ours = al.validate(solved, 230, seed=5, batch=32)
    monkeypatch.setattr(beside, "CORES", 1)
    theirs = al.validate(solved, 230, seed=5, batch=32)
    assert ours.violations == theirs.violations
    for name, sampled in ours.functionals.items():
        np.testing.assert_array_equal(sampled.mean, theirs.functionals[name].mean)
        np.testing.assert_array_equal(sampled.std, theirs.functionals[name].std)


def test_moments_of_paths_and_kept_systems_are_those_of_the_samples_themselves():
    # As many kept as sampled: the paths themselves are at hand. One constraint with factor 1 on the mean.
    # On so many steps that limits are counted at the instants of the design's own grid.
    limits = [al.path("x").within(-0.13, 0.13, sigmas=1.0)]
    solution = al.solve(oscillator_problem(subject_to=limits, grid=al.Grid(4.0, 320)))
    evidence = al.validate(solution, 150, batch=40, keep=150)
    upper, lower = evidence.trajectories
    paths = upper.values
    assert paths.shape == (150, 321)
    np.testing.assert_array_equal(lower.values, paths)
    sampled = evidence.functionals["x(t)"]
    np.testing.assert_allclose(sampled.mean, paths.mean(axis=0), rtol=1e-11, atol=1e-15)
    np.testing.assert_allclose(sampled.std, paths.std(axis=0, ddof=1), rtol=1e-9, atol=1e-15)
    broken = (np.abs(paths) > 0.13).any(axis=1)
    assert 0 < broken.sum() < 150
    np.testing.assert_array_equal(upper.violating, broken)
    assert evidence.violations["x"].count == broken.sum()


def test_kept_systems_are_the_physics_at_the_drawn_parameters(solution):
    germ = draw((LegendreGerm(),), 1000, np.random.default_rng(0))
    evidence = al.validate(solution, 1000, seed=0, batch=1000)
    response = solution.decisions["gain"] * (1 + HALF_WIDTH * germ[:, 0])
    assert float(evidence.functionals["response(t_f)"].mean) == pytest.approx(response.mean(), rel=1e-12)
    assert evidence.violations["response"].count == np.sum(response > 2.0)


def test_a_deterministic_design_is_validated_on_the_uncertain_systems():
    # The nominal gain puts the mean at the bound: half of all systems are beyond it.
    nominal = al.solve(al.deterministic(gain_problem(upper=2.0, sigmas=1.0)))
    assert nominal.decisions["gain"] == pytest.approx(2.0, rel=1e-7)
    evidence = al.validate(nominal, 4000)
    violation = evidence.violations["response"]
    assert violation.lower <= 0.5 <= violation.upper
    assert float(evidence.functionals["response(t_f)"].std) == pytest.approx(2.0 * SPREAD, rel=0.05)
    assert float(evidence.functionals["response(t_f)"].expanded_std) == 0.0


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
    for names in ((), ("spread",), ("low", "travel")):
        with pytest.raises(al.ProblemError, match=r"which systems are counted, \['high', 'low'\]"):
            evidence.violation(*names)


def test_what_is_kept_of_the_samples_does_not_grow_with_the_instants_but_for_the_drawn_few():
    solution = al.solve(oscillator_problem())
    evidence = al.validate(solution, 600, batch=50, keep=7)
    arrays = {
        (one.text, name): leaf
        for one in evidence.functionals.values()
        for name, leaf in vars(one).items()
        if isinstance(leaf, np.ndarray)
    }
    # One number of each system for densities, where a functional is one number.
    assert all(array.shape == (600,) for (_, name), array in arrays.items() if name == "values")
    assert max(array.size for (_, name), array in arrays.items() if name != "values") <= 81
    assert [one.values.shape for one in evidence.trajectories] == [(7, 81), (7, 81)]
    assert [one.violating.shape for one in evidence.trajectories] == [(7,), (7,)]


def test_all_batches_share_one_compilation(solution):
    al.validate(solution, 90, batch=40)
    before = SIMULATE_BATCH.compilations
    al.validate(solution, 130, batch=40, seed=9)
    assert SIMULATE_BATCH.compilations == before


def test_a_design_of_which_nothing_is_uncertain_is_simulated_on_a_finer_grid():
    evidence = al.validate(al.solve(gain_problem(theta=1.0)))
    assert evidence.agrees
    assert evidence.joint.count == 0
    assert "nothing is uncertain: the one system simulated with 10 times as many steps" in str(evidence)


def test_a_coarse_grid_behind_a_design_without_uncertainty_is_found_out():
    swinging = Oscillator(m=1.0, c=al.Decision(0.5, 0.05, 8.0), k=10.0)
    problem = al.Problem(
        swinging,
        grid=al.Grid(4.0, 8),
        inputs={"force": sine()},
        minimize=0.1 * al.value("c") + al.rms("v").mean,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.GridWarning)
        solution = al.solve(problem, throw=False)  # the solve knows it already
    with pytest.warns(al.ExpansionWarning, match="contradict the solution.*Use more steps"):
        evidence = al.validate(solution)
    assert not evidence.agrees
    assert str(evidence).startswith("DISAGREES: ")


def test_a_seed_below_zero_is_what_the_refusal_speaks_of(solution):
    with pytest.raises(al.ProblemError, match="seed is a whole number of at least 0; received -1"):
        al.validate(solution, seed=-1)


@pytest.mark.parametrize(("samples", "batch"), [(1, 100), (0, 100), (100, 0)])
def test_numbers_of_samples_that_make_no_sense_are_refused(solution, samples, batch):
    with pytest.raises(al.ProblemError, match=f"received {min(samples, batch)}"):
        al.validate(solution, samples, batch=batch)


class Fragile(al.System):
    """Not finite where theta is beyond 1.29, which only a sample reaches; `kind` says how."""

    states = ("x",)
    gain: float
    theta: float
    kind: str = eqx.field(static=True)

    def rhs(self, t, z):
        return (0.0 * z.x,)

    def outputs(self, t, z):
        broken = {"nan": jnp.nan, "infinite": jnp.inf}[self.kind]
        return {"x": self.gain * jnp.where(self.theta > 1.29, broken, self.theta), "gain": self.gain}


def warned(problem):
    """The solution, of which fresh systems in a tail tell that some have no result."""
    with pytest.warns(al.ExpansionWarning, match=r"is not finite in about \d\S* % of all systems, .*theta=1\.29"):
        return al.solve(problem)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["nan", "infinite"])
@pytest.mark.parametrize(
    "bound",
    [al.terminal("x").mean <= 100, al.terminal("x").std <= 100, al.path("x").std <= 100],
    ids=["mean", "std", "std of a path"],
)
def test_a_sample_that_is_not_finite_is_named(bound, kind):
    problem = al.Problem(
        Fragile(al.Decision(1.0, 0.5, 2.0), al.Uniform(1.0, half_width=HALF_WIDTH), kind),
        grid=ONE_STEP,
        minimize=(al.terminal("gain")).mean,
        subject_to=[bound],
        expansion=al.Expansion(1),
    )
    solution = warned(problem)
    said = r"system with theta=1\.29\d* is not finite: output 'x' from t = 0 s on"
    with pytest.raises(al.SimulationError, match=said):
        al.validate(solution, 2000)


class Ending(Fragile):
    """Whose output is the root of a negative number after half a second."""

    def outputs(self, t, z):
        return {"x": jnp.where(self.theta > 1.29, jnp.sqrt(0.5 - t), self.theta), "gain": self.gain}


@pytest.mark.parametrize("limit", [al.path("x").at_most(5.0), al.integral("x").mean <= 5.0], ids=["path", "integral"])
def test_what_becomes_not_finite_on_the_way_is_named_with_its_instant(limit):
    problem = al.Problem(
        Ending(al.Decision(1.0, 0.5, 2.0), al.Uniform(1.0, half_width=HALF_WIDTH), "nan"),
        grid=al.Grid(1.0, 100),
        minimize=al.terminal("gain").mean,
        subject_to=[limit],
        expansion=al.Expansion(1),
    )
    said = r"theta=1\.29\d* is not finite: output 'x' from t = 0\.5[01]\d* s on"
    solution = warned(problem)
    with pytest.raises(al.SimulationError, match=said):
        al.validate(solution, 2000)


class Overflowing(Fragile):
    """Whose output is finite, but not its square."""

    def outputs(self, t, z):
        return {"x": self.gain * jnp.where(self.theta > 1.29, 1e200, self.theta), "gain": self.gain}


def test_a_functional_that_is_not_finite_of_outputs_that_are_is_named():
    problem = al.Problem(
        Overflowing(al.Decision(1.0, 0.5, 2.0), al.Uniform(1.0, half_width=HALF_WIDTH), "nan"),
        grid=ONE_STEP,
        minimize=al.terminal("gain").mean,
        subject_to=[al.rms("x").mean <= 100.0],
        expansion=al.Expansion(1),
    )
    solution = warned(problem)
    with pytest.raises(al.SimulationError, match=r"theta=1\.29\d* is not finite: rms\(x\)\."):
        al.validate(solution, 2000)


def test_a_broken_system_beyond_the_samples_asked_for_is_no_matter():
    problem = al.Problem(
        Fragile(al.Decision(1.0, 0.5, 2.0), al.Uniform(1.0, half_width=HALF_WIDTH), "nan"),
        grid=ONE_STEP,
        minimize=(al.terminal("gain")).mean,
        subject_to=[al.path("x").at_most(100.0)],
        expansion=al.Expansion(1),
    )
    germ = draw((LegendreGerm(),), 400, np.random.default_rng(0))[:, 0]
    first = int(np.argmax(1 + HALF_WIDTH * germ > 1.29))
    # The batch before the break is larger than what is asked for, so the broken system is simulated and dropped.
    solution = warned(problem)
    batch = first // 2 + 2
    assert batch < first < 2 * batch
    evidence = al.validate(solution, first, batch=batch)
    assert np.isfinite(evidence.functionals["x(t)"].std).all()
    assert float(evidence.functionals["x(t)"].mean[0]) == pytest.approx(np.mean(1 + HALF_WIDTH * germ[:first]) / 2)


def test_evidence_prints_what_it_found(solution):
    text = str(al.validate(solution, 1000, seed=7))
    assert "1000 fresh samples, seed 7" in text
    assert "violates response:" in text
    assert "95 % confidence" in text
    assert dataclasses.is_dataclass(al.results.Evidence)


def test_progress_is_told(solution):
    told = []
    al.validate(solution, 100, batch=40, progress=lambda *words: told.append(words))
    assert told == [("Monte Carlo", done, 100) for done in (0, 40, 80, 100)]


def test_systems_are_simulated_on_a_grid_whose_error_is_an_order_below_what_is_tolerated():
    class Fading(al.System):
        states = ("x",)
        k: Any
        a: Any

        def initial(self):
            return {"x": self.a}

        def rhs(self, t, z):
            return (-self.k * z.x,)

        def outputs(self, t, z):
            return {"x": z.x, "loss": (self.a - 1.0) ** 2}

    problem = al.Problem(
        Fading(al.Uniform(2.0, half_width=0.01), al.Decision(0.5, 0.1, 2.0)),
        grid=al.Grid(2.0, 4),
        minimize=al.terminal("loss").mean,
        subject_to=[al.terminal("x").mean <= 1.0, al.path("x").at_most(3.0, sigmas=1.0)],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = al.solve(problem)
        evidence = al.validate(solution, 2000)
    low, high = 1.99, 2.01
    exact = (np.exp(-2 * low) - np.exp(-2 * high)) / (2 * (high - low))
    sampled = evidence.functionals["x(t_f)"]
    # Four steps of RK4 are off by two per cent; what is sampled, by chance alone.
    assert abs(float(solution.moments["x(t_f)"].mean) - exact) > 20 * float(sampled.standard_error)
    assert abs(float(sampled.mean) - exact) < 4 * float(sampled.standard_error)
    assert evidence.functionals["x(t)"].mean.shape == (5,)
    assert evidence.instants == 4 * solution.certificate.grid_error.factor + 1
