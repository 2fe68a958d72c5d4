"""Covariances of stationary processes, and their Karhunen-Loève modes on an interval, in Legendre polynomials.

The eigenproblem `∫ C(t, s) φ(s) ds = λ φ(t)` is projected on the orthonormal Legendre polynomials of the interval
(Ghanem and Spanos, Stochastic Finite Elements, 1991, section 2.3.3). The inner integral is split at `s = t`, where a
covariance may have a kink: Gauss quadrature is then spectrally accurate for exponential covariances too, for which
plain Nyström quadrature converges with the square of the spacing only.
"""

import abc
from typing import Any, NamedTuple, Self, final

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Float
from numpy.polynomial.legendre import leggauss, legvander
from typing_extensions import override

from aleator._core.border import positive, real, real_array, refuse_not_finite
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, Module

# Numbers of polynomials, tried in turn.
_SIZES = (32, 48, 64, 96, 128, 192, 256, 384, 512)

# Converged: shares of variance agree between two sizes to this, and the last eighth of the polynomials is as small.
_CONVERGED = 1e-11

# Modes with a smaller share of the variance are lost in rounding.
_LEAST_SHARE = 1e-12

# An eigenvalue below this is truly negative: quadrature errors are smaller.
_NEGATIVE = -1e-6


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


class _AbstractOfTime(AbstractCovariance):
    """A covariance whose only parameter is a correlation time, s."""

    correlation_time: float

    def __init__(self, correlation_time: float):
        what = f"{type(self).__name__}: 'correlation_time'"
        self.correlation_time = positive(what, plain_number(what, correlation_time))


@final
class ExponentialCovariance(_AbstractOfTime):
    """Correlation `exp(-lag / correlation_time)`: coloured noise, that is, white noise through a first-order lag.

    Its paths are continuous but nowhere smooth, so that its variance is spread over many modes: about
    `0.2 t_final / (correlation_time (1 - energy))`.
    """

    @override
    def correlation(self, lag: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.exp(-lag / self.correlation_time)

    def __str__(self) -> str:
        return f"exponential covariance of correlation time {float(self.correlation_time):g} s"


@final
class SquaredExponentialCovariance(_AbstractOfTime):
    """Correlation `exp(-lag² / (2 correlation_time²))`: very smooth paths, carried by few modes."""

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
        ends = {"f_low": f_low, "f_high": f_high}
        band = [plain_number(f"BandLimitedCovariance: '{name}'", end) for name, end in ends.items()]
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
        what = "BandLimitedCovariance.from_psd: "
        table = [real_array(what + name, one) for name, one in (("frequencies", frequencies), ("psd", psd))]
        if table[0].ndim != 1 or table[0].shape != table[1].shape or table[0].size < 2:
            raise ProblemError(
                f"{what}expected two vectors of the same length, of at least 2; received frequencies {table[0].shape} "
                f"and psd {table[1].shape}."
            )
        refuse_not_finite(what + "frequencies and psd", np.stack(table))
        if table[0][0] < 0 or not np.all(np.diff(table[0]) > 0):
            raise ProblemError(f"{what}frequencies must increase from 0 Hz or more; received {table[0]}.")
        if table[1].min() < 0 or table[1].max() == 0:
            raise ProblemError(
                f"{what}the psd must be nonnegative and not zero throughout; received values from {table[1].min():g} "
                f"to {table[1].max():g}."
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


def plain_number(what: str, value: Any) -> float:
    """A finite plain number. Raises `ProblemError` for anything else, such as a decision."""
    if isinstance(value, AbstractLeaf):
        raise ProblemError(
            f"{what} sets the covariance's eigenfunctions, which are computed once; expected a plain number; received "
            f"{value}. Make `std` or `mean` uncertain or decided instead."
        )
    return real(what, value)
