"""Plain numbers: outputs that decisions depend on, and germ values of given inputs."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.ensemble import concrete
from aleator.uncertainty import AbstractDistribution, AbstractGerm

# Germ values of unbounded distributions are sought between these probability levels.
_FURTHEST_LEVELS = (1e-300, 1 - 1e-16)


def plain(outputs: Pytree) -> Pytree:
    """Outputs as plain numbers, for decisions that depend on them. Raises `ProblemError` while they are compiled."""
    values = [concrete(leaf) for leaf in jax.tree.leaves(outputs)]
    if any(one is None for one in values):
        raise ProblemError(
            "How a function is expanded by elements or adaptively depends on its values, which are not known inside "
            "jax.jit: expand outside of it (jax.grad alone is no obstacle), or by a fixed expansion."
        )
    return jax.tree.unflatten(jax.tree.structure(outputs), values)


def germ_of(distributions: Mapping[str, AbstractDistribution], inputs: Mapping[str, Any]) -> dict[str, float]:
    """The germ values at which the uncertain inputs have given values.

    Raises `ProblemError` if an input is missing or unknown, if a value lies outside its distribution, or if that
    depends on several germ variables.
    """
    if set(inputs) != set(distributions):
        raise ProblemError(f"Expected a value for each of {list(distributions)}; received {list(inputs)}.")
    point = {}
    for name, distribution in distributions.items():
        germs = distribution.germs(name)
        if len(germs) != 1:
            raise ProblemError(f"'{name}' depends on the germ variables {list(germs)}: use at_germ(points).")
        ((variable, germ),) = germs.items()
        point[variable] = _inverted(name, distribution, germ, float(inputs[name]))
    return point


def _inverted(name: str, distribution: AbstractDistribution, germ: AbstractGerm, value: float) -> float:
    """The germ value at which a distribution has a given value, found by bracketing: it increases with its germ."""

    def excess(point: float) -> float:
        return float(jax.lax.stop_gradient(distribution.realised((jnp.asarray(point),)))) - value

    low, high = (
        end if np.isfinite(end) else float(germ.quantile(np.array(level)))
        for end, level in zip(germ.support(), _FURTHEST_LEVELS, strict=True)
    )
    rounding = 1e-12 * (1 + abs(value))
    if excess(low) > rounding or excess(high) < -rounding:
        raise ProblemError(f"'{name}' = {value:g} lies outside its distribution {distribution}.")
    if excess(low) >= 0 or excess(high) <= 0:
        return low if excess(low) >= 0 else high
    return float(scipy.optimize.brentq(excess, low, high, xtol=1e-14))  # type: ignore[arg-type]
