"""Right-hand sides that switch, over a stated width, against the motions without it."""

import numpy as np
import pytest

import aleator as al
from compiling import compiled

GRAVITY = 9.81


class Block(al.System):
    """A block on a rough floor: mass 1 kg."""

    states = ("x", "v")
    friction: al.Number
    speed: float
    width: float

    def initial(self):
        return {"v": self.speed}

    def rhs(self, t, z, force):
        return z.v, force - self.friction * GRAVITY * al.smooth.sign(z.v, width=self.width)

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v}


def test_a_block_slides_to_rest_and_stays():
    """`x = v0² / (2 mu g)`, for a coefficient between 0.4 and 0.8."""
    grid = al.Grid(1.0, 1000)

    def slid(friction):
        block = Block(friction, speed=3.0, width=1e-2)
        return al.simulate(block, grid, inputs={"force": al.Tabulated([0.0, 1.0], [0.0, 0.0])})

    friction = al.Uniform.bounds(0.4, 0.8)
    expanded = al.expand(lambda at: slid(at["friction"])["x"][-1], {"friction": friction}, al.Expansion(6))
    assert float(expanded.mean) == pytest.approx(0.7948935557, abs=1e-4)
    assert float(expanded.std) == pytest.approx(0.1603331839, abs=1e-4)
    assert abs(np.asarray(slid(0.4)["v"])[-1]) < 1e-6


def test_least_time_over_a_rough_floor_and_what_it_owes_to_the_width():
    """10 m out, which is half of the least time out and back: `2 sqrt(20 (a + b) / (a b))` with `a, b = 400 ± mu g`."""
    problem = al.Problem(
        Block(0.6, speed=0.0, width=0.1),
        grid=al.Grid(al.Decision(0.4, 0.1, 1.0), 60),
        inputs={"force": al.Control(lambda s: 400.0 - 800.0 * s, -400.0, 400.0)},
        minimize=al.objectives.final_time(),
        subject_to=[al.terminal("x").mean.equals(10.0), al.terminal("v").mean.equals(0.0)],
    )
    solution = al.solve(problem)
    assert 2 * solution.objective == pytest.approx(0.6325240163, rel=5e-3)
    smoothing = solution.certificate.smoothing
    assert smoothing is not None
    assert not smoothing.broken
    assert 0 < smoothing.moved["x"] < 1e-2
    assert "at half the widths the objective is" in str(solution.certificate)


def test_switches_are_those_without_width_some_widths_away():
    x = np.linspace(-2.0, 2.0, 81)
    away, far = abs(x) > 0.2, abs(abs(x) - 1.0) > 0.2
    smooth = al.smooth
    found = compiled(
        lambda x: [
            *(switch(x, width=0.01) for switch in (smooth.sign, smooth.step, smooth.positive)),
            smooth.saturated(x, -1.0, 1.0, width=0.01),
            smooth.dead_zone(x, 1.0, width=0.01),
        ]
    )(x)
    sharp = [np.sign(x), x > 0, np.maximum(x, 0), np.clip(x, -1, 1), np.sign(x) * np.maximum(abs(x) - 1.0, 0)]
    for values, expected, where in zip(found, sharp, (away, away, away, far, far), strict=True):
        np.testing.assert_allclose(np.asarray(values)[where], expected[where], atol=1e-12)
    with pytest.raises(al.ProblemError, match="smooth: width"):
        al.smooth.sign(x, width=0.0)
    with pytest.raises(al.ProblemError, match="lower <= upper"):
        al.smooth.saturated(x, 0.5, -0.5, width=0.1)
    with pytest.raises(al.ProblemError, match="half_gap >= 0"):
        al.smooth.dead_zone(x, -0.5, width=0.1)
