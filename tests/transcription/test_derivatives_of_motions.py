"""Derivatives of motion plans agree with finite differences, also where they are taken instant by instant."""

import numpy as np
import pytest

import aleator as al
from aleator.studies import pick_and_place_effort, pick_and_place_time, swing_up
from aleator.studies.two_link_arm import START, TARGET, TwoLinkArm
from aleator.transcription import transcribe
from aleator.transcription.sequential._instantaneous import instantaneous

REST = {"start": (START, 0.0), "end": (TARGET, 0.0)}


def codesign():
    """Decisions in the motion, the model, a distribution, the final time, and one shared by motion and model."""
    shared = al.Decision(0.9, 0.5, 1.5).shared("length")
    arm = TwoLinkArm(
        payload=al.Uniform(1.0, half_width=al.Decision(0.2, 0.05, 0.5)),
        length_1=shared,
        length_2=al.Decision(0.8, 0.5, 1.5),
    )
    points = al.fit_control_points(np.linspace(START, TARGET, 30), 4, **REST)
    motion = al.BSpline(al.Decision(points, -3.0, 3.0), start=((shared, 0.3), 0.0), end=REST["end"])
    torque, tip = al.path("q1_torque"), al.path("tip_x")
    return al.Problem(
        al.InverseDynamics(arm, motion=motion),
        grid=al.Grid(al.Decision(1.7, 1.0, 3.0), 12),
        minimize=al.objectives.final_time() + al.objectives.effort("q1_torque", "q2_torque"),
        subject_to=[
            torque.within(-40.0, 40.0, sigmas=1.5),
            al.path("q2_torque").at_most(40.0, worst_case=True),
            (tip.mean - tip.std - al.value("length_2") >= -3.0).named("mixed"),
            al.path("q1_rate").within(-9.0, 9.0),
            (al.time_integral(torque.std) <= 50.0).named("spread"),
        ],
        expansion=al.Expansion(order=2),
    )


def differences(program, x, step=1e-5):
    columns = []
    for i in range(len(x)):
        shift = np.zeros(len(x))
        shift[i] = step
        up, down = program.evaluate(x + shift), program.evaluate(x - shift)
        columns.append(
            (np.append(up.constraints, up.objective) - np.append(down.constraints, down.objective)) / (2 * step)
        )
    return np.stack(columns, axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "problem",
    [
        codesign,
        pick_and_place_time.robust_problem,
        pick_and_place_effort.terminal_variance_problem,
        swing_up.robust_problem,
    ],
    ids=["co-design", "inverse dynamics", "forward dynamics", "hybrid dynamics"],
)
def test_derivatives_agree_with_finite_differences(problem):
    declared = problem()
    program = transcribe(declared).program
    x = declared.placements.vector("initial") + 0.01 * np.sin(np.arange(declared.placements.size))
    found = program.evaluate(x)
    jacobian = np.vstack([found.jacobian, found.gradient])
    np.testing.assert_allclose(jacobian, differences(program, x), rtol=1e-6, atol=1e-6 * np.abs(jacobian).max())


def test_only_statistics_of_paths_alone_are_taken_instant_by_instant():
    declared = codesign()
    which = instantaneous(declared)
    texts = [str(declared.expressions[i]) for i in which]
    assert len(texts) == 5
    assert not any("length_2" in text or "∫" in text for text in texts)


def test_what_is_uncertain_in_the_motion_is_differentiated_as_a_whole():
    arm = TwoLinkArm(payload=1.0)
    motion = al.BSpline(al.Decision(np.zeros((4, 2)), -3.0, 3.0), start=((al.Uniform(0.5, half_width=0.1), 0.3), 0.0))
    problem = al.Problem(
        al.InverseDynamics(arm, motion=motion),
        grid=al.Grid(1.5, 6),
        minimize=al.objectives.effort("q1_torque"),
        subject_to=[al.path("q1_torque").at_most(100.0, sigmas=1.0)],
        expansion=al.Expansion(order=2),
    )
    assert instantaneous(problem) == ()
    program = transcribe(problem).program
    x = problem.placements.vector("initial") + 0.1 * np.sin(np.arange(8))
    found = program.evaluate(x)
    jacobian = np.vstack([found.jacobian, found.gradient])
    np.testing.assert_allclose(jacobian, differences(program, x), rtol=1e-6, atol=1e-6 * np.abs(jacobian).max())
