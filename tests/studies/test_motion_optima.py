"""The optima of the motion studies, and their limits on finer grids by another quadrature than the plans used."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.studies import pick_and_place_effort, pick_and_place_time, six_axis_arm, swing_up
from aleator.uncertainty import realise


def moments(solution, names, finer=10):
    """Mean and standard deviation of outputs over a uniform distribution, by Gauss-Legendre nodes on a finer grid."""
    problem = al.uncertain(solution.problem)
    problem = problem.on_grid(problem.grid.finer(finer))
    nodes, weights = np.polynomial.legendre.leggauss(9)

    @jax.jit
    def histories(germ):
        realised = realise(problem.simulation, germ, jnp.asarray(solution.vector))
        system, inputs, grid = realised.system, realised.inputs, realised.grid
        return al.simulate(system, grid, inputs, only=names)

    found = [histories(jnp.array([node])) for node in nodes]
    means = {name: sum(w / 2 * np.asarray(one[name]) for w, one in zip(weights, found, strict=True)) for name in names}
    squares = {
        name: sum(w / 2 * (np.asarray(one[name]) - means[name]) ** 2 for w, one in zip(weights, found, strict=True))
        for name in names
    }
    return means, {name: np.sqrt(square) for name, square in squares.items()}


TORQUES, GAPS = ("q1_torque", "q2_torque"), ("gap_1", "gap_2", "elbow_x", "tip_x")


@pytest.mark.slow
def test_the_fastest_robust_plan_keeps_its_limits_between_the_instants():
    solution = al.solve(pick_and_place_time.robust_problem(1.0))
    means, stds = moments(solution, (*TORQUES, *GAPS))
    assert max(np.max(np.abs(means[name]) + stds[name]) for name in TORQUES) <= 10 * (1 + 2e-6)
    assert min(np.min(means[name]) for name in GAPS) >= -2e-6
    # What holding between instants costs is small.
    assert solution.objective <= 1.5939 * 1.001


@pytest.mark.slow
def test_the_plan_at_the_root_of_three_is_that_of_the_worst_case():
    # Of the model, found by a search over payloads: no standard deviation is in it.
    plan = al.solve(pick_and_place_time.robust_problem(np.sqrt(3.0)), between=1)
    problem = plan.problem
    limits = [al.path(name).within(-10.0, 10.0, worst_case=True) for name in TORQUES]
    worst = al.Problem(
        problem.system,
        grid=problem.grid,
        minimize=al.objectives.final_time(),
        subject_to=[*limits, *(al.path(name).at_least(0.0) for name in ("elbow_x", "tip_x", "gap_1", "gap_2"))],
        expansion=problem.expansion,
    )
    found = al.solve(worst, start=plan.decisions, between=1)
    assert found.objective == pytest.approx(plan.objective, rel=1e-6)


@pytest.mark.slow
def test_the_plan_of_least_effort_is_as_good_as_the_reference_and_keeps_its_distances():
    solution = al.solve(pick_and_place_effort.robust_problem(1.0))
    assert solution.objective <= 112.125
    means, stds = moments(solution, (*GAPS, "q1", "q2", "q1_rate", "q2_rate"))
    # Ten times as many steps also integrate better than the plan's did: by some 1e-4 rad at the end.
    assert min(np.min(means[name] - stds[name]) for name in GAPS) >= -3e-4
    # The expansion's means of the ends are those of the model to a five-hundredth of their spreads.
    for name, target in (("q1", -np.pi / 6), ("q2", -np.pi / 6), ("q1_rate", 0.0), ("q2_rate", 0.0)):
        assert abs(means[name][-1] - target) <= stds[name][-1] / 500, name


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::aleator.GridWarning")
def test_the_other_plans_of_forward_dynamics_are_as_good_as_the_reference(monkeypatch):
    # At the reference's own instants, which are too few for the speeds at the end: a warning says so.
    monkeypatch.setattr(pick_and_place_effort, "STEPS", 60)
    assert al.solve(pick_and_place_effort.deterministic_problem(), between=1).objective <= 106.35
    least = al.solve(pick_and_place_effort.terminal_variance_problem(), between=1)
    assert least.objective <= 0.025335


def swing_up_as_good_as_the_reference(problem, best):
    solution = al.solve(problem)
    # Not rounded off, its energy is that of the same plan to the rounding: 0.01 W over its duration.
    rounding = swing_up.SMOOTHING * float(solution.decisions["t_final"])
    assert solution.objective + rounding <= best
    return solution


@pytest.mark.slow
def test_the_swing_up_is_as_good_as_the_reference():
    rounded = swing_up_as_good_as_the_reference(swing_up.deterministic_problem(), 27.8)
    sharp = swing_up.deterministic_problem(smoothing=0.0)
    assert al.solve(sharp, start=rounded.decisions, between=1, throw=False).objective <= 27.8


@pytest.mark.slow
def test_the_robust_swing_up_is_as_good_as_the_reference_and_holds_with_four_times_as_many_steps():
    solution = swing_up_as_good_as_the_reference(swing_up.robust_problem(1.0), 30.6)
    means, stds = moments(solution, ("q1_torque", "q2", "q2_rate", "tip_x", "tip_y"), finer=4)
    assert np.max(np.abs(means["q1_torque"]) + stds["q1_torque"]) <= 10.001
    assert np.hypot(*(stds[name][-1] ** 2 for name in ("tip_x", "tip_y"))) <= 0.01 * 1.001
    np.testing.assert_allclose([means["q2"][-1], means["q2_rate"][-1]], 0.0, atol=5e-3)


@pytest.mark.slow
def test_the_six_axis_arm_is_as_fast_as_an_independent_program_finds():
    solution = al.solve(six_axis_arm.robust_problem(1.0), between=1)
    # CasADi and IPOPT, `benchmarks/casadi_motion.py`.
    assert solution.objective == pytest.approx(0.7866628406, rel=1e-6)


@pytest.mark.slow
def test_the_six_axis_arm_with_its_mean_payload_is_faster_and_keeps_its_limits_between_instants():
    solution = al.solve(six_axis_arm.deterministic_problem())
    # The best of searches from many starts; for all payloads it takes 0.7871 s.
    assert solution.objective == pytest.approx(0.78213, abs=1e-4)
    assert solution.certificate.between.holds
