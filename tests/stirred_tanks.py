"""A stirred tank with an acid that dissociates at once: one state, and one algebraic variable from its equilibrium."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import aleator as al


class Tank(al.System):
    """A weak acid is fed, leaves with the flow, and reacts at a rate that its dissociated part sets.

    `hydrogen` follows from the equilibrium `constant = h² / (acid - h)`, the positive one of two solutions.
    """

    states = ("acid",)
    algebraic = ("hydrogen",)

    constant: Any = 0.1
    rate: Any = 1.0

    def change(self, acid, hydrogen, feed):
        return (feed - 0.5 * acid - self.rate * hydrogen * acid,)

    def rhs(self, t, z, feed):
        return self.change(z.acid, z.hydrogen, feed)

    def residual(self, t, z):
        return (z.hydrogen**2 - self.constant * (z.acid - z.hydrogen),)

    def algebraic_guess(self, t, z):
        return {"hydrogen": jnp.sqrt(self.constant * jnp.abs(z.acid))}

    def outputs(self, t, z, feed):
        miss = (z.hydrogen - 0.2) ** 2 + 0.01 * feed**2
        return {"acid": z.acid, "hydrogen": z.hydrogen, "feed": feed, "miss": miss}

    def initial(self):
        return {"acid": 0.2}


class ExplicitTank(Tank):
    """The same tank with the equilibrium in closed form."""

    algebraic = ()
    residual = al.System.residual
    algebraic_guess = al.System.algebraic_guess

    def rhs(self, t, z, feed):
        return self.change(z.acid, hydrogen(self.constant, z.acid), feed)

    def outputs(self, t, z, feed):
        state = self.Whole(z.acid, hydrogen(self.constant, z.acid))
        return super().outputs(t, state, feed)

    class Whole(NamedTuple):
        """The state with the algebraic variable."""

        acid: Any
        hydrogen: Any


def hydrogen(constant, acid):
    """The equilibrium in closed form."""
    return 0.5 * (-constant + jnp.sqrt(constant**2 + 4.0 * constant * acid))


def tank_problem(steps: int = 50, **options: Any) -> al.Problem:
    """Little feed that brings the hydrogen near 0.2, within a limit for three standard deviations."""
    defaults: dict[str, Any] = {
        "grid": al.Grid(2.0, steps),
        "inputs": {"feed": al.BSpline(al.Decision(np.full(5, 0.5), 0.0, 5.0), degree=2)},
        "minimize": al.integral("miss").mean,
        "subject_to": [
            al.path("hydrogen").at_most(0.18, sigmas=2.0),
            al.terminal("acid").mean >= 0.45,
        ],
        "expansion": al.Expansion(order=2),
    }
    tank = Tank(constant=al.Uniform(0.1, half_width=0.01), rate=al.Uniform(1.0, half_width=0.1))
    return al.Problem(tank, **(defaults | options))
