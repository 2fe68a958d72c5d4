"""Small dense systems of equations, solved entry by entry: under `vmap` each operation then serves all points at once.

A library call for each matrix would cost more than the arithmetic. Singular matrices give NaN.
"""

import jax.numpy as jnp
import jax.scipy.linalg as linalg
import numpy as np
from jaxtyping import Array, Float

# Beyond this size the unrolled operations take longer to compile than they save.
_UNROLLED = 8

# A pivot this small relative to the diagonal counts as zero.
_SINGULAR = 64 * float(np.finfo(float).eps)


def solve_positive(M: Float[Array, "n n"], b: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    """Solve `M x = b` for a symmetric positive definite `M`; NaN where it is not.

    Uses the factorisation `L D Lᵀ`. `b` is a vector, or a matrix of several columns.
    """
    n = len(M)
    if n == 0:
        return b
    if n > _UNROLLED:
        return _solve_large(M, b)
    lower = [[jnp.ones(())] * n for _ in range(n)]
    pivots: list[Array] = []
    for j in range(n):
        pivot = M[j, j] - sum((lower[j][k] ** 2 * pivots[k] for k in range(j)), start=jnp.zeros(()))
        pivots.append(jnp.where(pivot > _SINGULAR * jnp.abs(M[j, j]), pivot, jnp.nan))
        for i in range(j + 1, n):
            rest = M[i, j] - sum((lower[i][k] * lower[j][k] * pivots[k] for k in range(j)), start=jnp.zeros(()))
            lower[i][j] = rest / pivots[j]
    forward: list[Array] = []
    for i in range(n):
        forward.append(b[i] - sum((lower[i][k] * forward[k] for k in range(i)), start=jnp.zeros_like(b[i])))
    found: list[Array] = [jnp.zeros(())] * n
    for i in reversed(range(n)):
        known = sum((lower[k][i] * found[k] for k in range(i + 1, n)), start=jnp.zeros_like(b[i]))
        found[i] = forward[i] / pivots[i] - known
    return jnp.stack(found)


def solve_any(A: Float[Array, "m n"], b: Float[Array, " m"]) -> Float[Array, " n"]:
    """The solution of `A x = b`, the shortest if there are many, else by least squares; NaN without full rank."""
    rows, columns = A.shape
    if rows == columns == 1:
        return b / A[0]
    if rows == columns:
        return jnp.linalg.solve(A, b)
    return A.T @ solve_positive(A @ A.T, b) if rows < columns else solve_positive(A.T @ A, A.T @ b)


def _solve_large(M: Float[Array, "n n"], b: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
    factor = jnp.linalg.cholesky(M)
    pivots = jnp.diagonal(factor) ** 2
    regular = jnp.all(pivots > _SINGULAR * jnp.abs(jnp.diagonal(M)))
    return jnp.where(regular, linalg.cho_solve((factor, True), b), jnp.nan)
