"""What a solution tells of a limit over time."""

import numpy as np
import pytest

from aleator.solution import ConstraintResult


@pytest.mark.parametrize(("lower", "upper", "time", "worst"), [(0.0, np.inf, 0.2, 0.5), (-np.inf, 4.0, 0.0, 3.0)])
def test_the_worst_instant_of_a_limit_is_that_of_least_slack_on_its_own_side(lower, upper, time, worst):
    result = ConstraintResult(
        name="limit",
        text="x(t)",
        lower=lower,
        upper=upper,
        values=np.array([3.0, 2.0, 0.5, 1.0]),
        times=np.array([0.0, 0.1, 0.2, 0.3]),
        multipliers=np.zeros(4),
        active=np.zeros(4, dtype=bool),
        scale=1.0,
    )
    assert (result.worst_time, result.worst, result.violation) == (time, worst, 0.0)
