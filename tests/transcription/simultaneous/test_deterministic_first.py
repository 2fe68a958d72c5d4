"""Robust problems started from the answer to their deterministic ones, by either transcription."""

import numpy as np
import pytest
from test_guesses import swing_up

import aleator as al
from zoo import LOSS, ONE_STEP, RESPONSE, SPREAD, gain_problem

DIRECT = al.Simultaneous(al.schemes.HermiteSimpson())


def family() -> al.Problem:
    torque = {"torque": al.BSpline(al.Decision(np.zeros(30), -8.0, 8.0), degree=3)}
    return swing_up(60, al.Uniform(1.0, half_width=0.01), inputs=torque, expansion=al.Expansion(order=2))


def solved(problem: al.Problem, way: al.Simultaneous | al.Sequential = DIRECT, **options) -> al.Solution:
    return al.solve(problem, transcription=way, between=1, accuracy=0.3, throw=False, **options)


@pytest.mark.slow
@pytest.mark.parametrize("way", [DIRECT, al.Sequential()], ids=["direct collocation", "shooting"])
def test_a_family_of_pendulums_takes_a_few_iterations_from_the_answer_of_one(way):
    from_one, from_scratch = (solved(family(), way, deterministic_first=first) for first in (True, False))
    assert from_one.ok
    assert from_one.objective == pytest.approx(from_scratch.objective, rel=1e-3)
    before = from_one.effort.at_means
    assert before is not None
    assert before.starts
    assert before.status is al.Status.SOLVED
    assert 3 * from_one.effort.iterations < from_scratch.effort.iterations
    assert f"after {before.iterations} iterations" in str(from_one)
    assert from_scratch.effort.at_means is None


def test_an_answer_at_the_means_starts_the_robust_problem_unless_there_is_none():
    """No spread is as large as is asked where nothing is uncertain."""
    limits = [RESPONSE.at_most(2.0, sigmas=1.0), (RESPONSE.std >= 0.1).named("spread")]
    spread = al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits)
    for problem, starts in ((gain_problem(), True), (spread, False)):
        found = al.solve(problem, deterministic_first=True)
        assert found.ok
        before = found.effort.at_means
        assert before is not None
        assert before.starts is starts
        assert ("started nothing" in str(found)) is not starts
    assert found.decisions["gain"] == pytest.approx(2.0 / (1 + SPREAD), rel=1e-6)


def test_a_problem_without_distributions_is_solved_once_and_one_start_is_given_at_most():
    found = al.solve(gain_problem(theta=1.0), deterministic_first=True)
    assert found.ok
    assert found.effort.at_means is None
    with pytest.raises(al.ProblemError, match="either `warm_start` or `deterministic_first`"):
        al.solve(gain_problem(theta=1.0), warm_start=found, deterministic_first=True)
    with pytest.raises(al.ProblemError, match="expected True or False as `deterministic_first`"):
        al.solve(gain_problem(theta=1.0), deterministic_first="yes")
