"""A block with dry friction that stops and stays, at an uncertain coefficient, and its fastest way out and back.

The ways are closed forms: `v² / (2 mu g)` to rest, and halves of constant acceleration. After opty's gallery.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

G, SPEED = 9.81, 3.0


class Block(al.System):
    states = ("x", "v")

    mu: al.Number
    first: al.Number = SPEED

    def initial(self):
        return {"v": self.first}

    def rhs(self, t, z, force=0.0):
        return z.v, force - self.mu * G * jnp.tanh(z.v / 1e-3)

    def outputs(self, t, z):
        return z._asdict()


@pytest.mark.slow
def test_the_fastest_way_out_and_back():
    limit = 10.0
    # The way back mirrors the way out.
    problem = al.Problem(
        Block(mu=0.6, first=0.0),
        grid=al.Grid(al.Decision(1.0, 0.1, 10.0), 40),
        inputs={"force": al.Control(lambda fraction: limit * (1 - 2 * fraction), -limit, limit)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(10.0), al.terminal("v").mean.equals(0.0)],
    )
    solution = al.solve(problem, transcription=al.Simultaneous(al.schemes.Radau(3), error=1e-4))
    faster, slower = limit + 0.6 * G, limit - 0.6 * G
    assert 2 * solution.objective == pytest.approx(2 * np.sqrt(20 * (faster + slower) / (faster * slower)), rel=5e-3)


class Pulled(al.System):
    states = ("v",)
    algebraic = ("friction",)

    ramp: al.Number
    width: al.Number

    def initial(self):
        return {"v": SPEED}

    def rhs(self, t, z):
        return (self.ramp * t - 0.6 * G * z.friction,)

    def residual(self, t, z):
        return (al.smooth.sign_residual(z.friction, z.v, width=self.width),)

    def algebraic_guess(self, t, z):
        return {"friction": al.smooth.sign(z.v, width=self.width)}

    def outputs(self, t, z):
        return {"v": z.v}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:At half the widths")
def test_a_block_sticks_until_a_growing_force_pulls_it_loose():
    # It stops where 3 - mu g t + k t²/2 = 0, and leaves where k t = mu g.
    slope, end = 4.0, 2.0
    stops = (0.6 * G - np.sqrt((0.6 * G) ** 2 - 2 * slope * SPEED)) / slope
    leaves = 0.6 * G / slope
    solution, errors = None, []
    for width in (1e-3, 1e-4):
        problem = al.Problem(
            Pulled(al.Decision(4.5, 3.5, 5.0), width=width),
            grid=al.Grid(end, 20),
            minimize=al.value("ramp"),
            subject_to=[al.terminal("v").mean >= slope * (end - leaves) ** 2 / 2],
            integrator=al.integrators.Rodas5P(),  # by which the answer is checked
        )
        transcription = al.Simultaneous(al.schemes.Radau(3), error=1e-5)
        solution = al.solve(problem, transcription=transcription, warm_start=solution)
        errors.append(abs(solution.decisions["ramp"] - slope))
        speeds = solution.states["v"]
        is_stuck = (speeds["time"] > stops + 0.05) & (speeds["time"] < leaves - 0.05)
        assert np.max(np.abs(speeds["mean"].values[is_stuck])) < 3 * width
    # In proportion to the width.
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(10, rel=0.3)


class Ramped(al.System):
    """A block that is pulled by a force which grows, in one of three ways: it slides, sticks, or is pulled loose."""

    states = ("v", "clock")
    ramp: al.Number
    friction: float
    moves: float = 1.0
    events: ClassVar = {
        "rest": al.Event(lambda self, t, z: z.v, direction=-1),
        "loose": al.Event(lambda self, t, z: self.ramp * z.clock - self.friction),
        "end": al.Event(lambda self, t, z: z.clock - 2.0),
    }

    def initial(self):
        return {"v": SPEED}

    def rhs(self, t, z):
        return self.moves * (self.ramp * z.clock - self.friction), 1.0

    def outputs(self, t, z):
        return {"v": z.v}


@pytest.mark.slow
def test_phases_that_end_where_it_stops_and_where_it_leaves_are_exact():
    ramp, slope = al.Decision(4.5, 4.0 - 0.4, 5.0).shared("ramp"), 4.0
    grids = {name: al.Grid(until=name, at_most=2.0, steps=4) for name in ("rest", "loose", "end")}
    motion = al.Phases(
        sliding=al.Phase(Ramped(ramp, 0.6 * G), grids["rest"]),
        stuck=al.Phase(Ramped(ramp, 0.6 * G, 0.0), grids["loose"]),
        pulled=al.Phase(Ramped(ramp, 0.6 * G), grids["end"]),
    )
    limit = al.terminal("v").mean >= slope * (2.0 - 0.6 * G / slope) ** 2 / 2
    found = al.solve(al.Problem(motion, minimize=al.value("ramp"), subject_to=[limit]))
    assert found.ok, found
    assert found.objective == pytest.approx(slope, abs=1e-7)
