"""Torques of motions of degree 2 jump at their knots: limits are judged on both sides, and such plans are found."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.transcription._jumps import jumps


class Swing(al.Lagrangian):
    """A pendulum under a torque: the torque rises and falls within each piece of its motion."""

    names = ("q",)
    mass: Any

    def kinetic_energy(self, q, v):
        return 0.5 * self.mass * v[0] ** 2

    def potential_energy(self, q):
        return -4.0 * self.mass * jnp.cos(q[0])


def fastest(steps, free=2):
    ends = {"start": (0.0, 0.0), "end": (2.0, 0.0)}
    points = al.fit_control_points(np.linspace(0.0, 2.0, 200), free, degree=2, **ends)
    motion = al.BSpline(al.Decision(points, -2.0, 4.0), degree=2, **ends)
    return al.Problem(
        al.InverseDynamics(Swing(al.Uniform(1.0, half_width=0.1)), motion={"q": motion}),
        grid=al.Grid(al.Decision(3.0, 0.2, 9.0), steps),
        minimize=al.objectives.final_time(),
        subject_to=al.path("q_torque").within(-10.0, 10.0, sigmas=1.0),
        expansion=al.Expansion(order=1),
    )


def highest(solution):
    """The largest mean torque with a standard deviation beside it, on both sides of every knot: from the equations."""
    points = np.concatenate([[0.0, 0.0], np.ravel(solution.decisions["motion.q.free"]), [2.0, 2.0]])
    duration = solution.decisions["t_final"]
    inner = np.linspace(0.0, 1.0, len(points) - 1)
    from scipy.interpolate import BSpline

    curve = BSpline(np.concatenate([[0.0, 0.0], inner, [1.0, 1.0]]), points, 2)
    sides = np.concatenate([inner[1:] - 1e-9, inner[:-1] + 1e-9, np.linspace(1e-9, 1 - 1e-9, 20_001)])
    torque = curve.derivative(2)(sides) / duration**2 + 4.0 * np.sin(curve(sides))
    return float(np.max(np.abs(torque) * (1 + 0.1 / np.sqrt(3))))


@pytest.mark.parametrize("steps", [60, 61])
def test_a_plan_whose_torque_jumps_is_found_and_holds_on_both_sides_of_the_jump(steps):
    """Whether the knots fall on instants of the grid (60 steps) or between them (61)."""
    solution = al.solve(fastest(steps))
    assert solution.ok
    assert highest(solution) == pytest.approx(10.0, rel=1e-4)


def test_multistart_solves_plans_that_jump():
    starts = al.multistart(fastest(60), starts=2, seed=1, spread=0.05)
    assert all(one.ok for one in starts.solutions)


def test_the_sides_of_a_jump_are_continued_to_it():
    fine = np.arange(21.0)
    values = np.where(fine < 7.3, 2.0 + 0.1 * fine, -1.0 + 0.2 * fine)[:, None]
    (jump,) = jumps(values, np.array([7.3 / 20]))
    assert jump.place == pytest.approx(7.3)
    assert jump.before == pytest.approx([2.73])
    assert jump.after == pytest.approx([0.46])
    assert jumps(np.sin(fine / 5)[:, None], np.array([0.3, 0.7])) == []
