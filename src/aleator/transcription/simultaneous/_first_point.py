"""The first point of a simultaneous program: all that follows from decisions and states."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator._core.errors import SimulationError
from aleator.design import Problem, unsolved
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._pointwise import Pointwise
from aleator.transcription.simultaneous._program import Assembled


def _algebraic(
    problem: Problem,
    points: Float[Array, "realisations germs"],
    places: Float[Array, "places 2"],
    at: tuple[Array, Array, Array, Array],
) -> Float[Array, "realisations places algebraic"]:
    """The algebraic variables at some places, from decisions, duration, and the signals and states there."""
    decisions, duration, signals, states = at
    asked = Pointwise.of(problem)
    shared = jnp.append(decisions[asked.direct], duration)
    return asked.everywhere(asked.algebraic, points, places, shared, signals, states)


ALGEBRAIC = Compiled(_algebraic, use=Use.ONCE)


def started(
    traced: Problem,
    layout: Layout,
    assembled: Assembled,
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
    states: Float[np.ndarray, "realisations points states"],
) -> Float[np.ndarray, " variables"]:
    """The point of a program at some decisions and states: all else follows from them.

    Raises `SimulationError` where the algebraic variables of a realisation do not follow from its initial state.
    """
    variables, numbers = np.zeros(layout.count), layout.numbers
    variables[numbers.decisions] = decisions
    variables[np.append(numbers.signals.ravel(), numbers.duration)] = assembled.known(variables)
    variables[numbers.states] = states
    if numbers.algebraic.size:
        mesh, values = layout.plan.mesh, layout.view(variables)
        at = values.decisions, values.duration[0], values.signals, states[:, mesh.sides]
        found = np.asarray(
            ALGEBRAIC(traced, jnp.asarray(points), jnp.asarray(mesh.places), jax.tree.map(jnp.asarray, at))
        )
        _refuse_unsolved(traced, points, decisions, found)
        variables[numbers.algebraic] = found
    # Each is tied to those before it: what is missing from zero is what it stands for, and what an interval adds.
    ties = assembled.rows.ties
    for some in (numbers.integrals, *layout.stages[1:]):
        these = np.isin(ties.variables, some)
        # What is NaN here makes no start; the rows that are NaN there say where.
        variables[ties.variables[these]] = np.nan_to_num(-assembled.constraints(variables)[ties.rows][these])
        if some is numbers.integrals:
            variables[some] = np.cumsum(variables[some], axis=1)
    return variables


def _refuse_unsolved(
    traced: Problem,
    points: Float[np.ndarray, "realisations germs"],
    decisions: Float[np.ndarray, " n"],
    found: Float[np.ndarray, "realisations places algebraic"],
) -> None:
    failed = ~np.isfinite(found[:, 0]).all(axis=1)
    if failed.any():
        first = int(np.argmax(failed))
        reason = unsolved(traced, jnp.asarray(points[first]), jnp.asarray(decisions))
        raise SimulationError(f"{reason} This is collocation point {first + 1} of {len(points)}.")
