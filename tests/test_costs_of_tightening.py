"""Limits that hold between the instants by tightened bounds: what that costs at most, beside SciPy on dense limits."""

import itertools

import jax.numpy as jnp
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


@pytest.mark.parametrize(
    "way",
    [al.Sequential(), pytest.param(al.Simultaneous(), marks=pytest.mark.slow)],
    ids=["shooting", "collocation"],
)
def test_the_best_design_lies_between_the_loose_and_the_tightened_one(way):
    with pytest.warns(al.GridWarning, match="tightened at the instants, which may cost up to .*: use more steps"):
        tightened = al.solve(ride(1.35), transcription=way, refine=False)
    loose = tightened.objective * (1 - tightened.certificate.between.cost)
    best = densely_limited(1.35)
    assert loose <= best * (1 + 1e-6)
    assert best <= tightened.objective * (1 + 1e-6)
    assert al.solve(ride(2.0), transcription=way).certificate.between.cost == 0.0  # they hold by themselves


@pytest.mark.slow
def test_what_costs_nothing_at_the_instants_costs_all_of_the_objective_between_them():
    class Hop(al.System):
        """A height that follows a rate, and an obstacle between two instants."""

        states = ("y",)
        width: al.Number

        def rhs(self, t, z, rate):
            return (rate,)

        def outputs(self, t, z, rate):
            return {"clear": z.y - jnp.exp(-(((t - 0.513) / self.width) ** 2)), "effort": rate**2}

    problem = al.Problem(
        Hop(0.01),
        grid=al.Grid(1.0, 20),
        inputs={"rate": al.Control(0.0, -100.0, 100.0, degree=1)},
        minimize=al.integral("effort").mean,
        subject_to=[al.path("clear").at_least(-0.2)],
    )
    with pytest.warns(al.GridWarning, match="may cost up to 1 of the objective"):
        solution = al.solve(problem, refine=False)
    # No way over the obstacle costs less than a straight line to its top, of a height of 0.8 less what the width saves.
    assert solution.objective > 0.7**2 / 0.513
