"""A block with dry friction that stops and stays, at an uncertain coefficient, and its fastest way out and back.

The ways are closed forms: `v² / (2 mu g)` to rest, and halves of constant acceleration. After opty's gallery.
"""

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
def test_the_block_stops_and_stays():
    def end(at):
        return al.simulate(Block(mu=at["mu"]), al.Grid(1.0, 2000))["x"][-1]

    found = al.expand(end, {"mu": al.Uniform.bounds(0.4, 0.8)}, al.Expansion(order=6))
    # Of v² / (2 mu g) over all mu.
    way = SPEED**2 / (2 * G)
    mean = way * np.log(2) / 0.4
    assert found.mean == pytest.approx(mean, abs=1e-3)
    assert found.std == pytest.approx(np.sqrt(way**2 / (0.4 * 0.8) - mean**2), abs=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.4, 0.6, 0.8])
def test_a_block_at_rest_does_not_creep(mu):
    found = al.simulate(Block(mu=mu), al.Grid(1.0, 2000))
    stopped = found["x"][1600:]  # since 0.8 s
    assert np.max(np.abs(stopped - SPEED**2 / (2 * mu * G))) < 1e-3
    assert np.max(np.abs(found["v"][1600:])) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("limit", [10.0, 400.0])
def test_the_fastest_way_out_and_back(limit):
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
