"""A damped rod as a black box of SciPy, against the same rod as a system of ours: period and last angle."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.special import ellipk

import aleator as al
import black_boxes as boxes

# A uniform rod of 1 kg and 1 m, hinged at its end, with viscous damping of 0.1 N m s/rad.
UNCERTAIN = {
    "mass": al.Normal(1.0, 0.02),
    "length": al.Uniform(1.0, half_width=0.03),
    "damping": al.Uniform(0.1, half_width=0.03),
}
ORDER = al.Expansion(order=3)
GRID = al.Grid(boxes.DURATION, 600)


class Rod(al.System):
    """The rod from its energies: kinetic m l²/6 θ'², potential -m g l/2 cos θ; the hinge brakes by c θ'."""

    states = ("angle", "speed")
    # In the order of a dict's keys, so that both have the same points.
    damping: al.Number
    length: al.Number
    mass: al.Number

    def initial(self):
        return {"angle": boxes.RELEASE}

    def rhs(self, t, z):
        weight = -1.5 * boxes.GRAVITY / self.length * jnp.sin(z.angle)
        return z.speed, weight - 3 * self.damping * z.speed / (self.mass * self.length**2)

    def outputs(self, t, z):
        return {"angle": z.angle, "speed": z.speed}


def period(history):
    """The time between the first passage through the vertical and the third."""
    curve = CubicHermiteSpline(np.linspace(0.0, boxes.DURATION, 601), history["angle"], history["speed"])
    passages = curve.roots(extrapolate=False)
    return passages[2] - passages[0]


def test_the_rod_has_the_period_of_the_pendulum_without_damping():
    # T = 4 sqrt(l_r / g) K(sin²(θ₀/2)) with the reduced length 2 l / 3.
    exact = 4 * np.sqrt(2 / 3 / boxes.GRAVITY) * ellipk(np.sin(boxes.RELEASE / 2) ** 2)
    assert abs(boxes.rod({"mass": 1.0, "length": 1.0, "damping": 0.0})["period"] - exact) < 1e-9


@pytest.mark.slow
def test_period_and_angle_of_a_black_box_have_the_statistics_of_our_own_system():
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        box = al.expand(al.foreign.BlackBox(boxes.rod, executor=executor), UNCERTAIN, ORDER)

    def simulated(rod):
        history = al.simulate(rod, GRID)
        return {"angle": float(history["angle"][-1]), "period": period(history)}

    own = al.expand(simulated, Rod(**UNCERTAIN), ORDER, traced=False)
    for name in ("angle", "period"):
        for statistic in ("mean", "std"):
            np.testing.assert_allclose(getattr(box[name], statistic), getattr(own[name], statistic), rtol=1e-6)
        np.testing.assert_allclose(box.sobol("length")[name], own.sobol("length")[name], rtol=1e-5)
    assert float(box["period"].std) > 0.01
    assert float(box.error["period"]) < 1e-3
