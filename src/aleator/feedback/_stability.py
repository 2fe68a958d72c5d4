"""Gains that destabilise, and plans that no gains can stabilise: seen in the linearised loop at the start of a plan."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator._core.identity import own_code
from aleator.dynamics import Grid, System, called, derivative, initial_state
from aleator.dynamics._grid import sampled
from aleator.dynamics._system import state_type
from aleator.feedback._controllers import AbstractController, Plan
from aleator.feedback._lqr import LQR, linearised
from aleator.trajectories import AbstractSignal

# A mode that grows by a smaller part of the fastest rate is at rest.
_GROWTH = 1e-6


def _linear_loop(
    law: AbstractController, model: System, inputs: dict[str, AbstractSignal], grid: Grid, names: Any, code: str
) -> tuple[Float[Array, "n n"], Float[Array, "n m"], Float[Array, "m n"]]:
    """The derivatives of the rates by states and commanded inputs, and of these by the states, at the start."""
    del code  # tells programs apart
    (of, to), t = names, grid.times[0]
    values = sampled({**model.signals(), **inputs}, grid, grid.fractions[:1])
    now = {name: rows[0] for name, rows in values.items()}
    start = initial_state(model, t, now)
    plan = Plan(start, now, lambda z, inputs: derivative(model, t, z, inputs), to)
    (z, named), (u, commanded) = ravel_pytree(start), plan.flat

    def rates(z: Array, u: Array) -> Array:
        return ravel_pytree(plan.rates(named(z), now | commanded(u)))[0]

    def command(z: Array) -> Array:
        measured = state_type(of)(**{name: getattr(named(z), name) for name in of})
        values = called(law, law.command, t, measured, plan)
        return ravel_pytree(tuple(jnp.asarray(values[name], dtype=float) for name in to))[0]

    return *linearised(rates, z, u), jnp.zeros((u.size, z.size)) if isinstance(law, LQR) else jax.jacfwd(command)(z)


_LINEAR_LOOP = Compiled(_linear_loop, use=Use.BRIEF)


def unstable(
    law: AbstractController,
    model: System,
    inputs: dict[str, AbstractSignal],
    grid: Grid,
    of: tuple[str, ...],
    to: tuple[str, ...],
) -> str:
    """That errors grow faster than without feedback, or that no gains hinder it; empty if neither is so.

    `inputs`: of the plan.
    """
    arguments = numbers_to_arrays((law, model, inputs, grid))
    A, B, K = map(np.asarray, _LINEAR_LOOP(*arguments, (of, to), own_code((law, model, inputs))))
    if isinstance(law, LQR):
        if law.final is not None or _can_be_stabilised(A, B):
            return ""
        return (
            f"al.lqr: expected a plan that {', '.join(to)} can stabilise; received one with a mode, at its start, that "
            "does not decay and that no such input moves. Give final=, the weight at the end."
        )
    loop = np.linalg.eigvals(A + B @ K)
    growth, before = loop.real.max(), max(np.linalg.eigvals(A).real.max(), 0.0)
    if growth <= before + _GROWTH * np.abs(loop).max():
        return ""
    return (
        f"Feedback: its gains destabilise: at the start of the plan errors grow by {growth:.3g} 1/s with them, and by "
        f"{before:.3g} 1/s without. Change a sign, or add a gain of a rate: gains multiply the plan minus what is "
        "measured, and the product is added to the planned input."
    )


def _can_be_stabilised(A: np.ndarray, B: np.ndarray) -> bool:
    """Whether inputs reach every mode that does not decay (Hautus)."""
    size = max(np.abs(A).max(initial=0.0), np.abs(B).max(initial=0.0))
    modes = (value for value in np.linalg.eigvals(A) if value.real >= -_GROWTH * size)
    return all(np.linalg.matrix_rank(np.hstack([A - value * np.eye(len(A)), B])) == len(A) for value in modes)
