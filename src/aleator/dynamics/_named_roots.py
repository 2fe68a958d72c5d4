"""Newton's method for unknowns with names, and what is told where it fails."""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, is_number, numbers_to_arrays
from aleator._core.leaves import named_leaves
from aleator.dynamics._newton import Root, newton

Named: TypeAlias = Callable[[Array], Any]
"""Turns the vector of all unknowns into a named tuple."""

_GOLDEN = (5**0.5 - 1) / 2

# So many residuals are listed one by one.
_LISTED = 8


def named_root(
    equations: Callable[[Pytree, Any], Float[Array, " n"]], numbers: Pytree, guess: Any
) -> tuple[Root, Named]:
    """Solve `equations(numbers, unknowns) = 0` from a guess, a named tuple of arrays: see `newton`."""
    start, named = ravel_pytree(guess)
    terms = constant_terms(lambda given: equations(given, guess), numbers)
    return newton(lambda vector: equations(numbers, named(vector)), start, terms), named


def constant_terms(equations: Callable[[Pytree], Float[Array, " n"]], given: Pytree) -> Float[Array, " n"]:
    """The magnitudes of the terms that known numbers add to each equation: their rounding limits the unknowns.

    Computed by derivatives along all numbers at once, with weights under which terms of opposite sign do not cancel.
    """
    dynamic, static = eqx.partition(numbers_to_arrays(given), eqx.is_inexact_array)
    numbers, combined = ravel_pytree(dynamic)
    if not numbers.size:
        return jnp.zeros_like(equations(given))
    order = np.arange(1, numbers.size + 1)
    weights = np.stack([0.5 + order * _GOLDEN % 1, (-1.0) ** order * (0.5 + order * _GOLDEN**2 % 1)])

    def of(numbers: Float[Array, " numbers"]) -> Float[Array, " n"]:
        return equations(eqx.combine(combined(numbers), static))

    _, along = jax.vmap(lambda weight: jax.jvp(of, (numbers,), (numbers * weight,)))(jnp.asarray(weights))
    return jnp.nan_to_num(jnp.abs(along).max(axis=0), nan=0.0, posinf=0.0)


def failure_text(root: Root, named: Named, guess: Any) -> str:
    """Where Newton's method went from a guess, and what is left of the equations there."""
    worst = int(np.argmax(np.nan_to_num(np.abs(root.relative), nan=np.inf)))
    count = root.relative.size
    every = ", ".join(f"{float(one):.3g}" for one in np.asarray(root.residuals))
    return (
        f"From the guess {listed(guess._asdict())} it reached in {int(root.steps)} steps "
        f"{listed(named(root.point)._asdict())}, where equation {worst + 1} of {count} is left with a residual of "
        f"{float(root.residuals[worst]):.3g}{f' (all: {every})' if 1 < count <= _LISTED else ''}{_remark(root)}."
    )


def numbers_in(system: eqx.Module) -> dict[str, Any]:
    """The numbers in the fields of a realised system, by name."""
    return {name: leaf for name, leaf in named_leaves(system) if is_number(leaf) or isinstance(leaf, int)}


def listed(numbers: Mapping[str, Any]) -> str:
    """Numbers with their names."""
    style: Any = {"float_kind": "{:.6g}".format}
    return ", ".join(f"{name}={np.array2string(np.asarray(value), formatter=style)}" for name, value in numbers.items())


def _remark(root: Root) -> str:
    if not np.isfinite(root.residuals).all():
        return ", which is not a finite number"
    if not root.regular:
        return "; the Jacobian is singular there: the equations do not determine the unknowns, or two solutions meet"
    return ""
