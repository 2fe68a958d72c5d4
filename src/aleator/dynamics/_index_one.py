"""The algebraic variables of a system: what follows at each instant from equations of index 1.

They are a function of the time, the states and the inputs at that instant alone, which Newton's method finds from the
system's own guess: neither the steps of an integrator nor other realisations have an effect on them. So wherever a
system is evaluated they are eliminated, `z' = f(t, z, y(t, z))`, and every integrator keeps its order.
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.dynamics._named_roots import Named, named_root
from aleator.dynamics._newton import Root
from aleator.dynamics._returned import as_equations, starting
from aleator.dynamics._system import System, evaluated, state_type


def guessed_algebraic(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> Any:
    """The guess of the algebraic variables as a named tuple of arrays: their number and shapes, too."""
    who = f"{system.title}.algebraic_guess"
    given = evaluated(system, system.algebraic_guess, t, z, inputs)
    if not isinstance(given, Mapping) or not set(given) <= set(system.algebraic):
        raise ProblemError(
            f"{who} returns a dict of values near the solution, by the names of some of the algebraic variables "
            f"{system.algebraic}; received {given!r}."
        )
    return state_type(system.algebraic)(*starting(who, system.algebraic, given))


def algebraic_residuals(system: System, t: Any, whole: Any, inputs: dict[str, Array]) -> Float[Array, " algebraic"]:
    """`system.residual` at states and algebraic variables, as one vector of as many entries as the latter have."""
    size = sum(jnp.size(getattr(whole, name)) for name in system.algebraic)
    return as_equations(system, evaluated(system, system.residual, t, whole, inputs), system.algebraic, size)


def completed(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> Any:
    """The states with the algebraic variables that follow from them, as one named tuple; unchanged if it has them.

    Where Newton's method finds no isolated solution they are NaN: see `explain_algebraic`.
    """
    if not system.algebraic or len(z) > len(system.states):
        return z
    root, named = solved_algebraic(system, t, z, inputs)
    return with_algebraic(system, z, named(jnp.where(root.converged, root.point, jnp.nan)))


def solved_algebraic(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> tuple[Root, Named]:
    """Solve for the algebraic variables; differentiable to any order, by the implicit function theorem."""

    def equations(numbers: tuple[System, Any, Any, dict[str, Array]], y: Any) -> Float[Array, " algebraic"]:
        one, at, states, now = numbers
        return algebraic_residuals(one, at, with_algebraic(one, states, y), now)

    return named_root(equations, (system, t, z, inputs), guessed_algebraic(system, t, z, inputs))


def with_algebraic(system: System, z: Any, y: Any) -> Any:
    """States and algebraic variables as one named tuple."""
    return state_type((*system.states, *system.algebraic))(*z, *y)
