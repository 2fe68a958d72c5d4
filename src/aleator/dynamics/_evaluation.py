"""What a system says at one instant: its initial state, rates and outputs, as arrays; checked at trace time.

Algebraic variables are a function of the time, the states and the inputs at that instant alone (index 1), which
Newton's method finds from the system's own guess: neither the steps of an integrator nor other realisations have an
effect on them. So wherever a system is evaluated they are eliminated, `z' = f(t, z, y(t, z))`, and every integrator
keeps its order.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import traceable
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator.dynamics._grid import Grid, inputs_on
from aleator.dynamics._newton import Named, Root, failure_text, listed, named_root, numbers_in
from aleator.dynamics._system import AbstractSystem, System, evaluated, state_type
from aleator.trajectories import AbstractSignal

# So many places along a step are looked at for the first one where the equations have no solution.
_LOOKED_AT = 16


def initial_state(system: System, t: Any = None, inputs: Mapping[str, Any] | None = None) -> Any:
    """The initial state as a named tuple of arrays: at the time `t`, with the inputs there, if these are given."""
    values = system.initial() if inputs is None else system.starting(t, inputs)
    if not isinstance(values, Mapping):
        raise ProblemError(
            f"{system.title}.initial returns a dict of initial values by state; "
            f"received {type(values).__name__} {values!r}."
        )
    unknown = set(values) - set(system.states)
    if unknown & set(system.algebraic):
        raise ProblemError(
            f"{system.title}.initial names {sorted(unknown & set(system.algebraic))}, which follow from the "
            "states: give values near them in algebraic_guess(t, z)."
        )
    if unknown:
        raise ProblemError(
            f"{system.title}.initial names {sorted(unknown)}, which are not states; expected some of {system.states}."
        )
    return state_type(system.states)(*starting(f"{system.title}.initial", system.states, values))


def derivative(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> Any:
    """`system.rhs` as a named tuple, one rate for each state. Algebraic variables that `z` lacks are solved for."""
    with _signals_told(system):
        return _checked_rates(system, z, evaluated(system, system.rhs, t, completed(system, t, z, inputs), inputs))


def derivative_and_observation(
    system: System, t: Any, z: Any, inputs: dict[str, Array]
) -> tuple[Any, dict[str, Array]]:
    """Both `derivative` and `observation`, by `system.rates_and_outputs`."""
    with _signals_told(system):
        rates, outputs = evaluated(system, system.rates_and_outputs, t, completed(system, t, z, inputs), inputs)
        return _checked_rates(system, z, rates), as_outputs(system, outputs)


def _checked_rates(system: System, z: Any, rates: Any) -> Any:
    name = system.title
    if not isinstance(rates, tuple | list):
        raise ProblemError(f"{name}.rhs returns one rate for each of {system.states} as a tuple; received {rates!r}.")
    if len(rates) != len(system.states):
        raise ProblemError(
            f"{name}.rhs: expected {len(system.states)} rates, for {system.states}; received {len(rates)}."
        )
    arrays = [traceable(f"{name}.rhs, '{state}'", rate) for state, rate in zip(system.states, rates, strict=True)]
    for state, rate in zip(system.states, arrays, strict=True):
        expected = jnp.shape(getattr(z, state))
        if jnp.shape(rate) != expected:
            remedy = "" if expected else f" If '{state}' is an array, give its initial value in initial()."
            raise ProblemError(
                f"{name}.rhs: expected a rate of shape {expected} for '{state}'; received {jnp.shape(rate)}.{remedy}"
            )
    return state_type(system.states)(*arrays)


def observation(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> dict[str, Array]:
    """`system.outputs` as arrays by name. Algebraic variables that `z` lacks are solved for."""
    with _signals_told(system):
        return as_outputs(system, evaluated(system, system.outputs, t, completed(system, t, z, inputs), inputs))


def event_levels(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> Float[Array, " events"]:
    """The functions of all events. Algebraic variables that `z` lacks are solved for."""
    return system.event_levels(t, completed(system, t, z, inputs), **inputs)


def after_events(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> Float[Array, "events states"]:
    """The states after each event. Algebraic variables that `z` lacks are solved for."""
    return system.after_events(t, completed(system, t, z, inputs), **inputs)


@contextlib.contextmanager
def _signals_told(system: System) -> Iterator[None]:
    """What is refused because a field holds a signal where a number is used, with how a signal is given instead."""
    try:
        yield
    except ProblemError as error:
        for name in (field.name for field in dataclasses.fields(system) if field.name not in system.signal_fields):
            signal = getattr(system, name)
            if isinstance(signal, AbstractSignal) and type(signal).__name__ in f"{error}":
                raise ProblemError(
                    f"{str(error).rstrip('.')}. '{name}' of {system.title} is a signal over time, not a "
                    f"number: give it to the problem or simulation, as inputs={{'{name}': ...}}, and let the method "
                    f"take it: rhs(self, t, z, {name})."
                ) from error
        raise


def starting(what: str, names: tuple[str, ...], numbers: Mapping[str, Any]) -> list[Array]:
    """Initial values or guesses by name as arrays, zero where not given; known ones are checked to be finite."""
    values = [traceable(f"{what}, '{name}'", numbers.get(name, 0.0)) for name in names]
    for name, value in zip(names, values, strict=True):
        if not isinstance(value, Tracer) and not np.isfinite(value).all():
            raise ProblemError(f"{what}, '{name}': expected finite numbers; received {numbers[name]}.")
    return values


def as_outputs(system: AbstractSystem, values: Any) -> dict[str, Array]:
    """The return value of `system.outputs` as arrays by name."""
    if not isinstance(values, dict):
        raise ProblemError(
            f"{system.title}.outputs returns a dict of arrays by name; received {type(values).__name__}."
        )
    who = f"{system.title}.outputs"
    arrays = {}
    for name, value in values.items():
        if not isinstance(name, str):
            raise ProblemError(f"{who}: expected names of outputs; received {name!r}.")
        arrays[name] = traceable(f"{who}, '{name}'", value)
        if arrays[name].size == 0:
            raise ProblemError(
                f"{who}, '{name}': expected at least one number; received an array of shape {arrays[name].shape}, on "
                "which every constraint would hold. Drop the output."
            )
    return arrays


def as_equations(
    system: AbstractSystem, values: Any, unknowns: tuple[str, ...], expected: int
) -> Float[Array, " expected"]:
    """The return value of `system.residual` as one vector, of as many entries as there are numbers in `unknowns`."""
    name = system.title
    if not isinstance(values, tuple | list):
        received = f"an array of shape {values.shape}" if isinstance(values, jax.Array) else type(values).__name__
        raise ProblemError(
            f"{name}.residual returns the equations as a tuple, one equation too: 'return (left - right,)'; "
            f"received {received}."
        )
    vector = jnp.concatenate([jnp.zeros(0), *(jnp.ravel(traceable(f"{name}.residual", value)) for value in values)])
    if vector.size != expected:
        raise ProblemError(
            f"{name}.residual: expected as many equations as there are numbers in the unknowns {unknowns}, "
            f"{expected}; received {vector.size}."
        )
    return vector


def guessed_algebraic(system: System, t: Any, z: Any, inputs: dict[str, Array]) -> Any:
    """The guess of the algebraic variables as a named tuple of arrays: their number and shapes, too."""
    who = f"{system.title}.algebraic_guess"
    values = evaluated(system, system.algebraic_guess, t, z, inputs)
    if not isinstance(values, Mapping) or not set(values) <= set(system.algebraic):
        raise ProblemError(
            f"{who} returns a dict of values near the solution, by the names of some of the algebraic variables "
            f"{system.algebraic}; received {values!r}."
        )
    return state_type(system.algebraic)(*starting(who, system.algebraic, values))


def algebraic_residuals(system: System, t: Any, whole: Any, inputs: dict[str, Array]) -> Float[Array, " algebraic"]:
    """`system.residual` at states and algebraic variables, as one vector of as many entries as the latter have."""
    size = sum(jnp.size(getattr(whole, name)) for name in system.algebraic)
    return as_equations(system, evaluated(system, system.residual, t, whole, inputs), system.algebraic, size)


def completed(system: System, t: Any, z: Any, inputs: dict[str, Array], near: Any = None) -> Any:
    """The states with the algebraic variables that follow from them, as one named tuple; unchanged if it has them.

    Where Newton's method finds no isolated solution they are NaN: see `explain_algebraic`. It starts from those that
    are `near`, by default from the system's own guess.
    """
    if not system.algebraic or len(z) > len(system.states):
        return z
    root, named = solved_algebraic(system, t, z, inputs, near)
    return with_algebraic(system, z, named(jnp.where(root.converged, root.point, jnp.nan)))


def solved_algebraic(system: System, t: Any, z: Any, inputs: dict[str, Array], near: Any = None) -> tuple[Root, Named]:
    """Solve for the algebraic variables; differentiable to any order, by the implicit function theorem."""

    def equations(numbers: tuple[System, Any, Any, dict[str, Array]], y: Any) -> Float[Array, " algebraic"]:
        one, at, states, now = numbers
        return algebraic_residuals(one, at, with_algebraic(one, states, y), now)

    guess = guessed_algebraic(system, t, z, inputs) if near is None else near
    return named_root(equations, (system, t, z, inputs), guess)


def with_algebraic(system: System, z: Any, y: Any) -> Any:
    """States and algebraic variables as one named tuple."""
    return variables_of(system, (*z, *y))


def variables_of(system: System, numbers: Sequence[Any]) -> Any:
    """States, and algebraic variables if there are more numbers, as a named tuple."""
    return state_type((*system.states, *system.algebraic)[: len(numbers)])(*numbers)


def explain_algebraic(
    system: System, grid: Grid, inputs: dict[str, AbstractSignal], course: Float[np.ndarray, "instants states"]
) -> str:
    """Why the algebraic variables cannot be found along a course of the states, NaN at its end; empty if they can.

    - `inputs`: with the system's own signals; `course`: the states side by side at each instant of the grid.
    """
    now = inputs_on(grid, inputs)
    times = np.asarray(grid.times)

    def solvable(t: Array, row: Array) -> tuple[Array, Any]:
        _, named = ravel_pytree(initial_state(system, t, now(t)))
        z = named(row)
        return jnp.isfinite(row).all() & solved_algebraic(system, t, z, now(t))[0].converged, z

    good, states = evaluate(jax.vmap(solvable), jax_array(times), jax_array(course), use=Use.ONCE)
    if np.all(good):
        return ""
    last = max(int(np.argmin(good)) - 1, 0)
    z = jax.tree.map(lambda one: np.asarray(one)[last], states)
    return explain_from(system, float(times[last]), z, float(grid.step), now)


def explain_from(system: System, t: float, z: Any, step: float, now: Callable[[Any], dict[str, Array]]) -> str:
    """Why the algebraic variables cannot be found at an instant or within a step after it; empty if they can.

    - `now`: the inputs at a time.
    """
    shares = np.arange(_LOOKED_AT + 1) / _LOOKED_AT

    def onward(share: Array, t: Array, z: Any) -> tuple[Root, Any, Any, Any, Array]:
        """The solution on the tangent to the course."""
        later, slope = t + share * step, derivative(system, t, z, now(t))
        place = jax.tree.map(lambda one, change: one + jnp.where(share > 0, share * step * change, 0.0), z, slope)
        at = system, later, place, now(later)
        root, guess = solved_algebraic(*at)[0], guessed_algebraic(*at)
        return root, ravel_pytree(guess)[1](root.point), place, guess, root.converged

    tried = evaluate(jax.vmap(onward, (0, None, None)), jax_array(shares), t, numbers_to_arrays(z), use=Use.ONCE)
    *places, converged = jax.tree.map(np.asarray, tried)
    if converged.all():
        return ""
    first = int(np.argmin(converged))
    root, reached, place, guess = jax.tree.map(lambda one: one[first], places)
    numbers = listed({**place._asdict(), **numbers_in(system)})
    return (
        f"{system.title}: its algebraic variables have no solution at about t = "
        f"{t + shares[first] * step:.4g} s{f', with {numbers}' if numbers else ''}. "
        f"{failure_text(root, reached, guess)} {_remedy(root)}"
    )


def _remedy(root: Root) -> str:
    if np.isfinite(root.residuals).all() and not root.regular:
        return (
            "Each of them has to follow from the equations at a fixed state (index 1): differentiate by time those "
            "that do not contain them, or keep away from where solutions meet."
        )
    return "Check whether a solution exists there, and return values closer to it from algebraic_guess(t, z)."
