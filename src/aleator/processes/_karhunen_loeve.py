"""The Karhunen-Loève modes of a stationary covariance on an interval, in Legendre polynomials.

The eigenproblem `∫ C(t, s) φ(s) ds = λ φ(t)` is projected on the orthonormal Legendre polynomials of the interval
(Ghanem and Spanos, Stochastic Finite Elements, 1991, section 2.3.3). The inner integral is split at `s = t`, where a
covariance may have a kink: Gauss quadrature is then spectrally accurate for exponential covariances too, for which
plain Nyström quadrature converges with the square of the spacing only.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.polynomial.legendre import leggauss, legvander

from aleator._core.errors import ProblemError
from aleator.processes._covariance import AbstractCovariance

# Numbers of polynomials, tried in turn.
_SIZES = (32, 48, 64, 96, 128, 192, 256, 384, 512)

# Converged: shares of variance agree between two sizes to this, and the last eighth of the polynomials is as small.
_CONVERGED = 1e-11

# Modes with a smaller share of the variance are lost in rounding.
_LEAST_SHARE = 1e-12

# An eigenvalue below this is truly negative: quadrature errors are smaller.
_NEGATIVE = -1e-6


class Modes(NamedTuple):
    """The retained modes, largest first.

    - `shares`: the fraction of the variance in each mode: its eigenvalue divided by the length of the interval;
    - `functions`: `sqrt(λ_k) φ_k` of each mode in Legendre polynomials (not normalised) of the interval.
    """

    shares: Float[np.ndarray, " modes"]
    functions: Float[np.ndarray, "polynomials modes"]


def karhunen_loeve(covariance: AbstractCovariance, duration: float, energy: float, modes: int | None) -> Modes:
    """The first `modes` modes on an interval of length `duration` (s), or as many as carry the share `energy`.

    The number of polynomials grows until the modes converge. Raises `ProblemError` if the largest number does not
    resolve them, if requested modes are lost in rounding, or if the covariance is not positive semi-definite.
    """
    _refuse_no_correlation(covariance, duration)
    before = np.zeros(0)
    for size in _SIZES:
        shares, vectors = _eigenpairs(covariance, duration, size)
        if modes is not None:
            _refuse_drowned(modes, shares, before)
        kept = _count(shares, energy) if modes is None else modes
        if kept is not None and kept <= len(before) and _is_converged(before[:kept], shares[:kept], vectors[:, :kept]):
            _refuse_negative(covariance, shares)
            return Modes(shares[:kept], _functions(shares[:kept], vectors[:, :kept]))
        before = shares
    raise ProblemError(
        f"RandomProcess: the modes asked for ({f'energy={energy:g}' if modes is None else f'modes={modes}'}) of the "
        f"{covariance} over {duration:g} s are not resolved by {_SIZES[-1]} polynomials: it varies too fast for so "
        "long a time. Ask for fewer modes (modes=...), or give a smoother covariance or a shorter time."
    )


def _refuse_no_correlation(covariance: AbstractCovariance, duration: float) -> None:
    values = np.asarray(covariance.correlation(np.linspace(0.0, duration, 101)))
    if values.shape != (101,) or not np.isfinite(values).all() or abs(values[0] - 1) > _CONVERGED:
        raise ProblemError(
            f"RandomProcess: the correlation of the {covariance} must be finite, of the shape of the lags and 1 at lag "
            f"0; received shape {values.shape} for (101,) lags, starting with {values.flat[0]:g}."
        )


def _refuse_drowned(modes: int, shares: Float[np.ndarray, " size"], before: Float[np.ndarray, " smaller"]) -> None:
    """Refuse more modes than exceed rounding errors, once a larger size adds none."""
    carried, carried_before = (int(np.sum(some > _LEAST_SHARE)) for some in (shares, before))
    if modes > carried == carried_before:
        raise ProblemError(
            f"RandomProcess: {modes} modes were asked for, but only {carried} carry more than {_LEAST_SHARE:.0e} of "
            f"the variance; the others are rounding errors. Ask for at most {carried}."
        )


def _refuse_negative(covariance: AbstractCovariance, shares: Float[np.ndarray, " size"]) -> None:
    if shares[-1] < _NEGATIVE:
        raise ProblemError(
            f"RandomProcess: the {covariance} is not a covariance: its eigenvalue {shares[-1]:.1e} (as a share of the "
            "variance) is negative. Its correlation must be positive semi-definite."
        )


def _eigenpairs(
    covariance: AbstractCovariance, duration: float, size: int
) -> tuple[Float[np.ndarray, " size"], Float[np.ndarray, "size size"]]:
    """Eigenvalues (shares of the variance) and eigenvectors, largest first, on the interval [0, 1]."""
    nodes, weights = leggauss(size)
    nodes, weights = (nodes + 1) / 2, weights / 2
    degrees = np.arange(size)
    earlier = np.empty((size, size))
    for i, now in enumerate(nodes):
        correlation = covariance.correlation(duration * now * (1 - nodes))
        earlier[i] = now * (weights * correlation) @ _orthonormal(now * nodes, size)
    # Mirroring time maps the integral over s > t to that over s < t; odd polynomials change sign.
    image = earlier + earlier[::-1] * (-1.0) ** degrees[None, :]
    matrix = (_orthonormal(nodes, size) * weights[:, None]).T @ image
    shares, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return shares[::-1], vectors[:, ::-1]


def _orthonormal(points: Float[np.ndarray, " n"], size: int) -> Float[np.ndarray, "n size"]:
    """The orthonormal Legendre polynomials of [0, 1]."""
    return legvander(2 * points - 1, size - 1) * _norms(size)[None, :]


def _norms(size: int) -> Float[np.ndarray, " size"]:
    return np.sqrt(2 * np.arange(size) + 1)


def _count(shares: Float[np.ndarray, " size"], energy: float) -> int | None:
    """How many modes carry the share `energy`; `None` if all of them together do not."""
    enough = np.cumsum(shares) >= energy
    return int(np.argmax(enough)) + 1 if enough.any() else None


def _is_converged(
    before: Float[np.ndarray, " modes"], shares: Float[np.ndarray, " modes"], vectors: Float[np.ndarray, "size modes"]
) -> bool:
    weighted = np.abs(vectors) * np.sqrt(np.maximum(shares, 0.0))[None, :]
    tail = weighted[7 * len(vectors) // 8 :].max()
    return bool(np.abs(shares - before).max() < _CONVERGED and tail < _CONVERGED)


def _functions(
    shares: Float[np.ndarray, " modes"], vectors: Float[np.ndarray, "size modes"]
) -> Float[np.ndarray, "size modes"]:
    # An eigenvector's sign is arbitrary: making its largest entry positive fixes it on every machine.
    largest = np.argmax(np.abs(vectors), axis=0)
    signs = np.sign(vectors[largest, np.arange(len(shares))])
    return vectors * (signs * np.sqrt(shares))[None, :] * _norms(len(vectors))[:, None]


# Its own program, so that one that is called outside of others is compiled once for each size.
@functools.partial(jax.jit, static_argnames="size")
def legendre(x: Float[Array, ""], size: int) -> Float[Array, " size"]:
    """The Legendre polynomials of degree 0 to `size - 1` at `x`, by their recurrence; differentiable in `x`."""

    def step(carry: tuple[Array, Array], degree: Array) -> tuple[tuple[Array, Array], Array]:
        before, now = carry
        after = ((2 * degree + 1) * x * now - degree * before) / (degree + 1)
        return (now, after), now

    x = jnp.asarray(x, dtype=float)
    _, values = jax.lax.scan(step, (jnp.zeros_like(x), jnp.ones_like(x)), jnp.arange(size, dtype=float))
    return values
