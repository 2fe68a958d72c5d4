"""Assembly: from blocks to the sparse Jacobian and Hessian of a program, whose patterns are known by construction.

The constraints of a simultaneous program are `L z + C r(z)`: constant matrices, and the rows `r` of its blocks. So the
entries of the Jacobian are linear in those of the blocks' Jacobians, and the entries of the Hessian are sums of those
of the blocks' Hessians, by constant matrices that are put together once.
"""

import math
from dataclasses import dataclass
from typing import Any, final

import numpy as np
import scipy
from jaxtyping import Float, Int

from aleator.nlp import SparseMatrix, with_entries
from aleator.transcription.simultaneous._blocks import Family


@final
@dataclass(frozen=True)
class Pattern:
    """Which variables the blocks of a family are given, how they depend on them, and where their rows stand among all.

    - `columns`: shape (outer, inner, columns); `rows`: shape (outer, inner, rows);
    - `slopes`: the entries of a block's Jacobian that may differ from zero, among all row by row; `bends`: those of
      its Hessian's lower triangle.
    """

    columns: Int[np.ndarray, "outer inner columns"]
    rows: Int[np.ndarray, "outer inner rows"]
    slopes: Int[np.ndarray, " slopes"]
    bends: Int[np.ndarray, " bends"]

    @classmethod
    def of(cls, family: Family, first: int) -> "Pattern":
        """That of a family which holds the numbers of its variables, from the first number of a row on."""
        shared, own = np.asarray(family.shared), np.asarray(family.own)
        shared, depends = np.broadcast_to(shared, (*own.shape[:2], shared.size)), family.dependence
        shape = *own.shape[:2], len(depends.first)
        rows = np.arange(first, first + math.prod(shape)).reshape(shape)
        columns = np.concatenate([shared, own], axis=2)
        return cls(columns, rows, np.flatnonzero(depends.first), np.flatnonzero(np.tril(depends.second)))

    @property
    def slopes_shape(self) -> tuple[int, ...]:
        """That of the entries of all blocks' Jacobians."""
        return *self.rows.shape[:2], self.slopes.size

    @property
    def bends_shape(self) -> tuple[int, ...]:
        """That of the entries of the Hessians' lower triangles."""
        return *self.rows.shape[:2], self.bends.size

    @property
    def entries(self) -> tuple[np.ndarray, np.ndarray]:
        """The row and the column of each entry of the Jacobians, block by block."""
        rows, columns = np.divmod(self.slopes, max(self.columns.shape[2], 1))
        return self.rows[..., rows].ravel(), self.columns[..., columns].ravel()

    @property
    def lower(self) -> tuple[np.ndarray, np.ndarray]:
        """The row and the column of each entry of the Hessians' lower triangles, in the program's own."""
        first, second = np.divmod(self.bends, max(self.columns.shape[2], 1))
        one, other = self.columns[..., first].ravel(), self.columns[..., second].ravel()
        return np.maximum(one, other), np.minimum(one, other)

    def full(self, entries: Float[np.ndarray, " entries"]) -> Float[np.ndarray, "outer inner rows columns"]:
        """The Jacobians of all blocks, from their entries."""
        shape = *self.rows.shape, self.columns.shape[2]
        found = np.zeros((*shape[:2], shape[2] * shape[3]))
        found[..., self.slopes] = entries.reshape(self.slopes_shape)
        return found.reshape(shape)


@final
@dataclass(frozen=True)
class Jacobian:
    """The Jacobian of `L z + C r(z)`.

    - `sparsity`: its pattern; `constant`: the entries of `L` in it; `gather`: gives, of the entries of the blocks'
      Jacobians, what they add.
    """

    sparsity: SparseMatrix
    constant: Float[np.ndarray, " entries"]
    gather: SparseMatrix

    @classmethod
    def of(cls, linear: SparseMatrix, combined: SparseMatrix, patterns: list[Pattern]) -> "Jacobian":
        """That of constant matrices and blocks, with the rows of `linear` in the order of the constraints."""
        count = linear.shape[1]
        rows, columns = (np.concatenate(parts) for parts in zip(*(one.entries for one in patterns), strict=True))
        # Every entry of a block's row goes wherever that row does.
        order = np.argsort(rows, kind="stable")
        starts = np.searchsorted(rows[order], np.arange(combined.shape[1] + 1))
        terms = combined.tocoo()
        sizes = np.diff(starts)[terms.col]
        which = np.repeat(np.arange(terms.nnz), sizes)
        inside = np.arange(sizes.sum()) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        entry = order[starts[terms.col][which] + inside]
        keys = terms.row[which].astype(np.int64) * count + columns[entry]
        known = linear.tocoo()
        own = known.row.astype(np.int64) * count + known.col
        every, places = np.unique(np.concatenate([own, keys]), return_inverse=True)
        constant = np.bincount(places[: own.size], known.data, minlength=every.size)
        adding = terms.data[which], (places[own.size :], entry)
        gather = scipy.sparse.csr_array(adding, shape=(every.size, rows.size))
        return cls(_pattern(every, linear.shape), constant, gather)

    def at(self, entries: Float[np.ndarray, " block_entries"]) -> SparseMatrix:
        """The matrix, from the entries of the blocks' Jacobians."""
        return with_entries(self.sparsity, self.constant + self.gather @ entries)


@final
@dataclass(frozen=True)
class Curvature:
    """The lower triangle of the Hessian of a Lagrangian: a sum of blocks."""

    sparsity: SparseMatrix
    gather: SparseMatrix

    @classmethod
    def of(cls, patterns: list[Pattern], count: int) -> "Curvature":
        """That of all blocks, for so many variables."""
        rows, columns = (np.concatenate(parts) for parts in zip(*(one.lower for one in patterns), strict=True))
        every, places = np.unique(rows.astype(np.int64) * count + columns, return_inverse=True)
        taken = (np.ones(rows.size), (places, np.arange(rows.size)))
        gather = scipy.sparse.csr_array(taken, shape=(every.size, rows.size))
        return cls(_pattern(every, (count, count)), gather)

    def at(self, entries: Float[np.ndarray, " block_entries"]) -> SparseMatrix:
        """The matrix, from the entries of the blocks' Hessians."""
        return with_entries(self.sparsity, self.gather @ entries)


def matrix(entries: list[tuple[Any, Any, Any]], shape: tuple[int, int]) -> SparseMatrix:
    """A sparse matrix from the rows, columns and numbers of its entries: arrays that are broadcast, several times."""
    parts = [tuple(np.ravel(one) for one in np.broadcast_arrays(*some)) for some in entries]
    rows, columns, numbers = (np.concatenate([np.zeros(0), *some]) for some in zip(*parts, strict=True))
    return scipy.sparse.coo_array((numbers, (rows.astype(int), columns.astype(int))), shape=shape).tocsr()


def _pattern(keys: Int[np.ndarray, " entries"], shape: tuple[int, int]) -> SparseMatrix:
    rows, columns = np.divmod(keys, shape[1])
    starts = np.searchsorted(rows, np.arange(shape[0] + 1))
    found = scipy.sparse.csr_array((np.ones(keys.size, dtype=bool), columns, starts), shape=shape)
    found.has_canonical_format = True
    return found
