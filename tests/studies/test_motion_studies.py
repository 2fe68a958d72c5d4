"""The studies of motion planning: the time-optimal one in small from stage to page, the others as a user runs them."""

import json
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import aleator as al
from aleator import cli
from aleator.reporting import page_html
from aleator.studies import load
from aleator.studies._motion.build import TARGET as TOLERATED
from aleator.studies._motion.build import price
from aleator.studies._motion.family import Family, fly
from aleator.studies._motion.results import Effort
from aleator.studies.pick_and_place_time._run import MEAN, ONE, WORST
from aleator.studies.pick_and_place_time._study import PickAndPlaceTime
from aleator.studies.swing_up._facts import terminal_norm
from aleator.studies.two_link_arm import START, TARGET, TwoLinkArm
from aleator.uncertainty import realise

SMALL = Effort(starts=3, samples=1_500, family=300, calibration_samples=2_000)


@pytest.fixture(scope="module")
def study():
    found = PickAndPlaceTime(SMALL)
    for stage in found.stages:
        found.run(stage)
    return found


@pytest.mark.slow
def test_a_search_that_was_cut_short_keeps_its_finished_starts_and_the_page_says_so(study, monkeypatch):
    begun = load("pick-and-place-time", quick=True)
    finished = study.done.searches[MEAN]
    monkeypatch.setattr(al, "multistart", lambda *arguments, **options: replace(finished, interrupted=True))
    with pytest.raises(KeyboardInterrupt):
        begun.run("plans")
    assert begun.done.plans == {MEAN: finished.best}
    html = page_html(begun.page())
    assert "Not reached or not completed: plans" in html
    assert f"{len(finished.solutions)} are finished and kept" in html
    assert begun.headline().startswith("Incomplete")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "reference"), [(MEAN, 1.4142), (ONE, 1.5938)])
def test_the_plans_are_as_fast_as_those_of_an_independent_program(study, name, reference):
    assert study.done.coarse[name].objective == pytest.approx(reference, abs=1e-4)
    # Limits that hold between the instants too cost a little.
    assert reference < study.done.plans[name].objective < 1.002 * reference


@pytest.mark.slow
def test_violations_are_the_shares_of_a_uniform_distribution_that_lie_beyond_the_margin(study):
    for name, expected in ((MEAN, 1.0), (ONE, 1 - 1 / np.sqrt(3)), (WORST, 0.0)):
        share = study.done.evidence[name].violations["torque"]
        assert share.estimate == pytest.approx(expected, abs=4.5 * np.sqrt(0.25 / share.samples))
    # They are counted between the instants, and the page says at how many.
    assert {one.instants for one in study.done.evidence.values()} == {901}
    assert "over time at 901 instants" in page_html(study.page())
    assert study.done.calibration.evidence.instants == 901


@pytest.mark.slow
def test_the_calibrated_margin_is_the_closed_form(study):
    # A uniform distribution leaves 1 - a/√3 outside μ ± aσ; that lies below the target by what fresh payloads are in
    # error by.
    found = study.done.calibration
    error = 4.5 * np.sqrt(TOLERATED / SMALL.calibration_samples)
    assert TOLERATED - error < 1 - found.sigmas / np.sqrt(3) < TOLERATED
    assert found.confirmed
    assert found.sentence("payloads") in page_html(study.page())
    assert study.done.plans["calibrated"] is found.solution


@pytest.mark.slow
def test_the_design_to_build_holds_at_both_ends_of_the_distribution_and_its_price_is_told(study):
    plan, printed = study.done.plans[WORST], study.done.plans[ONE]
    problem = plan.problem
    # Torques are straight lines in the payload, so that the ends of its distribution are their worst case.
    for end in (-1.0, 1.0):
        realised = realise(problem.simulation, jnp.array([end]), jnp.asarray(plan.vector))
        system, inputs, grid = realised.system, realised.inputs, realised.grid
        torques = al.simulate(system, grid.finer(10), inputs, only=("q1_torque", "q2_torque"))
        assert max(np.max(np.abs(rows)) for rows in torques.values()) <= 10 * (1 + 2e-6)
    said = study.verdict()
    assert (said.level, said.word) == ("good", "Build")
    assert price(plan.objective, printed.objective, "s") in said.headline
    assert said.headline in study.headline()
    assert study.done.evidence[WORST].joint.upper <= TOLERATED


@pytest.mark.slow
def test_a_family_follows_the_plan_and_its_torques_spread_as_the_expansion_says(study):
    plan, family = study.done.plans[ONE], study.done.families[ONE]
    np.testing.assert_allclose(np.ptp(family.systems["q1"], axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(family.nominal["q1"][[0, -1]], [START[0], TARGET[0]], atol=1e-9)
    _, tip = TwoLinkArm(payload=1.0).places(np.array(TARGET))
    np.testing.assert_allclose([family.nominal[name][-1] for name in ("tip_x", "tip_y")], tip, atol=1e-9)
    moments = plan.moments["q1_torque(t)"]
    torques = family.systems["q1_torque"]
    # The torque is affine in the payload, so that the nominal one is its mean.
    np.testing.assert_allclose(family.nominal["q1_torque"], moments.mean, atol=1e-9)
    error = np.abs(torques.mean(axis=0) - moments.mean)
    assert np.all(error <= 4.5 * moments.std / np.sqrt(len(torques)) + 1e-9)
    np.testing.assert_allclose(torques.std(axis=0), moments.std, rtol=0.15, atol=1e-9)


@pytest.mark.slow
def test_a_finer_flight_passes_through_the_same_instants(study):
    plan = study.done.plans[ONE]
    coarse, fine = (fly(plan.problem, plan.vector, 20, seed=5, finer=finer) for finer in (1, 3))
    np.testing.assert_allclose(fine.times[::3], coarse.times, rtol=1e-12)
    np.testing.assert_allclose(fine.systems["q2_torque"][:, ::3], coarse.systems["q2_torque"], atol=1e-9)


@pytest.mark.slow
def test_extremes_of_a_family_are_those_of_a_finer_flight(study):
    plan, family = study.done.plans[ONE], study.done.families[ONE]
    finer = fly(plan.problem, plan.vector, SMALL.family, seed=2, finer=10)
    for name in ("q2_torque", "gap_2"):
        rows = finer.systems[name]
        np.testing.assert_allclose(family.extremes[name], np.stack([rows.min(axis=1), rows.max(axis=1)], axis=1))
        np.testing.assert_allclose(family.extremes[name], finer.extremes[name])
        assert np.all(family.extremes[name][:, 0] <= family.systems[name].min(axis=1) + 1e-12)
    assert np.any(family.extremes["q2_torque"][:, 1] > family.systems["q2_torque"].max(axis=1) + 1e-6)


def test_the_variance_of_the_tip_is_told_with_the_error_of_its_sample():
    # Of n normal numbers the variance has the standard error s² sqrt(2 / n); so has the norm of two of equal size.
    count, spread = 20_000, 0.3
    ends = np.random.default_rng(4).normal(0.0, spread, (2, count, 1))
    family = Family(np.zeros(1), {}, dict(zip(("tip_x", "tip_y"), ends, strict=True)), {})
    value, error = (float(part) for part in terminal_norm(family).split(" ± "))
    assert error == pytest.approx(spread**2 * np.sqrt(2 / count), rel=0.35)
    assert abs(value - np.sqrt(2) * spread**2) < 4 * error


@pytest.mark.slow
def test_the_page_shows_the_figures_of_the_chapter_and_the_numbers(study):
    html = page_html(study.page())
    for figure in ("Figure 5.5", "Figure 5.6", "Figure 5.7"):
        assert figure in html
    assert "Not reached" not in html
    assert html.count('"frames":[') == 2
    assert "1.4142" in html  # the reference
    assert "42.3" in html  # outside μ ± σ
    assert "What a margin costs" in html


@pytest.mark.slow
def test_the_study_writes_its_files_and_tables(study, tmp_path):
    written = [*study.save(tmp_path), study.write_page(tmp_path)]
    assert {one.name for one in written} == {"results.nc", "designs.json", "report.html"}
    saved = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert saved[f"plans/{ONE}"]["objective"]["value"] == study.done.plans[ONE].objective
    assert [table.caption for table in study.tables()] == [
        "Plans, limits and violations",
        "Published and reference values compared with ours",
        "Local optima of the searches",
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "figures", "verdict"),
    [
        ("pick-and-place-effort", ("5.2", "5.3"), "Build: "),
        # Its calibration takes minutes, and is left out.
        ("swing-up", ("5.10", "5.11", "5.13", "5.14"), "Not calibrated: No design to build yet"),
    ],
)
def test_the_quick_run_writes_a_report_and_says_what_it_leaves_out(name, figures, verdict, tmp_path):
    result = CliRunner().invoke(cli.application, ["run", name, "--quick", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    told = " ".join(result.output.split())
    assert verdict in told
    assert "This was a quick run, without" in told
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert all(f"Figure {number}" in page for number in figures)
    assert "Not reached" not in page
    saved = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert {one["status"] for one in saved.values()} == {al.Status.SOLVED.value}
