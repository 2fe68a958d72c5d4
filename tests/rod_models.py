"""The rod of the FMUs, as this package writes it."""

import jax.numpy as jnp

import aleator as al


class Rod(al.System):
    """A uniform rod that swings about its end, with the numbers of the FMU."""

    states = ("angle", "rate")

    damping: al.Number = 0.1
    length: al.Number = 1.0
    angle: al.Number = 1.0

    def initial(self):
        return {"angle": self.angle}

    def rhs(self, t, z, torque=0.0):
        moment = 9.81 * self.length / 2 * jnp.sin(z.angle)
        return z.rate, (torque - moment - self.damping * z.rate) / (self.length**2 / 3)

    def outputs(self, t, z):
        height = self.length / 2 * (1 - jnp.cos(z.angle))
        return {"angle": z.angle, "rate": z.rate, "energy": self.length**2 * z.rate**2 / 6 + 9.81 * height}
