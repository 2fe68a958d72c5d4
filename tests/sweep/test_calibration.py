"""Margins calibrated to how often limits are broken, against the normal distribution's tables."""

import warnings
from typing import Any

import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.sweep import _calibrate

SPREAD = 0.2


class Shifted(al.AlgebraicSystem):
    """Two numbers chosen, each with normal or other noise on it."""

    place: Any
    noise: Any
    other: Any
    other_noise: Any

    def outputs(self):
        return {"x": self.place + SPREAD * self.noise, "y": self.other + SPREAD * self.other_noise}


X, Y = al.output("x"), al.output("y")


def shifted_problem(noise=None, least=-5.0, most=5.0, sigmas=(1.0, 1.0), upper=2.0):
    """Push `x`, and `y`, as close to 2 as the margins let: each breaks it with probability `Phi(-sigmas)`.

    Margins for `x` have a design up to `(2 - least) / SPREAD`.
    """
    model = Shifted(
        place=al.Decision(max(0.0, least), least, most),
        noise=al.Normal(0.0, 1.0) if noise is None else noise,
        other=al.Decision(0.0, -5.0, 5.0),
        other_noise=al.Normal(0.0, 1.0),
    )
    limits = [X.at_most(upper, sigmas=sigmas[0]), Y.at_most(2.0, sigmas=sigmas[1])]
    return al.Problem(model, minimize=-X.mean - Y.mean, subject_to=limits, expansion=al.Expansion(order=1))


def calibrated(names="x", target=0.05, problem=None, **options):
    return al.calibrate(problem or shifted_problem(), names, target, **({"samples": 2000} | options))


def ratios(names, target, seeds, truth):
    """The true violation of each calibrated design over its target."""
    found = [calibrated(names, target, seed=seed) for seed in seeds]
    assert all(one.confirmed for one in found)
    assert all(one.confirmation.upper <= target for one in found)
    return np.array([truth(one.sigmas) for one in found]) / target


def either(sigmas):
    """How often a system breaks one of two independent limits, each with the same margin."""
    return 1 - stats.norm.cdf(sigmas) ** 2


@pytest.mark.slow
@pytest.mark.parametrize("target", [0.05, 0.01])
def test_the_true_violation_exceeds_the_target_in_no_more_than_one_run_of_twenty(target):
    found = ratios("x", target, range(20), stats.norm.sf)
    assert np.sum(found > 1) <= 1
    # Nor is the margin needlessly large.
    assert np.median(found) > 1 / 3


def test_several_limits_share_one_target_and_a_system_that_breaks_two_counts_once():
    found = ratios(("x", "y"), 0.05, range(2), either)
    assert np.sum(found > 1) <= 1
    assert np.median(found) > 0.5
    found = calibrated(["y", "x", "y"])
    assert found.names == ("y", "x")
    assert [one.expression.sigmas for one in found.solution.problem.constraints] == pytest.approx([found.sigmas] * 2)
    assert found.confirmation.lower <= either(found.sigmas) <= found.confirmation.upper
    assert found.evidence.violations["x"].estimate < found.confirmation.estimate
    assert "violates y or x" in str(found)


def test_margins_of_several_limits_keep_the_ratio_in_which_they_were_given():
    found = calibrated(("x", "y"), problem=shifted_problem(sigmas=(0.8, 1.6)))
    margins = found.margins
    assert margins["y"] == found.sigmas == pytest.approx(2 * margins["x"])
    exact = 1 - stats.norm.cdf(margins["x"]) * stats.norm.cdf(margins["y"])
    assert found.confirmation.lower <= exact <= found.confirmation.upper <= 0.05


def test_fresh_systems_are_those_of_no_trial_and_of_no_evidence_with_the_same_seed():
    found = calibrated(seed=0)
    samples = found.evidence.samples
    assert found.confirmation.count == found.evidence.violations["x"].count
    assert samples > 2000
    assert al.validate(found.solution, samples, seed=0).violations["x"].count != found.confirmation.count
    assert found.evidence.seed != 0
    # As many systems as in a trial, by the seed of the confirmation, would be those of the trial itself.
    again = al.validate(found.solution, found.chosen.violation.samples, seed=found.evidence.seed)
    assert again.violations["x"].count != found.chosen.violation.count
    repeated = calibrated(seed=0)
    assert (repeated.sigmas, repeated.confirmation) == (found.sigmas, found.confirmation)


@pytest.mark.slow
def test_targets_of_one_in_ten_thousand_take_some_thousand_samples():
    target = 1e-4
    found = ratios("x", target, range(3), stats.norm.sf)
    assert np.all(found < 1)
    assert np.all(found > 0.7)
    found = calibrated(("x", "y"), target)
    assert found.confirmation.samples == 4000
    assert found.confirmation.lower <= either(found.sigmas) <= found.confirmation.upper <= target
    assert "weighted" in found.sentence()


@pytest.mark.slow
def test_a_rare_target_that_no_weights_reach_is_counted_on_more_systems():
    # A triangular distribution ends: beyond a margin of the root of six no system is left, and weights have nothing to
    # find.
    problem = shifted_problem(al.Triangular(-1.0, 0.0, 1.0), sigmas=(3.0, 1.0), most=2.0 - SPREAD)
    found = calibrated("x", 2e-3, problem, samples=1000, max_trials=1)
    assert found.confirmed
    assert (found.trials[0].violation.count, found.trials[0].violation.samples) == (0, 10_000)
    assert (found.confirmation.count, found.confirmation.samples) == (0, 20_000)


@pytest.mark.parametrize(("target", "first"), [(0.0228, 1.0), (0.2, 3.0)])
def test_calibration_finds_the_margin_of_a_normal_response(target, first):
    found = calibrated("x", target, shifted_problem(sigmas=(first, 1.0)), samples=5000)
    assert found.confirmed
    assert not found.missing
    # The violation lies below the target by no more than what 5000 systems are in error by, a few times over.
    assert target - 12 * np.sqrt(target / 5000) < stats.norm.sf(found.sigmas) < target
    assert found.solution.decisions["place"] == pytest.approx(2.0 - SPREAD * found.sigmas, rel=1e-6)
    assert found.confirmation.lower <= stats.norm.sf(found.sigmas) <= found.confirmation.upper
    assert f"chosen: {found.sigmas:.4f}, confirmed for the target of {100 * target:g} %" in str(found)
    assert found.sentence("cars").endswith(f"of {found.confirmation.samples} fresh cars, at 97.5 % confidence")


def test_a_wide_target_ends_at_the_smallest_margin_and_one_that_does_not_matter_is_not_searched_for():
    found = calibrated("x", 0.9, samples=500)
    assert found.sigmas <= 0.02
    assert found.chosen.violation.estimate == pytest.approx(0.5, abs=0.1)
    assert found.confirmed
    # The place is at its own bound, and never gets near 100.
    found = calibrated("x", 0.1, shifted_problem(upper=100.0), samples=500)
    assert len(found.trials) == 1
    assert found.solution.decisions["place"] == pytest.approx(5.0, rel=1e-5)


LEAST = {"least": 2.0 - 1.55 * SPREAD}


def test_a_margin_is_found_although_a_wider_one_has_no_design():
    # The margin exists up to 1.55; the first guess beyond 1 is 1.6.
    found = calibrated("x", stats.norm.sf(1.4), shifted_problem(**LEAST), samples=5000)
    assert found.confirmed
    assert 1.4 < found.sigmas < 1.5


def test_a_target_that_no_design_reaches_is_not_confirmed_and_what_was_found_is_kept():
    with pytest.warns(al.CalibrationWarning, match=r"not confirmed .* from sigmas = 1\.5\d* on there is no design"):
        found = calibrated("x", 0.01, shifted_problem(**LEAST))
    assert not found.confirmed
    assert found.confirmation is None
    assert found.sigmas == max(one.sigmas for one in found.trials) == pytest.approx(1.55, abs=0.01)
    assert "no margin tried is violated rarely enough" in str(found)
    with pytest.raises(al.SolveError, match="'x' is violated by"):
        calibrated("x", 0.01, shifted_problem(least=1.9))


def test_a_design_a_little_below_the_target_is_not_confirmed_and_how_many_systems_would_tell_is_said():
    # The widest margin is 1.55, which is broken by 6.06 %: too close to 6.3 % for some thousand systems to tell.
    with pytest.warns(al.CalibrationWarning, match=r"about [\de.+]+ fresh systems would tell; from sigmas = 1\.5"):
        found = calibrated("x", 0.063, shifted_problem(**LEAST), samples=1000, seed=1)
    assert not found.confirmed
    assert found.confirmation.lower < stats.norm.sf(found.sigmas) < 0.063 < found.confirmation.upper


def test_a_spent_budget_of_trials_is_told():
    with pytest.warns(al.CalibrationWarning, match="the trials are used up: expected more than max_trials = 2"):
        found = calibrated("x", 0.01, max_trials=2)
    assert len(found.trials) == 2


def test_fresh_systems_that_break_it_too_often_widen_the_margin(monkeypatch):
    # A measurement of trials that is far too low, as the winner of many is: the first choice is not confirmed.
    honest = _calibrate._Sampler.trial

    def lucky(self, solution):
        share = honest(self, solution)
        return al.results.Proportion(share.count // 3, share.samples)

    monkeypatch.setattr(_calibrate._Sampler, "trial", lucky)
    found = calibrated()
    assert found.confirmed
    assert stats.norm.sf(found.sigmas) < 0.05
    # Every look at fresh systems costs half of the confidence that is left.
    looks = np.log2(2 / 40 / (1 - found.confirmation.confidence))
    assert looks == pytest.approx(round(looks), abs=1e-6)
    assert looks > 1


def interrupting(monkeypatch, name, at, error=KeyboardInterrupt):
    """`name` of the module raises at its call number `at`."""
    calls, honest = [], getattr(_calibrate, name)

    def called(*arguments, **options):
        calls.append(arguments)
        if len(calls) == at:
            raise error
        return honest(*arguments, **options)

    monkeypatch.setattr(_calibrate, name, called)


@pytest.mark.parametrize(("name", "at"), [("solve", 3), ("validate", None)], ids=["solving", "confirming"])
def test_ctrl_c_returns_the_trials_that_are_finished_and_confirms_nothing(monkeypatch, name, at):
    at = at or 1 + len(calibrated().trials)
    interrupting(monkeypatch, name, at)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = calibrated()
    assert found.interrupted
    assert not found.confirmed
    assert len(found.trials) == at - 1
    assert found.chosen in found.trials
    assert "not confirmed for the target of 5 %: it was interrupted" in str(found)


def test_ctrl_c_before_the_first_trial_is_ctrl_c(monkeypatch):
    interrupting(monkeypatch, "solve", 1)
    with pytest.raises(KeyboardInterrupt):
        calibrated()


def test_a_solve_that_fails_in_mid_search_loses_nothing(monkeypatch):
    honest, broken = _calibrate.solve, 2.4

    def solve(problem, *arguments, **options):
        if problem.constraints[0].expression.sigmas > broken:
            raise al.SimulationError("no")
        return honest(problem, *arguments, **options)

    monkeypatch.setattr(_calibrate, "solve", solve)
    with pytest.warns(al.CalibrationWarning, match=r"from sigmas = 2\.4\d* on there is no design \(no\)"):
        found = calibrated("x", 1e-3)
    assert not found.confirmed
    assert found.sigmas == pytest.approx(broken, rel=0.01)


def moments():
    return al.Problem(shifted_problem().system, minimize=X.mean, subject_to=[X.std <= 0.3])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": 1.0}, "expected target as a probability between 0 and 1, such as 0.01; received 1.0"),
        ({"target": 0.01, "samples": 600}, "expected at least 1000 samples to resolve a violation of .*; received 600"),
        ({"samples": 2000.5}, "samples as a whole number of at least 2; received 2000.5"),
        ({"max_trials": 0}, "max_trials as a whole number of at least 1; received 0"),
        ({"precision": 1.5}, "precision as a number between 0 and 1; received 1.5"),
        ({"names": ("x", "travel")}, "There is no constraint 'travel'; expected one of"),
        ({"names": ()}, r"a constraint's name, or several in a tuple; received \(\)"),
        ({"problem": shifted_problem(sigmas=(0.0, 1.0))}, "'x' contain no standard deviation; set sigmas=1"),
        (
            {"problem": al.deterministic(shifted_problem())},
            "with distributions .al.deterministic holds them",
        ),
        ({"problem": moments()}, "no single system is counted against 'x' .*: it is a statistic of all systems"),
    ],
)
def test_calibrations_that_make_no_sense_are_refused_before_anything_is_solved(options, message, monkeypatch):
    monkeypatch.setattr(_calibrate, "solve", lambda *_, **__: pytest.fail("solved"))
    given = {"problem": shifted_problem(), "names": "x", "samples": 2000, "target": 0.05} | options
    with pytest.raises(al.ProblemError, match=message):
        al.calibrate(**given)
