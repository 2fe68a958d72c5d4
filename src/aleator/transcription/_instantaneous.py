"""Expressions of paths of a system without states: their rows depend on one instant each, and on few numbers there.

A row of such an expression (a mean torque and its spread, at one instant) is a function of what is known at that
instant, some tens of numbers, whatever the number of decisions behind them. Its derivatives by these numbers are taken
instant by instant, and multiplied with the derivatives of the numbers by the decisions, which no model takes part in.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import decided_bounds
from aleator.collocation import Collocation
from aleator.design import AbstractFunctional, Expression, Path, Problem, Statistic, functionals_of
from aleator.dynamics import Grid, Known, System, known_at, observation, observed_at
from aleator.statistics import Constants
from aleator.transcription._scope import ExpansionScope
from aleator.uncertainty import named_numbers, realise, survey


class Rows(NamedTuple):
    """Some expressions over all instants.

    - `values`, `derivatives`: of each, shapes (rows,) and (rows, n);
    - `samples`: each of their functionals at the collocation points, shape (points, instants);
    - `statistics`: those of each expression, in order.
    """

    values: tuple[Float[Array, " rows"], ...]
    derivatives: tuple[Float[Array, "rows n"], ...]
    samples: dict[AbstractFunctional, Float[Array, "points instants"]]
    statistics: tuple[tuple[Float[Array, " instants"], ...], ...]


def instantaneous(problem: Problem) -> tuple[int, ...]:
    """Which of a problem's expressions depend on one instant a row."""
    system = problem.system
    if not (isinstance(system, System) and isinstance(problem.grid, Grid)) or system.states:
        return ()
    signals = [getattr(system, name) for name in system.signal_fields]
    if survey((signals, problem.inputs)).distributions:
        return ()
    return tuple(i for i, one in enumerate(problem.expressions) if _is_instantaneous(one))


def _is_instantaneous(expression: Expression) -> bool:
    """Whether it consists of statistics of paths, each by itself: no integral, no norm, no number of the model."""
    paths = all(isinstance(one, Path) for one in functionals_of((expression,)))
    return paths and bool(expression.atoms) and all(isinstance(atom, Statistic) for atom in expression.atoms)


def instantaneous_rows(
    problem: Problem,
    which: tuple[int, ...],
    collocation: Collocation,
    constants: Constants,
    decisions: Float[Array, " n"],
) -> Rows:
    """The expressions `which` of a problem and their derivatives, instant by instant."""
    expressions = tuple(problem.expressions[i] for i in which)
    functionals = functionals_of(expressions)
    frozen, direct = _frozen(problem)
    needed = {name for one in functionals for name in one.outputs}

    def known(x: Array) -> Known:
        system, inputs, grid = realise(problem.model, jnp.zeros(len(problem.survey.germ_names)), x)
        return known_at(system.focused(needed), grid, inputs)

    at = known(decisions)

    def row(numbers: Array) -> tuple[Array, tuple]:
        """All expressions at one instant, from what is known there and the decisions that act on the model itself."""
        now, chosen = numbers[: at.rows.shape[1]], numbers[at.rows.shape[1] :]

        def one(point: Array) -> tuple[Array, ...]:
            system = realise(frozen.model, point, chosen).system.focused(needed)
            outputs = observed_at(system, at, now, observation)
            return tuple(functional.evaluate(outputs, problem.grid) for functional in functionals)

        samples = dict(zip(functionals, jax.vmap(one)(collocation.points), strict=True))
        weights = jnp.ones(1)  # no expression of these integrates over time
        scope = ExpansionScope(samples, collocation, constants, named_numbers(problem.model, decisions), weights)
        values, taken = scope.evaluated(expressions)
        return jnp.concatenate(values), (tuple(samples.values()), taken)

    chosen = decisions[direct]
    numbers = jnp.concatenate([at.rows, jnp.broadcast_to(chosen[None], (len(at.rows), len(direct)))], axis=1)
    values, (samples, taken) = jax.vmap(row)(numbers)
    slopes = jax.vmap(jax.jacfwd(lambda x: row(x)[0]))(numbers)
    inner = jax.jacfwd(lambda x: known(x).rows)(decisions)
    derivatives = jnp.einsum("trk,tkn->trn", slopes[..., : at.rows.shape[1]], inner)
    derivatives = derivatives.at[..., direct].add(slopes[..., at.rows.shape[1] :])
    return Rows(
        tuple(values.T),
        tuple(jnp.moveaxis(derivatives, 1, 0)),
        dict(zip(functionals, (jnp.moveaxis(one, 1, 0) for one in samples), strict=True)),
        taken,
    )


def _frozen(problem: Problem) -> tuple[Problem, np.ndarray]:
    """The problem without the decisions of its signals and its final time, and where the others are in `x`."""

    def plain(leaf: Any) -> Any:
        return jnp.asarray(leaf.initial) if decided_bounds(leaf) is not None else leaf

    def still(tree: Any) -> Any:
        return jax.tree.map(plain, tree, is_leaf=lambda leaf: decided_bounds(leaf) is not None)

    system = problem.system
    for name in system.signal_fields:  # type: ignore[union-attr]
        system = eqx.tree_at(lambda tree, name=name: getattr(tree, name), system, still(getattr(system, name)))
    parts = system, still(problem.inputs), still(problem.grid)
    frozen = eqx.tree_at(lambda tree: (tree.system, tree.inputs, tree.grid), problem, parts)
    places = problem.survey.decisions
    where = [np.arange(places[name].where.start, places[name].where.stop) for name in frozen.survey.decisions]
    return frozen, np.concatenate([np.zeros(0, dtype=int), *where])
