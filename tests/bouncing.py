"""Bodies that bounce and land, with closed forms, and bodies that have no simulation."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from compiling import compiled
from zoo import G, Shot

ADAPTIVE = [al.integrators.Tsit5(), al.integrators.Rodas5P()]
LANDED = al.Grid(until="ground", at_most=10.0, steps=40)


class Ball(al.System):
    """A ball that bounces: `v -> -e v` on the floor."""

    states = ("y", "v")
    e: al.Number = 0.7
    height: al.Number = 1.0
    events: ClassVar = {
        "floor": al.Event(lambda self, t, z: z.y, direction=-1, jump=lambda self, t, z: {"v": -self.e * z.v})
    }

    def rhs(self, t, z):
        return z.v, -G

    def initial(self):
        return {"y": self.height}

    def outputs(self, t, z):
        return {"h": z.y, "v": z.v}


def second_flight(e, height, t, sqrt=np.sqrt):
    """The height of the ball between its second bounce and the third one."""
    first = sqrt(2 * height / G)
    after = t - first * (1 + 2 * e)
    return e**2 * G * first * after - G / 2 * after**2


class Parts(Ball):
    """A ball that meets a wall at the floor, at the same time."""

    events: ClassVar = {
        **Ball.events,
        "wall": al.Event(lambda self, t, z: 2 * z.y, jump=lambda self, t, z: {"v": 0 * z.v}),
    }


class Grazing(Shot):
    events: ClassVar = {"ceiling": al.Event(lambda self, t, z: z.y - (self.speed * jnp.sin(self.angle)) ** 2 / (2 * G))}


class Stopped(Ball):
    events: ClassVar = {"floor": al.Event(lambda self, t, z: z.y, direction=-1, jump=lambda self, t, z: {"v": 0.0})}


class Rooted(Ball):
    """A ball that leaves the floor with the root of what may be negative."""

    events: ClassVar = {
        "floor": al.Event(lambda self, t, z: z.y, direction=-1, jump=lambda self, t, z: {"v": jnp.sqrt(self.e)})
    }


def agreeing(simulated, exact, at, order):
    """Pairs of the values of two functions, and of their derivatives up to an order, by one program."""
    both = [(simulated, exact)]
    for _ in range(order):
        both.append(tuple(map(jax.jacfwd, both[-1])))
    return jax.tree.map(np.asarray, compiled(lambda at: [(ours(at), right(at)) for ours, right in both])(np.array(at)))


def refused(system, grid, *words, inputs=None, integrator=None):
    with pytest.warns(al.SimulationWarning) as caught:
        history = al.simulate(system, grid, inputs, integrator)
    assert np.isnan(np.asarray(next(iter(history.values())))[-1]).all()
    for word in words:
        assert word in str(caught[0].message)
