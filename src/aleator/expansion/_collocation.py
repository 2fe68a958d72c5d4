"""`Collocation`: the linear map from samples at germ points to the coefficients of an expansion (section 4.2).

It depends on the germ alone, so it is built and factorised once per problem; the optimiser changes only the samples.
Traced samples are worked on by JAX, and known ones by NumPy, which compiles nothing.
"""

from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from aleator._core.arrays import alike, in_library, jax_array, quietly
from aleator._core.leaves import Module

LEAST_REMAINDER = 1e-8
"""One minus the leverage counts as zero up to this: rounding of an exact zero."""

ROUNDING = 1e-12
"""Outputs that vary by less than this part of their size are constant up to rounding."""

# A spread of less than this part of others beside it may be the error of an integrator.
_INTEGRATED = 1e-6

UNRESOLVED = 0.05
"""Above this relative leave-one-out error an output is not resolved, unless its `Expansion` says otherwise."""


@final
class Collocation(Module):
    """Collocation points and the linear map from samples to coefficients.

    - `points`: germ values, shape (n_cp, variables);
    - `weights` of the points, adding up to one, shape (n_cp,): equal unless the point set says otherwise;
    - `matrix`: the collocation matrix `A` (28), shape (n_cp, n_b);
    - `pseudo_inverse`: `A#` of equation (29), or the map of another fit, shape (n_b, n_cp);
    - `leverage`: diagonal of `A A#`, shape (n_cp,), for the leave-one-out error; one if no other point checks it;
    - `condition_number` of the matrix that was factorised.
    """

    points: Float[Array, "points variables"]
    weights: Float[Array, " points"]
    matrix: Float[Array, "points terms"]
    pseudo_inverse: Float[Array, "terms points"]
    leverage: Float[Array, " points"]
    condition_number: Float[Array, ""]

    @quietly
    def coefficients(self, samples: Float[Any, "points *shape"]) -> Float[Any, "terms *shape"]:
        """Coefficients `rho = A# P` of samples of any shape, such as time histories (equations 29 and 47)."""
        library, inverse, known = in_library(self.pseudo_inverse, samples)
        return alike(library.tensordot(inverse, known, axes=1), samples)


def leave_one_out(
    collocation: Collocation,
    samples: Float[Array, "points *shape"],
    coefficients: Float[Array, "terms *shape"],
) -> Float[Array, ""]:
    """Relative leave-one-out error of an expansion: the root of the mean squared prediction error over the variance.

    Both are summed over the entries of an output. The leverage gives the prediction of each sample from all others
    without another fit (Blatman and Sudret, 2010); squares are averaged by the weights of the points. 0 is perfect, 1
    is no better than the mean, 0.05 misses a new sample by a twentieth of the standard deviation. Zero if the output
    does not vary beyond rounding. Infinite if a sample cannot be predicted because its leverage is one: with as many
    points as terms, which only interpolate, and for a projection by a sparse grid, whose error is unknown.
    """
    return relative_error(*(part.sum() for part in mean_squares(collocation, samples, coefficients)))


@quietly
def leave_one_out_of_entries(
    collocation: Collocation, samples: Float[Array, "points *shape"], coefficients: Float[Array, "terms *shape"]
) -> Float[Array, "*shape"]:
    """`leave_one_out` of each entry by its own spread; zero where that is the error of an integrator beside others."""
    library, error, variance, square = in_library(*mean_squares(collocation, samples, coefficients))
    errors = relative_error(error, variance, library.maximum(square, variance.max() * (_INTEGRATED / ROUNDING) ** 2))
    return jax_array(errors.reshape(samples.shape[1:]))


@quietly
def jackknife(
    collocation: Collocation,
    samples: Float[Array, "points *shape"],
    coefficients: Float[Array, "terms *shape"],
) -> Float[Array, ""]:
    """Relative error of an expansion due to the choice of points: an rms under the germ's distribution over the spread.

    It is the root of the summed squared changes of the coefficients as each point is left out, over the variance of the
    samples. For orthonormal polynomials that sum is a mean square under the distribution. The leave-one-out error shows
    how well points predict each other; this one how errors grow where there are no points, as in the tails of unbounded
    distributions, into which the polynomials extrapolate. Infinite and zero where `leave_one_out` is.
    Source: MacKinnon and White (1985), Some heteroskedasticity-consistent covariance matrix estimators (HC3).
    """
    library, collocation, samples, coefficients = in_library(collocation, samples, coefficients)
    flat, terms = samples.reshape(len(samples), -1), coefficients.reshape(len(coefficients), -1)
    missed, predictable = _missed(collocation, flat, terms)
    change = library.sum(collocation.pseudo_inverse**2, axis=0) @ missed**2
    _, variance, square = mean_squares(collocation, samples, coefficients)
    return relative_error(library.where(predictable, change.sum(), jnp.inf), variance.sum(), square.sum())


@quietly
def left_out(
    collocation: Collocation,
    samples: Float[Any, "points *shape"],
    coefficients: Float[Any, "terms *shape"],
    most: int,
) -> Float[np.ndarray, "terms left *shape"]:
    """The coefficients without one of the points, of those `most` points whose absence changes them most.

    None at all if some sample cannot be predicted by the others.
    """
    _, collocation, samples, coefficients = in_library(collocation, samples, coefficients)
    flat, terms = samples.reshape(len(samples), -1), coefficients.reshape(len(coefficients), -1)
    missed, predictable = map(np.asarray, _missed(collocation, flat, terms))
    inverse = np.asarray(collocation.pseudo_inverse)
    change = np.sum(inverse**2, axis=0) * np.sum(missed**2, axis=1)
    which = np.argsort(-change)[: most if predictable else 0]
    without = terms[:, None] - inverse[:, which, None] * missed[which]
    return without.reshape(len(terms), len(which), *samples.shape[1:])


@quietly
def fresh_error(
    matrix: Float[np.ndarray, "fresh terms"],
    samples: Float[Array, "fresh *shape"],
    coefficients: Float[Array, "terms *shape"],
) -> Float[Array, ""]:
    """Relative error of an expansion at fresh points, from which no coefficient follows, summed over the entries.

    It is the root mean squared error over the spread, whose square is the variance of the expansion plus the mean
    square that it misses. Collocation points do not show what is constant at them, such as a ripple of their pitch.
    """
    library, samples, terms = in_library(samples, coefficients)
    misses = samples - library.tensordot(matrix, terms, axes=1)
    missed, square = (library.sum(one**2) / max(len(one), 1) for one in (misses, samples))
    return jax_array(relative_error(missed, library.sum(terms[1:] ** 2) + missed, square))


@quietly
def mean_squares(
    collocation: Collocation, samples: Float[Any, "points *shape"], coefficients: Float[Any, "terms *shape"]
) -> tuple[Float[Array, " entries"], Float[Array, " entries"], Float[Array, " entries"]]:
    """For each entry: the mean square of the leave-one-out residuals, the variance, and the mean square."""
    library, collocation, samples, coefficients = in_library(collocation, samples, coefficients)
    flat, terms = samples.reshape(len(samples), -1), coefficients.reshape(len(coefficients), -1)
    missed, predictable = _missed(collocation, flat, terms)
    mean = collocation.weights @ flat
    return (
        library.where(predictable, collocation.weights @ missed**2, jnp.inf),
        collocation.weights @ (flat - mean[None, :]) ** 2,
        collocation.weights @ flat**2,
    )


@quietly
def _missed(
    collocation: Collocation, flat: Float[Array, "points entries"], terms: Float[Array, "terms entries"]
) -> tuple[Float[Array, "points entries"], Bool[Array, ""]]:
    """The leave-one-out residual of each sample, and whether every sample can be predicted by the others."""
    library, collocation, flat, terms = in_library(collocation, flat, terms)
    remainder = 1 - collocation.leverage
    predictable = remainder > LEAST_REMAINDER
    residual = flat - collocation.matrix @ terms
    return residual / library.where(predictable, remainder, 1.0)[:, None], predictable.all()


@quietly
def relative_error(
    error: Float[Array, "*n"], variance: Float[Array, "*n"], square: Float[Array, "*n"], *, rounding: float = ROUNDING
) -> Float[Array, "*n"]:
    """The root of error over variance; zero where a spread is rounding, as a part of the root mean square."""
    # Compared with `<=` so that NaN propagates and non-finite samples do not pass for constant.
    library, error, variance, square = in_library(error, variance, square)
    constant = variance <= rounding**2 * square
    return library.where(constant, 0.0, library.sqrt(error / library.where(constant, 1.0, variance)))


def leave_one_out_history(
    collocation: Collocation,
    samples: Float[Array, "points instants *shape"],
    coefficients: Float[Array, "terms instants *shape"],
) -> Float[Array, " instants"]:
    """The leave-one-out error at each instant, relative to the largest variance up to that instant.

    As the phases of realisations drift apart, the response becomes more and more nonlinear in the germ (Wan and
    Karniadakis, 2006, Long-term behavior of polynomial chaos in stochastic flow simulations), so that an order that is
    ample at first fails later.

    Relative to the variance at the same instant it would rise wherever all trajectories meet, as those of an oscillator
    do near its turning points. Rounding is judged in the same way, by the largest square up to that instant.
    """
    return error_history(mean_squares(collocation, samples, coefficients), samples.shape[1])


def error_history(
    parts: tuple[Float[Array, " entries"], Float[Array, " entries"], Float[Array, " entries"]], instants: int
) -> Float[Array, " instants"]:
    """`leave_one_out_history` from the `mean_squares` of all entries."""
    error, variance, square = (part.reshape(instants, -1).sum(axis=1) for part in parts)
    library, error, variance, square = in_library(error, variance, square)
    largest: Any = np.maximum.accumulate if library is np else jax.lax.cummax
    return relative_error(error, largest(variance), largest(square))


def resolved_instants(
    collocation: Collocation,
    samples: Float[Array, "points instants *shape"],
    coefficients: Float[Array, "terms instants *shape"],
    tolerance: float = UNRESOLVED,
) -> Int[Array, ""]:
    """How many instants of a history, from the first on, an expansion resolves: the index of the first unresolved one.

    An instant is unresolved if its `leave_one_out_history` exceeds `tolerance` or is NaN.
    """
    library, errors = in_library(leave_one_out_history(collocation, samples, coefficients))
    unresolved = ~(errors <= tolerance)
    return jax_array(library.where(unresolved.any(), library.argmax(unresolved), len(unresolved)))


def components(
    outputs: tuple[Float[np.ndarray, "points entries"], ...], weights: Float[np.ndarray, " points"]
) -> tuple[Float[np.ndarray, "points components"], ...]:
    """Each output that varies, in principal components, scaled so that its squares add up to the number of points.

    Means are subtracted and rows weighted by the roots of the weights. In principal components an output of thousands
    of entries has no more columns than there are points, with the same sums of squares over its entries.
    """
    roots = np.sqrt(weights)[:, None]
    varying = []
    for values in outputs:
        deviation = roots * (values - (weights @ values)[None, :])
        size = np.linalg.norm(deviation)
        if size > ROUNDING * np.linalg.norm(roots * values):
            left, sizes, _ = np.linalg.svd(deviation * (np.sqrt(len(weights)) / size), full_matrices=False)
            varying.append((left * sizes[None, :])[:, sizes > ROUNDING * sizes[0]])
    return tuple(varying)
