"""Assembly: from blocks to a program's rows and their sparse derivatives, whose patterns are known by construction.

The constraints of a simultaneous program are `L z + C r(z)`: constant matrices, and the rows `r` of its blocks. They
are the problem's own, then those that tie lifted variables to what they stand for. So the entries of the Jacobian are
linear in those of the blocks' Jacobians, and the entries of the Hessian are sums of those of the blocks' Hessians, by
constant matrices that are put together once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, final

import numpy as np
import scipy
from jax.extend.core import ClosedJaxpr
from jaxtyping import Float, Int

from aleator._core.dependence import Dependence
from aleator.nlp import SparseMatrix, with_entries
from aleator.transcription.simultaneous._blocks import Family
from aleator.transcription.simultaneous._families import EQUATIONS, KNOWN, RATES, number_of, objective_of
from aleator.transcription.simultaneous._layout import Layout


@final
@dataclass(frozen=True)
class Pattern:
    """Which variables the blocks of a family are given, how they depend on them, and where their rows stand among all.

    - `columns`: shape (outer, inner, columns); `rows`: shape (outer, inner, rows);
    - `slopes`: the entries of a block's Jacobian that may differ from zero, among all row by row; `bends`: those of
      its Hessian's lower triangle; `affine`: the equations of a block if the former are the same everywhere.
    """

    columns: Int[np.ndarray, "outer inner columns"]
    rows: Int[np.ndarray, "outer inner rows"]
    slopes: Int[np.ndarray, " slopes"]
    bends: Int[np.ndarray, " bends"]
    affine: ClosedJaxpr | None

    @classmethod
    def of(cls, family: Family, depends: Dependence, first: int) -> "Pattern":
        """That of a family which holds the numbers of its variables, from the first number of a row on."""
        shared, own = np.asarray(family.shared), np.asarray(family.own)
        shared = np.broadcast_to(shared, (*own.shape[:2], shared.size))
        shape = *own.shape[:2], len(depends.first)
        rows = np.arange(first, first + math.prod(shape)).reshape(shape)
        columns = np.concatenate([shared, own], axis=2)
        bends = np.flatnonzero(np.tril(depends.second))
        return cls(columns, rows, np.flatnonzero(depends.first), bends, depends.affine)

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
        every = np.zeros((*shape[:2], shape[2] * shape[3]))
        every[..., self.slopes] = entries.reshape(self.slopes_shape)
        return every.reshape(shape)


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


def _matrix(entries: list[tuple[Any, Any, Any]], shape: tuple[int, int]) -> SparseMatrix:
    """A sparse matrix from the rows, columns and numbers of its entries: arrays that are broadcast, several times."""
    parts = [tuple(np.ravel(one) for one in np.broadcast_arrays(*some)) for some in entries]
    rows, columns, numbers = (np.concatenate([np.zeros(0), *some]) for some in zip(*parts, strict=True))
    return scipy.sparse.coo_array((numbers, (rows.astype(int), columns.astype(int))), shape=shape).tocsr()


def _pattern(keys: Int[np.ndarray, " entries"], shape: tuple[int, int]) -> SparseMatrix:
    rows, columns = np.divmod(keys, shape[1])
    starts = np.searchsorted(rows, np.arange(shape[0] + 1))
    pattern = scipy.sparse.csr_array((np.ones(keys.size, dtype=bool), columns, starts), shape=shape)
    pattern.has_canonical_format = True
    return pattern


def without_affine(
    layout: Layout,
    families: Sequence[Family],
    patterns: Sequence[Pattern],
    signals: Sequence[tuple[Float[np.ndarray, " known"], SparseMatrix]],
) -> tuple[Float[np.ndarray, " rows"], SparseMatrix, list[Pattern]]:
    """What affine blocks say, the rows of all where variables are zero and how these act on them, and the patterns of
    what is left to be evaluated.

    - `signals`: see `affine_signals`, of each phase; none where they are evaluated.

    Blocks that grow with the mesh are left: their rates are asked for elsewhere too.
    """
    phases, left, entries = len(layout.phases), list(patterns), list[tuple[Any, Any, Any]]()
    constant, first = np.zeros(sum(one.rows.size for one in patterns)), 0
    for known, slopes in signals:
        constant[first : first + known.size] = known
        acting = slopes.tocoo()
        entries.append((first + acting.row, layout.numbers.decisions[acting.col], acting.data))
        first += known.size
    growing = [number_of(kind, i, phases) for kind in (KNOWN, RATES, EQUATIONS) for i in range(phases)]
    for i, (family, pattern) in enumerate(zip(families, patterns, strict=True)):
        equations = pattern.affine if pattern.rows.size and i not in growing else None
        known = None if equations is None else family.affine(equations, pattern.slopes)
        if known is None or not all(np.isfinite(one).all() for one in known):
            left[i] = replace(pattern, affine=None)
            continue
        constant[pattern.rows], slopes = known
        entries.append((*pattern.entries, slopes.ravel()))
        left[i] = replace(pattern, slopes=pattern.slopes[:0])
    return constant, _matrix(entries, (constant.size, layout.count)), left


class Ties(NamedTuple):
    """Equalities that together determine as many variables from all others: their rows and variables, shape (ties,).

    Which row belongs to which variable matters little, but a block of rows must determine the block of their variables.
    """

    rows: Int[np.ndarray, " ties"]
    variables: Int[np.ndarray, " ties"]


@final
@dataclass(frozen=True)
class Rows:
    """The constraints `L z + C r(z)` of a program: `linear`, `combined`.

    - `own`: the rows of each of the problem's constraints; `ties`: the others, each with the variable that stands for
      something else (of the two states of an interval, the later one; of the equations of algebraic variables, each
      one in turn).
    """

    linear: SparseMatrix
    combined: SparseMatrix
    own: tuple[slice, ...]
    ties: Ties


def rows_of(
    layout: Layout,
    blocks: list[Int[np.ndarray, "..."]],
    fit: Float[np.ndarray, "terms points"],
    affine: SparseMatrix,
) -> Rows:
    """The rows of a program.

    - `blocks`: the number of each row of each family's blocks, in the order of `Families.every`;
    - `fit`: see `Collocation.pseudo_inverse`;
    - `affine`: how variables act on the rows of blocks beside what these compute.
    """
    phases, constraints = len(layout.phases), len(layout.problem.constraints)
    objective = objective_of(phases)
    kinds = [blocks[first : first + phases] for first in range(0, objective, phases)]
    others = blocks[objective + 1 :]
    limits, integrands = others[:constraints], others[constraints:]
    variables = layout.numbers
    linear, combined, stands_for, own = [], [], [], []
    count = 0

    def take(shape: tuple[int, ...]) -> Int[np.ndarray, "..."]:
        """The numbers of the next rows, in an array of a shape."""
        nonlocal count
        first, count = count, count + math.prod(shape)
        return np.arange(first, count).reshape(shape)

    for one in limits:
        rows = take((one.size,))
        combined.append((rows, one.ravel(), 1.0))
        own.append(slice(int(rows[0]), int(rows[-1]) + 1) if one.size else slice(count, count))

    def tied(these: Any, to: Any) -> None:
        """Variables that are rows of blocks."""
        rows = take(np.shape(these))
        linear.append((rows, these, 1.0))
        combined.append((rows, np.reshape(to, np.shape(these)), -1.0))
        stands_for.append(np.ravel(these))

    decided = ~np.isin(layout.known, layout.fixed)
    known, *of_phases = kinds
    tied(layout.known[decided], np.concatenate([one.ravel() for one in known])[decided])
    for phase, part, families in zip(layout.phases, variables.phases, zip(*of_phases, strict=True), strict=True):
        initial, rates, equations, paths, ends, composed, nodes, levels = families
        mesh, states = phase.mesh, part.states.shape[2]
        tied(part.states[:, 0], initial[:, 0])
        lengths, scheme = mesh.lengths, mesh.scheme
        ends_of = part.states[:, mesh.points]
        rows = take(ends_of[:, :, 1:].shape)
        linear += [(rows, ends_of[:, :, 1:], 1.0), (rows, ends_of[:, :, :1], -1.0)]
        stands_for.append(ends_of[:, :, 1:].ravel())
        stages = rates[:, mesh.stages]
        for i in range(stages.shape[2]):
            shares = lengths[:, None] * scheme.weights[:, i]
            combined.append((rows, stages[:, :, i : i + 1, :states], -shares[None, :, :, None]))
        rows = take(part.algebraic.shape)
        combined.append((rows, equations, 1.0))
        stands_for.append(part.algebraic.ravel())
        # A realisation that ends by an event lasts until its function is zero.
        rows = take(levels.shape)
        combined.append((rows, levels, 1.0))
        stands_for.append(part.duration.ravel()[: levels.size])
        rows = take(part.integrals.shape)
        linear += [(rows, part.integrals, 1.0), (rows[:, 1:], part.integrals[:, :-1], -1.0)]
        shares = lengths[:, None] * scheme.weights[-1]
        combined.append((rows[:, :, None], stages[..., states:], -shares[None, :, :, None]))
        stands_for.append(part.integrals.ravel())
        tied(part.paths, paths)
        tied(part.ends, ends)
        tied(part.composed, composed)
        tied(part.nodes, nodes)
    samples, between = layout.samples(variables), layout.integrated(variables)
    expanded = [(samples[one], terms) for one, terms in layout.coefficients(variables).items()]
    expanded += [(between[one], terms) for one, terms in layout.between(variables).items()]
    for every, terms in expanded:
        rows = take(terms.shape)
        at = every[: layout.plan.points]
        linear.append((rows, terms, 1.0))
        shares = -fit.reshape(*fit.shape, *(1,) * (at.ndim - 1))
        linear.append((rows[:, None], at[None], shares))
        stands_for.append(terms.ravel())
    rows = take(variables.totals.shape)
    linear.append((rows, variables.totals, 1.0))
    for row, integrand in zip(rows, integrands, strict=True):
        combined.append((row, integrand.ravel(), -layout.phases[0].pointwise.grid.fraction_weights))
    stands_for.append(variables.totals)
    first = own[-1].stop if own else 0
    ties = Ties(np.arange(first, count), np.concatenate(stands_for).astype(int))
    matrix = _matrix(combined, (count, sum(rows.size for rows in blocks)))
    return Rows(_matrix(linear, (count, layout.count)) + matrix @ affine, matrix, tuple(own), ties)
