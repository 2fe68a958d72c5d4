"""What a motion study says at the end: a design only where fresh systems confirm it, its price, what compares."""

import re
from dataclasses import replace

import numpy as np
import pytest

import aleator as al
from aleator.studies._motion.facts import TARGET, build_verdict, compared, meets, price
from aleator.studies._motion.results import Family
from aleator.studies.swing_up._facts import terminal_norm
from zoo import STRESS, bar_problem

TOLD = {"unit": "mm", "who": "samples"}


def bar(sigmas):
    """The lightest bar for a uniform load: `(1 - sigmas / √3) / 2` of them break it."""
    return al.Problem(
        bar_problem().system, minimize=al.output("mass").mean, subject_to=[STRESS.at_most(0.5, sigmas=sigmas)]
    )


@pytest.fixture(scope="module")
def printed():
    return al.solve(bar(1.0))


@pytest.fixture(scope="module")
def found():
    return al.calibrate(bar(1.6), "stress", TARGET, samples=2_000)


def test_a_confirmed_margin_is_a_design_to_build_with_its_interval_and_its_price(found, printed):
    said = build_verdict(found, printed, beside=" It is slow.", **TOLD)
    assert (said.level, said.word) == ("good", "Build")
    # The width is the load's mean and `sigmas` standard deviations of it, over the stress.
    more = found.solution.objective / printed.objective - 1
    assert more == pytest.approx(0.3 / np.sqrt(3) * (found.sigmas - 1) / 0.5 / printed.objective, rel=1e-5)
    assert price(found.solution.objective, printed.objective, "mm") in said.headline
    assert "10.0\u202f% more" in price(110.0, 100.0, "mm")
    assert "10.0\u202f% less" in price(90.0, 100.0, "mm")
    assert found.sentence("samples") in said.headline
    assert said.headline.endswith(" It is slow.")


def test_there_is_no_design_to_build_where_the_interval_reaches_beyond_the_target(found, printed):
    # The same calibration had so many of the fresh systems broken a limit: its estimate meets the target.
    share = replace(found.confirmation, count=round(TARGET * found.confirmation.samples))
    worse = replace(found, confirmation=share, missing="fresh systems are too few")
    assert share.estimate <= TARGET < share.upper
    assert not meets(worse)
    said = build_verdict(worse, printed, **TOLD)
    assert (said.level, said.word) == ("bad", "Not confirmed")
    assert "No design to build" in said.headline
    assert "fresh systems are too few" in said.headline
    said = build_verdict(None, printed, **TOLD)
    assert (said.level, said.word) == ("caution", "Not calibrated")
    assert "No design to build yet" in said.headline


def test_limits_that_were_given_no_margin_count_as_well(found, printed):
    samples = found.evidence.samples
    broken = dict.fromkeys(found.evidence.broken, np.arange(samples) < round(2 * TARGET * samples))
    other = replace(found, evidence=replace(found.evidence, broken=broken))
    assert other.confirmed
    assert not meets(other)
    said = build_verdict(other, printed, **TOLD)
    assert (said.level, said.word) == ("bad", "Not confirmed")
    assert "2.00" in said.headline


def test_what_compares_with_printed_numbers_follows_from_the_numbers():
    for ours, told in (
        ({"a": 10.0, "b": 12.1, "c": 14.8}, "signs, order and sizes agree:"),
        ({"a": 10.0, "b": 11.0, "c": 15.0}, "signs and order agree, sizes do not:"),
        ({"a": 10.0, "b": 14.0, "c": 13.0}, "signs agree, order and sizes do not:"),
        ({"a": 10.0, "b": 9.0, "c": 15.0}, "signs, order and sizes do not agree:"),
    ):
        sentence = compared({"a": 1.0, "b": 1.2, "c": 1.5}, ours, "efforts")
        assert sentence.startswith("Of efforts, ")
        assert told in sentence
        changes = [float(one) for one in re.findall(r"[+−]([\d.]+)\u202f% \(published", sentence)]
        np.testing.assert_allclose(changes, [abs(ours[name] / 10 - 1) * 100 for name in "bc"], rtol=5e-3)
    assert compared({"a": 1.0, "b": 1.2}, {"a": 3.0, "b": float("nan")}, "efforts") == ""


def test_the_variance_of_the_tip_is_told_with_the_error_of_its_sample():
    # Of n normal numbers the variance has the standard error s² sqrt(2 / n); so has the norm of two of equal size.
    count, spread = 20_000, 0.3
    ends = np.random.default_rng(4).normal(0.0, spread, (2, count, 1))
    family = Family(np.zeros(1), {}, dict(zip(("tip_x", "tip_y"), ends, strict=True)), {})
    value, error = (float(part) for part in terminal_norm(family).split(" ± "))
    assert error == pytest.approx(spread**2 * np.sqrt(2 / count), rel=0.35)
    assert abs(value - np.sqrt(2) * spread**2) < 4 * error
