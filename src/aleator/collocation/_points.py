"""Point sets in the unit cube, to be mapped into germ space by the quantile functions."""

import numpy as np
from jaxtyping import Float


def hammersley(count: int, variables: int) -> Float[np.ndarray, "count variables"]:
    """The Hammersley set: `(i - 1/2)/count` beside the radical inverses of `i = 1 .. count` in the prime bases.

    The half and the start at 1 keep every coordinate off 0 and 1, where unbounded laws are infinite.
    Source: Hammersley (1960), Annals of the New York Academy of Sciences 86.
    """
    index = np.arange(1, count + 1)
    columns = [(index - 0.5) / count, *(radical_inverse(index, base) for base in _primes(variables - 1))]
    return np.stack(columns[:variables], axis=1) if variables else np.zeros((count, 0))


def radical_inverse(index: np.ndarray, base: int) -> Float[np.ndarray, " count"]:
    """The digits of each index in `base`, mirrored at the point (van der Corput)."""
    remaining, factor = index.copy(), 1.0 / base
    value = np.zeros(index.shape)
    while remaining.any():
        remaining, digit = np.divmod(remaining, base)
        value += factor * digit
        factor /= base
    return value


def _primes(count: int) -> list[int]:
    primes: list[int] = []
    candidate = 2
    while len(primes) < count:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return primes
