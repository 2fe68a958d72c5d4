"""The studies of motion planning: their optima against other programs and quadratures, and the runs of users. Slow."""

import json
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.reporting import page_html
from aleator.studies import Draft, load, swing_up
from aleator.studies._shared import TARGET as TOLERATED
from aleator.studies.pick_and_place_effort._chapter import ROBUST
from aleator.studies.pick_and_place_time._chapter import MEAN, ONE, REFERENCE, WORST
from aleator.studies.swing_up._chapter import EXPECTED
from aleator.uncertainty import realise
from six_axis_arm import robust_problem as six_axis_problem

pytestmark = pytest.mark.slow

TORQUES, GAPS = ("q1_torque", "q2_torque"), ("gap_1", "gap_2", "elbow_x", "tip_x")


def moments(solution, names, finer=10):
    """Mean and standard deviation of outputs over a uniform distribution, by Gauss-Legendre nodes on a finer grid."""
    problem = al.uncertain(solution.problem)
    problem = problem.on_grid(problem.grid.finer(finer))
    nodes, weights = np.polynomial.legendre.leggauss(9)

    @jax.jit
    def histories(germ):
        realised = realise(problem.simulation, germ, jnp.asarray(solution.vector))
        return al.simulate(realised.system, realised.grid, realised.inputs, only=names)

    found = [histories(jnp.array([node])) for node in nodes]
    rows = {name: np.array([one[name] for one in found]) for name in names}
    means = {name: weights / 2 @ one for name, one in rows.items()}
    return means, {name: np.sqrt(weights / 2 @ (one - means[name]) ** 2) for name, one in rows.items()}


@cache
def quick(name):
    """The page of a quick run."""
    draft = Draft(load(name, quick=True))
    draft.fill()
    return draft


# --- Optima ----------------------------------------------------------------------------------------------------------


def test_the_plan_of_least_effort_is_as_good_as_the_reference_and_keeps_its_distances():
    solution = quick("pick-and-place-effort").kept["plans"][ROBUST]
    assert solution.objective <= 112.125
    means, stds = moments(solution, (*GAPS, "q1", "q2", "q1_rate", "q2_rate"))
    # Ten times as many steps also integrate better than the plan's did: by some 1e-4 rad at the end.
    assert min(np.min(means[name] - stds[name]) for name in GAPS) >= -3e-4
    # The expansion's means of the ends are those of the model to a five-hundredth of their spreads.
    for name, target in (("q1", -np.pi / 6), ("q2", -np.pi / 6), ("q1_rate", 0.0), ("q2_rate", 0.0)):
        assert abs(means[name][-1] - target) <= stds[name][-1] / 500, name


def test_the_robust_swing_up_is_as_good_as_the_reference_and_holds_with_four_times_as_many_steps():
    solution = quick("swing-up").kept["plans"][EXPECTED]
    # Not rounded off, its energy is that of the same plan to the rounding: 0.01 W over its duration.
    assert solution.objective + swing_up.SMOOTHING * float(solution.decisions["t_final"]) <= 30.6
    means, stds = moments(solution, ("q1_torque", "q2", "q2_rate", "tip_x", "tip_y"), finer=4)
    assert np.max(np.abs(means["q1_torque"]) + stds["q1_torque"]) <= 10.001
    assert np.hypot(*(stds[name][-1] ** 2 for name in ("tip_x", "tip_y"))) <= 0.01 * 1.001
    np.testing.assert_allclose([means["q2"][-1], means["q2_rate"][-1]], 0.0, atol=5e-3)


def test_the_six_axis_arm_is_as_fast_as_an_independent_program_finds():
    problem, reference = six_axis_problem(1.0), 0.7866628406  # CasADi and IPOPT, `benchmarks/casadi_motion.py`
    assert al.solve(problem, between=1).objective == pytest.approx(reference, rel=1e-6)
    # Limits that hold between the instants too cost a little.
    assert reference < al.solve(problem).objective < 1.001 * reference


# --- Chapter and page ------------------------------------------------------------------------------------------------


@pytest.fixture
def page():
    return quick("pick-and-place-time")


def test_the_plans_are_as_fast_as_those_of_an_independent_program_and_break_limits_as_often_as_expected(page):
    for name, reference in REFERENCE.items():
        plan = page.kept["plans"][name]
        coarse = al.solve(plan.problem, start=plan.decisions, between=1)
        assert coarse.objective == pytest.approx(reference, abs=1e-4)
        # Limits that hold between the instants too cost a little.
        assert reference < plan.objective < 1.002 * reference
    for name, expected in ((MEAN, 1.0), (ONE, 1 - 1 / np.sqrt(3)), (WORST, 0.0)):
        share = page.kept["evidence"][name].violations["torque"]
        assert share.estimate == pytest.approx(expected, abs=4.5 * np.sqrt(0.25 / share.samples))
    # They are counted between the instants.
    assert {one.instants for one in page.kept["evidence"].values()} == {1171}
    # A uniform distribution leaves 1 - a/√3 outside μ ± aσ, which lies below the target by the error of a count.
    margin = page.kept["calibration"]
    error = 4.5 * np.sqrt(TOLERATED / margin.chosen.violation.samples)
    assert TOLERATED - error < 1 - margin.sigmas / np.sqrt(3) < TOLERATED
    assert margin.confirmed
    assert page.kept["plans"]["calibrated"] is margin.solution


def test_the_design_to_build_holds_at_both_ends_of_the_distribution_and_its_price_is_told(page):
    plan, printed = page.kept["plans"][WORST], page.kept["plans"][ONE]
    # Torques are straight lines in the payload, so that the ends of its distribution are their worst case.
    for end in (-1.0, 1.0):
        realised = realise(plan.problem.simulation, jnp.array([end]), jnp.asarray(plan.vector))
        torques = al.simulate(realised.system, realised.grid.finer(13), realised.inputs, only=TORQUES)
        assert max(np.max(np.abs(rows)) for rows in torques.values()) <= 10 * (1 + 2e-6)
    said = page.page().verdict
    assert (said.level, said.word) == ("good", "Build")
    assert f"Duration is {100 * (plan.objective / printed.objective - 1):.2g}\u202f% longer" in said.headline
    assert page.kept["evidence"][WORST].joint.upper <= TOLERATED


def test_the_page_shows_the_figures_of_the_chapter_and_the_numbers(page, tmp_path):
    html = page_html(page.page())
    assert all(f"Figure {number}" in html for number in ("5.5", "5.6", "5.7"))
    assert html.count('"frames":[') == 2
    assert page.kept["calibration"].sentence("payloads") in html
    page.save(tmp_path)
    saved = json.loads((tmp_path / "designs.json").read_text(encoding="utf-8"))
    assert saved[f"plans/{ONE}"]["objective"]["value"] == page.kept["plans"][ONE].objective
