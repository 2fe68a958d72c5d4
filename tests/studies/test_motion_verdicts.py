"""What a motion study says at the end: a design only where fresh systems confirm it, its price, what compares."""

import re
from dataclasses import replace

import numpy as np
import pytest

import aleator as al
from aleator.reporting import Table
from aleator.studies._motion.build import TARGET, build_verdict, margin_blocks, meets, price, price_table
from aleator.studies._motion.printed import compared
from zoo import Decay

TOLD = {"unit": "1/s", "who": "samples"}


def decay(sigmas):
    """The slowest decay to 0.4 within a second: of a uniform rate, `(1 - sigmas / √3) / 2` are too slow."""
    return al.Problem(
        Decay(rate=al.Uniform(al.Decision(1.2, 0.5, 2.0), half_width=0.1)),
        grid=al.Grid(1.0, 20),
        minimize=al.value("rate.mean"),
        subject_to=[al.terminal("x").at_most(0.4, sigmas=sigmas).named("level")],
    )


@pytest.fixture(scope="module")
def printed():
    return al.solve(decay(1.0))


@pytest.fixture(scope="module")
def found():
    return al.calibrate(decay(1.6), "level", TARGET, samples=2_000)


def unconfirmed(found, count):
    """The same calibration had so many of the fresh systems broken a limit."""
    assert found.confirmation is not None
    return replace(found, confirmation=replace(found.confirmation, count=count), missing="fresh systems are too few")


def test_a_confirmed_margin_is_a_design_to_build_with_its_interval_and_its_price(found, printed):
    said = build_verdict(found, printed, beside=" It is slow.", **TOLD)
    assert (said.level, said.word) == ("good", "Build")
    # x(1) = exp(-rate) is nearly a straight line over the rates: its mean rises by σ for each unit of the margin.
    more = found.solution.objective / printed.objective - 1
    assert more == pytest.approx(0.1 / np.sqrt(3) * (found.sigmas - 1) / printed.objective, rel=0.1)
    assert price(found.solution.objective, printed.objective, "1/s") in said.headline
    assert found.sentence("samples") in said.headline
    assert said.headline.endswith(" It is slow.")
    assert found.confirmation.upper <= TARGET


def test_there_is_no_design_to_build_where_the_interval_reaches_beyond_the_target(found, printed):
    share = found.confirmation
    worse = unconfirmed(found, round(TARGET * share.samples))
    # Its estimate meets the target, its interval does not.
    assert worse.confirmation.estimate <= TARGET < worse.confirmation.upper
    assert not meets(worse)
    said = build_verdict(worse, printed, **TOLD)
    assert (said.level, said.word) == ("bad", "Not confirmed")
    assert "No design to build" in said.headline
    assert "fresh systems are too few" in said.headline


def test_limits_that_were_given_no_margin_count_as_well(found, printed):
    joint = replace(found.evidence.joint, count=round(2 * TARGET * found.evidence.samples))
    other = replace(found, evidence=replace(found.evidence, joint=joint))
    assert other.confirmed
    assert not meets(other)
    said = build_verdict(other, printed, **TOLD)
    assert (said.level, said.word) == ("bad", "Not confirmed")
    assert "2.00" in said.headline


def test_without_a_calibration_the_verdict_says_that_there_is_none(printed):
    said = build_verdict(None, printed, **TOLD)
    assert (said.level, said.word) == ("caution", "Not calibrated")
    assert "No design to build yet" in said.headline


@pytest.mark.parametrize(("built", "change"), [(110.0, "10.0\u202f% more"), (90.0, "10.0\u202f% less")])
def test_a_price_is_told_beside_that_of_the_printed_margin(built, change):
    assert change in price(built, 100.0, "J")
    assert f"{built:.4g}" in price(built, 100.0, "J")


def test_the_table_of_margins_shows_those_that_were_reached(found, printed):
    plans = {"robust": printed, "calibrated": found.solution}
    evidence = {"calibrated": found.evidence}
    margins = {"robust": 1.0, "worst": 1.7, "calibrated": found.sigmas}
    table = price_table(plans, evidence, margins, "robust", "energy, N m")
    assert "Energy, N m" in table.header
    assert [row[0] for row in table.rows] == ["robust", "calibrated"]
    assert [row[-1] == "–" for row in table.rows] == [True, False]
    _, drawing = margin_blocks(found, table, "samples")
    assert found.sentence("samples") in drawing.caption
    assert list(margin_blocks(None, Table("", [], []), "samples")) == []


@pytest.mark.parametrize(
    ("ours", "told"),
    [
        ({"a": 10.0, "b": 12.1, "c": 14.8}, "signs, order and sizes agree:"),
        ({"a": 10.0, "b": 11.0, "c": 15.0}, "signs and order agree, sizes do not:"),
        ({"a": 10.0, "b": 14.0, "c": 13.0}, "signs agree, order and sizes do not:"),
        ({"a": 10.0, "b": 9.0, "c": 15.0}, "signs, order and sizes do not agree:"),
    ],
)
def test_what_compares_with_printed_numbers_follows_from_the_numbers(ours, told):
    sentence = compared({"a": 1.0, "b": 1.2, "c": 1.5}, ours, "efforts")
    assert sentence.startswith("Of efforts, ")
    assert told in sentence
    changes = [float(one) for one in re.findall(r"[+−]([\d.]+)\u202f% \(published", sentence)]
    np.testing.assert_allclose(changes, [abs(ours[name] / 10 - 1) * 100 for name in "bc"], rtol=5e-3)


def test_nothing_compares_with_a_single_plan():
    assert compared({"a": 1.0, "b": 1.2}, {"a": 3.0, "b": float("nan")}, "efforts") == ""
