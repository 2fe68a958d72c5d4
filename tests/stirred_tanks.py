"""The stirred tank of the zoo, and the same with its equilibrium in closed form."""

import jax.numpy as jnp

import aleator as al
from zoo import Tank


class ExplicitTank(Tank):
    """The tank without an algebraic variable."""

    algebraic = ()
    residual = al.System.residual
    algebraic_guess = al.System.algebraic_guess

    def rhs(self, t, z, feed):
        return (feed - 0.5 * z.acid - self.rate * hydrogen(self.constant, z.acid) * z.acid,)

    def outputs(self, t, z, feed):
        h = hydrogen(self.constant, z.acid)
        return {"acid": z.acid, "hydrogen": h, "feed": feed, "miss": (h - 0.2) ** 2 + 0.01 * feed**2}


def hydrogen(constant, acid):
    """The equilibrium in closed form."""
    return 0.5 * (-constant + jnp.sqrt(constant**2 + 4.0 * constant * acid))
