"""What a motion study says at the end: a design only where fresh systems confirm it, and its price."""

import re
from dataclasses import replace

import numpy as np
import pytest

import aleator as al
from aleator.reporting import interval
from aleator.studies._shared import TARGET, to_build
from zoo import STRESS, bar_problem

SAID = {"labels": {"width": "a width of"}, "who": "samples", "objective": "mass"}


def bar(sigmas):
    """The lightest bar for a uniform load: `(1 - sigmas / √3) / 2` of them break it."""
    return al.Problem(
        bar_problem().system, minimize=al.output("mass").mean, subject_to=[STRESS.at_most(0.5, sigmas=sigmas)]
    )


@pytest.fixture(scope="module")
def printed():
    return al.solve(bar(1.0))


@pytest.fixture(scope="module")
def counted(printed):
    return al.validate(printed, 2_000, seed=1)


@pytest.fixture(scope="module")
def margin():
    return al.calibrate(bar(1.6), "stress", TARGET, samples=2_000)


def test_a_confirmed_margin_is_a_design_to_build_with_its_interval_and_its_price(margin, printed, counted):
    said = to_build(margin, printed, counted, **SAID)
    assert (said.level, said.word) == ("good", "Build")
    # The width is the load's mean and `sigmas` standard deviations of it, over the stress.
    more = margin.solution.objective / printed.objective - 1
    assert more == pytest.approx(0.3 / np.sqrt(3) * (margin.sigmas - 1) / 0.5 / printed.objective, rel=1e-5)
    assert f"Mass is {100 * more:.2g}\u202f% higher." in said.headline
    share = max(margin.confirmation, margin.evidence.joint, key=lambda one: one.upper)
    assert interval(share) in dict(said.rows)["Limits broken"]
    # (1 - 1 / √3) / 2 of the samples break the printed one.
    (against,) = map(int, re.findall(r"against (\d+) with the printed margin", said.headline))
    assert against == pytest.approx(1000 * (1 - 1 / np.sqrt(3)) / 2, abs=4.5 * np.sqrt(1000 * 1000 * 0.17 / 2_000))


def test_there_is_no_design_to_build_where_the_interval_reaches_beyond_the_target(margin, printed, counted):
    # The same calibration had so many of the fresh systems broken a limit: its estimate meets the target.
    share = replace(margin.confirmation, count=round(TARGET * margin.confirmation.samples))
    worse = replace(margin, confirmation=share, missing="fresh systems are too few")
    assert share.estimate <= TARGET < share.upper
    said = to_build(worse, printed, counted, **SAID)
    assert (said.level, said.word) == ("caution", "Do not build yet")
    assert interval(share) in dict(said.rows)["Limits broken"]
    said = to_build(None, printed, counted, **SAID)
    assert (said.level, said.word) == ("caution", "Do not build yet")
