"""Guesses of states: where simultaneous programs start whose simulation at the initial decisions is useless."""

import numpy as np
import pytest
import xarray
from collocated_problems import Swing, states_at_start

import aleator as al
from zoo import LOSS, ONE_STEP, RESPONSE, SPREAD, gain_problem

DURATION = 3.0


def turning(t: float) -> dict[str, float]:
    """Half a turn at a constant rate."""
    return {"angle": np.pi * t / DURATION, "rate": np.pi / DURATION}


TIMES = np.array([0.0, 0.4 * DURATION, DURATION])
COLUMNS = {"angle": np.pi * TIMES / DURATION, "rate": np.full(3, np.pi / DURATION)}
TABLES = {
    "a dict": {"time": TIMES, **COLUMNS},
    "an xarray.Dataset": xarray.Dataset({name: ("time", one) for name, one in COLUMNS.items()}, {"time": TIMES}),
    "a NumPy array": np.array(
        list(zip(TIMES, *COLUMNS.values(), strict=True)), [("time", float), ("angle", float), ("rate", float)]
    ),
    "a function that returns the states in order": lambda t: tuple(turning(t).values()),
}


@pytest.mark.parametrize("name", TABLES)
def test_a_table_starts_where_a_function_does(name):
    problem = al.Problem(
        Swing(al.Uniform(1.0, half_width=0.1)),
        grid=al.Grid(DURATION, 10),
        inputs={"torque": al.BSpline(al.Decision(np.zeros(30), -5.0, 5.0), degree=3)},
        minimize=al.integral("effort").mean,
        expansion=al.Expansion(order=1),
    )
    states, times = states_at_start(problem, TABLES[name])
    expected = np.stack([np.pi * times / DURATION, np.full(len(times), np.pi / DURATION)], axis=1)
    np.testing.assert_allclose(states, np.broadcast_to(expected, states.shape), rtol=1e-14, atol=1e-14)


# --- Robust problems started from the answer to their deterministic ones ---------------------------------------------


def test_an_answer_at_the_means_starts_the_robust_problem_unless_there_is_none():
    """No spread is as large as is asked where nothing is uncertain."""
    limits = [RESPONSE.at_most(2.0, sigmas=1.0), (RESPONSE.std >= 0.1).named("spread")]
    spread = al.Problem(gain_problem().system, grid=ONE_STEP, minimize=LOSS.mean, subject_to=limits)
    for problem, starts in ((gain_problem(), True), (spread, False)):
        found = al.solve(problem, deterministic_first=True)
        assert found.ok
        assert found.effort.at_means is starts
        assert ("without an answer at the means" in str(found)) is not starts
    assert found.decisions["gain"] == pytest.approx(2.0 / (1 + SPREAD), rel=1e-6)


def test_a_problem_without_distributions_is_solved_once_and_one_start_is_given_at_most():
    found = al.solve(gain_problem(theta=1.0), deterministic_first=True)
    assert found.ok
    assert found.effort.at_means is None
    with pytest.raises(al.ProblemError, match="either `warm_start` or `deterministic_first`"):
        al.solve(gain_problem(theta=1.0), warm_start=found, deterministic_first=True)
