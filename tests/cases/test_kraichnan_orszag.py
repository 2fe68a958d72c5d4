"""The three modes of Kraichnan and Orszag: an uncertain initial state on both sides of a separatrix, for long.

Wan and Karniadakis, Journal of Computational Physics 209 (2005) 617. Moments by composite Gauss rules in the logarithm
of the initial state, 720 points, DOP853 at 1e-10.
"""

import numpy as np
import pytest

import aleator as al

pytestmark = pytest.mark.slow

GRID = al.Grid(30.0, 600)
AT = np.array([100, 200, 400, 600])  # 5, 10, 20 and 30
MEANS = {"y1": (0.074792, 0.458451, 0.26307, 0.3801), "y3": (0.289829, -0.377878, -0.03704, 0.1303)}
VARIANCES = {
    "y1": (0.002979, 0.084779, 0.07705, 0.1191),
    "y2": (0.572185, 0.065730, 0.3177, 0.203),
    "y3": (0.338575, 0.499854, 0.5380, 0.5196),
}


class Modes(al.System):
    states = ("y1", "y2", "y3")
    start: al.Number

    def initial(self):
        return {"y1": 1.0, "y2": self.start}

    def rhs(self, t, z):
        return z.y1 * z.y3, -z.y2 * z.y3, -(z.y1**2) + z.y2**2

    def outputs(self, t, z):
        return z._asdict()


def modes(at, instants):
    return {name: values[instants] for name, values in al.simulate(Modes(at["y2"]), GRID).items()}


START = {"y2": al.Uniform(0.0, half_width=0.1)}


def test_elements_follow_three_modes_for_long():
    expanded = al.expand(lambda at: modes(at, AT), START, al.MultiElement(order=4, error=1e-3))
    for name, variances in VARIANCES.items():
        assert expanded[name].std ** 2 == pytest.approx(variances, abs=1e-3)
    for name, means in MEANS.items():
        assert expanded[name].mean == pytest.approx(means, abs=1e-3)
