"""The distribution of an output from its expansion, and statistics of many outputs, such as the instants of a path.

Small probabilities of either tail come from lines of their own: those for small values of the output, or of its
negative. A probability is that of the smaller side.

Statistics by lines cost milliseconds each. Of a path only those entries are taken so that a limit may be decided by, a
few of hundreds; others are taken by points that all outputs share, some hundred times as fast. There is a smooth
transition.
"""

import abc
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import batching, mlir
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import jax_array, quietly
from aleator._core.equations import derived
from aleator._core.leaves import is_traced
from aleator._core.parallel import in_order
from aleator.statistics._lines import SINGLE, AnyLines, Cloud, LinesInElements
from aleator.statistics._lower_tails import AbstractLowerTail, Cut, Place, TailByLines, TailInElements

# Values of an output that differ by this part of its root mean square are equal.
EQUAL = 1e-14
# Lines run along a variable too where the others state a larger error of a probability, and count if they differ from
# these by no more than so many such errors.
_DOUBTFUL, _COVERED = 1e-8, 2
# Points are evaluated for so many entries at once, each at least so wide.
_TOGETHER, _NO_WIDTH = 64, 1e-150
# By how many standard deviations an entry may be apart from the one that decides to be taken by lines alone; more for a
# tail further out, about which the mean and the spread say less (from Cornish and Fisher's second term).
_NEAR, _NEARER = 0.1, 0.125


class Estimate(NamedTuple):
    """A statistic of an output, or of some entries.

    - `error`: the 95 % half-width of its integral over the expansion, NaN where points have a part in it;
    - `slopes`: its derivatives by the coefficients of the same entry;
    - `by_numbers`: those by the numbers of the statistic, such as a level, in their order.
    """

    value: Float[Any, "*n"]
    error: Float[Any, "*n"]
    slopes: Float[np.ndarray, "terms *n"]
    by_numbers: tuple[Float[Any, "*n"], ...]

    @property
    def rows(self) -> Float[np.ndarray, "results *n"]:
        """All of it, one after the other."""
        return np.stack([self.value, self.error, *self.slopes, *self.by_numbers])


class AbstractOutputDistribution(abc.ABC):
    """The distribution of an output, or of some entries, by their coefficients."""

    def __init__(self, coefficients: Float[np.ndarray, "terms *n"]):
        self._mean = coefficients[0]
        self._rest = np.concatenate([np.zeros_like(coefficients[:1]), coefficients[1:]])
        self._equal = EQUAL * np.sqrt(np.sum(coefficients**2, axis=0))

    @abc.abstractmethod
    def _sought(
        self, sign: Float[Any, "*n"], search: Callable[[AbstractLowerTail], Place]
    ) -> tuple[AbstractLowerTail, Place]:
        """The lower tail of the output, or of its negative by its sign, and the threshold that is sought in it."""

    def _slopes(
        self, by_mean: Float[Any, "*n"], by_others: Float[np.ndarray, "terms *n"]
    ) -> Float[np.ndarray, "terms *n"]:
        return np.concatenate([np.broadcast_to(by_mean, by_others.shape[1:])[None], by_others[1:]])

    def chance(self, value: Any, *, above: bool, or_equal: bool = False) -> Estimate:
        """The probability of more than a value, or of less, without loss of digits where it is small.

        What equals the value but for rounding, as systems at a stop do, counts only with `or_equal`.
        """
        off = float(value) - self._mean + (self._equal if above != or_equal else -self._equal)
        threshold, sign = -np.abs(off), np.where(off < 0, 1.0, -1.0)
        tail, (_, at, *_) = self._sought(sign, lambda tail: Place(threshold, tail.cut(threshold)))
        beyond, slopes = tail.below(threshold, at)
        density, slopes = tail.change(threshold, at, slopes)
        # By the mean, from the density; by what follows, through the sign of the tail's own coefficients.
        slopes, is_beyond = self._slopes(-sign * density, sign * slopes), (off < 0) != above
        return Estimate(
            np.where(is_beyond, beyond, 1 - beyond),
            tail.error(at),
            np.where(is_beyond, slopes, -slopes),
            (-density if above else density,),
        )

    def between(self, low: Any, high: Any) -> Estimate:
        """The probability of values between two, these included."""
        under, over = self.chance(low, above=False, or_equal=True), self.chance(high, above=True, or_equal=True)
        by_ends = -under.by_numbers[0], -over.by_numbers[0]
        return Estimate(1 - under.value - over.value, under.error + over.error, -under.slopes - over.slopes, by_ends)

    def density(self, value: Any) -> Estimate:
        """The probability density at a value, without derivatives."""
        chance = self.chance(value, above=False, or_equal=True)
        unknown = np.full_like(chance.value, np.nan)
        return Estimate(chance.by_numbers[0], unknown, np.full_like(chance.slopes, np.nan), (unknown,))

    @quietly
    def quantile(self, level: Any) -> Estimate:
        """The value that the output stays below with a probability."""
        level = float(level)
        sign, own = (1.0, level) if level < 0.5 else (-1.0, 1 - level)
        tail, (quantile, at, slopes, by_level) = self._sought(sign, lambda tail: tail.quantile(own))
        share = tail.error(at)
        # Where few lines meet a tail, the density there says nothing of how far others would move it.
        error = np.where(share > own / 2, np.abs(quantile), np.where(at.density > 0, share / at.density, 0.0))
        return Estimate(self._mean + sign * quantile, error, self._slopes(1.0, slopes), (by_level,))

    def mean_beyond(self, level: Any, *, lower: bool) -> Estimate:
        """The mean of the values below a quantile, or above it."""
        level = float(level)
        sign, own = (1.0, level) if level < 0.5 else (-1.0, 1 - level)
        tail, (quantile, at, moving, _) = self._sought(sign, lambda tail: tail.quantile(own))
        shortfall, slopes = tail.shortfall(quantile, at)
        # The quantile contributes where many systems share it: else as much lies below as the level says.
        below, slopes = quantile - shortfall / own, moving * (1 - at.below / own) - slopes / own
        # The mean of all is zero, so that those on the other side of the quantile balance these.
        factor = 1.0 if (sign > 0) == lower else -own / (1 - own)
        by_level = np.abs(factor * below - quantile) / (level if lower else 1 - level)
        value = self._mean + sign * factor * below
        return Estimate(value, tail.error(at) * by_level, self._slopes(1.0, factor * slopes), (by_level,))


@final
class DistributionByLines(AbstractOutputDistribution):
    """That of one output. `lines`: of NumPy's arrays."""

    def __init__(self, coefficients: Float[np.ndarray, " terms"], lines: AnyLines):
        super().__init__(coefficients)
        self._lines, self._tails = lines, dict[tuple[float, bool], AbstractLowerTail]()

    def _tail(self, sign: float, *, is_axial: bool) -> AbstractLowerTail:
        if (sign, is_axial) not in self._tails:
            signed, lines = sign * self._rest, self._lines
            in_elements = isinstance(lines, LinesInElements)
            tail = TailInElements(signed, lines) if in_elements else TailByLines(signed, lines, is_axial=is_axial)
            self._tails[sign, is_axial] = tail
        return self._tails[sign, is_axial]

    @override
    def _sought(
        self, sign: Float[Any, ""], search: Callable[[AbstractLowerTail], Place]
    ) -> tuple[AbstractLowerTail, Place]:
        """Along the lines with the smaller error.

        Where the output bends, lines to its smallest values meet a threshold twice, or touch it, even if it rises all
        along one of the variables: lines along this variable meet it once, if they find as much within what the others
        may be off by.
        """
        tail = self._tail(float(sign), is_axial=False)
        place = search(tail)
        error = tail.error(place.cut)
        if isinstance(self._lines, LinesInElements) or not (self._lines.is_whole_lattice and error > _DOUBTFUL):
            return tail, place
        axial = self._tail(float(sign), is_axial=True)
        again = search(axial)
        moved = abs(again.threshold - place.threshold) * place.cut.density
        agrees = abs(again.cut.below - place.cut.below) + moved <= _COVERED * error
        return (axial, again) if agrees and axial.error(again.cut) < error else (tail, place)


@final
class TailByPoints(AbstractLowerTail):
    """The probability below a threshold by points that are the same for all outputs: a matrix product, and a sum.

    Each point is spread out by a kernel of fourth order, a polynomial within its width.
    """

    close: ClassVar[float] = 1e-4

    def __init__(self, signed: Float[np.ndarray, "terms entries"], cloud: Cloud):
        self._terms = np.asarray(cloud.terms)
        self.std = np.sqrt(np.sum(signed**2, axis=0))
        self._values = signed.T @ self._terms
        # What is certain has some width too, whose reciprocal may be multiplied by anything.
        self._width = np.maximum(cloud.width * self.std, _NO_WIDTH)

    def _places(self, threshold: Float[np.ndarray, " entries"]) -> Float[np.ndarray, "entries points"]:
        return (threshold - self._values.T).T / self._width[:, None]

    def _slopes(self, each: Float[np.ndarray, "entries points"]) -> Float[np.ndarray, "terms entries"]:
        """Those of a mean over the points, by its derivatives by their values."""
        return self._terms @ each.T / each.shape[1]

    @override
    def cut(self, threshold: Float[np.ndarray, " entries"]) -> Cut:
        place = self._places(threshold)
        return Cut(np.mean(_kernel_below(place), axis=1), np.mean(_kernel(place), axis=1) / self._width)

    @override
    def below(
        self, threshold: Float[np.ndarray, " entries"], at: Cut
    ) -> tuple[Any, Float[np.ndarray, "terms entries"]]:
        return at.below, -self._slopes(_kernel(self._places(threshold)) / self._width[:, None])

    @override
    def shortfall(
        self, threshold: Float[np.ndarray, " entries"], at: Cut
    ) -> tuple[Any, Float[np.ndarray, "terms entries"]]:
        place = self._places(threshold)
        square = np.minimum(place**2, 1.0)
        inside = np.clip(place, -1.0, 1.0) / 2 + (5 + square * (45 - square * (25 - 7 * square))) / 64
        value = self._width * np.mean(inside + np.maximum(place - 1, 0.0), axis=1)
        return value, -self._slopes(_kernel_below(place))

    @override
    def error(self, at: Cut) -> Float[np.ndarray, " entries"]:
        """Unknown."""
        return np.full(self.std.shape, np.nan)


def _kernel(place: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    square = np.minimum(place**2, 1.0)
    return (1 - square) * (3 - 7 * square) * (15 / 32)


def _kernel_below(place: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    place = np.clip(place, -1.0, 1.0)
    square = place**2
    return 0.5 + place * (45 - square * (50 - 21 * square)) / 32


@final
class DistributionByPoints(AbstractOutputDistribution):
    """That of some entries."""

    def __init__(self, coefficients: Float[np.ndarray, "terms entries"], cloud: Cloud):
        super().__init__(coefficients)
        self._cloud = cloud

    @override
    def _sought(
        self, sign: Float[Any, "*entries"], search: Callable[[AbstractLowerTail], Place]
    ) -> tuple[AbstractLowerTail, Place]:
        tail = TailByPoints(sign * self._rest, self._cloud)
        return tail, search(tail)


class Sloped(NamedTuple):
    """A statistic of coefficients of shape (terms, *shape): as an `Estimate` of each entry.

    `by_numbers` is stacked along a first axis.
    """

    values: Float[Any, "*shape"]
    errors: Float[Any, "*shape"]
    slopes: Float[Any, "terms *shape"]
    by_numbers: Float[Any, "numbers *shape"]


def sloped(
    kind: Any, coefficients: Float[np.ndarray, "terms *shape"], lines: AnyLines, *, by_lines_alone: bool = False
) -> Sloped:
    """A statistic of a known output, entry by entry, on all cores. Without JAX: programs call it."""
    terms, *shape = coefficients.shape
    every = coefficients.reshape(terms, -1)
    is_finite = np.isfinite(every).all(axis=0)
    entries, is_path = every[:, is_finite], every.shape[1] > SINGLE
    known = jax.tree.map(np.asarray, lines).for_one_of(every.shape[1])

    def by_points(some: Float[np.ndarray, "terms entries"]) -> Float[np.ndarray, "results entries"]:
        return kind.of_distribution(DistributionByPoints(some, known.cloud)).rows

    def by_lines(entry: int) -> Float[np.ndarray, " results"]:
        return kind.of_distribution(DistributionByLines(entries[:, entry], known)).rows

    share = np.ones(entries.shape[1])
    results = np.zeros((2 + terms + len(jax.tree.leaves(kind)), entries.shape[1]))
    if is_path and entries.size and not by_lines_alone:
        share = _share_by_lines(kind, entries)
        blocks = np.split(entries, range(_TOGETHER, entries.shape[1], _TOGETHER), axis=1)
        results = np.concatenate(list(in_order(by_points, blocks)), axis=1)
    near = np.flatnonzero(share).tolist()
    for entry, fine in zip(near, in_order(by_lines, near), strict=True):
        part, own = share[entry], results[:, entry]
        results[:, entry] = fine if part == 1 else own + part * (fine - own)
    whole = np.full((len(results), every.shape[1]), np.nan)
    whole[:, is_finite] = results
    whole = whole.reshape(-1, *shape)
    return Sloped(whole[0], whole[1], whole[2 : 2 + terms], whole[2 + terms :])


@quietly
def _share_by_lines(kind: Any, terms: Float[np.ndarray, "terms entries"]) -> Float[np.ndarray, " entries"]:
    """The part that lines have in each entry of a path; points have the rest."""
    apart, away = kind.apart(terms[0], np.sqrt(np.sum(terms[1:] ** 2, axis=0)))
    share = np.nan_to_num(np.clip(2 - apart / (_NEAR + _NEARER * away**2), 0.0, 1.0))
    return share**2 * (3 - 2 * share)


def statistic_of(
    kind: Any, coefficients: Float[Array, "terms *shape"], lines: AnyLines, *, by_lines_alone: bool = False
) -> Float[Array, "*shape"]:
    """A statistic of an output, known or traced, with first derivatives: second ones are zero."""
    if not is_traced((kind, coefficients, lines)):
        return jax_array(sloped(kind, np.asarray(coefficients), lines, by_lines_alone=by_lines_alone).values)
    (numbers, own), (constants, others) = jax.tree.flatten(kind), jax.tree.flatten(lines)

    structures = own, others, by_lines_alone

    def found(coefficients: Array, numbers: list[Array], constants: list[Array]) -> Sloped:
        return Sloped(*_sloped.bind(coefficients, *numbers, *constants, structures=structures, depth=0))

    @jax.custom_jvp
    def values(coefficients: Array, numbers: list[Array], constants: list[Array]) -> Array:
        return found(coefficients, numbers, constants).values

    def tangent(primals: Any, tangents: Any) -> tuple[Array, Array]:
        """Values and slopes are found together: a tangent costs one sum. Slopes rest in further derivatives."""
        value, _, slopes, by_numbers = found(*jax.lax.stop_gradient(primals))
        change = jnp.sum(slopes * tangents[0], axis=0)
        return value, change + sum(slope * by for slope, by in zip(by_numbers, tangents[1], strict=True))

    values.defjvp(derived(tangent))
    return values(coefficients, [jnp.asarray(one, dtype=float) for one in numbers], constants)


# NumPy computes it inside programs too: its equations would take seconds to compile for each basis.
_sloped = Primitive("statistic_of_tail")
_sloped.multiple_results = True


def _by_numpy(coefficients: Any, *rest: Any, structures: Any, depth: int) -> list[np.ndarray]:
    own, others, by_lines_alone = structures
    batch, inner = coefficients.shape[:depth], coefficients.shape[depth:]
    numbers = [np.asarray(one).reshape(-1) for one in rest[: own.num_leaves]]
    lines = jax.tree.unflatten(others, rest[own.num_leaves :])
    outputs = np.asarray(coefficients).reshape(-1, *inner)

    def each(i: int) -> Sloped:
        kind = jax.tree.unflatten(own, [float(one[i]) for one in numbers])
        return sloped(kind, outputs[i], lines, by_lines_alone=by_lines_alone)

    parts = zip(*in_order(each, range(len(outputs))), strict=True)
    return [np.stack(one).reshape((*batch, *one[0].shape)) for one in parts]


def _shapes(coefficients: Any, *_: Any, structures: Any, depth: int) -> list[ShapedArray]:
    batch, (terms, *shape) = coefficients.shape[:depth], coefficients.shape[depth:]
    counts = (), (), (terms,), (structures[0].num_leaves,)
    return [ShapedArray((*batch, *count, *shape), coefficients.dtype) for count in counts]


def _batched(
    operands: Sequence[Array], axes: Sequence[int | None], *, structures: Any, depth: int
) -> tuple[list[Array], list[int]]:
    """A batch of outputs and of the statistic's numbers, for lines of one basis."""
    count = 1 + structures[0].num_leaves
    (size,) = {one.shape[axis] for one, axis in zip(operands, axes, strict=True) if axis is not None}
    moved = [
        jnp.broadcast_to(one, (size, *one.shape)) if axis is None else jnp.moveaxis(one, axis, 0)
        for one, axis in zip(operands[:count], axes[:count], strict=True)
    ]
    return _sloped.bind(*moved, *operands[count:], structures=structures, depth=depth + 1), [0] * 4


def _lowered(context: Any, *operands: Any, **params: Any) -> Any:
    def call(*arrays: Any) -> list[np.ndarray]:
        return _by_numpy(*arrays, **params)

    shapes = context.avals_in, context.avals_out
    options: Any = {"has_side_effect": False, "returns_token": False}
    return mlir.emit_python_callback(context, call, None, list(operands), *shapes, **options)[0]


_sloped.def_impl(lambda *operands, **params: list(map(jax_array, _by_numpy(*operands, **params))))
_sloped.def_abstract_eval(_shapes)
batching.primitive_batchers[_sloped] = _batched
mlir.register_lowering(_sloped, _lowered, cacheable=False)
