"""Solvers are told which derivatives are zero wherever the decisions are."""

import numpy as np

from aleator.studies import pick_and_place_time
from aleator.transcription import transcribe
from aleator.transcription.sequential._sparsity import sparsity_of


def test_what_was_felt_at_some_instant_is_counted_wherever_the_decision_is_felt():
    # Three instants, two decisions with local support; the second path felt the first decision only once.
    first = np.array([[True, False], [True, True], [False, True]])
    second = np.array([[False, False], [True, False], [False, False]])
    alone = np.array([[False, False]])
    found = sparsity_of(np.vstack([first, second, alone]), [slice(0, 3), slice(3, 6)], 3)
    np.testing.assert_array_equal(found[:3], first)
    np.testing.assert_array_equal(found[3:6], [[True, False], [True, False], [False, False]])
    assert found[6].all()


def test_no_derivative_of_a_plan_is_outside_the_sparsity():
    problem = pick_and_place_time.robust_problem()
    program = transcribe(problem).program
    assert program.sparsity.mean() < 0.5
    rng, lower, upper = np.random.default_rng(1), program.lower, program.upper
    for _ in range(20):
        x = np.clip(program.start + rng.standard_normal(program.start.shape), lower, upper)
        assert not (program.evaluate(x).jacobian != 0)[~program.sparsity].any()
