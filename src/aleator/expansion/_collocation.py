"""`Collocation`: the linear map from samples at germ points to the coefficients of an expansion (section 4.2).

It depends on the germ alone, so it is built and factorised once per problem; what the optimiser changes are samples.
"""

from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# What is left of one minus the leverage by rounding, where it is zero in exact arithmetic.
_LEAST_REMAINDER = 1e-8

# Outputs that vary by less than this part of their size are constant, but for rounding.
_ROUNDING = 1e-12


@final
class Collocation(eqx.Module):
    """Collocation points and the linear map from samples to coefficients.

    - `points`: germ values, shape (n_cp, variables);
    - `weights` of the points, adding up to one, shape (n_cp,): equal unless the point set says otherwise;
    - `matrix`: the collocation matrix `A` (28), shape (n_cp, n_b);
    - `pseudo_inverse`: `A#` of equation (29), or the map of another fit, shape (n_b, n_cp);
    - `leverage`: diagonal of `A A#`, shape (n_cp,), for the leave-one-out error; one where nothing checks a point;
    - `condition_number` of the matrix that was factorised.
    """

    points: Float[Array, "points variables"]
    weights: Float[Array, " points"]
    matrix: Float[Array, "points terms"]
    pseudo_inverse: Float[Array, "terms points"]
    leverage: Float[Array, " points"]
    condition_number: Float[Array, ""]

    def coefficients(self, samples: Float[Array, "points *shape"]) -> Float[Array, "terms *shape"]:
        """Coefficients `rho = A# P` of samples of any shape, for instance time histories (equations 29 and 47)."""
        return jnp.tensordot(self.pseudo_inverse, samples, axes=1)


def leave_one_out(
    collocation: Collocation,
    samples: Float[Array, "points *shape"],
    coefficients: Float[Array, "terms *shape"],
) -> Float[Array, ""]:
    """Relative leave-one-out error of an expansion: the root of the mean squared prediction error over the variance.

    Both are summed over the entries of an output. Each sample is predicted from all others at no further cost, by the
    leverage (Blatman and Sudret, 2010), and squares are averaged by the weights of the points. 0 is perfect; 1 is no
    better than the mean; 0.05 misses a new sample by a twentieth of the standard deviation. Zero where the output does
    not vary beyond rounding. Infinite where a sample cannot be predicted, its leverage being one: as many points as
    terms, for instance, only interpolate, and of a projection by a sparse grid nothing is known.
    """
    return relative_error(*(part.sum() for part in mean_squares(collocation, samples, coefficients)))


def jackknife(
    collocation: Collocation,
    samples: Float[Array, "points *shape"],
    coefficients: Float[Array, "terms *shape"],
) -> Float[Array, ""]:
    """What the choice of the points makes of an expansion: an rms error under the germ's distribution over the spread.

    It is the root of the sum of squares by which coefficients change as each point is left out, which for orthonormal
    polynomials is a mean square under the distribution, and over the variance of the samples. The leave-one-out error
    asks how points predict each other; this asks what their errors become where there are none, as in the tails of
    unbounded distributions, into which powers are extrapolated. Infinite and zero where `leave_one_out` is.
    Source: MacKinnon and White (1985), Some heteroskedasticity-consistent covariance matrix estimators (HC3).
    """
    flat, terms = samples.reshape(len(samples), -1), coefficients.reshape(len(coefficients), -1)
    missed, predictable = _missed(collocation, flat, terms)
    change = jnp.sum(collocation.pseudo_inverse**2, axis=0) @ missed**2
    _, variance, square = mean_squares(collocation, samples, coefficients)
    return relative_error(jnp.where(predictable, change.sum(), jnp.inf), variance.sum(), square.sum())


def leave_one_out_by_entry(
    collocation: Collocation,
    samples: Float[Array, "points *shape"],
    coefficients: Float[Array, "terms *shape"],
) -> Float[Array, "*shape"]:
    """The error of `leave_one_out` for each entry of an output by itself, for instance for each instant of a path.

    Entries that hardly vary have large errors of no consequence: weigh them by their variance before you judge.
    """
    parts = mean_squares(collocation, samples, coefficients)
    return relative_error(*parts).reshape(samples.shape[1:])


def mean_squares(
    collocation: Collocation, samples: Float[Array, "points *shape"], coefficients: Float[Array, "terms *shape"]
) -> tuple[Float[Array, " entries"], Float[Array, " entries"], Float[Array, " entries"]]:
    """Of each entry: the mean square of the leave-one-out residuals, the variance, and the mean square."""
    flat, terms = samples.reshape(len(samples), -1), coefficients.reshape(len(coefficients), -1)
    missed, predictable = _missed(collocation, flat, terms)
    mean = collocation.weights @ flat
    return (
        jnp.where(predictable, collocation.weights @ missed**2, jnp.inf),
        collocation.weights @ (flat - mean[None, :]) ** 2,
        collocation.weights @ flat**2,
    )


def _missed(
    collocation: Collocation, flat: Float[Array, "points entries"], terms: Float[Array, "terms entries"]
) -> tuple[Float[Array, "points entries"], Bool[Array, ""]]:
    """By how much each sample is missed by all others; and whether others predict every one."""
    remainder = 1 - collocation.leverage
    predictable = remainder > _LEAST_REMAINDER
    residual = flat - collocation.matrix @ terms
    return residual / jnp.where(predictable, remainder, 1.0)[:, None], predictable.all()


def relative_error(
    error: Float[Array, "*n"], variance: Float[Array, "*n"], square: Float[Array, "*n"]
) -> Float[Array, "*n"]:
    """The root of error over variance; zero where the variance is rounding."""
    # Asked this way round, samples that are not finite leave a nan and do not pass for constant.
    constant = variance <= _ROUNDING**2 * square
    return jnp.where(constant, 0.0, jnp.sqrt(error / jnp.where(constant, 1.0, variance)))
