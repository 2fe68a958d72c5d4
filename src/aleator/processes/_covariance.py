"""Covariances of stationary processes: exponential, squared exponential and band-limited."""

import abc
from typing import Any, Self, final

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.module import Module
from aleator.processes._checks import plain_number, positive_number


class AbstractCovariance(Module):
    """The covariance of a stationary process, as `std² * correlation(lag)`.

    A user's own is a subclass with `correlation`. Its parameters are plain numbers, since the eigenfunctions depend on
    them and are computed once, when a process is declared.
    """

    @abc.abstractmethod
    def correlation(self, lag: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The correlation of two instants that are `lag >= 0` seconds apart: 1 at lag 0.

        It must be positive semi-definite, and smooth for `lag > 0`; a kink at lag 0, like the exponential's, is
        allowed.
        """


@final
class ExponentialCovariance(AbstractCovariance):
    """Correlation `exp(-lag / correlation_time)`: coloured noise, that is, white noise through a first-order lag.

    Its paths are continuous but nowhere smooth, so that its variance is spread over many modes: about
    `0.2 t_final / (correlation_time (1 - energy))`.
    """

    correlation_time: float

    def __init__(self, correlation_time: float):
        self.correlation_time = positive_number("ExponentialCovariance", "correlation_time", correlation_time)

    @override
    def correlation(self, lag: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.exp(-lag / self.correlation_time)

    def __str__(self) -> str:
        return f"exponential covariance of correlation time {float(self.correlation_time):g} s"


@final
class SquaredExponentialCovariance(AbstractCovariance):
    """Correlation `exp(-lag² / (2 correlation_time²))`: very smooth paths, carried by few modes."""

    correlation_time: float

    def __init__(self, correlation_time: float):
        self.correlation_time = positive_number("SquaredExponentialCovariance", "correlation_time", correlation_time)

    @override
    def correlation(self, lag: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.exp(-0.5 * (lag / self.correlation_time) ** 2)

    def __str__(self) -> str:
        return f"squared exponential covariance of correlation time {float(self.correlation_time):g} s"


@final
class BandLimitedCovariance(AbstractCovariance):
    """The covariance of a process whose power lies between two frequencies in Hz.

    `BandLimitedCovariance(0.5, 4.0)` has a flat spectrum. `from_psd` takes a one-sided power spectral density from a
    table, linear between its samples and zero outside of them, in squared units of the signal per Hz. About
    `2 (f_high - f_low) t_final` modes carry its variance.
    """

    frequencies: Float[np.ndarray, " samples"]
    psd: Float[np.ndarray, " samples"]

    def __init__(self, f_low: float, f_high: float):
        band = [plain_number("BandLimitedCovariance", name, f) for name, f in (("f_low", f_low), ("f_high", f_high))]
        if not 0 <= band[0] < band[1]:
            raise ProblemError(
                f"BandLimitedCovariance: expected 0 <= f_low < f_high; received f_low={band[0]:g}, f_high={band[1]:g}."
            )
        self.frequencies = np.array(band)
        self.psd = np.full(2, 1 / (band[1] - band[0]))

    @classmethod
    def from_psd(cls, frequencies: Any, psd: Any) -> Self:
        """The covariance of a tabulated one-sided power spectral density; its standard deviation is `std`.

        Raises `ProblemError` unless the frequencies (Hz) increase from 0 or more and the values are nonnegative.
        """
        try:
            table = [np.array(column, dtype=float) for column in (frequencies, psd)]
        except (TypeError, ValueError) as error:
            raise ProblemError(
                "BandLimitedCovariance.from_psd: frequencies and psd must be plain numbers; "
                f"received {frequencies!r} and {psd!r}."
            ) from error
        if table[0].ndim != 1 or table[0].shape != table[1].shape or table[0].size < 2:
            raise ProblemError(
                "BandLimitedCovariance.from_psd: expected two vectors of the same length, of at least 2; "
                f"received frequencies {table[0].shape} and psd {table[1].shape}."
            )
        if not np.isfinite(table).all() or table[0][0] < 0 or not np.all(np.diff(table[0]) > 0):
            raise ProblemError(
                "BandLimitedCovariance.from_psd: frequencies must be finite and increase from 0 Hz or more, and the "
                "psd must be finite."
            )
        if table[1].min() < 0 or table[1].max() == 0:
            raise ProblemError(
                f"BandLimitedCovariance.from_psd: the psd must be nonnegative and not zero throughout; received values "
                f"from {table[1].min():g} to {table[1].max():g}."
            )
        covariance = cls(float(table[0][0]), float(table[0][-1]))
        return eqx.tree_at(lambda tree: (tree.frequencies, tree.psd), covariance, tuple(table))

    @property
    def std(self) -> float:
        """The root of the integral of the power spectral density: the standard deviation that the table implies."""
        return float(np.sqrt(np.trapezoid(self.psd, self.frequencies)))

    @override
    def correlation(self, lag: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The cosine transform of the density, segment by segment."""
        omega = 2 * np.pi * lag
        total = np.zeros_like(omega)
        for left, right, start, end in zip(
            self.frequencies[:-1], self.frequencies[1:], self.psd[:-1], self.psd[1:], strict=True
        ):
            centre, half = (left + right) / 2, (right - left) / 2
            # Spherical Bessel functions are the transforms of a constant and of a line: accurate at small lags too.
            level, slope = (scipy.special.spherical_jn(order, omega * half) for order in (0, 1))
            total += half * ((start + end) * np.cos(omega * centre) * level)
            total -= half * ((end - start) * np.sin(omega * centre) * slope)
        return total / self.std**2

    def __str__(self) -> str:
        return f"covariance of the band from {float(self.frequencies[0]):g} to {float(self.frequencies[-1]):g} Hz"
