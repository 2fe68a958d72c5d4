"""Square matrices that are zero at known places: found by few tangents, factorised within their band."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.lax import stop_gradient
from jaxtyping import Array, Bool, Float, Int

Vector: TypeAlias = Float[Array, " n"]
Entries: TypeAlias = Float[Array, "n width"]

# A band is worth its loops over rows if the matrix is so many times as wide as what a row of its factors may fill.
_NARROW = 8
# Patterns of more columns are multiplied as sparse ones.
_FEW_COLUMNS = 100


def column_groups(pattern: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, " columns"]:
    """A group for each column, such that none of a group have a row in common: one tangent along all of them tells
    their entries apart (Curtis, Powell and Reid, IMA Journal of Applied Mathematics 13, 1974).
    """
    groups = np.full(pattern.shape[1], -1)
    if len(groups) > _FEW_COLUMNS:
        sparse = scipy.sparse.csc_array(pattern.astype(np.int32))
        table = (sparse.T @ sparse).tocsr()
        met = np.split(table.indices, table.indptr[1:-1])
    else:
        met = map(np.flatnonzero, pattern.T.astype(np.float32) @ pattern)
    for column, others in enumerate(met):
        taken = groups[others]
        groups[column] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    return groups


def seeds_of(groups: Int[np.ndarray, " columns"]) -> Float[np.ndarray, "groups columns"]:
    """A tangent for each group of columns; one at least."""
    return (np.arange(groups.max(initial=0) + 1)[:, None] == groups).astype(float)


class Sparsity(NamedTuple):
    """Where a square matrix may differ from zero, and how its entries are stored.

    - `seeds`: tangents whose images hold all entries; `groups`: the image that has each column;
    - `rows`, `columns`: the place of each stored entry, of shapes (n, 1) and (n, width): in rows of the band, in an
      order in which that is narrow, or all of them; `known`: which of them may differ from zero;
    - `band`: how many diagonals there are below and above the main one; None if all entries are stored.
    """

    seeds: Float[np.ndarray, "groups n"]
    groups: Int[np.ndarray, " n"]
    rows: Int[np.ndarray, "n 1"]
    columns: Int[np.ndarray, "n width"]
    known: Bool[np.ndarray, "n width"]
    band: tuple[int, int] | None

    @classmethod
    def of(cls, pattern: Bool[np.ndarray, "n n"]) -> "Sparsity":
        """That of a matrix which is zero where its pattern is."""
        n, groups = len(pattern), column_groups(pattern)
        if n < _NARROW:
            return cls._full(pattern, groups)
        order = scipy.sparse.csgraph.reverse_cuthill_mckee(scipy.sparse.csr_array(pattern | pattern.T), True)
        lower = np.subtract(*np.nonzero(pattern[order][:, order]))
        below, above = int(lower.max(initial=0)), int(-lower.min(initial=0))
        if _NARROW * (2 * below + above + 1) > n:
            return cls._full(pattern, groups)
        places = np.arange(n)[:, None] + np.arange(-below, above + 1)
        rows, columns = order[:, None], order[np.clip(places, 0, n - 1)]
        known = pattern[rows, columns] & (places >= 0) & (places < n)
        return cls(seeds_of(groups), groups, rows, columns, known, (below, above))

    @classmethod
    def _full(cls, pattern: Bool[np.ndarray, "n n"], groups: Int[np.ndarray, " n"]) -> "Sparsity":
        n = len(pattern)
        return cls(seeds_of(groups), groups, np.arange(n)[:, None], np.tile(np.arange(n), (n, 1)), pattern, None)

    def entries(self, images: Float[Array, "groups n"]) -> Entries:
        """The matrix, from the images of `seeds`."""
        if self.band is None and len(self.seeds) == len(self.groups):  # each column has an image of its own, in order
            images = images.T
        else:
            images = images[self.groups[self.columns], self.rows]
        return images if self.known.all() else jnp.where(self.known, images, 0.0)

    def diagonal(self, numbers: Float[np.ndarray, " n"]) -> Entries:
        """A diagonal matrix."""
        main = np.arange(len(self.rows))[:, None] if self.band is None else self.band[0]
        return jnp.asarray(np.where(np.arange(self.columns.shape[1]) == main, numbers[self.rows], 0.0))

    def solver(self, entries: Entries) -> Callable[[Vector], Vector]:
        """Solves linear equations with a matrix that is factorised once; differentiable to any order."""
        solve = _factorised(stop_gradient(entries), self.band)
        if self.band is None:
            return lambda right: jax.lax.custom_linear_solve(entries.__matmul__, right, lambda _, one: solve(one))
        order = self.rows[:, 0]

        def times(unknowns: Vector) -> Vector:
            return jnp.zeros_like(unknowns).at[order].set(jnp.sum(entries * unknowns[self.columns], axis=1))

        def solved(_: Callable[[Vector], Vector], right: Vector) -> Vector:
            return jnp.zeros_like(right).at[order].set(solve(right[order]))

        return lambda right: jax.lax.custom_linear_solve(times, right, solved)


def _factorised(entries: Entries, band: tuple[int, int] | None) -> Callable[[Vector], Vector]:
    """Solves linear equations by factors with partial pivoting."""
    if len(entries) < _NARROW:
        inverse = _inverse(entries)

        def refined(right: Vector) -> Vector:
            unknowns = inverse @ right
            return unknowns + inverse @ (right - entries @ unknowns)

        return refined
    if band is None:
        factors, _, order = jax.lax.linalg.lu(entries)
        lower = partial(jax.lax.linalg.triangular_solve, factors, left_side=True, lower=True, unit_diagonal=True)
        upper = partial(jax.lax.linalg.triangular_solve, factors, left_side=True)
        return lambda right: upper(lower(right[order][:, None]))[:, 0]
    below, width = band[0], sum(band) + 1

    def pivoted(window: Array, is_pivot: Bool[Array, " rows"]) -> tuple[Array, Array]:
        """The pivot among some rows, and the others, by choices: many loops are faster so than by places."""
        is_pivot = is_pivot.reshape(-1, *(1,) * (window.ndim - 1))
        return jnp.where(is_pivot, window, 0.0).sum(axis=0), jnp.where(is_pivot[1:], window[:1], window[1:])

    def eliminate(window: Array, following: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """The rows in which a column is not zero yet, from that column on; those of the next column."""
        is_pivot = jnp.arange(below + 1) == jnp.argmax(jnp.abs(window[:, 0]))
        top, rest = pivoted(window, is_pivot)
        multiples = rest[:, 0] / top[0]
        rest = jnp.pad(rest[:, 1:] - jnp.outer(multiples, top[1:]), ((0, 0), (0, 1)))
        return jnp.concatenate([rest, following[None]]), (is_pivot, multiples, top)

    def forward(window: Array, row: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        is_pivot, multiples, following = row
        top, rest = pivoted(window, is_pivot)
        return jnp.concatenate([rest - multiples * top, following[None]]), top

    def backward(later: Array, row: tuple[Array, Array]) -> tuple[Array, Array]:
        top, number = row
        unknown = (number - jnp.sum(top[1:] * later)) / top[0]
        return jnp.concatenate([unknown[None], later])[:-1], unknown

    first = np.arange(below + 1)[:, None]
    places = below - first + np.arange(width)
    begin = jnp.where(places < width, entries[first, np.minimum(places, width - 1)], 0.0)
    _, (pivots, multiples, tops) = jax.lax.scan(eliminate, begin, _later(entries, below))

    def solve(right: Vector) -> Vector:
        _, reduced = jax.lax.scan(forward, right[: below + 1], (pivots, multiples, _later(right, below)))
        return jax.lax.scan(backward, jnp.zeros(width - 1), (tops, reduced), reverse=True)[1]

    return solve


def _inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The inverse of a small matrix, by elimination with partial pivoting in a loop over its columns.

    JAX calls LAPACK for factors, one matrix after the other, and loads SciPy for that.
    """
    n = len(matrix)

    def eliminate(carried: tuple[Array, Array], unit: Vector) -> tuple[tuple[Array, Array], Bool[Array, " n"]]:
        rows, is_done = carried
        column = rows[:, :n] @ unit
        is_pivot = jnp.arange(n) == jnp.argmax(jnp.where(is_done, -1.0, jnp.abs(column)))
        top = jnp.where(is_pivot[:, None], rows, 0.0).sum(axis=0) / jnp.where(is_pivot, column, 0.0).sum()
        rows = jnp.where(is_pivot[:, None], top, rows - jnp.outer(column, top))
        return (rows, is_done | is_pivot), is_pivot

    begin = jnp.concatenate([matrix, jnp.eye(n)], axis=1), jnp.zeros(n, bool)
    (rows, _), pivots = jax.lax.scan(eliminate, begin, jnp.eye(n))
    return pivots.astype(float) @ rows[:, n:]


def _later(rows: Array, below: int) -> Array:
    """The row that joins the window at each column; none in the end."""
    return jnp.concatenate([rows[below + 1 :], jnp.zeros((below + 1, *rows.shape[1:]))])
