"""The Bernstein form of a basis on the box of its germ."""

import math
from typing import TypeAlias, final

import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.expansion import AbstractBasis, InElements, PiecewiseBasis, in_each
from aleator.uncertainty import AbstractGerm

# An evaluation holds a few tensors of this many numbers.
_MOST_COEFFICIENTS = 2**22


@final
class Enclosure(Module):
    """The Bernstein form of a basis on the box of its germ.

    - `bernstein[i]`: the coefficients of the polynomials of variable `i`, shape (degree + 1, degree + 1), by degree in
      the columns; `halves[i]`: from the coefficients on a box to those on its lower and upper half;
    - `powers[i, m, k]`: the coefficient of `x^m` in the polynomial of degree `k`, for a local search;
    - `indices`: degrees of each term in each variable that occurs; `place`: of each term in the flat tensor of degrees;
    - `sizes`: a bound on the absolute value of each term.
    """

    bernstein: tuple[Float[Array, "n n"], ...]
    halves: tuple[Float[Array, "2 n n"], ...]
    powers: Float[Array, "variables orders orders"]
    indices: Int[Array, "terms variables"]
    place: Int[Array, " terms"]
    sizes: Float[Array, " terms"]

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of a tensor of coefficients."""
        return tuple(len(matrix) for matrix in self.bernstein)


Form: TypeAlias = Enclosure | InElements


def enclosure(basis: AbstractBasis) -> Form:
    """Preparation: the Bernstein form of a basis, of a piecewise one that in each element.

    Raises `ProblemError` if the support is unbounded, or if the Bernstein coefficients need too much memory.
    """
    unbounded = [name for name, germ in basis.germs.items() if not np.all(np.isfinite(germ.support()))]
    if unbounded:
        raise ProblemError(
            f"Supremum and infimum: {', '.join(map(repr, unbounded))} can take values without bound, and so can the "
            "output; use bounded distributions such as Uniform or Beta, or a quantile (for instance .quantile(0.999)) "
            "instead."
        )
    if isinstance(basis, PiecewiseBasis):
        return in_each(enclosure, basis)
    active = [i for i, degree in enumerate(basis.degrees) if degree > 0]
    shape = [basis.degrees[i] + 1 for i in active]
    if math.prod(shape) > _MOST_COEFFICIENTS:
        raise ProblemError(
            f"Supremum and infimum: the Bernstein form in {len(active)} variables has {math.prod(shape)} coefficients, "
            f"more than {_MOST_COEFFICIENTS}. Use a lower order or fewer variables, or a quantile instead."
        )
    germs = list(basis.germs.values())
    bernstein = [_bernstein(germs[i], basis.degrees[i]) for i in active]
    indices = basis.indices[:, active]
    largest = [np.abs(matrix).max(axis=0)[degrees] for matrix, degrees in zip(bernstein, indices.T, strict=True)]
    return Enclosure(
        bernstein=tuple(jax_array(matrix) for matrix in bernstein),
        halves=tuple(jax_array(_halves(basis.degrees[i])) for i in active),
        powers=jax_array(_powers(bernstein)),
        indices=jax_array(indices),
        place=jax_array(indices @ np.array([math.prod(shape[k + 1 :]) for k in range(len(shape))], dtype=int)),
        sizes=jax_array(np.prod(largest, axis=0) * np.ones(basis.terms)),
    )


def _bernstein(germ: AbstractGerm, degree: int) -> Float[np.ndarray, "n n"]:
    """The Bernstein coefficients of the orthonormal polynomials of a germ on its support, one in each column."""
    low, high = germ.support()
    # At Chebyshev points, which keep the matrix of the Bernstein polynomials well conditioned.
    at = (1 - np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))) / 2
    powers = np.arange(degree + 1)
    choices = np.array([math.comb(degree, k) for k in powers])
    values = choices * at[:, None] ** powers * (1 - at[:, None]) ** (degree - powers)
    return np.linalg.solve(values, germ.polynomials(degree, low + (high - low) * at))


def _halves(degree: int) -> Float[np.ndarray, "2 n n"]:
    """De Casteljau's algorithm at the middle, as matrices: exact, because all entries are binary fractions."""
    lower = np.array([[math.comb(j, k) / 2.0**j for k in range(degree + 1)] for j in range(degree + 1)])
    return np.stack([lower, lower[::-1, ::-1]])


def _powers(bernstein: list[Float[np.ndarray, "n n"]]) -> Float[np.ndarray, "variables orders orders"]:
    """The polynomials of each variable by powers of `x`, which is -1 and 1 at the ends of the support."""
    most = max((len(matrix) for matrix in bernstein), default=1)
    powers = np.zeros((len(bernstein), most, most))
    x = np.polynomial.Polynomial([0.0, 1.0])
    for matrix, out in zip(bernstein, powers, strict=True):
        n = len(matrix)
        basis = [math.comb(n - 1, k) * ((1 + x) / 2) ** k * ((1 - x) / 2) ** (n - 1 - k) for k in range(n)]
        out[:n, :n] = np.stack([polynomial.coef for polynomial in basis], axis=1) @ matrix
    return powers
