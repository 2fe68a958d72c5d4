"""Feedback around a decided plan, against NumPy and SciPy."""

import re
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
import zoo
from aleator.feedback import AbstractController
from zoo import histories

STEPS = 20
GAINS = al.Decision([10.0, 5.0], 0.0, 200.0)


class Cart(al.System):
    """A cart with quadratic drag and an uncertain mass."""

    states = ("x", "v")
    m: al.Number

    def rhs(self, t, z, u):
        return z.v, (u - z.v * jnp.abs(z.v) / 2) / self.m

    def outputs(self, t, z, u):
        return {"x": z.x, "v": z.v, "effort": u**2}


@cache
def steered(**way: Any) -> al.Solution:
    """From rest to rest over 1 m in 1 s, with least effort."""
    return al.solve(plan(0.005, feedback=al.Feedback(gains=GAINS, of=("x", "v"))), **way)


def plan(spread, **options: Any) -> al.Problem:
    return al.Problem(
        Cart(m=al.Uniform(1.0, half_width=0.2)),
        grid=al.Grid(1.0, STEPS),
        inputs={"u": al.Control(lambda s: 6 - 12 * s, -50, 50, degree=1)},
        minimize=al.integral("effort").mean,
        subject_to=[
            al.terminal("x").mean.equals(1.0),
            al.terminal("v").mean.equals(0.0),
            al.terminal("x").std <= spread,
        ],
        expansion=al.Expansion(order=5),
        **options,
    )


def by_numpy(u, gains):
    """The means of `x`, `v` and of the effort, and the spread of `x`, at the end: Runge's method at Gauss's points."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    m, (k, d) = 1 + 0.2 * nodes[:, None], gains

    def rates(t, y):
        planned = np.interp(t, np.linspace(0, 1, STEPS + 1), u)
        command = planned + k * (y[:, 2:3] - y[:, :1]) + d * (y[:, 3:4] - y[:, 1:2])
        v, v_plan = y[:, 1:2], y[:, 3:4]
        after = (command - v * abs(v) / 2) / m, planned - v_plan * abs(v_plan) / 2
        return np.hstack([v, after[0], v_plan, after[1], command**2])

    y, h = np.zeros((len(nodes), 5)), 0.1 / STEPS
    for i in range(10 * STEPS):
        a = rates(i * h, y)
        b = rates((i + 0.5) * h, y + h / 2 * a)
        c = rates((i + 0.5) * h, y + h / 2 * b)
        y = y + h / 6 * (a + 2 * b + 2 * c + rates((i + 1) * h, y + h * c))
    mean = weights @ y / 2
    return mean[0], mean[1], mean[4], np.sqrt(weights @ (y[:, 0] - mean[0]) ** 2 / 2)


@pytest.mark.slow
def test_decided_gains_hold_the_spread_of_a_cart_as_by_numpy():
    decided = steered().decisions
    x, v, effort, spread = by_numpy(decided["inputs.u"], decided["feedback.gains"])
    assert (x, v, spread) == pytest.approx((1.0, 0.0, 0.005), abs=5e-6)
    assert steered().objective == pytest.approx(effort, rel=1e-6)


@pytest.mark.slow
def test_collocation_decides_the_same_plan_and_gains():
    shot, collocated = steered(), steered(transcription=al.Simultaneous(al.schemes.GaussLegendre(3)))
    assert collocated.ok
    # Runge's method errs by 2.4e-6 m at the end, and a metre costs 2 * 12.3: the effort grows as its square.
    assert collocated.objective == pytest.approx(shot.objective, abs=2.4e-6 * 24.6)
    for name, values in shot.decisions.items():
        assert collocated.decisions[name] == pytest.approx(values, abs=1e-3)


def test_the_answer_is_certified_and_its_motions_have_the_plan():
    assert steered().ok
    states, outputs = steered().states, steered().outputs
    assert set(states) == {"x", "v", "x_plan", "v_plan"}
    assert {"u.command", "u.applied", "x.error", "v.error"} <= set(outputs)


def test_limits_are_those_of_actuators_and_a_law_of_ones_own_is_a_law():
    class Own(AbstractController):
        k: al.Number

        def command(self, t, measured, plan):
            return {"u": plan.inputs["u"] + self.k * (plan.states.x - measured.x)}

    class Jerky(Cart):
        def initial(self):
            return {"x": self.m - 1.0}

    def commanded(gains):
        problem = al.Problem(
            Jerky(m=al.Uniform(1.0, half_width=0.2)),
            grid=al.Grid(1.0, STEPS),
            inputs={"u": al.BSpline(al.Decision(np.zeros(4), -1, 1))},
            feedback=al.Feedback(gains=gains, of="x", limits=(-1.0, 1.0)),
            minimize=al.terminal("x").mean,
        )
        return histories(problem, [[-0.9], [0.6]])

    own, numbers = commanded(Own(k=50.0)), commanded([50.0])
    command, applied = (np.asarray(own[f"u.{name}"]) for name in ("command", "applied"))
    assert abs(command).max() > 2.0
    np.testing.assert_allclose(applied, np.clip(command, -1.0, 1.0), atol=1e-12)
    np.testing.assert_allclose(numbers["u.command"], command, atol=1e-10)


@pytest.mark.parametrize(
    ("upper", "said"),
    zoo.cases([(-20.0, r"errors grow by .* with all 12 values of feedback\.gains .* their bounds: widen"), (20.0, "")]),
    ids=["every gain", "some gains"],
)
@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")  # of a design that is none
def test_a_search_that_fails_says_that_all_gains_within_their_bounds_destabilise(upper, said):
    gains = al.Decision(np.full(2, -60.0), -60.0, upper)
    declared = plan(0.005, feedback=al.Feedback(gains=gains, of=("x", "v")))
    problem = al.Problem(
        Cart(m=1.0),
        grid=declared.grid,
        inputs={"u": al.Control(0.0, -50, 50, degree=1)},
        minimize=declared.objective,
        subject_to=declared.constraints,
        feedback=al.Feedback(gains=gains, of=("x", "v")),
    )
    failed = al.solve(problem, al.solvers.FilterSQP(max_iterations=2), throw=False)
    assert not failed.ok
    assert re.search(said, failed.why())
    assert ("destabilise" in failed.why()) == bool(said)
