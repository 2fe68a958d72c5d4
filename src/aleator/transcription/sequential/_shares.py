"""The contributions of collocation points to a problem's expansions, and the combination of all contributions.

Simulation takes almost all the time of an evaluation, and points are independent until coefficients are formed, which
are sums over the points. So a large problem is simulated in parts, one per core, each of which gives its share of the
coefficients, with derivatives; the rest of the work is small.
"""

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator.design import AbstractFunctional, Expression, Problem, functionals_of
from aleator.dynamics import Grid
from aleator.expansion import Collocation
from aleator.statistics import Constants
from aleator.transcription._resolution import seen
from aleator.transcription._scope import Terms, scope_from, simulated

# Fewest points per part that are worth the overhead of a time step, and fewest numbers worth that of threads.
_FEWEST_POINTS, _FEWEST_NUMBERS = 16, 200_000
# Two parts, unless there are points enough for more.
_POINTS_OF_A_PART, _MOST_PARTS = 128, 8


class Share(NamedTuple):
    """The contribution of some points.

    - `samples`: each functional at the points; `finite`: whether all of these are;
    - `tangents`: the derivatives of samples (of a path at a few instants) by the decisions that are parameters of
      distributions; None if there are no such decisions;
    - `terms`: the points' share of the terms of expressions; `slopes`: its derivatives by the decisions, along a first
      axis of each array.
    """

    samples: tuple[Float[Array, "points ..."], ...]
    finite: Bool[Array, ""]
    tangents: tuple[Float[Array, "points ... parameters"] | None, ...]
    terms: Terms
    slopes: Terms


class Combined(NamedTuple):
    """Some expressions: their values, flattened, the derivatives of these, and the statistics in each, in order."""

    values: tuple[Float[Array, " rows"], ...]
    derivatives: tuple[Float[Array, "rows n"], ...]
    statistics: tuple[tuple[Float[Array, "..."], ...], ...]


class Part(NamedTuple):
    """Some of the collocation points, and the columns of the pseudo-inverse that belong to them."""

    points: Float[np.ndarray, "points variables"]
    fit: Float[np.ndarray, "terms points"]


def share_of(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    points: Float[Array, "points variables"],
    fit: Float[Array, "terms points"],
    scenarios: Float[Array, "scenarios variables"] | None,
    decisions: Float[Array, " n"],
) -> Share:
    """The contribution of some points, and of the scenarios of the worst case, to expressions of some functionals.

    Derivatives are computed in forward mode: few decisions, thousands of rows.
    """
    parameters = tuple(problem.placements.of_distributions.values())

    def contributed(x: Array) -> tuple[tuple[Terms, tuple], tuple]:
        samples, terms = simulated(problem, functionals, points, fit, scenarios, x)
        looked_at = [seen(values, one.is_path) for one, values in zip(functionals, samples, strict=True)]
        return (terms, tuple(looked_at) if parameters else ()), samples

    def along(direction: Array) -> tuple[Any, Any, Any]:
        return jax.jvp(contributed, (decisions,), (direction,), has_aux=True)

    # Tangents along the first axis: along the last one, inner loops would run over the shortest of all axes.
    (terms, _), (slopes, looked_at), samples = jax.vmap(along, out_axes=(None, 0, None))(jnp.eye(decisions.size))
    of_distributions = tuple(jnp.moveaxis(one, 0, -1)[..., jnp.array(parameters)] for one in looked_at)
    finite = jnp.array([jnp.isfinite(one).all() for one in samples]).all()
    return Share(samples, finite, of_distributions or (None,) * len(functionals), terms, slopes)


def combined(
    problem: Problem,
    expressions: tuple[Expression, ...],
    constants: Constants,
    terms: Terms,
    slopes: Terms,
    decisions: Float[Array, " n"],
) -> Combined:
    """Expressions from the terms of all points, with derivatives by the chain rule."""
    functionals = functionals_of(expressions)

    def rows(terms: Terms, x: Array) -> tuple[tuple[Array, ...], tuple]:
        return scope_from(problem, functionals, (), terms, constants, x).evaluated(expressions)

    def along(slope: Terms, direction: Array) -> tuple[Any, Any, Any]:
        return jax.jvp(rows, (terms, decisions), (slope, direction), has_aux=True)

    every = jnp.eye(decisions.size)
    values, derivatives, taken = jax.vmap(along, out_axes=(None, 0, None))(slopes, every)
    return Combined(values, tuple(one.T for one in derivatives), taken)


def added(shares: tuple[Any, ...]) -> Any:
    """The sum over all parts of terms or slopes."""
    return reduce(lambda one, other: jax.tree.map(jnp.add, one, other), shares)


def parts_of(problem: Problem, collocation: Collocation, constants: Constants) -> tuple[Part, ...]:
    """The collocation points in parts of one size if simulating them takes long enough, else one part.

    The number of parts follows from the problem alone, so that digits do not depend on the number of cores. The last
    part is filled up with copies of its last point, which contribute nothing.
    """
    points, fit = np.asarray(collocation.points), np.asarray(collocation.pseudo_inverse)
    grid, count = problem.grid, len(points)
    tangents = 1 + problem.placements.size
    whole = not (problem.is_integrated and isinstance(grid, Grid)) or constants.scenarios is not None
    if whole or count < 2 * _FEWEST_POINTS or count * grid.steps * tangents < _FEWEST_NUMBERS:
        return (Part(points, fit),)
    number = min(max(2, count // _POINTS_OF_A_PART), _MOST_PARTS)
    size = -(-count // number)
    missing = size * number - count
    points = np.concatenate([points, np.repeat(points[-1:], missing, axis=0)])
    fit = np.concatenate([fit, np.zeros((len(fit), missing))], axis=1)
    return tuple(
        Part(one, columns) for one, columns in zip(np.split(points, number), np.split(fit, number, axis=1), strict=True)
    )
