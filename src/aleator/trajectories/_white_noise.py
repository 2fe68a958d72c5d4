"""`WhiteNoise`: noise whose values at two instants have nothing in common."""

from typing import Any, final

import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import refusal
from aleator._core.leaves import lowest, realised_shape, stored_numbers
from aleator.trajectories._signals import AbstractSignal, as_array


@final
class WhiteNoise(AbstractSignal):
    """White noise `w` of mean zero, `E[w(t) w(s)] = intensity δ(t - s)`: an input of a problem, or a sensor's noise.

    - `intensity`: in the unit of the signal squared times a second, the two-sided power spectral density per hertz: a
      number, a distribution or a `Decision`, or several, whose noises are independent.

    A problem carries the covariance of the states beside each realisation, by its differential equation: no germ
    variables. By itself the signal is its mean, zero.

    Raises `ProblemError` for an intensity that is, or may be, negative.
    """

    intensity: Any

    def __init__(self, intensity: Any):
        self.intensity = stored_numbers("WhiteNoise: intensity", intensity)
        least = lowest(self.intensity)
        if least is not None and least < 0:
            raise refusal("WhiteNoise: intensity", "no negative number", intensity)

    @property
    def covariance(self) -> Float[Array, " n"]:
        """The intensities, side by side."""
        return jnp.ravel(as_array(self.intensity))

    @override
    def __call__(self, t: Float[Array, ""]) -> Float[Array, "..."]:
        del t
        return jnp.zeros(realised_shape(self.intensity))
