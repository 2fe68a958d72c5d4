"""Limits that hold between the instants by tightened bounds: what that costs at most, beside SciPy on dense limits."""

import itertools

import numpy as np
import pytest
from scipy.optimize import minimize

import aleator as al
from zoo import block_problem


def ride(fastest, steps=3):
    """One metre in one second from rest to rest, no faster than `fastest`, at least effort, by a force that is linear.

    Runge-Kutta and Simpson's rule integrate that exactly.
    """
    x, v = al.terminal("x"), al.terminal("v")
    limits = [x.mean.equals(1.0), v.mean.equals(0.0), (al.path("v").mean <= fastest).named("speed")]
    return block_problem(steps=steps, inputs={"force": al.Control(0.0, -50.0, 50.0, degree=1)}, subject_to=limits)


def densely_limited(fastest, steps=3):
    """The least effort with the speed limited at 20 places of each step, by SciPy."""
    h, places = 1.0 / steps, np.linspace(0.0, 1.0, 21)[1:] / steps

    def rolled(push):
        x = v = effort = 0.0
        speeds = []
        for a, b in itertools.pairwise(push):
            speeds += list(v + a * places + (b - a) * places**2 / (2 * h))
            effort += h * (a * a + a * b + b * b) / 3
            x, v = x + h * v + h * h * (a / 3 + b / 6), v + h * (a + b) / 2
        return effort, x, v, np.array(speeds)

    limits = [
        {"type": "eq", "fun": lambda push: [rolled(push)[1] - 1, rolled(push)[2]]},
        {"type": "ineq", "fun": lambda push: fastest - rolled(push)[3]},
    ]
    options = {"maxiter": 500, "ftol": 1e-12}
    start = np.linspace(6.0, -6.0, steps + 1)
    found = minimize(lambda push: rolled(push)[0], start, method="SLSQP", constraints=limits, options=options)
    assert found.success
    return found.fun


def test_the_best_design_lies_between_the_loose_and_the_tightened_one():
    with pytest.warns(al.GridWarning, match="tightened at the instants, which may cost up to .*: use more steps"):
        tightened = al.solve(ride(1.35), refine=False)
    loose = tightened.objective * (1 - tightened.certificate.between.cost)
    best = densely_limited(1.35)
    assert loose <= best * (1 + 1e-6)
    assert best <= tightened.objective * (1 + 1e-6)
    assert al.solve(ride(2.0)).certificate.between.cost == 0.0  # they hold by themselves
