"""What a system says at one instant: its initial state, rates and outputs, as arrays; checked at trace time."""

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array

from aleator._core.border import traceable
from aleator._core.errors import ProblemError
from aleator.dynamics._index_one import completed
from aleator.dynamics._returned import as_outputs, starting
from aleator.dynamics._system import System, evaluated, state_type
from aleator.trajectories import AbstractSignal


def initial_state(system: System, t: Any = None, inputs: Mapping[str, Any] | None = None) -> Any:
    """The initial state as a named tuple of arrays: at the time `t`, with the inputs there, if these are given."""
    given = system.initial() if inputs is None else system.starting(t, inputs)
    if not isinstance(given, Mapping):
        raise ProblemError(
            f"{system.title}.initial returns a dict of initial values by state; "
            f"received {type(given).__name__} {given!r}."
        )
    unknown = set(given) - set(system.states)
    if unknown & set(system.algebraic):
        raise ProblemError(
            f"{system.title}.initial names {sorted(unknown & set(system.algebraic))}, which follow from the "
            "states: give values near them in algebraic_guess(t, z)."
        )
    if unknown:
        raise ProblemError(
            f"{system.title}.initial names {sorted(unknown)}, which are not states; expected some of {system.states}."
        )
    return state_type(system.states)(*starting(f"{system.title}.initial", system.states, given))


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
