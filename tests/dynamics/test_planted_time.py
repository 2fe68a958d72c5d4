"""Equations that contain the time see that of each stage of a step."""

import numpy as np

import aleator as al


class Clock(al.System):
    """A cubic rate of the time alone, which rules of the fourth order integrate without error."""

    states = ("x",)

    def rhs(self, t, z):
        return (4.0 * t**3,)

    def outputs(self, t, z):
        return {"x": z.x}


def test_a_cubic_rate_is_integrated_exactly_by_three_steps():
    grid = al.Grid(2.0, 3, t_start=0.5)
    times = np.linspace(0.5, 2.0, 4)
    np.testing.assert_allclose(al.simulate(Clock(), grid)["x"], times**4 - 0.5**4, rtol=1e-13)
