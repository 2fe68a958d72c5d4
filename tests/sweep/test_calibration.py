"""Margins calibrated to how often limits are broken, against the normal distribution's tables.

Most tests stand in for solving and sampling by NumPy: a design is its margins, which normal noise exceeds.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.sweep import _calibrate, _margins
from executors import Inline

SPREAD, NAMES = 0.2, ("x", "y")
X, Y = al.output("x"), al.output("y")


class Shifted(al.AlgebraicSystem):
    """Two numbers chosen, each with noise on it."""

    place: al.Number
    noise: al.Number
    other: al.Number
    other_noise: al.Number

    def outputs(self):
        return {"x": self.place + SPREAD * self.noise, "y": self.other + SPREAD * self.other_noise}


def shifted_problem(sigmas=(1.0, 1.0), noise=None, most=5.0):
    """Push `x`, and `y`, as close to 2 as the margins let: each breaks it with probability `Phi(-sigmas)`."""
    noises = noise or al.Normal(0.0, 1.0), al.Normal(0.0, 1.0)
    model = Shifted(al.Decision(0.0, -5.0, most), noises[0], al.Decision(0.0, -5.0, 5.0), noises[1])
    limits = [X.at_most(2.0, sigmas=sigmas[0]), Y.at_most(2.0, sigmas=sigmas[1])]
    return al.Problem(model, minimize=-X.mean - Y.mean, subject_to=limits, expansion=al.Expansion(order=1))


def calibrated(names="x", target=0.05, problem=None, **options):
    return al.calibrate(problem or shifted_problem(), names, target, **({"samples": 2000} | options))


def either(sigmas):
    """How often a system breaks one of two independent limits, each with the same margin."""
    return 1 - stats.norm.cdf(sigmas) ** 2


# --- By the library --------------------------------------------------------------------------------------------------


def test_a_calibration_finds_the_margin_of_normal_responses():
    found = calibrated(["y", "x", "y"], samples=5000)
    assert found.names == ("y", "x")
    assert found.confirmed
    assert found.confirmation.lower <= either(found.sigmas) <= found.confirmation.upper <= 0.05
    assert either(found.sigmas) > 0.5 * 0.05
    assert found.solution.decisions["place"] == pytest.approx(2.0 - SPREAD * found.sigmas, rel=1e-6)
    # A system that breaks both counts once.
    assert found.evidence.violations["x"].estimate < found.confirmation.estimate
    assert f"chosen: {found.sigmas:.4f}, confirmed for the target of 5 %" in str(found)
    assert found.sentence("cars").endswith(f"of {found.confirmation.samples} fresh cars, at 97.5 % confidence")


@pytest.mark.slow
def test_targets_of_one_in_ten_thousand_take_some_thousand_samples():
    found = calibrated(NAMES, 1e-4)
    assert found.confirmation.samples == 4000
    assert 0.7e-4 < either(found.sigmas) < 1e-4
    assert found.confirmation.lower <= either(found.sigmas) <= found.confirmation.upper <= 1e-4
    assert "weighted" in found.sentence()
    # A triangular distribution ends: beyond a margin of the root of six no system is left for weights to find.
    problem = shifted_problem((3.0, 1.0), al.Triangular(-1.0, 0.0, 1.0), most=2.0 - SPREAD)
    found = calibrated("x", 2e-3, problem, samples=1000, max_trials=1)
    assert found.confirmed
    assert (found.trials[0].violation.count, found.trials[0].violation.samples) == (0, 10_000)
    assert (found.confirmation.count, found.confirmation.samples) == (0, 20_000)


# --- By NumPy --------------------------------------------------------------------------------------------------------


class Bench:
    """Solves and counts what `shifted_problem` is, from `sigmas` up to the widest margin of `x` with a design.

    `lucky` trials count a part of their violations. `at` is the call of `solve` or `validate`, counted from 1, at which
    Ctrl-C is pressed.
    """

    def __init__(self):
        self.widest, self.error, self.lucky, self.at = np.inf, al.SolveError, 1, {}
        self.seeds, self.executors, self.calls = [], [], {"solve": 0, "validate": 0}

    def called(self, name):
        self.calls[name] += 1
        if self.calls[name] == self.at.get(name):
            raise KeyboardInterrupt

    def solve(self, problem, **_):
        self.called("solve")
        margins = [problem.named(name)[0].expression.sigmas for name in NAMES]
        if margins[0] > self.widest:
            raise self.error("'x' is violated")
        return SimpleNamespace(problem=problem, margins=np.array(margins), active=NAMES, objective=margins[0])

    def validate(self, solution, samples, *, seed, keep, executor):
        self.called("validate")
        self.seeds.append(seed)
        self.executors.append(executor)
        broken = np.random.default_rng(seed).standard_normal((samples, 2)) > solution.margins
        every = 1 if keep else self.lucky  # only what is confirmed keeps histories

        def violation(*names):
            return al.results.Proportion(
                int(broken[:, [n in names for n in NAMES]].any(axis=1).sum()) // every, samples
            )

        return SimpleNamespace(violation=violation)


@pytest.fixture
def bench(monkeypatch):
    bench = Bench()
    monkeypatch.setattr(_calibrate, "solve", bench.solve)
    monkeypatch.setattr(_margins, "validate", bench.validate)
    return bench


@pytest.mark.parametrize(("names", "truth"), [("x", stats.norm.sf), (NAMES, either)], ids=["one limit", "two limits"])
def test_the_true_violation_exceeds_the_target_in_no_more_than_one_run_of_twenty(bench, names, truth):
    found = [calibrated(names, 0.05, seed=seed) for seed in range(20)]
    assert all(one.confirmed and one.confirmation.upper <= 0.05 and not one.missing for one in found)
    true = np.array([truth(one.sigmas) for one in found])
    assert np.sum(true > 0.05) <= 1
    assert np.median(true) > 0.5 * 0.05  # nor is the margin needlessly large


def test_fresh_systems_are_those_of_no_trial_and_of_no_evidence_with_the_same_seed(bench):
    bench.lucky = 3  # so that more than one look at fresh systems is needed
    executor = Inline(lambda results: results[-1])
    found = calibrated(seed=0, executor=executor)
    # One seed for all trials, and a new one for every look.
    of_trials, *of_looks = dict.fromkeys(bench.seeds)
    assert bench.seeds.count(of_trials) == len(found.trials)
    assert len(of_looks) == len(bench.seeds) - len(found.trials) > 1
    assert 0 not in bench.seeds
    assert {id(one) for one in bench.executors} == {id(executor)}
    again = calibrated(seed=0)
    assert (again.sigmas, again.confirmation) == (found.sigmas, found.confirmation)


def test_fresh_systems_that_break_it_too_often_widen_the_margin(bench):
    # A measurement of trials that is far too low, as the winner of many is: the first choice is not confirmed.
    bench.lucky = 3
    found = calibrated()
    assert found.confirmed
    assert stats.norm.sf(found.sigmas) < 0.05
    # Every look at fresh systems costs half of the confidence that is left.
    looks = np.log2(2 / 40 / (1 - found.confirmation.confidence))
    assert looks == pytest.approx(round(looks), abs=1e-6)
    assert looks > 1


def test_a_target_that_no_design_reaches_is_not_confirmed_and_what_was_found_is_kept(bench):
    bench.widest = 1.55
    with pytest.warns(al.CalibrationWarning, match=r"not confirmed .* from sigmas = 1\.5\d* on there is no design"):
        found = calibrated("x", 0.01)
    assert not found.confirmed
    assert found.confirmation is None
    assert found.sigmas == max(one.sigmas for one in found.trials) == pytest.approx(1.55, abs=0.01)
    assert "no margin tried is violated rarely enough" in str(found)
    bench.widest = 0.5
    with pytest.raises(al.SolveError, match="'x' is violated"):
        calibrated("x", 0.01)


@pytest.mark.filterwarnings("error")
def test_ctrl_c_returns_the_trials_that_are_finished_and_confirms_nothing(bench):
    trials = len(calibrated().trials)
    for name, at, kept in (("solve", 3, 2), ("validate", trials + 1, trials)):
        bench.at, bench.calls = {name: at}, dict.fromkeys(bench.calls, 0)
        found = calibrated()
        assert found.interrupted
        assert not found.confirmed
        assert len(found.trials) == kept
        assert found.chosen in found.trials
        assert "not confirmed for the target of 5 %: it was interrupted" in str(found)
    bench.at, bench.calls = {"solve": 1}, dict.fromkeys(bench.calls, 0)
    with pytest.raises(KeyboardInterrupt):
        calibrated()
