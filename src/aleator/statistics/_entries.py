"""Statistics of many outputs, such as the instants of a path, with their gradients.

Each costs milliseconds by lines. Of a path only those entries are taken so that a limit may be decided by, a few of
hundreds; others are taken by points that all outputs share, some hundred times as fast. There is a smooth transition.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from aleator.statistics._lines import SINGLE, AnyLines
from aleator.statistics._output_distribution import Estimate, OutputDistribution, TailByPoints, TailOf
from aleator.statistics._statistic import Std, in_blocks
from aleator.statistics._tail_in_elements import lower_tail

# Points are evaluated for so many entries at once.
_TOGETHER = 64
# By how many standard deviations an entry may be apart from the one that decides to be taken by lines alone; more for a
# tail further out, about which the mean and the spread say less (from Cornish and Fisher's second term).
_NEAR, _NEARER = 0.1, 0.125


def rows_of(
    kinds: Sequence[Any], coefficients: Sequence[Float[Array, "terms *shape"]]
) -> Float[Array, "columns entries"]:
    """The coefficients of all entries of some paths, followed by the numbers of their statistics."""
    each = []
    for kind, terms in zip(kinds, coefficients, strict=True):
        numbers = [jnp.full((1, *terms.shape[1:]), number, dtype=float) for number in jax.tree.leaves(kind)]
        each.append(jnp.concatenate([terms, *numbers]).reshape(len(terms) + len(numbers), -1))
    return jnp.concatenate(each, axis=1)


def _split(structure: Any, rows: Float[Array, "columns *n"]) -> tuple[Any, Float[Array, "terms *n"]]:
    terms = len(rows) - structure.num_leaves
    return jax.tree.unflatten(structure, list(rows[terms:])), rows[:terms]


@partial(jax.custom_jvp, nondiff_argnums=(0, 3))
def statistics_of_rows(
    structure: Any, rows: Float[Array, "columns entries"], lines: AnyLines, paths: int
) -> Float[Array, " entries"]:
    """The statistic of each entry of some paths of one length, with kinds of one structure."""
    return _evaluated(_of_row, structure, rows, lines, paths)[0]


@statistics_of_rows.defjvp
def _with_tangents(
    structure: Any, paths: int, primals: tuple[Array, AnyLines], tangents: tuple[Array, Any]
) -> tuple[Array, Array]:
    """The gradient is found once, together with the statistic: a tangent costs one sum."""
    results = _evaluated(jax.value_and_grad(_of_row, argnums=1), structure, *primals, paths)
    return results[0], jnp.sum(results[1:] * tangents[0], axis=0)


def estimate_of_row(structure: Any, row: Float[Array, " columns"], tail_of: TailOf) -> Estimate:
    """The statistic of an entry, and its error."""
    kind, terms = _split(structure, row)
    return kind.of_distribution(OutputDistribution(terms, tail_of))


def _of_row(structure: Any, row: Float[Array, " columns"], tail_of: TailOf) -> Float[Array, ""]:
    return estimate_of_row(structure, row, tail_of).value


def _evaluated(
    function: Callable[..., Any], structure: Any, rows: Array, lines: AnyLines, paths: int
) -> Float[Array, "results entries"]:
    """The results of a function of each row."""
    entries = rows.shape[1] // paths
    lines, of_row = lines.for_one_of(entries), partial(function, structure)
    if entries <= SINGLE:
        return by_lines(of_row, rows, lines)
    kinds, terms = jax.tree.map(lambda each: each.reshape(*each.shape[:-1], paths, -1), _split(structure, rows))
    apart, away = kinds.apart(terms[0], Std().of(terms, ()))
    share = jnp.nan_to_num(jnp.clip(2 - apart / (_NEAR + _NEARER * away**2), 0.0, 1.0)).ravel()
    share = jax.lax.stop_gradient(share**2 * (3 - 2 * share))
    by_points = jax.vmap(lambda row: _flat(of_row(row, partial(TailByPoints.of, cloud=lines.cloud))))
    coarse = in_blocks(by_points, rows, _TOGETHER).T
    fine = by_lines(of_row, rows, lines, (coarse, jnp.argsort(-share), jnp.sum(share > 0)))
    return coarse + share[None] * (fine - coarse)


def _flat(results: Any) -> Float[Array, " results"]:
    return jnp.hstack(jax.tree.leaves(results))


def by_lines(
    function: Callable[[Float[Array, " columns"], TailOf], Any],
    rows: Float[Array, "columns entries"],
    lines: AnyLines,
    some: tuple[Float[Array, "results entries"], Int[Array, " entries"], Int[Array, ""]] | None = None,
) -> Float[Array, "results entries"]:
    """The results of a function of each row by lines, one after the other.

    - `some`: the results of other rows, an order, and how many of the first in this order are taken.
    """

    def each(row: Float[Array, " columns"]) -> Float[Array, " results"]:
        return _flat(function(row, partial(lower_tail, lines=lines)))

    count = rows.shape[1]
    if count == 1:
        return each(rows[:, 0])[:, None]
    if some is None:
        return jax.lax.map(each, rows.T).T
    results, order, taken = some

    def evaluate(k: Int[Array, ""], results: Array) -> Array:
        return results.at[:, order[k]].set(each(rows[:, order[k]]))

    return jax.lax.fori_loop(0, taken, evaluate, results)
