"""What a page holds of each design of a front, for a reader to choose."""

import dataclasses
import re

import numpy as np
import pytest
import report_problems as given
import shown_results as shown

import aleator as al
from aleator import ProblemError
from aleator.reporting import front_blocks, report, share_text, trade_off_blocks
from aleator.reporting._report import choice


def facts(choice, caption):
    """The facts of one kind, by name, with plain spaces."""
    rows = next(one.rows for one in choice.facts if one.caption.startswith(caption))
    return {name: value.replace("\u202f", " ") for name, value in rows}


def linked(fronts=None, evidence=()):
    return front_blocks(fronts or {"uOpt": given.front()}, evidence)[0]


def test_each_point_of_a_front_tells_its_decisions_objective_limits_prices_and_certificate():
    front, block = given.front(), linked()
    names = [one.name.replace("\u202f", " ").split(": ")[1] for one in block.choices]
    assert names == ["0.9 m", "0.3 m", "0.2 m", "−0.5 m"]
    chosen, solution = block.choices[2], front.solutions[2]
    assert facts(chosen, "Decisions") == {"c.mean": f"{solution.decisions['c.mean']:.4f} N s/m"}
    assert facts(chosen, "Objective") == {"μ[∫effort dt]": f"{solution.objective:.3f} m²/s³"}
    assert re.match(r"0\.\d+ ≤ 0\.2 m at \d\.\d+ s", facts(chosen, "Limits")[given.NAME])
    assert facts(chosen, "Shadow prices") == {given.NAME: f"{front.shadow_prices[2]:.2f} m²/s³ per m"}
    assert facts(chosen, "Statistics") == {"μ[∫effort dt]": f"{solution.objective:.3f} m²/s³"}
    assert facts(chosen, "Certificate")["Status"] == "solved"
    assert facts(chosen, "Limits")["Active"] == given.NAME


def test_a_point_without_a_design_tells_why():
    failed = linked().choices[3]
    assert facts(failed, "Certificate")["Status"] == "infeasible"
    assert failed.facts[0].note == given.front().points[3].why()
    assert "Shadow prices" not in [one.caption for one in failed.facts]
    refused = al.results.Refused(given.problem(), "no decision can meet it")
    front = dataclasses.replace(given.front(), points=(*given.front().points[:3], refused))
    alone = linked({"uOpt": front}).choices[3]
    assert facts(alone, "Certificate") == {"Status": "infeasible"}
    assert alone.facts[0].note == "no decision can meet it"
    assert alone.bands == ()


def test_evidence_is_shown_at_the_design_on_which_it_was_sampled_and_nowhere_else(tmp_path):
    along = al.validate_all(given.front(), 400, seed=3)
    block = linked(evidence=[one for one in along.evidence if one])
    for each, evidence in zip(block.choices, along.evidence, strict=False):
        counted = facts(each, "Evidence")
        assert counted["Fresh systems"] == "400"
        share = share_text(evidence.violations[given.NAME])
        assert counted[f"Systems that violate {given.NAME}"] == share.replace("\u202f", " ")
    assert block.table.header[-1] == "Violate any limit"
    assert block.table.rows[3][-1] == "–"
    # The evidence on the solution of another problem with the same decisions is not on these.
    other = [dataclasses.replace(given.evidence(), solution=given.front().solutions[0])]
    assert "Fresh systems" not in facts(linked(evidence=other).choices[1], "Evidence")
    few = dataclasses.replace(given.front(), values=given.front().values[:1], points=given.front().points[:1])
    with pytest.raises(ProblemError, match=f"evidence at '{along.places[1]}' .* is on none of the fronts"):
        report(given.solution(), fronts=few, along=along, path=tmp_path / "page.html")


def test_the_points_of_several_fronts_in_any_order_are_linked_with_their_own_designs():
    first, order = given.front(), [2, 0, 1]
    second = al.results.Front(first.bound, first.values[order], tuple(first.points[i] for i in order))
    block = linked({"a": first, "b": second})
    assert [one.name.split(",")[0] for one in block.choices] == ["a"] * 4 + ["b"] * 3
    for figure in block.figures:
        traces = [one for one in figure.data if one.meta and len(one.meta) > 1]
        assert [sorted(one.meta) for one in traces] == [[0, 1, 2, 3], [4, 5, 6]]
        assert list(traces[1].x) == sorted(traces[1].x)  # lines join neighbours
        for trace in traces:
            for x, place in zip(trace.x, trace.meta, strict=True):
                assert f"{x:g}".replace("-", "−") in block.choices[place].name


def test_the_designs_of_a_trade_off_are_linked_with_their_points():
    (block,) = trade_off_blocks({"ours": shown.trade_off(3)})
    assert len(block.figures) == 3
    assert all(list(figure.data[0].meta) == [0, 1, 2] for figure in block.figures)
    for row, one in zip(block.table.rows, block.choices, strict=True):
        assert [cell.replace("\u202f", " ") for cell in row[:3]] == list(facts(one, "Wishes").values())[:3]


def test_what_a_wish_buys_is_the_ratio_of_weights_and_a_decision_at_its_bound_tells_what_that_costs():
    front = dataclasses.replace(shown.trade_off(2), weights=np.array([[np.nan, np.nan], [3.0, 1.5], [np.nan, np.nan]]))
    (block,) = trade_off_blocks({"made up": front})
    for end in (0, -1):
        assert facts(block.choices[end], "Wishes")["Rates of exchange"] == "none at an end of the front"
    (told,) = (one for name, one in facts(block.choices[1], "Wishes").items() if name.endswith("more of effort buys"))
    assert float(told.split(" ")[0]) == pytest.approx(2.0)
    (block,) = trade_off_blocks(
        {"made up": dataclasses.replace(shown.trade_off(3), weights=np.full((3, 3), 2.0) / [1, 2, 4])}
    )
    (told,) = (one for name, one in facts(block.choices[1], "Wishes").items() if name.endswith("more of effort buys"))
    assert [float(one.split(" ")[0]) for one in told.split(" or ")] == pytest.approx([2.0, 4.0])
    # The mass is the width, whose lower bound it reaches.
    assert facts(choice("alone", given.bar()), "Shadow prices")["bound of width"] == "1.000 per mm"
