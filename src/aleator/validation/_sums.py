"""`Sums`: moments of samples that come in batches (Pébay, Formulas for robust, one-pass parallel computation, 2008)."""

from typing import NamedTuple, Self, final

import numpy as np
from jaxtyping import Float


@final
class Sums(NamedTuple):
    """The number of samples, their mean, and the sums of the powers 2 to 4 of deviations from it."""

    number: int
    mean: Float[np.ndarray, "*shape"]
    second: Float[np.ndarray, "*shape"]
    third: Float[np.ndarray, "*shape"]
    fourth: Float[np.ndarray, "*shape"]

    @classmethod
    def of(cls, values: Float[np.ndarray, "samples *shape"]) -> Self:
        """The sums of one batch."""
        mean = values.mean(axis=0)
        away = values - mean
        return cls(len(values), mean, *(np.sum(away**power, axis=0) for power in (2, 3, 4)))

    def merged(self, other: Self) -> Self:
        """The sums of both batches together."""
        (n, mean, second, third, fourth), (m, *_) = self, other
        total, shift = n + m, other.mean - mean
        return type(self)(
            total,
            mean + shift * m / total,
            second + other.second + shift**2 * n * m / total,
            third
            + other.third
            + shift**3 * n * m * (n - m) / total**2
            + 3 * shift * (n * other.second - m * second) / total,
            fourth
            + other.fourth
            + shift**4 * n * m * (n**2 - n * m + m**2) / total**3
            + 6 * shift**2 * (n**2 * other.second + m**2 * second) / total**2
            + 4 * shift * (n * other.third - m * third) / total,
        )

    @property
    def std(self) -> Float[np.ndarray, "*shape"]:
        """The standard deviation."""
        return np.asarray(np.sqrt(self.second / (self.number - 1)))

    @property
    def std_error(self) -> Float[np.ndarray, "*shape"]:
        """The standard error of the standard deviation, from the fourth moment; zero where nothing varies."""
        n, variance = self.number, self.second / (self.number - 1)
        spread = np.maximum(self.fourth / n - variance**2 * (n - 3) / (n - 1), 0.0) / n
        return np.asarray(np.sqrt(spread) / (2 * np.sqrt(np.where(variance > 0, variance, np.inf))))
