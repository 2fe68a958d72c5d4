"""Expressions of paths of a system without states: each row depends on one instant, and on few numbers there.

A row of such an expression (a mean torque and its spread at one instant) is a function of some tens of numbers known at
that instant, whatever the number of decisions behind them. Its derivatives by these numbers are taken instant by
instant, and multiplied by the derivatives of the numbers by the decisions, which do not involve the model.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator._core.compilation import Compiled, Use
from aleator.design import (
    AbstractFunctional,
    Expression,
    Extreme,
    Path,
    Problem,
    Statistic,
    Taken,
    extreme_functionals,
    frozen,
    functionals_of,
    has_random_signals,
    numbers_of,
)
from aleator.dynamics import Grid, Known, System, known_at, observed_at
from aleator.expansion import Collocation
from aleator.statistics import Constants
from aleator.transcription._expansions import ExpansionScope, tails_in
from aleator.transcription.sequential._affine import Anchors, affine_features, anchored
from aleator.uncertainty import named_numbers, realise


class Block(NamedTuple):
    """An expression: its values, flattened, the derivatives of these, and the statistics in it, in order."""

    values: Float[Array, " rows"]
    derivatives: Float[Array, "rows n"]
    statistics: tuple[Float[Array, "..."], ...]


def instantaneous(problem: Problem) -> tuple[int, ...]:
    """The indices of a problem's expressions whose rows depend on one instant each; none beside tails, which are
    computed between programs.
    """
    system = problem.system
    if not isinstance(system, System) or system.is_integrated:
        return ()
    if has_random_signals(problem) or tails_in(problem.expressions):
        return ()
    return tuple(i for i, one in enumerate(problem.expressions) if _is_instantaneous(one))


def _is_instantaneous(expression: Expression) -> bool:
    """Whether it consists of statistics of paths, each by itself: no integral, no norm, no number of the model."""
    paths = all(isinstance(one, Path) for one in functionals_of((expression,)))
    return paths and bool(expression.atoms) and all(isinstance(atom, Statistic | Extreme) for atom in expression.atoms)


def instantaneous_rows(
    problem: Problem,
    which: tuple[int, ...],
    collocation: Collocation,
    constants: Constants,
    anchors: Anchors | None,
    decisions: Float[Array, " n"],
) -> tuple[list[Block], dict[AbstractFunctional, Float[Array, "points instants"]]]:
    """The expressions `which` of a problem, instant by instant, and their functionals at the collocation points."""
    expressions = tuple(problem.expressions[i] for i in which)
    fixed, direct = frozen(problem)

    def known(x: Array) -> tuple[Array, Known]:
        now = _known(problem, direct, x)
        return now.rows, now

    inner, now = jax.jacfwd(known, has_aux=True)(decisions)
    instant = _Instant(functionals_of(expressions), fixed, direct, now)
    held = extreme_functionals(expressions)
    sizes: list[int] = []

    def row(numbers: Array) -> tuple[Array, tuple]:
        """All expressions at one instant, from the numbers known there and the decisions in the model itself."""
        samples, coefficients = instant.expanded(collocation, anchors, numbers)
        realised = instant.realised(held, constants.scenarios, numbers)
        named = cache(partial(named_numbers, problem.simulation, decisions))
        scope = ExpansionScope(coefficients, constants, named, scenarios=realised)
        blocks, taken = scope.evaluated(expressions)
        sizes[:] = [one.size for one in blocks]
        values = jnp.concatenate(blocks)
        return values, (values, tuple(samples.values()), taken)

    slopes, (values, samples, taken) = jax.vmap(lambda one: _differentiated(row, one))(now.rows)
    derivatives = jnp.einsum("trk,tkn->trn", slopes, inner)
    parts = (jnp.split(every, np.cumsum(sizes)[:-1], axis=1) for every in (values, derivatives))
    return [
        Block(jnp.ravel(one), along.reshape(-1, decisions.size), own)
        for one, along, own in zip(*parts, taken, strict=True)
    ], dict(zip(instant.functionals, (jnp.moveaxis(one, 1, 0) for one in samples), strict=True))


def _differentiated(
    function: Callable[[Array], tuple[Array, Any]], at: Float[Array, " numbers"]
) -> tuple[Float[Array, "rows numbers"], Any]:
    """The derivatives of a function, and the auxiliary part of its result.

    Intermediate values that the derivatives need, such as sines, are kept behind barriers; otherwise the compiler would
    compute them again for every derivative.
    """
    _, along, auxiliary = jax.linearize(function, at, has_aux=True)
    along = jax.tree.map(_kept, along)
    return jax.vmap(along, out_axes=-1)(jnp.eye(at.size)), auxiliary


def _kept(leaf: Array) -> Array:
    # Matrices are left out: as sums and products of other values, they cost more to keep than to recompute. One barrier
    # for all would make each wait for all others: it doubles the time of an evaluation.
    return jax.lax.optimization_barrier(leaf) if jnp.issubdtype(leaf.dtype, jnp.floating) and leaf.ndim <= 1 else leaf


def anchors_of(problem: Problem, collocation: Collocation, decisions: Float[np.ndarray, " n"]) -> Anchors | None:
    """The collocation points at which a traced problem's instantaneous functionals are evaluated; None for all."""
    which = instantaneous(problem)
    if not which or collocation.points.size == 0:
        return None
    features, affine = map(np.asarray, FEATURES(problem, which, collocation.points, jax_array(decisions)))
    if not affine.any():
        return None
    return anchored(np.asarray(collocation.points), features, affine.tolist())


def _features(
    problem: Problem, which: tuple[int, ...], points: Float[Array, "points variables"], decisions: Float[Array, " n"]
) -> tuple[Float[Array, "points features"], Array]:
    """The features, at all points, in which functionals are affine, and which functionals are."""
    fixed, direct = frozen(problem)
    now = _known(problem, direct, decisions)
    instant = _Instant(functionals_of(tuple(problem.expressions[i] for i in which)), fixed, direct, now)
    affine = []

    def at(point: Array) -> Array:
        features, yes = affine_features(lambda *both: instant.at(instant.functionals, *both), point, now.rows[0])
        affine[:] = yes
        return features

    return jax.vmap(at)(points), jnp.array(affine)


FEATURES = Compiled(_features, use=Use.BRIEF)


@final
@dataclass(frozen=True)
class _Instant:
    """The functionals of some expressions at one instant, as functions of a germ point and of a row of numbers.

    - `frozen`, `direct`: see `frozen`; `known`: the numbers known at the instants, one row each, and those of the
      decisions in the model itself.
    """

    functionals: tuple[AbstractFunctional, ...]
    frozen: Problem
    direct: np.ndarray
    known: Known

    def at(
        self, functionals: Sequence[AbstractFunctional], point: Float[Array, " variables"], numbers: Array
    ) -> tuple[Array, ...]:
        """Some functionals of one system of the family."""
        now, chosen = jnp.split(numbers, [numbers.size - len(self.direct)])
        system = realise(self.frozen.simulation, point, chosen).traced
        assert isinstance(system, System)
        system = system.focused({name for one in functionals for name in one.outputs})
        taken = Taken(observed_at(system, self.known, now), {})
        return numbers_of(functionals, taken, self.frozen.grid)

    def realised(
        self,
        held: tuple[AbstractFunctional, ...],
        scenarios: Float[Array, "scenarios variables"] | None,
        numbers: Array,
    ) -> dict[AbstractFunctional, Float[Array, " scenarios"]]:
        """Some functionals at the scenarios of the worst case."""
        if scenarios is None or not held:
            return {}
        return dict(zip(held, jax.vmap(lambda point: self.at(held, point, numbers))(scenarios), strict=True))

    def expanded(
        self, collocation: Collocation, anchors: Anchors | None, numbers: Array
    ) -> tuple[dict[AbstractFunctional, Float[Array, " points"]], dict[AbstractFunctional, Float[Array, " terms"]]]:
        """All functionals at all collocation points, and the coefficients of their expansions.

        Affine ones are evaluated at the anchors only, and their coefficients follow from these directly, so that their
        derivatives at all points are never needed.
        """
        affine = anchors.affine if anchors else (False,) * len(self.functionals)
        samples: dict[AbstractFunctional, Array] = {}
        coefficients: dict[AbstractFunctional, Array] = {}

        def solve(which: bool, points: Array, spread: Callable[[Array], Array], fit: Array) -> None:
            some = [one for one, yes in zip(self.functionals, affine, strict=True) if yes is which]
            results = jax.vmap(lambda point: self.at(some, point, numbers))(points) if some else ()
            for one, values in zip(some, results, strict=True):
                samples[one], coefficients[one] = spread(values), fit @ values

        solve(False, collocation.points, lambda values: values, collocation.pseudo_inverse)
        if anchors:
            fit = collocation.coefficients(anchors.weights)
            solve(True, anchors.points, lambda values: anchors.weights @ values, fit)
        return {one: samples[one] for one in self.functionals}, coefficients


def _known(problem: Problem, direct: np.ndarray, decisions: Float[Array, " n"]) -> Known:
    """What is known at each instant, followed by the decisions in the model itself."""
    simulation = realise(problem.simulation, jnp.zeros(len(problem.placements.germ_names)), decisions)
    system, grid = simulation.traced, simulation.grid
    assert isinstance(system, System)
    assert isinstance(grid, Grid)
    known = known_at({**system.signals(), **simulation.inputs}, grid)
    chosen = jnp.broadcast_to(decisions[direct], (len(known.rows), len(direct)))
    return Known(jnp.concatenate([known.rows, chosen], axis=1), known.inputs)
