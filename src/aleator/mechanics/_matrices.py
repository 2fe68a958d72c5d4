"""Small dense systems of equations and blocks of matrices, entry by entry.

Under `vmap` each operation serves all points, where a library call for each matrix would cost more than the arithmetic;
and slices compile far sooner than gathers and scatters. Singular matrices give NaN.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.linalg as linalg
import numpy as np
from jaxtyping import Array, Float

from aleator.mechanics._spatial import Numbers, library

# Beyond this length of sums products are left to the library.
_SHORT = 6

# Beyond this size the unrolled operations take longer to compile than they save.
_UNROLLED = 8

# A pivot this small relative to the diagonal counts as zero.
_SINGULAR = 64 * float(np.finfo(float).eps)


def product(A: Float[Array, "m k"], b: Float[Array, "k ..."]) -> Float[Array, "m ..."]:
    """`A b`, of a vector or column by column, as a sum of products.

    XLA fuses these with their surroundings, and compiles them in half the time of calls for small matrices. For many
    products in a row, as along a tree of bodies, `A @ b` runs faster.
    """
    return jnp.matmul(A, b) if A.shape[1] > _SHORT else _product(A, b)


# Traced once for all its uses.
@jax.jit
def _product(A: Array, b: Array) -> Array:
    return (A * b[None]).sum(axis=1) if b.ndim == 1 else (A[:, :, None] * b[None]).sum(axis=1)


def solve_positive(M: Float[Array, "n n"], b: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """Solve `M x = b` for a symmetric positive definite `M`; NaN where it is not.

    `b` is a vector, or a matrix of several columns.
    """
    return positive_solver(M)(b)


def positive_solver(M: Float[Array, "n n"]) -> Callable[[Float[Array, "n ..."]], Float[Array, "n ..."]]:
    """What solves `M x = b` for any `b`: see `solve_positive`. Factorised once, `L D Lᵀ`."""
    n = len(M)
    if n == 0:
        return lambda b: b
    if n > _UNROLLED:
        return _large_solver(M)
    limits, rest = _SINGULAR * jnp.abs(jnp.diagonal(M)), M
    columns: list[Array] = []
    pivots: list[Array] = []
    for j in range(n):
        pivots.append(jnp.where(rest[0, 0] > limits[j], rest[0, 0], jnp.nan))
        columns.append(rest[1:, 0] / pivots[-1])
        rest = rest[1:, 1:] - columns[-1][:, None] * rest[:1, 1:]

    def solve(b: Array) -> Array:
        rest, forward = b.reshape(n, -1), list[Array]()
        for column in columns:
            forward.append(rest[:1])
            rest = rest[1:] - column[:, None] * rest[:1]
        x = forward[-1] / pivots[-1]
        for j in reversed(range(n - 1)):
            x = jnp.concatenate([forward[j] / pivots[j] - columns[j][None] @ x, x])
        return x.reshape(b.shape)

    return solve


def solve_any(A: Float[Array, "m n"], b: Float[Array, "m ..."]) -> Float[Array, "n ..."]:
    """The solution of `A x = b`, the shortest if many, else by least squares; not finite without full rank."""
    rows, columns = A.shape
    if rows == columns == 1:
        return b / A[0]
    if rows == columns == 2:
        return product(inverse(A), b)
    if rows == columns:
        return jnp.linalg.solve(A, b)
    if rows < columns:
        return product(A.T, solve_positive(product(A, A.T), b))
    return solve_positive(product(A.T, A), product(A.T, b))


def inverse(A: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """The inverse of a matrix; not finite where it is singular."""
    if len(A) != 2:
        return jnp.linalg.inv(A)
    # By Cramer's rule: a closed loop in a plane has two equations.
    (a, b), (c, d) = A
    return jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / (a * d - b * c)


def _large_solver(M: Float[Array, "n n"]) -> Callable[[Float[Array, "n ..."]], Float[Array, "n ..."]]:
    factor = jnp.linalg.cholesky(M)
    pivots = jnp.diagonal(factor) ** 2
    regular = jnp.all(pivots > _SINGULAR * jnp.abs(jnp.diagonal(M)))
    return lambda b: jnp.where(regular, linalg.cho_solve((factor, True), b), jnp.nan)


def entries(vector: Float[Array, " n"]) -> list[Array]:
    """The numbers of a vector: half the equations of an iteration over it."""
    return [part.reshape(()) for part in jax.lax.split(vector, [1] * len(vector))] if len(vector) else []


def taken(array: Float[Numbers, "n ..."], places: Sequence[int]) -> Float[Numbers, "places ..."]:
    """The entries at some places along the first axis, in the order of the places."""
    if tuple(places) == tuple(range(len(array))):
        return array
    parts = [array[first:last] for first, last in _runs(places)]
    return parts[0] if len(parts) == 1 else library(array).concatenate([array[:0], *parts])


def block(M: Float[Array, "m n"], rows: Sequence[int], columns: Sequence[int]) -> Float[Array, "rows columns"]:
    """The entries of a matrix in some rows and columns."""
    return taken(taken(M, rows).T, columns).T


def spread(values: Float[Array, "places ..."], places: Sequence[int], count: int) -> Float[Array, "count ..."]:
    """Values at some places along the first axis of so many; zero elsewhere."""
    others = [i for i in range(count) if i not in places]
    return merged(values, places, jnp.zeros((len(others), *values.shape[1:])), others)


def merged(
    first: Float[Any, "some ..."], places: Sequence[int], second: Float[Any, "others ..."], others: Sequence[int]
) -> Float[Array, "n ..."]:
    """Two parts of an array, each at its places along the first axis."""
    listed = [*places, *others]
    return taken(jnp.concatenate([first, second]), [listed.index(i) for i in range(len(listed))])


def _runs(places: Sequence[int]) -> Iterator[tuple[Any, Any]]:
    """Ranges of places that follow one another, from the first to before the last."""
    left = [int(place) for place in places]
    while left:
        count = next((i for i in range(1, len(left)) if left[i] != left[0] + i), len(left))
        yield left[0], left[0] + count
        left = left[count:]
