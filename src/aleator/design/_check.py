"""Checks of a problem before anything is compiled; each refusal says what was expected and what was received."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import meant, traceable
from aleator._core.equations import Digest, digest_of, joint_digest, refuse_unsteady
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.identity import code_digest, is_library
from aleator.design._cost import CostCurve
from aleator.design._declaration import AbstractProblem
from aleator.design._expression import Expression
from aleator.design._extreme import Extreme
from aleator.design._functionals import AbstractIntegral
from aleator.design._realisations import refuse_diagnosed
from aleator.design._response import grid_at
from aleator.design._scope import AbstractComposite, AbstractScope, Value
from aleator.design._statistic import (
    AbstractFunctional,
    Taken,
    functionals_of,
    joined,
    statistics_in,
)
from aleator.design._units import refuse_clashes
from aleator.dynamics import (
    AbstractIntegrator,
    AbstractSystem,
    AlgebraicSystem,
    Equations,
    Grid,
    Instant,
    System,
    called,
    check_signals,
)
from aleator.expansion import Expansion
from aleator.statistics import AbstractStatistic, Sobol, TotalSobol, refuse_correlated
from aleator.trajectories import piecewise_in
from aleator.uncertainty import named_numbers, realise, refuse_nonpositive, uncertain_again


def check(problem: AbstractProblem) -> "Declared":
    """Raise `ProblemError` for the first fault found, from the outside inwards; else trace the equations."""
    _check_types(problem)
    _check_inputs(problem)
    _check_time(problem)
    _check_worst_cases(problem)
    refuse_nonpositive(problem.simulation)
    _check_values(problem)
    _check_germs(problem)
    refuse_clashes(problem)
    refuse_diagnosed(problem)
    return declared(problem)


def _check_types(problem: AbstractProblem) -> None:
    system: Any = problem.system
    has_no_time = isinstance(system, AbstractSystem) and not system.has_time
    expected: tuple[tuple[str, Any, tuple[type, ...]], ...] = (
        ("system", system, (System, AlgebraicSystem)),
        ("grid", problem.grid, (Instant,) if has_no_time else (Grid,)),
        ("expansion", problem.expansion, (Expansion,)),
        ("integrator", problem.integrator, (AbstractIntegrator,)),
    )
    for name, value, kinds in expected:
        if not isinstance(value, kinds):
            remedy = " An algebraic system has no time: drop the grid." if kinds == (Instant,) else ""
            raise ProblemError(
                f"Problem: '{name}' must be a {' or '.join(kind.__name__ for kind in kinds)}; "
                f"received {type(value).__name__} {value!r}.{remedy}"
            )
    if has_no_time:
        return
    # A system without states evolves only by a motion that is given to it.
    names = getattr(system, "states", None)
    assert isinstance(system, System)
    if names is None or not (names or problem.inputs or system.signals()):
        raise ProblemError(f'{type(system).__name__} names no states: expected `states = ("x", ...)` in the class.')


def _check_inputs(problem: AbstractProblem) -> None:
    if not (isinstance(problem.system, System) and isinstance(problem.grid, Grid)):
        if problem.inputs:
            name = type(problem.system).__name__
            raise ProblemError(f"{name} is algebraic and takes no inputs; received {sorted(problem.inputs)}.")
        return
    check_signals(problem.system, problem.grid, problem.inputs)
    _refuse_jumps_inside(problem.system)


def _refuse_jumps_inside(system: System) -> None:
    """Refuse a control that jumps in the place of a number: only signals are told on which side of a jump a step is."""
    for field in dataclasses.fields(system):
        inside = () if field.name in system.signal_fields else piecewise_in(getattr(system, field.name))
        if any(one.degree == 0 for one in inside):
            raise ProblemError(
                f"{type(system).__name__}.{field.name}: an al.Control of degree 0 jumps between two steps, and a "
                "number of a model cannot tell on which side a step is. Give it as an input: "
                f'inputs={{"{field.name}": al.Control(...)}}, an argument of rhs and outputs; or use degree=1.'
            )


def _check_time(problem: AbstractProblem) -> None:
    """Refuse functionals over time of a system without time, and `output` of one with time."""
    has_time, name = problem.system.has_time, type(problem.system).__name__
    for functional in functionals_of(problem.expressions):
        if functional.needs_time and not has_time:
            raise ProblemError(
                f"'{functional.text()}' is taken over time, but {name} is algebraic, without time: use "
                f"al.output('{functional.output}')."
            )
        if has_time and not functional.needs_time:
            raise ProblemError(
                f"al.output is for systems without time, but {name} evolves in time: choose a functional, such as "
                f"al.terminal('{functional.output}'), al.path('{functional.output}') or al.rms('{functional.output}')."
            )


def _check_worst_cases(problem: AbstractProblem) -> None:
    """Refuse the worst case of an output in an objective, or in a function of expressions: realisations are limited."""
    composite = [atom for one in problem.expressions for atom in one.atoms if isinstance(atom, AbstractComposite)]
    misplaced = [*problem.objective.leaves, *(part for atom in composite for part in atom.parts)]
    for atom in misplaced:
        if isinstance(atom, Extreme):
            raise ProblemError(
                f"'{atom.text()}' is the worst case of the model, or of its collocation points, which can only be "
                "limited, realisation by realisation, as in .at_most(bound, worst_case=True): it has no place in an "
                "objective, a penalty or a function of expressions. Use a statistic there, such as .quantile(0.99) or "
                ".supremum."
            )


def _check_values(problem: AbstractProblem) -> None:
    numbers = named_numbers(problem.simulation, jax_array(problem.placements.vector("initial")))
    for expression in problem.expressions:
        for atom in expression.leaves:
            if isinstance(atom, Value | CostCurve) and atom.name not in numbers:
                raise ProblemError(_unknown("number of the model", atom.name, list(numbers)))


def _check_germs(problem: AbstractProblem) -> None:
    """Refuse Sobol indices of unknown germ variables, and of those in a correlated group."""
    known = list(problem.placements.germ_names)
    for one in statistics_in(problem.expressions):
        kind = one.kind
        refuse_correlated(problem.placements.distributions, kind)
        named = kind.variables if isinstance(kind, Sobol) else (kind.variable,) if isinstance(kind, TotalSobol) else ()
        for name in named:
            if name not in known:
                raise ProblemError(_unknown("germ variable", name, known))


def _unknown(kind: str, name: str, known: list[str]) -> str:
    return f"There is no {kind} '{name}'; expected one of {known}.{meant(name, known)}"


class Declared(NamedTuple):
    """A problem's equations, and the digest of all that is computed: of these and of its expressions."""

    equations: Equations
    digest: Digest


def declared(problem: AbstractProblem) -> Declared:
    """Trace the equations of a problem; for a deterministic one, of the uncertain one that it stands for.

    Raises `ProblemError` if two traces differ, or if outputs and expressions do not match.
    """
    whole = eqx.tree_at(lambda one: one.simulation, problem, uncertain_again(problem.simulation))
    equations, realisation = _traced(whole)
    refuse_unsteady(type(problem.system).__name__, equations.digest, lambda: _traced(whole)[0].digest)
    instants = len(whole.grid.fractions) if isinstance(whole.grid, Grid) else 1
    outputs = {name: np.zeros((instants, *shape)) for name, shape in equations.output_shapes().items()}
    _check_outputs(whole, outputs)
    expressions = digest_of(_check_shapes(whole, outputs))
    parts = {"realisation": realisation, "equations": equations.digest, "expressions": expressions}
    # A user's own statistics and integrators are in no equations.
    kinds = (type(whole.integrator), *(type(one.kind) for one in statistics_in(whole.expressions)))
    own = {one.__qualname__: Digest(code_digest(one), False) for one in kinds if not is_library(one.__module__)}
    return Declared(equations, joint_digest(parts | own))


def _traced(problem: AbstractProblem) -> tuple[Equations, Digest]:
    """The equations of a realised system, and the digest of how its numbers and signals follow from the problem's."""
    places, found = problem.placements, list[Equations]()
    numbers, static = eqx.partition(numbers_to_arrays(problem.simulation), eqx.is_array)

    def realised(numbers: Any, germ: jax.Array, decisions: jax.Array) -> Any:
        simulation = realise(eqx.combine(numbers, static), germ, decisions)
        found.append(simulation.traced_equations())
        return eqx.filter(numbers_to_arrays((simulation, simulation.start())), eqx.is_array)

    germ, decisions = (jax.ShapeDtypeStruct((size,), float) for size in (len(places.germ_names), places.size))
    closed = jax.make_jaxpr(realised)(numbers, germ, decisions)
    return found[0], digest_of(closed)


def _check_outputs(problem: AbstractProblem, outputs: Mapping[str, np.ndarray]) -> None:
    for functional in functionals_of(problem.expressions):
        for name in functional.outputs:
            if name not in outputs:
                raise ProblemError(_unknown(f"output of {type(problem.system).__name__}", name, list(outputs)))


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
        self._grid = grid_at(problem, jnp.zeros(problem.placements.size))

    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> jax.Array:
        # A statistic has the shape of its functional, without the axis of jointly taken ones.
        del kind
        values = joined([self._evaluated(one) for one in functionals])
        return values if len(functionals) == 1 else values[..., 0]

    def _evaluated(self, functional: AbstractFunctional) -> jax.Array:
        integrals: dict[AbstractFunctional, jax.Array] = {}
        if isinstance(functional, AbstractIntegral):
            now = {name: one[0] for name, one in self._outputs.items()}
            integrals[functional] = traceable(
                f"{type(functional).__name__}.integrand", called(functional, functional.integrand, now)
            )
        taken = Taken(self._outputs, integrals)
        who = f"{type(functional).__name__}.evaluate"
        value = traceable(who, called(functional, functional.evaluate, taken, self._grid))
        instants = len(self._outputs[functional.output])
        if functional.is_path and value.shape[:1] != (instants,):
            raise ProblemError(f"{who}: expected one number per instant, {instants} in all; received {value.shape}.")
        return value

    def time_integral(self, expression: Expression) -> jax.Array:
        return expression.evaluate(self)[0]

    def realised(self, functional: AbstractFunctional) -> jax.Array:
        return self._evaluated(functional)

    def value(self, name: str) -> jax.Array:
        numbers = named_numbers(self._problem.simulation, jnp.zeros(self._problem.placements.size))
        return jnp.ones(jnp.shape(numbers[name]) if name in numbers else ())
