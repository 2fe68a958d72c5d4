from dataclasses import replace

import numpy as np
import pytest
import report_problems as given

import aleator as al
from aleator.studies import suspension
from aleator.studies._suspension_facts import box, cost, published_table
from aleator.studies._suspension_page import suspension_page, write_page
from aleator.studies._suspension_verdict import verdict


@pytest.fixture(scope="module")
def study():
    """The real three designs on a coarse grid, with little evidence: seconds instead of minutes."""
    grid = al.Grid(t_final=2.8, steps=280)
    results = given.empty_study()
    expansion = al.Expansion(order=3, tolerance=0.2)  # as that of aOpt, the least resolved
    problems = {
        "dOpt": suspension.deterministic_problem(),
        "uOpt": suspension.robust_problem(),
        "aOpt": suspension.apportionment_problem(),
    }
    for name, problem in problems.items():
        coarse = al.Problem(
            problem.system,
            grid=grid,
            inputs=problem.inputs,
            minimize=problem.objective,
            subject_to=problem.constraints,
            expansion=expansion,
        )
        results.designs[name] = al.solve(coarse, accuracy=0.05)
    return results


@pytest.fixture(scope="module")
def sampled(study):
    evidence = {name: al.validate(one, 300, seed=1, keep=10) for name, one in study.designs.items()}
    return replace(study, evidence=evidence)


def headings(page):
    return [section.heading for section in page.sections]


def numbers(page):
    return [block.number for section in page.sections for block in section.blocks if block.kind == "drawing"]


def test_the_page_of_a_study_that_reached_nothing_says_so(tmp_path):
    text = write_page(given.empty_study(), tmp_path / "page.html").read_text(encoding="utf-8")
    assert "no recommendation yet" in text
    assert "The study was stopped early." in text


def test_the_page_of_designs_alone_shows_where_they_stand(study):
    page = suspension_page(study)
    assert numbers(page)[:2] == ["7.2", "6.2"]
    assert page.verdict.word == "Incomplete"


def test_the_verdict_names_the_design_its_cost_and_how_often_cars_violate(sampled):
    said = verdict(sampled)
    initial, apportioned = cost(sampled.designs["uOpt"]), cost(sampled.designs["aOpt"])
    assert f"${apportioned:.2f} instead of ${initial:.2f}" in said.headline
    assert [card.label[:4] for card in said.cards[:3]] == ["dOpt", "uOpt", "aOpt"]


def test_the_cost_is_that_of_the_curves(study):
    assert cost(study.designs["uOpt"]) == pytest.approx(
        0.5 + 1.4e6 / 3750**1.5 + 0.75 + 3.31e5 / 250**2 + 0.85 + 0.733 / 0.17375
    )
    assert cost(study.designs["dOpt"]) == cost(study.designs["uOpt"])
    assert cost(study.designs["aOpt"]) == pytest.approx(study.designs["aOpt"].objective)


def test_a_box_reaches_the_worst_value_of_the_printed_travel_constraint(study):
    one = study.designs["uOpt"]
    worst = max(np.max(np.abs(part.values)) for part in one.constraints if part.name == "travel")
    shown = box(one, "uOpt")
    assert shown.centre["travel"] + shown.half["travel"] == pytest.approx(worst)
    assert box(study.designs["dOpt"], "dOpt").half == {"travel": 0.0, "ride": 0.0, "holding": 0.0}


def test_every_figure_of_the_chapters_is_on_the_page(sampled):
    front = al.Front("travel", np.array([0.203]), (sampled.designs["aOpt"],))
    fronts = {name: al.Front("travel", np.array([0.203]), (one,)) for name, one in sampled.designs.items()}
    holding = {name: al.Front("holding", np.array([0.034]), (sampled.designs[name],)) for name in ("dOpt", "uOpt")}
    narrow = dict(zip(("dOpt", "uOpt, 1 σ", "uOpt, 1.25 σ"), sampled.evidence.values(), strict=True))
    whole = replace(
        sampled,
        travel_fronts={**fronts, "aOpt": front},
        holding_fronts=holding,
        boxes=holding,
        narrow_evidence=narrow,
    )
    page = suspension_page(whole)
    expected = {"6.2", "6.4", "6.5", "6.6", "6.7", "6.8", "6.9", "6.10 a", "6.10 b", "7.2", "7.3", "7.4", "7.5"}
    assert expected <= set(numbers(page))
    assert "How to read this" in headings(page)


def test_published_numbers_stand_beside_ours_even_where_ours_are_missing(study):
    rows = {row[0]: row[1:] for row in published_table(study).rows}
    assert rows["Violate travel ±0.152 m: dOpt"] == ["59.6 %", "–"]
    assert rows["Cost of the initial spreads"] == ["$17.70", "$17.71"]
