"""The distribution of an output from its expansion, and statistics of many outputs, such as the instants of a path.

Small probabilities of either tail come from lines of their own: those for small values of the output, or of its
negative. A probability is that of the smaller side.

Statistics by lines cost milliseconds each. Of a path only those entries are taken so that a limit may be decided by, a
few of hundreds; others are taken by points that all outputs share, some hundred times as fast. There is a smooth
transition.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from typing_extensions import override

from aleator._core.arrays import Scalar, in_library, jax_array, numbers_to_arrays, quietly
from aleator._core.compilation import Compiled, Use
from aleator._core.parallel import over_devices
from aleator.statistics._known_distribution import KnownDistribution
from aleator.statistics._lines import SINGLE, AnyLines, Cloud
from aleator.statistics._lower_tails import EQUAL, AbstractLowerTail, Cut, lower_tail
from aleator.statistics._statistic import Std, in_blocks, root

# Points are evaluated for so many entries at once.
_TOGETHER = 64
# By how many standard deviations an entry may be apart from the one that decides to be taken by lines alone; more for a
# tail further out, about which the mean and the spread say less (from Cornish and Fisher's second term).
_NEAR, _NEARER = 0.1, 0.125


@final
class TailByPoints(AbstractLowerTail):
    """The probability below a threshold by points that are the same for all outputs: a matrix product, and a sum.

    Each point is spread out by a kernel of fourth order, a polynomial within its width.
    """

    close: ClassVar[float] = 1e-4

    values: Float[Array, " points"]
    width: Float[Array, ""]

    @classmethod
    def of(cls, signed: Float[Array, " terms"], cloud: Cloud) -> "TailByPoints":
        """That of an output with mean zero."""
        std = root(jnp.sum(signed**2))
        width = jnp.maximum(cloud.width * jax.lax.stop_gradient(std), np.finfo(float).tiny)
        return cls(std, signed @ cloud.terms, width)

    def _places(self, threshold: Float[Array, ""]) -> Float[Array, " points"]:
        return (threshold - self.values) / self.width

    @override
    def cut(self, threshold: Float[Array, ""]) -> Cut:
        square = jnp.minimum(self._places(threshold) ** 2, 1.0)
        density = jnp.mean((1 - square) * (3 - 7 * square)) * 15 / 32 / self.width
        none = jnp.zeros(0)
        return Cut(self.below(threshold, ()), density, *[none] * 8)

    @override
    def below(self, threshold: Float[Array, ""], at: object) -> Float[Array, ""]:
        place = jnp.clip(self._places(threshold), -1.0, 1.0)
        square = place**2
        return jnp.mean(0.5 + place * (45 - square * (50 - 21 * square)) / 32)

    @override
    def shortfall(self, threshold: Float[Array, ""], at: object) -> Float[Array, ""]:
        place = self._places(threshold)
        square = jnp.minimum(place**2, 1.0)
        inside = jnp.clip(place, -1.0, 1.0) / 2 + (5 + square * (45 - square * (25 - 7 * square))) / 64
        return self.width * jnp.mean(inside + jnp.maximum(place - 1, 0.0))

    @override
    def error(self, at: Cut) -> Float[Array, ""]:
        """Unknown."""
        return jnp.asarray(jnp.nan)


TailOf: TypeAlias = Callable[[Float[Array, " terms"]], AbstractLowerTail]
"""The lower tail of an output by its coefficients, the first of which is zero."""


class Estimate(NamedTuple):
    """A statistic, and the 95 % half-width of its integral over the expansion."""

    value: Float[Array, ""]
    error: Float[Array, ""]


@final
class OutputDistribution(NamedTuple):
    """The distribution of an output, whose tails some function gives: the upper one as that of its negative."""

    coefficients: Float[Array, " terms"]
    tail_of: TailOf

    def _side(self, is_lower: Bool[Array, ""]) -> tuple[Array, AbstractLowerTail]:
        sign = jnp.where(is_lower, 1.0, -1.0)
        return sign, self.tail_of(sign * self.coefficients.at[0].set(0.0))

    def chance(self, value: Scalar, *, above: bool, or_equal: bool = False) -> Estimate:
        """The probability of more than a value, or of less, without loss of digits where it is small.

        What equals the value but for rounding, as systems at a stop do, counts only with `or_equal`.
        """
        rounding = jax.lax.stop_gradient(EQUAL * root(jnp.sum(self.coefficients**2)))
        off = jnp.asarray(value) - self.coefficients[0] + (rounding if above != or_equal else -rounding)
        is_lower = off < 0
        sign, tail = self._side(is_lower)
        at = jax.lax.stop_gradient(tail.cut(sign * off))
        beyond = tail.below(sign * off, at)
        return Estimate(jnp.where(is_lower != above, beyond, 1 - beyond), tail.error(at))

    def between(self, low: Scalar, high: Scalar) -> Estimate:
        """The probability of values between two, these included."""
        under, over = self.chance(low, above=False, or_equal=True), self.chance(high, above=True, or_equal=True)
        return Estimate(1 - under.value - over.value, under.error + over.error)

    def density(self, value: Float[Array, ""]) -> Float[Array, ""]:
        """The probability density at a value. Not differentiable."""
        off = value - self.coefficients[0]
        sign, tail = self._side(off < 0)
        return tail.cut(sign * off).density

    def quantile(self, level: Scalar) -> Estimate:
        """The value that the output stays below with a probability."""
        is_lower = jnp.asarray(level) < 0.5
        sign, tail = self._side(is_lower)
        quantile, at = tail.quantile(jnp.where(is_lower, level, 1 - level))
        share = tail.error(at)
        error = share / jnp.where(at.density > 0, at.density, jnp.inf)
        # Where few lines meet a tail, the density there says nothing of how far others would move it.
        is_doubtful = share > jnp.where(is_lower, level, 1 - level) / 2
        return Estimate(self.coefficients[0] + sign * quantile, jnp.where(is_doubtful, jnp.abs(quantile), error))

    def mean_beyond(self, level: Scalar, *, lower: bool) -> Estimate:
        """The mean of the values below a quantile, or above it."""
        is_lower = jnp.asarray(level) < 0.5
        own = jnp.where(is_lower, level, 1 - level)
        sign, tail = self._side(is_lower)
        quantile, at = tail.quantile(own)
        below = quantile - tail.shortfall(quantile, at) / own
        # The mean of all is zero, so that those on the other side of the quantile balance these.
        away = jnp.where(is_lower == lower, below, -below * own / (1 - own))
        # By the derivative of the mean beyond a quantile by the level.
        slope = jnp.abs(away - quantile) / (level if lower else 1 - level)
        return Estimate(self.coefficients[0] + sign * away, tail.error(at) * slope)


def rows_of(
    kinds: Sequence[Any], coefficients: Sequence[Float[Array, "terms *shape"]]
) -> Float[Array, "columns entries"]:
    """The coefficients of all entries of some paths, followed by the numbers of their statistics."""
    each = []
    for kind, terms in zip(kinds, coefficients, strict=True):
        numbers = [jnp.full((1, *terms.shape[1:]), number, dtype=float) for number in jax.tree.leaves(kind)]
        each.append(jnp.concatenate([terms, *numbers]).reshape(len(terms) + len(numbers), -1))
    return jnp.concatenate(each, axis=1)


def _split(structure: Any, rows: Float[Array, "columns *n"]) -> tuple[Any, Float[Array, "terms *n"]]:
    terms = len(rows) - structure.num_leaves
    return jax.tree.unflatten(structure, list(rows[terms:])), rows[:terms]


@partial(jax.custom_jvp, nondiff_argnums=(0, 3))
def statistics_of_rows(
    structure: Any, rows: Float[Array, "columns entries"], lines: AnyLines, paths: int
) -> Float[Array, " entries"]:
    """The statistic of each entry of some paths of one length, with kinds of one structure."""
    return _evaluated(_of_row, structure, rows, lines, paths)[0]


@statistics_of_rows.defjvp
def _with_tangents(
    structure: Any, paths: int, primals: tuple[Array, AnyLines], tangents: tuple[Array, Any]
) -> tuple[Array, Array]:
    """The gradient is found once, together with the statistic: a tangent costs one sum.

    Crossings rest in it, so that second derivatives are zero: none are traced.
    """
    value, _, *slopes = _evaluated(_sloped, structure, *jax.lax.stop_gradient(primals), paths)
    return value, jnp.sum(jnp.stack(slopes) * tangents[0], axis=0)


def estimate_of_row(structure: Any, row: Float[Array, " columns"], tail_of: TailOf) -> Estimate:
    """The statistic of an entry, and its error."""
    kind, terms = _split(structure, row)
    return kind.of_distribution(OutputDistribution(terms, tail_of))


def _of_row(structure: Any, row: Float[Array, " columns"], tail_of: TailOf) -> Float[Array, ""]:
    return estimate_of_row(structure, row, tail_of).value


def _evaluated(
    function: Callable[..., Any], structure: Any, rows: Array, lines: AnyLines, paths: int
) -> Float[Array, "results entries"]:
    """The results of a function of each row."""
    entries = rows.shape[1] // paths
    lines, of_row = lines.for_one_of(entries), partial(function, structure)
    if entries <= SINGLE:
        return by_lines(of_row, rows, lines)
    kinds, terms = jax.tree.map(lambda each: each.reshape(*each.shape[:-1], paths, -1), _split(structure, rows))
    share = jax.lax.stop_gradient(_share_by_lines(kinds, terms).ravel())
    coarse = _by_points(of_row, rows, lines.cloud)
    fine = by_lines(of_row, rows, lines, (coarse, jnp.argsort(-share), jnp.sum(share > 0)))
    return coarse + share[None] * (fine - coarse)


def _by_points(
    of_row: Callable[..., Any], rows: Float[Array, "columns entries"], cloud: Cloud
) -> Float[Array, "results entries"]:
    by_points = jax.vmap(lambda row: _flat(of_row(row, partial(TailByPoints.of, cloud=cloud))))
    return in_blocks(by_points, rows, _TOGETHER).T


@quietly
def _share_by_lines(kind: Any, terms: Any) -> Float[Array, "*n entries"]:
    """The part that lines have in each entry of a path; points have the rest."""
    library, terms = in_library(terms)
    apart, away = kind.apart(terms[0], Std().of(terms, ()))
    share = library.nan_to_num(library.clip(2 - apart / (_NEAR + _NEARER * away**2), 0.0, 1.0))
    return share**2 * (3 - 2 * share)


def _flat(results: Any) -> Float[Array, " results"]:
    return jnp.hstack(jax.tree.leaves(results))


def by_lines(
    function: Callable[[Float[Array, " columns"], TailOf], Any],
    rows: Float[Array, "columns entries"],
    lines: AnyLines,
    some: tuple[Float[Array, "results entries"], Int[Array, " entries"], Int[Array, ""]] | None = None,
) -> Float[Array, "results entries"]:
    """The results of a function of each row by lines, one after the other.

    - `some`: the results of other rows, an order, and how many of the first in this order are taken.
    """

    def each(row: Float[Array, " columns"]) -> Float[Array, " results"]:
        return _flat(function(row, partial(lower_tail, lines=lines)))

    count = rows.shape[1]
    if count == 1:
        return each(rows[:, 0])[:, None]
    if some is None:
        return jax.lax.map(each, rows.T).T
    results, order, taken = some

    def evaluate(k: Int[Array, ""], results: Array) -> Array:
        return results.at[:, order[k]].set(each(rows[:, order[k]]))

    return jax.lax.fori_loop(0, taken, evaluate, results)


def _sloped(structure: Any, row: Float[Array, " columns"], tail_of: TailOf) -> Any:
    """The statistic of an entry, its error, and its derivatives by all columns."""

    def estimate(row: Float[Array, " columns"]) -> tuple[Array, Array]:
        return estimate_of_row(structure, row, tail_of)

    (value, error), slopes = jax.value_and_grad(estimate, has_aux=True)(row)
    return value, error, slopes


def _rows_by_points(
    kind: Any, coefficients: Float[Array, "terms entries"], cloud: Cloud
) -> Float[Array, "results entries"]:
    return _by_points(partial(_sloped, jax.tree.structure(kind)), rows_of([kind], [coefficients]), cloud)


# Its equations know no problem: one program serves all with as many terms. It has a loop that ends by a condition, and
# runs in milliseconds.
BY_POINTS = Compiled(_rows_by_points, use=Use.ONCE)


class Sloped(NamedTuple):
    """A statistic of known coefficients of shape (terms, *shape).

    - `values`, `errors`: the statistic, and the 95 % half-width of its integral over the expansion, NaN where points
      have a part in it; `slopes`: the derivatives of values by the coefficients of the same entry.
    """

    values: Float[np.ndarray, "*shape"]
    errors: Float[np.ndarray, "*shape"]
    slopes: Float[np.ndarray, "terms *shape"]


def sloped(
    kind: Any, coefficients: Float[np.ndarray, "terms *shape"], lines: AnyLines, *, by_lines_alone: bool = False
) -> Sloped:
    """A statistic of a known output, entry by entry, on all cores."""
    terms, *shape = coefficients.shape
    every = coefficients.reshape(terms, -1)
    is_finite = np.isfinite(every).all(axis=0)
    results, entries = np.full((2 + terms, every.shape[1]), np.nan), every[:, is_finite]
    numbers, lines = numbers_to_arrays(kind), lines.for_one_of(every.shape[1])
    known = jax.tree.map(np.asarray, lines)

    def by_points(some: Float[np.ndarray, "terms entries"]) -> Float[np.ndarray, "results entries"]:
        filled = np.pad(some, ((0, 0), (0, _TOGETHER - some.shape[1])), mode="edge")
        return np.asarray(BY_POINTS(numbers, jax_array(filled), lines.cloud))[: 2 + terms, : some.shape[1]]

    def by_lines_at(entry: int) -> Float[np.ndarray, " results"]:
        value, error, slopes = kind.of_distribution(KnownDistribution(entries[:, entry], known))
        return np.array([value, error, *slopes])

    share, coarse = np.ones(entries.shape[1]), np.zeros((2 + terms, entries.shape[1]))
    if every.shape[1] > SINGLE and entries.size and not by_lines_alone:
        share = np.asarray(_share_by_lines(kind, entries))
        blocks = np.split(entries, range(_TOGETHER, entries.shape[1], _TOGETHER), axis=1)
        coarse = np.concatenate(list(over_devices(by_points, blocks)), axis=1)
    near = np.flatnonzero(share).tolist()
    for entry, fine in zip(near, over_devices(by_lines_at, near), strict=True):
        part, own = share[entry], coarse[:, entry]
        coarse[:, entry] = fine if part == 1 else own + part * (fine - own)
    results[:, is_finite] = coarse
    value, error, *slopes = results.reshape(2 + terms, *shape)
    return Sloped(value, error, np.stack(slopes))


def prepare_sloped(kind: Any, shape: tuple[int, ...], lines: AnyLines) -> None:
    """Begin to compile what `sloped` will call for coefficients of a shape."""
    if math.prod(shape[1:]) > SINGLE:
        BY_POINTS.prepare(numbers_to_arrays(kind), jax_array(np.zeros((shape[0], _TOGETHER))), lines.cloud)
