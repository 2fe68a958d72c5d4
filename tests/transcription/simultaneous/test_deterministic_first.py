"""Robust problems started from the answer to their deterministic ones, by either transcription."""

import numpy as np
import pytest
from test_direct_collocation import move
from test_guesses import swing_up

import aleator as al

DIRECT = al.Simultaneous(al.schemes.HermiteSimpson())


def robust_swing_up() -> al.Problem:
    torque = {"torque": al.BSpline(al.Decision(np.zeros(30), -8.0, 8.0), degree=3)}
    length = al.Uniform(1.0, half_width=0.01)
    return swing_up(60, length, inputs=torque, expansion=al.Expansion(order=2))


def solved(problem: al.Problem, way: al.Simultaneous | al.Sequential, **options) -> al.Solution:
    return al.solve(problem, transcription=way, between=1, accuracy=0.3, throw=False, **options)


@pytest.mark.slow
@pytest.mark.parametrize("way", [DIRECT, al.Sequential()], ids=["direct collocation", "shooting"])
def test_a_swing_up_of_many_pendulums_takes_a_few_iterations_from_that_of_one(way):
    one = solved(robust_swing_up(), way, deterministic_first=True)
    scratch = solved(robust_swing_up(), al.Sequential())
    from_scratch = scratch if isinstance(way, al.Sequential) else solved(robust_swing_up(), way)
    assert one.ok
    assert one.objective == pytest.approx(scratch.objective, rel=1e-3)
    before = one.effort.at_means
    assert before is not None
    assert before.starts
    assert before.status is al.Status.SOLVED
    assert 3 * one.effort.iterations < from_scratch.effort.iterations
    assert f"after {before.iterations} iterations" in str(one)
    assert from_scratch.effort.at_means is None


@pytest.mark.slow
@pytest.mark.parametrize("way", [DIRECT, al.Sequential()], ids=["direct collocation", "shooting"])
def test_a_deterministic_problem_without_an_answer_starts_nothing_and_says_so(way):
    """No spread is as large as is asked where nothing is uncertain."""
    limits = [al.terminal("x").mean.equals(1.0), al.terminal("v").mean.equals(0.0), al.terminal("x").std >= 0.1]
    problem = move(gain=al.Uniform(2.0, half_width=0.6), subject_to=limits)
    found = solved(problem, way, deterministic_first=True)
    assert found.objective == pytest.approx(12.0 / 2.0**2, rel=1e-4)
    before = found.effort.at_means
    assert before is not None
    assert not before.starts
    assert "started nothing" in str(found)


def test_a_problem_without_distributions_is_solved_once():
    found = solved(move(), DIRECT, deterministic_first=True)
    assert found.ok
    assert found.effort.at_means is None


def test_one_start_is_given_at_most():
    known = solved(move(), DIRECT)
    with pytest.raises(al.ProblemError, match="either `warm_start` or `deterministic_first`"):
        solved(move(), DIRECT, warm_start=known, deterministic_first=True)
    with pytest.raises(al.ProblemError, match="expected True or False as `deterministic_first`"):
        solved(move(), DIRECT, deterministic_first="yes")
