"""The equations of a declared problem: traced once, with its expressions, whose outputs and shapes they must match."""

import uuid
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import traceable
from aleator._core.equations import Digest, digest_of, joint_digest, refuse_unsteady
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.identity import identity_of, is_library
from aleator._core.leaves import nodes
from aleator.design._check import unknown
from aleator.design._expression import Expression
from aleator.design._functionals import AbstractIntegral, events_of
from aleator.design._response import AbstractProblem
from aleator.design._rules import Own
from aleator.design._scope import AbstractScope
from aleator.design._statistic import AbstractFunctional, Taken, functionals_of, joined
from aleator.dynamics import (
    AbstractIntegrator,
    Equations,
    Grid,
    Occurrence,
    called,
    jump_times,
    phase_of,
    time_switches,
)
from aleator.statistics import AbstractStatistic
from aleator.trajectories import AbstractSignal, Parametrised
from aleator.uncertainty import AbstractDistribution, at_means, named_numbers, realise, uncertain_again

# How far from the initial decisions others are tried, as a part of their ranges.
_BESIDE = 1e-2


# A user's own classes of these kinds are called for each program.
_CALLED = AbstractDistribution, AbstractSignal, AbstractFunctional, AbstractStatistic, AbstractIntegrator


def declared(problem: AbstractProblem) -> tuple[Equations, Digest]:
    """Trace the equations of a problem; for a deterministic one, of the uncertain one that it stands for.

    Returns them with the digest of all that is computed. Raises `ProblemError` if two traces differ, or if outputs and
    expressions do not match.
    """
    whole = eqx.tree_at(lambda one: one.simulation, problem, uncertain_again(problem.simulation))
    equations, realisation, switching = _traced(whole)
    refuse_unsteady(type(problem.system).__name__, equations.digest, lambda: _traced(whole)[0].digest)
    for phase, names in switching.items():
        _refuse_moving_jumps(whole, equations, phase, names)
    grid = whole.grid
    equations.refuse_large_history(whole.system.title, grid.steps)
    shapes = equations.output_shapes()
    outputs = {name: np.zeros((grid.of(name).steps + 1, *shape)) for name, shape in shapes.items()}
    for name in (name for functional in functionals_of(whole.expressions) for name in functional.outputs):
        if name not in outputs:
            raise ProblemError(_unknown_output(whole, name, list(outputs)))
    expressions = digest_of(_check_shapes(whole, outputs))
    parts = {"realisation": realisation, "equations": equations.digest, "expressions": expressions}
    # What is called for each program is known to this process alone.
    kinds = {type(node) for node in nodes(whole) if isinstance(node, _CALLED)}
    own = sorted(identity_of(one) or uuid.uuid4().hex for one in kinds if not is_library(one.__module__))
    return equations, joint_digest(parts | {f"own {one}": Digest(one, False) for one in own})


def _unknown_output(problem: AbstractProblem, name: str, known: list[str]) -> str:
    phases, (phase, _, own) = list(problem.simulation.phases), name.partition(".")
    if phase not in phases:
        return unknown(f"output of {type(problem.system).__name__}", name, known)
    before, dot, _ = own.partition(".")
    if dot:
        return unknown("phase", before, phases)
    there = [one.partition(".")[2] for one in known if phase_of(one) == phase]
    return unknown(f"output of {type(problem.simulation.of(name).system).__name__}", own, there)


def may_lose_derivatives(problem: AbstractProblem) -> bool:
    """Whether derivatives may be others than those of the values, by its equations or a user's code besides."""
    equations, own = problem.simulation.equations, any(isinstance(one, Own | Parametrised) for one in nodes(problem))
    return own or not problem.is_declared or (equations is not None and equations.may_lose_derivatives)


def refuse_other_code(problem: AbstractProblem) -> None:
    """Raise `ProblemError` if a problem came from another process and the code gives other equations here."""

    def applied(germ: jax.Array, decisions: jax.Array) -> jax.Array:
        _ = realise(problem.simulation, germ, decisions).traced
        return decisions

    jax.eval_shape(applied, np.zeros(len(problem.placements.germ_names)), np.zeros(problem.placements.size))


def _traced(problem: AbstractProblem) -> tuple[Equations, Digest, dict[str, set[str]]]:
    """The equations of a realised system, the digest of how its numbers and signals follow from the problem's, and by
    phase the decided numbers with which it compares the time.
    """
    places, equations, switching = problem.placements, list[Equations](), dict[str, set[str]]()
    numbers, static = eqx.partition(numbers_to_arrays(problem.simulation), eqx.is_array)

    def realised(numbers: Any, germ: jax.Array, decisions: jax.Array) -> Any:
        simulation = realise(eqx.combine(numbers, static), germ, decisions)
        equations.append(simulation.traced_equations())
        phases = replace(simulation, equations=equations[0]).phases
        for phase, one in phases.items():
            if isinstance(one.grid, Grid) and (names := time_switches(one, problem.simulation.phases[phase]) - {""}):
                switching[phase] = names
        starts = [one.start() for one in phases.values()]
        return eqx.filter(numbers_to_arrays((simulation, *starts)), eqx.is_array)

    germ, decisions = (jax.ShapeDtypeStruct((size,), float) for size in (len(places.germ_names), places.size))
    closed = jax.make_jaxpr(realised)(numbers, germ, decisions)
    return equations[0], digest_of(closed), switching


def _refuse_moving_jumps(problem: AbstractProblem, equations: Equations, phase: str, names: set[str]) -> None:
    """Raise `ProblemError` if the equations of a phase jump at times that move with the decided numbers `names`.

    Where the time is compared with them, they may as well go on without a jump, as a ramp does: so jumps are sought at
    the initial decisions and at others.
    """
    places, germ = problem.placements, jax_array(np.zeros(len(problem.placements.germ_names)))
    start, lower, upper = map(places.vector, ("initial", "lower", "upper"))
    step = _BESIDE * np.maximum(np.abs(start), np.where(np.isfinite(upper - lower), upper - lower, 1.0))
    beside = np.clip(np.where(start + step <= upper, start + step, start - step), lower, upper)
    each = (realise(problem.simulation, germ, jax_array(one)) for one in (start, beside))
    both = [replace(one, equations=equations).phases[phase] for one in each]
    first, second = (jump_times(one, in_outputs=True) for one in both)
    end = min(float(one.grid.t_final) for one in both)
    moved = [t for t in first if t < end and not np.isclose(second, t, rtol=1e-9, atol=0.0).any()]
    if moved:
        listed = " and ".join(f"'{name}'" for name in sorted(names))
        raise ProblemError(
            f"{type(both[0].system).__name__}: its equations jump at t = {moved[0]:.4g} s, a time that follows from "
            f"{listed} by a comparison such as jnp.where(t < self.t_1, a, b). The derivative by that time is lost, and "
            "no solver could choose it. Declare the jump: let the equations take an input and choose by it, "
            "jnp.where(stage > 0.5, a, b), with inputs={'stage': al.StepFunction([t_1], [1.0, 0.0])}. For a number "
            "that stands in several places write t_1 = al.Decision(...).shared('t_1')."
        )


def _check_shapes(problem: AbstractProblem, outputs: Mapping[str, np.ndarray]) -> ClosedJaxpr:
    """Check that terms of expressions match, and that the objective is one number. Returns the expressions, traced."""
    zeros = {name: jax_array(values) for name, values in outputs.items()}

    def values(traced: AbstractProblem) -> list[jax.Array]:
        scope = _ShapeScope(traced, zeros)
        return [
            _evaluated(one, scope, written)
            for one, written in zip(traced.expressions, problem.expressions, strict=True)
        ]

    numbers, static = eqx.partition(numbers_to_arrays(problem), eqx.is_array)
    traced, shaped = jax.make_jaxpr(lambda numbers: values(eqx.combine(numbers, static)), return_shape=True)(numbers)
    if shaped[0].shape != ():
        raise ProblemError(
            f"The objective must be one number, but '{problem.objective}' has shape {shaped[0].shape}: use integral, "
            "rms, peak or terminal instead of path, and an output or one number of a model in the place of an array."
        )
    return traced


def _evaluated(expression: Expression, scope: AbstractScope, written: Expression) -> jax.Array:
    """The value of a traced expression; `written` is the same expression in a form that can be printed."""
    try:
        return jnp.asarray(expression.evaluate(scope))
    except AleatorError:
        raise
    except (TypeError, ValueError) as error:
        raise ProblemError(f"The terms of '{written}' have incompatible shapes: {error}") from error


class _ShapeScope(AbstractScope):
    """Statistics of the right shapes, with arbitrary values."""

    def __init__(self, problem: AbstractProblem, outputs: dict[str, jax.Array]):
        self._problem, self._outputs = problem, outputs
        self._first = {name: one[0] for name, one in outputs.items()}
        self._grid = realise(at_means(problem.simulation), jnp.zeros(0), jnp.zeros(problem.placements.size)).grid

    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> jax.Array:
        # A statistic has the shape of its functional, without the axis of jointly taken ones.
        del kind
        values = joined([self.realised(one) for one in functionals])
        return values if len(functionals) == 1 else values[..., 0]

    def realised(self, functional: AbstractFunctional) -> jax.Array:
        integrals: dict[AbstractFunctional, jax.Array] = {}
        if isinstance(functional, AbstractIntegral):
            integrals[functional] = traceable(
                f"{type(functional).__name__}.integrand", called(functional, functional.integrand, self._first)
            )
        events = {name: Occurrence(jnp.ones(()), self._first) for name in events_of([functional])}
        taken = Taken(self._outputs, integrals, events, jnp.ones((1, 1)))
        who = f"{type(functional).__name__}.evaluate"
        value = traceable(who, called(functional, functional.evaluate, taken, self._grid.of(functional.place)))
        if functional.is_path and value.shape[:1] != (instants := len(self._outputs[functional.output]),):
            raise ProblemError(f"{who}: expected one number per instant, {instants} in all; received {value.shape}.")
        return value

    def time_integral(self, expression: Expression) -> jax.Array:
        return expression.evaluate(self)[0]

    def value(self, name: str) -> jax.Array:
        numbers = named_numbers(self._problem.simulation, jnp.zeros(self._problem.placements.size))
        return jnp.ones(jnp.shape(numbers[name]) if name in numbers else ())
