from dataclasses import replace

import numpy as np
import pytest
import report_problems as given

import aleator as al
from aleator.studies import suspension
from aleator.studies.suspension._built import built_table
from aleator.studies.suspension._facts import box, cost
from aleator.studies.suspension._published import published_table
from aleator.studies.suspension._run import BUILT, QUICK, Effort
from aleator.studies.suspension._study import SuspensionStudy
from aleator.studies.suspension._verdict import verdict
from aleator.sweep import Trial


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


def having(results):
    """The study, having found these results."""
    made = SuspensionStudy(results.effort)
    made.found = results
    return made


def headings(page):
    return [section.heading for section in page.sections]


def numbers(page):
    return [
        block.number for section in page.sections for block in section.blocks if block.kind in ("drawing", "linked")
    ]


def test_the_page_of_a_study_that_reached_nothing_says_so(tmp_path):
    text = having(given.empty_study()).write_page(tmp_path).read_text(encoding="utf-8")
    assert "no recommendation yet" in text
    assert "The study was stopped early." in text


def test_the_page_of_designs_alone_shows_where_they_stand(study):
    page = having(study).page()
    assert numbers(page)[:2] == ["7.2", "6.2"]
    assert page.verdict.word == "Incomplete"


def calibrated(study, name, count=150, interrupted=False):
    """A design's calibration of which `count` of 20 000 fresh cars break a limit."""
    share = al.results.Proportion(count, 20_000, 0.975)
    problem = study.designs[name].problem
    for limit in BUILT[name]:
        problem = problem.with_sigmas(limit, 2.4 if limit == "ride" else 1.6)
    # uOpt is given another ride than that of the printed design.
    solution = study.designs["dOpt" if name == "uOpt" else name]
    trial = Trial(2.4, replace(solution, problem=problem), share)
    missing = "" if share.upper <= 0.01 else "about 1e+05 fresh cars would tell"
    return al.results.Calibration(BUILT[name], 0.01, (trial,), trial, share, None, missing, interrupted)


def full(sampled, **options):
    built = {name: calibrated(sampled, name, **options) for name in BUILT}
    return replace(sampled, effort=Effort(), built=built)


def test_the_verdict_names_the_designs_to_build_what_is_confirmed_and_the_price(sampled):
    said = verdict(full(sampled))
    headline = said.headline.replace("\u202f", " ")
    assert (said.level, said.word) == ("good", "Build")
    moments = (sampled.designs[name].moments["∫comfort dt"] for name in ("uOpt", "dOpt"))
    before, after = (float(one.mean + one.std) for one in moments)
    assert f"{after:.1f} m²/s³ instead of {before:.1f} m²/s³ (−{100 * (1 - after / before):.1f} %)" in headline
    assert f"${cost(sampled.designs['aOpt']):.2f} instead of ${cost(sampled.designs['aOpt']):.2f}" in headline
    assert "1.60 σ on travel and holding, 2.40 σ on ride" in headline
    assert any("confirmed for the target of 1 %: 0.75 %" in one for one in said.sentences)
    labels = [card.label for card in said.cards[:2]]
    assert labels == [f"{name} to build: cars beyond a limit" for name in BUILT]


def test_nothing_is_to_be_built_whose_interval_reaches_beyond_the_target(sampled):
    assert al.results.Proportion(190, 20_000, 0.975).upper > 0.01
    said = verdict(full(sampled, count=190))
    assert (said.level, said.word) == ("caution", "Do not build yet")
    assert "uOpt and aOpt" in said.headline
    some = full(sampled)
    some.built["aOpt"] = calibrated(sampled, "aOpt", count=190)
    assert "For aOpt no margin" in verdict(some).headline


@pytest.mark.parametrize("names", [(), ("uOpt",), ("uOpt", "aOpt")])
def test_a_study_that_was_stopped_before_its_margins_recommends_nothing(sampled, names):
    study = full(sampled)
    stopped = {name: calibrated(sampled, name, interrupted=True) for name in names}
    said = verdict(replace(study, built=stopped))
    assert said.word == "Incomplete"
    assert "break a limit" in said.headline


def test_a_quick_run_leaves_the_margins_to_the_full_one_and_says_so(sampled):
    assert not QUICK.calibration_samples
    quick = having(sampled)
    assert verdict(sampled).word == "A first look"
    assert "without the margins to build with" in quick.page().verdict.headline
    assert "without the margins to build with" in quick.headline()
    assert not {"designs to build", "calibration"} & set(quick.stages)


def test_the_designs_to_build_stand_beside_the_printed_ones(sampled):
    table = built_table(full(sampled))
    assert table.header == ["", "uOpt, printed", "uOpt, to build", "aOpt, printed", "aOpt, to build"]
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["Margins"][:2] == ["1.00 σ on travel and holding", "1.60 σ on travel and holding"]
    assert rows["Cost of the spreads"][:2] == ["$17.71", "$17.71"]


def test_a_front_that_was_cut_short_is_shown_with_what_is_missing(sampled, tmp_path):
    front = al.results.Front("travel", np.array([0.203]), (sampled.designs["uOpt"],), interrupted=True)
    whole = al.results.Front("travel", np.array([0.203]), (sampled.designs["dOpt"],))
    cut = replace(sampled, travel_fronts={"dOpt": whole, "uOpt": front})
    text = having(cut).write_page(tmp_path).read_text(encoding="utf-8")
    assert f"Of the front over travel of uOpt, 1 of {QUICK.front_points} points are finished and shown." in text
    assert "6.4" in numbers(having(cut).page())


def test_an_interrupted_front_keeps_its_finished_points(study, monkeypatch):
    def sweep(problem, bound, values, progress):
        return al.results.Front(bound, np.array(values[:1]), (study.designs["uOpt"],), interrupted=True)

    monkeypatch.setattr(al, "pareto", sweep)
    for stage, fronts in (("fronts over travel", "travel_fronts"), ("fronts over holding", "holding_fronts")):
        begun = having(replace(study, travel_fronts={}, holding_fronts={}, boxes={}))
        with pytest.raises(KeyboardInterrupt):
            begun.run(stage)
        assert [len(one.solutions) for one in getattr(begun.found, fronts).values()] == [1]
        assert stage not in begun.finished


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
    front = al.results.Front("travel", np.array([0.203]), (sampled.designs["aOpt"],))
    fronts = {name: al.results.Front("travel", np.array([0.203]), (one,)) for name, one in sampled.designs.items()}
    holding = {
        name: al.results.Front("holding", np.array([0.034]), (sampled.designs[name],)) for name in ("dOpt", "uOpt")
    }
    narrow = dict(zip(("dOpt", "uOpt, 1 σ", "uOpt, 1.25 σ"), sampled.evidence.values(), strict=True))
    whole = replace(
        sampled,
        travel_fronts={**fronts, "aOpt": front},
        holding_fronts=holding,
        boxes=holding,
        narrow_evidence=narrow,
    )
    page = having(whole).page()
    expected = {"6.2", "6.4", "6.5", "6.6", "6.7", "6.8", "6.9", "6.10 a", "6.10 b", "7.2", "7.3", "7.4", "7.5"}
    assert expected <= set(numbers(page))
    assert "How to read this" in headings(page)


def test_published_numbers_stand_beside_ours_even_where_ours_are_missing(study):
    table = published_table(study)
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["Violate travel ±0.152 m: dOpt"] == ["59.6\u202f%", "–", "–"]
    assert rows["Cost of the initial spreads"] == ["$17.70", "$17.71", "×1.00"]
    assert "order" not in table.note


def counted(sampled, *counts):
    """Evidence of the narrow designs in which so many of 1000 cars leave the travel."""
    one = sampled.evidence["uOpt"]
    shares = (al.results.Proportion(count, 1000) for count in counts)
    evidence = (replace(one, violations={**one.violations, "travel": share}) for share in shares)
    return replace(sampled, narrow_evidence=dict(zip(("dOpt", "uOpt, 1 σ", "uOpt, 1.25 σ"), evidence, strict=True)))


def test_order_and_sizes_are_said_to_agree_only_where_they_do(sampled):
    alike = published_table(counted(sampled, 600, 110, 36)).note
    assert "stand in the printed order" in alike
    assert "uOpt, a = 1" not in alike
    other = published_table(counted(sampled, 600, 36, 110)).note
    assert "stand not in the printed order" in other
    assert "uOpt, a = 1 and uOpt, a = 1.25" in other
    assert "Of 3 changes of a spread 3 have the printed sign." in other
    assert "are held by exactly the printed limits" in other
