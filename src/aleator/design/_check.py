"""Refuse a problem that does not fit together, before anything is compiled: what was expected, what was received."""

import difflib
import hashlib
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from aleator._core.arrays import numbers_to_arrays
from aleator._core.errors import ProblemError
from aleator.collocation import Expansion
from aleator.design._cost import CostCurve
from aleator.design._declaration import AbstractProblem
from aleator.design._language import AbstractFunctional, functionals_of
from aleator.design._response import history
from aleator.design._scope import AbstractScope, Value
from aleator.dynamics import AbstractIntegrator, AbstractSignal, Grid, System, input_names
from aleator.uncertainty import Survey, named_numbers, refuse_nonpositive


def check(problem: AbstractProblem) -> str:
    """Raise `ProblemError` for the first thing found wrong, from the outside inwards. Returns `physics`.

    That is a digest of the traced equations, expressions included: two problems that differ in it are compiled apart,
    also where the difference lies in what their code reads and not in their fields.
    """
    _check_types(problem)
    _check_inputs(problem)
    refuse_nonpositive(problem.model)
    _check_values(problem)
    physics, outputs = _trace(problem, _outputs_of, problem.survey)
    _check_outputs(problem, outputs)
    expressions = [_check_shape(problem, i, outputs) for i in range(len(problem.expressions))]
    return hashlib.sha256("\n".join([physics, *expressions]).encode()).hexdigest()


def _check_types(problem: AbstractProblem) -> None:
    expected: tuple[tuple[str, Any, type], ...] = (
        ("system", problem.system, System),
        ("grid", problem.grid, Grid),
        ("expansion", problem.expansion, Expansion),
        ("integrator", problem.integrator, AbstractIntegrator),
    )
    for name, value, kind in expected:
        if not isinstance(value, kind):
            raise ProblemError(
                f"Problem: '{name}' must be a {kind.__name__}; received {type(value).__name__} {value!r}."
            )
    if not getattr(problem.system, "states", ()):
        raise ProblemError(
            f'{type(problem.system).__name__} names no states: expected `states = ("x", ...)` in the class.'
        )


def _check_inputs(problem: AbstractProblem) -> None:
    needed, given = set(input_names(problem.system)), set(problem.inputs)
    if needed != given:
        raise ProblemError(
            f"{type(problem.system).__name__} takes the inputs {sorted(needed)}; received {sorted(given)}."
        )
    start, end = float(problem.grid.t_start), float(problem.grid.t_final)
    for name, signal in problem.inputs.items():
        if not isinstance(signal, AbstractSignal):
            raise ProblemError(
                f"Input '{name}' must be a signal, such as al.Tabulated(times, values); "
                f"received {type(signal).__name__}."
            )
        first, last = signal.span()
        if start < first or end > last:
            raise ProblemError(
                f"Input '{name}' is known from {first:g} to {last:g} s, but the grid asks for {start:g} to {end:g} s."
            )


def _check_values(problem: AbstractProblem) -> None:
    numbers = named_numbers(problem.model, jnp.asarray(problem.survey.vector("initial")))
    for expression in problem.expressions:
        for atom in expression.atoms:
            if isinstance(atom, Value | CostCurve) and atom.name not in numbers:
                raise ProblemError(_unknown("number of the model", atom.name, list(numbers)))


def _unknown(kind: str, name: str, known: list[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean '{close[0]}'?" if close else ""
    return f"There is no {kind} '{name}'; expected one of {known}.{hint}"


def _trace(problem: AbstractProblem, function: Callable[..., Any], *arguments: Any) -> tuple[str, Any]:
    """Trace `function(problem, *arguments)` without computing: its equations as text, and the shapes of its results.

    The problem's numbers are variables of the equations, so that the text does not depend on them; constants are what
    the code itself holds.
    """
    dynamic, static = eqx.partition(numbers_to_arrays(problem), eqx.is_array)
    closed, shapes = jax.make_jaxpr(
        lambda numbers: function(eqx.combine(numbers, static), *arguments), return_shape=True
    )(dynamic)
    constants = [np.asarray(constant) for constant in closed.consts]
    held = [f"{one.shape}{one.dtype}{hashlib.sha256(one.tobytes()).hexdigest()}" for one in constants]
    return "\n".join([str(closed), *held]), shapes


def _outputs_of(problem: AbstractProblem, places: Survey) -> dict[str, jax.Array]:
    return history(problem, jnp.zeros(len(places.distributions)), jnp.zeros(places.size))


def _check_outputs(problem: AbstractProblem, outputs: dict[str, jax.ShapeDtypeStruct]) -> None:
    for functional in functionals_of(problem.expressions):
        if functional.output not in outputs:
            raise ProblemError(_unknown(f"output of {type(problem.system).__name__}", functional.output, list(outputs)))


def _check_shape(problem: AbstractProblem, which: int, outputs: dict[str, jax.ShapeDtypeStruct]) -> str:
    """Check that an expression's terms go together, and that the objective is one number; its equations as text."""
    expression = problem.expressions[which]
    zeros = {name: jnp.zeros(one.shape) for name, one in outputs.items()}

    def value(traced: AbstractProblem) -> jax.Array:
        return jnp.asarray(traced.expressions[which].evaluate(_ShapeScope(traced, zeros)))

    try:
        text, shaped = _trace(problem, value)
    except (TypeError, ValueError) as error:
        raise ProblemError(f"The terms of '{expression}' have shapes that do not go together: {error}") from error
    if which == 0 and shaped.shape != ():
        raise ProblemError(
            f"The objective must be one number, but '{expression}' has shape {shaped.shape}: "
            "use integral, rms, peak or terminal in the place of path."
        )
    return text


class _ShapeScope(AbstractScope):
    """Statistics of the right shapes and no particular value."""

    def __init__(self, problem: AbstractProblem, outputs: dict[str, jax.Array]):
        self._problem, self._outputs = problem, outputs

    def statistic(self, functional: AbstractFunctional, kind: str) -> jax.Array:
        del kind
        return functional.evaluate(self._outputs, self._problem.grid)

    def value(self, name: str) -> jax.Array:
        del name
        return jnp.ones(())
