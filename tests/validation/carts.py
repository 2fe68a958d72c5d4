"""A cart on a spring whose evidence needs paths, integrals and numbers, in a module that processes can import."""

from typing import Any

import jax.numpy as jnp

import aleator as al


class Cart(al.System):
    """A mass on a spring and a damper, released from a distance."""

    states = ("x", "v")

    mass: Any
    spring: Any
    damping: Any
    distance: Any = 1.0

    def rhs(self, t, z):
        return z.v, -(self.spring * z.x + self.damping * z.v) / self.mass

    def outputs(self, t, z):
        return {"x": z.x, "v": z.v, "force": self.spring * z.x}

    def initial(self):
        return {"x": self.distance}


def cart_problem(*further: al.Constraint, **options: Any) -> al.Problem:
    """The softest spring with which most carts stay between limits that a few break."""
    cart = Cart(
        al.Uniform(1.0, half_width=0.2), al.Decision(9.0, 4.0, 20.0), al.Normal(0.8, 0.05), al.Normal(1.0, 0.03)
    )
    x, v = al.path("x"), al.path("v")
    limits = [
        (x.mean - x.std >= -0.75).named("back"),
        (v.mean + v.std - 0.1 * al.value("spring") <= 1.5).named("speed"),
        al.rms("force").at_most(4.0, sigmas=1).named("force"),
        *further,
    ]
    grid = al.Grid(2.0, 40)
    return al.Problem(cart, grid=grid, minimize=al.integral("force").mean, subject_to=limits, **options)


class Rooted(Cart):
    """A cart with an output that light ones do not have."""

    def outputs(self, t, z):
        return {"x": z.x, "root": jnp.sqrt(self.mass - 0.45)}


def rooted_problem() -> al.Problem:
    """All but three carts in a hundred have this output."""
    cart = Rooted(al.Normal(1.0, 0.3), 9.0, al.Decision(0.8, 0.5, 1.0))
    root = al.path("root")
    limits = [(root.mean <= 2.0).named("root")]
    expansion = al.Expansion(order=1)
    grid = al.Grid(2.0, 40)
    return al.Problem(cart, grid=grid, minimize=al.integral("x").mean, subject_to=limits, expansion=expansion)
