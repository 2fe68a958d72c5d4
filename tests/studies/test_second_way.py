"""The chapter of a design's second way: both answers in a table, and nothing before they are found."""

import math
from dataclasses import replace

import pytest

import aleator as al
from aleator.journalling import recalling
from aleator.studies._second_way import collocated, found_both_ways, second_way
from tiny_models import oscillator_problem


def both_ways():
    said = []
    problem = oscillator_problem(grid=al.Grid(4.0, 80))
    both = found_both_ways("dOpt", problem, lambda *told: said.append(told))
    assert said[0][0] == "dOpt by direct collocation"
    return both


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("journal")


@pytest.fixture(scope="module")
def found(folder):
    with al.journal(folder):
        return both_ways()


def read(text):
    """The number of a text such as `4.1·10⁻¹⁰`."""
    mantissa, _, power = text.partition("·10")
    return float(mantissa) * 10.0 ** int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")) or 0)


def rows(found):
    table, mesh = second_way("dOpt", found).blocks
    assert mesh.kind == "drawing"
    return table.caption, {row[0]: row[1:] for row in table.rows}


def test_nothing_is_shown_or_kept_before_it_is_found():
    assert second_way("dOpt", None).blocks == []
    assert collocated("dOpt", None) == {}


def test_both_answers_stand_side_by_side_with_their_difference(found):
    caption, shown = rows(found)
    assert caption == "dOpt by shooting and by direct collocation: they agree to 0.0001"
    first, second, difference = shown["c"]
    assert float(first) == pytest.approx(float(found.first.decisions["c"]), rel=1e-7)
    assert float(second) == pytest.approx(float(found.second.decisions["c"]), rel=1e-7)
    assert read(difference) == pytest.approx(found.decisions["c"], rel=0.06)
    worst = max(found.statistics, key=found.statistics.__getitem__)
    assert worst in shown["Statistics, the largest difference"][2]
    assert shown["Iterations"][:2] == [str(one.effort.iterations) for one in (found.first, found.second)]
    assert collocated("dOpt", found) == {"dOpt": found.second}


def test_what_does_not_agree_and_what_cannot_be_compared_is_said(found):
    apart = replace(found, objective=0.1, decisions={"c": math.inf})
    caption, shown = rows(apart)
    assert "do NOT agree" in caption
    assert shown["c"][2] == "on another mesh"


def test_decisions_at_their_bounds_are_left_out(found):
    fixed = replace(found, first=replace(found.first, at_bounds=("c",)))
    assert "c" not in rows(fixed)[1]


def test_both_answers_are_taken_from_their_journal(found, folder):
    with recalling(folder):
        again = both_ways()
    assert again.objective == found.objective
    assert again.statistics == found.statistics
    assert again.second.vector.tobytes() == found.second.vector.tobytes()
