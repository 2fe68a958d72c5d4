"""Statistics of third and fourth powers, corrected by fresh systems: skewness, kurtosis, and quantiles that follow from
them.

An expansion whose mean and spread are right may be wrong in these, for polynomials of a high power run away where no
collocation point lies, in systems so rare that mean and spread owe nothing to them.
"""

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator.certification._check import NEGLIGIBLE_SPREAD
from aleator.certification._fresh import DEEPEST_OF_SHAPES, fresh_systems
from aleator.statistics import AbstractStatistic, CornishFisher, Skewness
from aleator.transcription import AbstractTranscribed

Values = Float[np.ndarray, "systems ..."]
Replicates = Float[np.ndarray, "... replicates"]

# How many systems are predicted, at most and at least, how many numbers they may have in all, and a draw of their own.
_MOST, _FEWEST, _NUMBERS, _DRAW = 2**15, 2**11, 2**23, 10**6
# The expansion has the statistic of these systems within so many standard errors and this part of its size.
_ERRORS, _NONE = 4.0, 0.01


def means(weights: Values, values: Values) -> Replicates:
    """Weighted means along a last axis of replicates: zero, of all systems, and of all but one (the jackknife)."""
    weighted, weight = weights * values, weights.sum(axis=0)
    total = weighted.sum(axis=0)
    rest = (total - weighted) / (weight - weights)
    return np.moveaxis(np.concatenate([0 * total[None], (total / weight)[None], rest]), 0, -1)


def predicted_of_many(transcribed: AbstractTranscribed, terms: Float[np.ndarray, "terms ..."]) -> tuple[Values, Values]:
    """What the expansion of a functional predicts of many systems, and their weights."""
    count = int(np.clip(_NUMBERS // max(len(terms), terms[0].size), _FEWEST, _MOST))
    systems = fresh_systems(transcribed.problem.placements.germs.values(), count, _DRAW, DEEPEST_OF_SHAPES)
    predicted = np.tensordot(transcribed.discretised.basis.matrix(systems.points), terms, axes=1)
    return predicted, systems.weights.reshape(-1, *[1] * (predicted.ndim - 1))


def corrected_shape(
    kind: AbstractStatistic,
    base: Float[np.ndarray, "... 1"],
    mean: Float[np.ndarray, "..."],
    std: Float[np.ndarray, "..."],
    known: tuple[tuple[Values, Values], ...],
) -> tuple[Replicates, Float[np.ndarray, "..."]]:
    """A statistic in all replicates: uncorrected, by all fresh systems, by all but one; and a change of it that counts.

    - `base`: the expansion's own; `mean`, `std`: its moments of the functional;
    - `known`: values and weights of the fresh systems, simulated and predicted, and of many that are predicted.

    Where the expansion does not have the statistic of the many systems, it owes its own to yet rarer ones: then theirs
    is corrected, in the same way, by the difference between what is simulated and what is predicted.
    """
    simulated, predicted, of_many = (_shape(kind, values, weights, mean, std) for values, weights in known)
    error = np.sqrt((of_many.shape[-1] - 2) * np.var(of_many[..., 1:], axis=-1, keepdims=True))
    magnitude = np.minimum(np.abs(base), np.abs(simulated[..., :1]))[..., 0]
    size = std if isinstance(kind, CornishFisher) else np.maximum(magnitude, 1.0)
    is_theirs = np.abs(of_many[..., :1] - base) <= _ERRORS * error + _NONE * size[..., None]
    corrected = np.where(is_theirs, base, of_many[..., :1]) + simulated - predicted
    varies = (std > NEGLIGIBLE_SPREAD * np.max(std))[..., None]
    return np.concatenate([base, np.where(varies, corrected, base)], axis=-1), size


def _shape(
    kind: AbstractStatistic,
    values: Values,
    weights: Values,
    mean: Float[np.ndarray, "..."],
    std: Float[np.ndarray, "..."],
) -> Replicates:
    """The statistic of weighted values: of all, and of all but one."""
    scale = np.where(std > 0, std, 1.0)
    standard = (values - mean) / scale
    first, second, third, fourth = (means(weights, standard**power)[..., 1:] for power in range(1, 5))
    variance = second - first**2
    spread = np.sqrt(np.where(variance > 0, variance, 1.0))
    skewness = (third - 3 * first * second + 2 * first**3) / spread**3
    kurtosis = (fourth - 4 * first * third + 6 * first**2 * second - 3 * first**4) / spread**4
    if isinstance(kind, CornishFisher):
        moments = mean[..., None] + scale[..., None] * first, scale[..., None] * spread, skewness, kurtosis
        return np.asarray(kind.of_moments(*map(jax_array, moments)))
    return skewness if isinstance(kind, Skewness) else kurtosis
