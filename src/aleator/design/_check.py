"""Refuse a problem that does not fit together, before anything is compiled: what was expected, what was received."""

import difflib
from typing import Any

import jax
import jax.numpy as jnp

from aleator._core.arrays import numbers_to_arrays
from aleator._core.errors import ProblemError
from aleator.collocation import Expansion
from aleator.design._cost import CostCurve
from aleator.design._declaration import AbstractProblem
from aleator.design._language import AbstractFunctional, Expression, functionals_of
from aleator.design._response import history
from aleator.design._scope import AbstractScope, Value
from aleator.dynamics import AbstractIntegrator, AbstractSignal, Grid, System, input_names
from aleator.uncertainty import named_numbers, refuse_nonpositive


def check(problem: AbstractProblem) -> None:
    """Raise `ProblemError` for the first thing found wrong, from the outside inwards."""
    _check_types(problem)
    _check_inputs(problem)
    refuse_nonpositive(problem.model)
    _check_values(problem)
    _check_shapes(problem, _output_shapes(problem))


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


def _output_shapes(problem: AbstractProblem) -> dict[str, jax.ShapeDtypeStruct]:
    """Shapes of the outputs' histories, by tracing the physics once without computing anything."""
    places = problem.survey
    germ = jax.ShapeDtypeStruct((len(places.distributions),), float)
    decisions = jax.ShapeDtypeStruct((places.size,), float)
    return jax.eval_shape(lambda xi, x: history(numbers_to_arrays(problem), xi, x), germ, decisions)


def _check_shapes(problem: AbstractProblem, outputs: dict[str, jax.ShapeDtypeStruct]) -> None:
    for functional in functionals_of(problem.expressions):
        if functional.output not in outputs:
            raise ProblemError(_unknown(f"output of {type(problem.system).__name__}", functional.output, list(outputs)))
    shape = _shape(problem.objective, problem, outputs)
    if shape != ():
        raise ProblemError(
            f"The objective must be one number, but '{problem.objective}' has shape {shape}: "
            "use integral, rms, peak or terminal in the place of path."
        )
    for constraint in problem.constraints:
        _shape(constraint.expression, problem, outputs)


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


def _shape(
    expression: Expression, problem: AbstractProblem, outputs: dict[str, jax.ShapeDtypeStruct]
) -> tuple[int, ...]:
    try:
        return jax.eval_shape(lambda y: jnp.asarray(expression.evaluate(_ShapeScope(problem, y))), outputs).shape
    except (TypeError, ValueError) as error:
        raise ProblemError(f"The terms of '{expression}' have shapes that do not go together: {error}") from error
