"""A density as a fine quadrature: its nodes, probabilities and quantiles, and the polynomials orthonormal under it.

The line is mapped to a finite range of `t` by the double exponential maps of Takahasi and Mori (1974), which spread out
singular ends and decaying tails. That range is subdivided into panels until Gauss quadrature is accurate on each, which
also locates kinks and jumps of the density. Around peaks that lie between the nodes of the first panels, a scan puts
narrower ones.

The recurrence of any measure's polynomials follows by a discretised Stieltjes procedure (Gautschi, Orthogonal
Polynomials: Computation and Approximation, 2004, sections 2.2.3 and 2.2.4). Its inner products are taken on the nodes
of a fine quadrature, and each new polynomial is made orthogonal to all before it (as in the Lanczos process), which
keeps the basis orthonormal to rounding.
"""

import abc
import functools
from collections.abc import Callable
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.uncertainty._polynomials import AbstractGerm

_RULE = np.polynomial.legendre.leggauss(20)
_FIRST_PANELS = 64
# Evenly spread points at which peaks are sought that are too narrow for the first panels: those whose second difference
# exceeds this part of their height, the highest ones only. Panels around them double in width as often.
_SCANNED, _SHARP, _PEAKS, _DOUBLINGS = 2**16, 1e-4, 32, 16
_MOST_PANELS = 20_000
_TOLERANCE = 1e-11  # of each panel; the nodes of its halves are kept, which are far more accurate
_NARROWEST = 2.0**-46
_SHAKEN = 4.0  # by so many units of rounding of its coordinates a panel's values may be off
_NO_MASS = 1e-250  # a smaller total is the foot of a peak that lies between the first nodes
_BISECTIONS = 60
# A point that moves by no more than this rests.
_AT_REST = 1e-15

_FINITE_END, _FAR, _NEAR = 6.0, 4.5, 6.7  # values of t where a map is within 1e-275 of an end, or 1e30 away

_HALVINGS = 7
_AGREEMENT = 1e-11  # of two rules; the coefficients taken are those of the finer one, which is far more accurate


class _Map(NamedTuple):
    """A map between `t` in (first, last) and the support of a density."""

    first: float
    last: float
    to_x: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]
    to_t: Callable[[np.ndarray], np.ndarray]


def _finite_map(low: float, high: float) -> _Map:
    """From `low` to `high`. Distances are measured from the nearer end, so that a singularity at 0 is resolved."""
    width = high - low

    def to_x(t: np.ndarray) -> np.ndarray:
        distance = width / (1 + np.exp(np.pi * np.sinh(np.abs(t))))
        return np.where(t < 0, low + distance, high - distance)

    def slope(t: np.ndarray) -> np.ndarray:
        decay = np.exp(-np.pi * np.sinh(np.abs(t)))
        return width * np.pi * np.cosh(t) * decay / (1 + decay) ** 2

    def to_t(x: np.ndarray) -> np.ndarray:
        return np.arcsinh(np.log((x - low) / (high - x)) / np.pi)

    return _Map(-_FINITE_END, _FINITE_END, to_x, slope, to_t)


def _half_map(end: float, sign: int) -> _Map:
    """From `end` to infinity in the direction of `sign`, with `t` increasing with `x`."""

    def distance(t: np.ndarray) -> np.ndarray:
        return np.exp(np.pi / 2 * np.sinh(sign * t))

    first, last = (-_NEAR, _FAR) if sign > 0 else (-_FAR, _NEAR)
    return _Map(
        first,
        last,
        lambda t: end + sign * distance(t),
        lambda t: distance(t) * np.pi / 2 * np.cosh(t),
        lambda x: sign * np.arcsinh(2 / np.pi * np.log(sign * (x - end))),
    )


def _line_map() -> _Map:
    return _Map(
        -_FAR,
        _FAR,
        lambda t: np.sinh(np.pi / 2 * np.sinh(t)),
        lambda t: np.cosh(np.pi / 2 * np.sinh(t)) * np.pi / 2 * np.cosh(t),
        lambda x: np.arcsinh(2 / np.pi * np.arcsinh(x)),
    )


def _map(low: float, high: float) -> _Map:
    if np.isfinite(low) and np.isfinite(high):
        return _finite_map(low, high)
    if np.isfinite(low):
        return _half_map(low, 1)
    return _half_map(high, -1) if np.isfinite(high) else _line_map()


@final
class Measure:
    """The probability measure of a density on (low, high), which need not be normalised.

    Raises `ProblemError` if the density is negative or not finite, if it cannot be integrated, or if no mass is found.
    """

    def __init__(self, density: Callable[[np.ndarray], np.ndarray], low: float, high: float):
        self._density, self._ends = density, (low, high)
        self._map = _map(low, high)
        edges = self._divide()
        _, masses = self._panels(edges[:-1], edges[1:])
        sums = np.cumsum(masses.sum(axis=1))
        self._edges, self._total = edges, sums[-1]
        self._check_mass()
        self._levels = np.concatenate([[0.0], sums / self._total])
        self._check_ends()

    def rule(self, halvings: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Nodes (increasing) and weights (they add up to 1) that integrate under the measure.

        The panels are those that the density needs, halved `halvings` times for the functions to be integrated.
        """
        edges = self._edges
        for _ in range(halvings):
            edges = np.sort(np.concatenate([edges, (edges[:-1] + edges[1:]) / 2]))
        nodes, masses = (np.ravel(values) for values in self._panels(edges[:-1], edges[1:]))
        carrying = masses > 0
        return nodes[carrying], masses[carrying] / np.sum(masses)

    def cumulative(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Probability below each point."""
        x = np.asarray(x, dtype=float)
        with np.errstate(all="ignore"):
            t = self._map.to_t(np.clip(x, *self._ends))
        t = np.clip(np.nan_to_num(t, nan=0.0), self._edges[0], self._edges[-1])
        return self._level_at(t, self._panel_of(t, self._edges))

    def quantile(self, level: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The point below which each probability lies, by Newton's method inside its panel, bisection where a step
        leaves the bracket or does not halve it.
        """
        level = np.asarray(level, dtype=float)
        every = level.ravel()
        panels = self._panel_of(every, self._levels)
        low, high = self._edges[panels], self._edges[panels + 1]
        t, width, moving = (low + high) / 2, high - low, np.arange(every.size)
        for _ in range(_BISECTIONS):
            here = t[moving]
            off = self._level_at(here, panels[moving]) - every[moving]
            low[moving], high[moving] = np.where(off < 0, here, low[moving]), np.where(off < 0, high[moving], here)
            with np.errstate(all="ignore"):
                newton = here - off * self._total / (self._values(self._map.to_x(here)) * self._map.slope(here))
            middle, is_usable = (low[moving] + high[moving]) / 2, np.abs(newton - here) < width[moving] / 2
            t[moving] = np.where(is_usable, np.clip(newton, low[moving], high[moving]), middle)
            width[moving] = np.abs(t[moving] - here)
            moving = moving[width[moving] > _AT_REST]
            if not moving.size:
                break
        return self._map.to_x(t).reshape(level.shape)

    def _panel_of(self, values: np.ndarray, edges: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)

    def _level_at(self, t: np.ndarray, panel: np.ndarray) -> np.ndarray:
        _, masses = self._panels(self._edges[panel], t)
        return np.clip(self._levels[panel] + masses.sum(axis=-1) / self._total, 0, 1)

    def _panels(self, starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and masses of Gauss's rule on the panels from `starts` to `ends`: shape (*panels, 20)."""
        nodes, weights = _RULE
        centre, half = (starts + ends)[..., None] / 2, (ends - starts)[..., None] / 2
        t = centre + half * nodes
        x = self._map.to_x(t)
        return x, self._values(x) * self._map.slope(t) * half * weights

    def _values(self, x: np.ndarray) -> np.ndarray:
        """The density, checked; zero at points that rounding has moved onto an end."""
        low, high = self._ends
        inside = (x > low) & (x < high)
        values = np.zeros(x.shape)
        with np.errstate(all="ignore"):
            density = np.asarray(self._density(x[inside]))
        if density.shape != x[inside].shape:
            raise ProblemError(
                "A density takes an array of points and returns one number for each: expected shape "
                f"{x[inside].shape}; received {density.shape}. Write it with NumPy functions."
            )
        bad = ~(np.isfinite(density) & (density >= 0))
        if np.any(bad):
            raise ProblemError(
                f"A density is finite and not negative inside its bounds: received {density[bad][0]:g} at "
                f"{x[inside][bad][0]:g}. Correct the function, or set `lower` and `upper` to where it is a density."
            )
        values[inside] = density
        return values

    def _divide(self) -> np.ndarray:
        """Edges of the panels in `t`, halved until Gauss quadrature on each agrees with that on its halves."""
        narrowest = (self._map.last - self._map.first) * _NARROWEST
        edges = np.linspace(self._map.first, self._map.last, _FIRST_PANELS + 1)
        edges = np.union1d(edges, self._around_peaks())
        starts, ends, accepted = edges[:-1], edges[1:], [edges]
        count = starts.size
        while starts.size:
            middles = (starts + ends) / 2
            (nodes, whole), (_, left), (_, right) = (
                self._panels(a, b) for a, b in ((starts, ends), (starts, middles), (middles, ends))
            )
            fine = left.sum(axis=1) + right.sum(axis=1)
            accepted.append(middles)
            tolerance = (_TOLERANCE + self._noise(starts, ends)) * fine + self._shaken(nodes, whole) + 1e-290
            rough = (np.abs(whole.sum(axis=1) - fine) > tolerance) & (middles - starts > narrowest)
            starts, ends = (
                np.concatenate([starts[rough], middles[rough]]),
                np.concatenate([middles[rough], ends[rough]]),
            )
            count += starts.size
            if count > _MOST_PANELS:
                raise ProblemError(
                    "A density could not be integrated: it has too many jumps, is not smooth between them, or is not "
                    f"integrable near {float(self._map.to_x(starts[:1])[0]):g}. Check that its integral is finite, or "
                    "set `lower` and `upper` away from there."
                )
            if not np.all(np.isfinite(fine)):
                raise ProblemError("A density could not be integrated: its integral is not finite. Rescale it.")
        return np.unique(np.concatenate(accepted))

    def _around_peaks(self) -> np.ndarray:
        """Values of `t` at sharp peaks of the density and, at doubling distances, around them."""
        (low, high), (first, last) = self._ends, self._map[:2]
        places = (np.arange(_SCANNED) + 0.5) / _SCANNED
        is_finite = np.isfinite(high - low)
        t = first + (last - first) * places
        x = low + (high - low) * places if is_finite else self._map.to_x(t)
        heights = self._values(x) * (1.0 if is_finite else self._map.slope(t))
        before, middle, after = heights[:-2], heights[1:-1], heights[2:]
        sharp = (middle > (1 + _SHARP) * (before / 2 + after / 2)) & (middle >= before) & (middle >= after)
        peaks = 1 + np.flatnonzero(sharp)
        peaks = peaks[np.argsort(-heights[peaks], kind="stable")[:_PEAKS]]
        near = [self._map.to_t(x[peaks + k]) if is_finite else t[peaks + k] for k in (-1, 0, 1)]
        steps = (near[2] - near[0])[:, None] / 2 * 2.0 ** np.arange(_DOUBLINGS)
        around = near[1][:, None] + np.concatenate([-steps, 0 * steps[:, :1], steps], axis=1)
        return around[(around > first) & (around < last)]

    def _noise(self, starts: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """The possible rounding error of each panel's integral: coordinates resolve the distance to an end poorly."""
        noise = np.zeros(starts.shape)
        for end, t in zip(self._ends, (starts, ends), strict=True):
            if np.isfinite(end):
                with np.errstate(divide="ignore", invalid="ignore"):
                    noise += np.nan_to_num(64 * np.finfo(float).eps * abs(end) / np.abs(self._map.to_x(t) - end))
        return noise

    def _shaken(self, nodes: np.ndarray, masses: np.ndarray) -> np.ndarray:
        """By how much rounding of coordinates may change each integral: wholly, beside a zero of the density."""
        largest = np.max(np.abs([end for end in self._ends if np.isfinite(end)]), initial=0.0)
        rounding = np.finfo(float).eps * np.maximum(np.abs(nodes).max(axis=1), largest)
        with np.errstate(divide="ignore", invalid="ignore"):
            variation = np.ptp(masses / _RULE[1], axis=1) * 2 / (nodes[:, -1] - nodes[:, 0])
        return np.nan_to_num(_SHAKEN * rounding * variation, posinf=0.0)

    def _check_mass(self) -> None:
        if not self._total > _NO_MASS:
            raise ProblemError(
                f"A density has no mass where it was sampled: expected a positive integral between {self._ends[0]:g} "
                f"and {self._ends[1]:g}. Set `lower` and `upper` closely around its mass."
            )

    def _check_ends(self) -> None:
        """Refuse a density with mass at an end, beyond the last node or within the rounding of coordinates."""
        _, weights = self.rule(0)
        for end, inwards, last in zip(self._ends, (1, -1), weights[[0, -1]], strict=True):
            step = 8 * np.finfo(float).eps * abs(end)
            if 0 < step < np.inf:
                near, far = self._values(end + inwards * step * np.array([1.0, 64.0]))
                if near * step > 1e-12 * self._total and near > 2 * far:
                    raise ProblemError(
                        f"A density grows without bound towards its end {end:g}, where rounding hides it: expected the "
                        "singular end at 0. Shift the function so that this end is 0, and give `location`."
                    )
            elif last > 1e-12:
                raise ProblemError(
                    f"A density could not be integrated: its integral does not converge towards its end {end:g}. "
                    "Set `lower` and `upper` so that its integral is finite."
                )


def recurrence_of(
    nodes: Float[np.ndarray, " n"], weights: Float[np.ndarray, " n"], order: int
) -> tuple[Float[np.ndarray, " terms"], Float[np.ndarray, " terms"], Float[np.ndarray, "terms n"]]:
    """Coefficients `a` and `b` of `AbstractGerm.recurrence` for the measure of `weights` (of sum 1) at `nodes`.

    The third result holds the polynomials at the nodes, times the square root of the weights: orthonormal rows. `order`
    must be less than the number of nodes.
    """
    centre = weights @ nodes
    spread = np.sqrt(weights @ (nodes - centre) ** 2) if order else 1.0
    x = (nodes - centre) / spread  # a mean far from 0 would cost digits
    a, b = np.zeros(order + 1), np.zeros(order + 1)
    basis = np.empty((order + 1, nodes.size))
    basis[0] = np.sqrt(weights)
    for n in range(order + 1):
        product = x * basis[n]
        a[n] = basis[n] @ product
        if n == order:
            break
        for _ in range(2):  # twice, since rounding leaves a remainder the first time
            product = product - (basis[: n + 1] @ product) @ basis[: n + 1]
        b[n + 1] = np.linalg.norm(product)
        basis[n + 1] = product / b[n + 1]
    return centre + spread * a, spread * b, basis


class AbstractDensityGerm(AbstractGerm):
    """A germ given by its density: polynomials, quantiles and probabilities come from a fine quadrature of it."""

    @abc.abstractmethod
    def density(self, germ: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """The density inside the support, up to a constant factor."""

    @override
    def recurrence(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Raises `ProblemError` if moments of the density do not exist."""
        return _recurrence(self, order)

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        return _measure(self).quantile(level)

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        return _measure(self).cumulative(germ)


@functools.lru_cache(maxsize=128)
def _measure(germ: AbstractDensityGerm) -> Measure:
    return Measure(germ.density, *germ.support())


@functools.lru_cache(maxsize=512)
def _recurrence(germ: AbstractDensityGerm, order: int) -> tuple[np.ndarray, np.ndarray]:
    """The recurrence on successively finer rules, until two agree."""
    if order == 0:
        # At order 0 there is only the mean, which may be zero and so gives no scale for a tolerance.
        a, b = _recurrence(germ, 1)
        return a[:1], b[:1]
    a, b = _discretised(germ, order, halvings=0)
    for halvings in range(1, _HALVINGS):
        coarse = a, b
        a, b = _discretised(germ, order, halvings)
        change = np.max(np.abs([coarse[0] - a, coarse[1] - b]))
        rounding = 64 * np.finfo(float).eps * np.max(np.abs(a))  # of coordinates far from 0
        if change <= _AGREEMENT * np.max(np.append(b[1:], np.abs(a[-1] - a[0]))) + rounding:
            break
    else:
        raise ProblemError(
            f"The polynomials of a density are not resolved at order {order}: the function is not smooth between its "
            "jumps, or singular inside. Smooth it, or lower the order."
        )
    for coefficients in (a, b):
        coefficients.flags.writeable = False  # the cached array is shared
    return a, b


def _discretised(germ: AbstractDensityGerm, order: int, halvings: int) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = _measure(germ).rule(halvings)
    with np.errstate(over="ignore", invalid="ignore"):
        a, b, basis = recurrence_of(nodes, weights, order)
    for end, column in zip(germ.support(), (basis[:, 0], basis[:, -1]), strict=True):
        # Where the tail is too heavy, the highest polynomials concentrate at the last node, however far away it is.
        if np.isinf(end) and not np.all(np.abs(column) < 1e-6):
            raise ProblemError(
                f"The tail of a density decays too slowly for polynomials of order {order}: the moments that they "
                "need do not exist. Bound the density by `lower` and `upper`, lower the order, or take "
                "al.points.GaussPoints(), which need fewer than other points."
            )
    return a, b
