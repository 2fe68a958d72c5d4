"""Point sets: where in germ space a model is evaluated. This module has those that cover it evenly."""

import abc
from collections.abc import Mapping
from typing import ClassVar, NamedTuple, final

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Float
from typing_extensions import override

from aleator._core import given
from aleator._core.module import Module
from aleator.expansion._basis import Basis
from aleator.uncertainty import AbstractGerm

_SOBOL_BITS = 30


class Nodes(NamedTuple):
    """Collocation points with weights that add up to one, equal unless the set says otherwise.

    - `points`: germ values, shape (n_cp, variables);
    - `weights`: shape (n_cp,), of the squares in least squares and in the leave-one-out error.
    """

    points: Float[np.ndarray, "points variables"]
    weights: Float[np.ndarray, " points"]


def count_given(count: int | None) -> int | None:
    """A checked number of points or roots; None if it follows from the basis."""
    return None if count is None else given.whole("The number of points", count)


def seed_given(seed: int) -> int:
    """A checked seed of random numbers."""
    return given.whole("The seed of random points", seed, least=0)


class AbstractPoints(Module):
    """How collocation points are chosen for a basis.

    `nested`: whether a larger set contains the points of every smaller one, as growing an index set needs.
    """

    nested: ClassVar[bool] = False

    @abc.abstractmethod
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        """The points and their weights; `usual` is the number of points for sets that were given none."""

    def of(self, germs: Mapping[str, AbstractGerm]) -> "AbstractPoints":
        """The point set to use for a germ: itself, unless it chooses by the germ."""
        del germs
        return self


class AbstractCountedPoints(AbstractPoints):
    """A point set of any size: by default as many points as the fit needs, for least squares three per term."""

    count: int | None = eqx.field(static=True, default=None, converter=count_given)


class AbstractEvenPoints(AbstractCountedPoints):
    """Points that cover the unit cube evenly, mapped to the germ by its quantile functions; equal weights."""

    @override
    def nodes(self, basis: Basis, usual: int) -> Nodes:
        count = self.count or usual
        return Nodes(basis.map_to_germ(self.levels(count, basis.variables)), np.full(count, 1 / count))

    @abc.abstractmethod
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        """`count` points in the open unit cube."""


@final
class HammersleyPoints(AbstractEvenPoints):
    """The Hammersley set: `(i - 1/2)/count` and the radical inverses of `i = 1 .. count` in the prime bases.

    `count`: by default as many points as the fit needs, for least squares three per term.
    The half and the start at 1 keep every coordinate away from 0 and 1, where unbounded distributions are infinite.
    Source: Hammersley (1960), Annals of the New York Academy of Sciences 86.
    """

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        index = np.arange(1, count + 1)
        return np.column_stack([(index - 0.5) / count, _halton(index, variables - 1)])[:, :variables]


@final
class HaltonPoints(AbstractEvenPoints):
    """The Halton sequence from `i = 1` on: the radical inverses of `i` in the prime bases. Nested.

    `count`: by default as many points as the fit needs, for least squares three per term.
    Beyond about ten variables its columns are correlated unless there are very many points: take `SobolPoints` there.
    Source: Halton (1960), Numerische Mathematik 2.
    """

    nested: ClassVar[bool] = True

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        return _halton(np.arange(1, count + 1), variables)


class AbstractDrawnPoints(AbstractEvenPoints):
    """Random points in the unit cube, the same ones for the same `seed`."""

    seed: int = eqx.field(static=True, default=0, converter=seed_given)


@final
class SobolPoints(AbstractDrawnPoints):
    """The Sobol sequence with Owen's scrambling. Nested; most even if the count is a power of two.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the scrambling.
    Source: Owen (1998), Scrambling Sobol' and Niederreiter-Xing points; directions by Joe and Kuo (2008), by SciPy.
    """

    nested: ClassVar[bool] = True

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        engine = scipy.stats.qmc.Sobol(variables, scramble=True, bits=_SOBOL_BITS, rng=np.random.default_rng(self.seed))
        # Shifted by half a step, because 0 is infinite under an unbounded distribution.
        return engine.random_base2(int(count - 1).bit_length())[:count] + 0.5 ** (_SOBOL_BITS + 1)


@final
class LatinHypercubePoints(AbstractDrawnPoints):
    """A Latin hypercube: one random point in each of `count` slices of equal probability of every variable.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the random points.
    Source: McKay, Beckman and Conover (1979), Technometrics 21; by SciPy.
    """

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        return scipy.stats.qmc.LatinHypercube(variables, rng=np.random.default_rng(self.seed)).random(count)


@final
class RandomPoints(AbstractDrawnPoints):
    """Independent random points, as in Monte Carlo. Nested.

    `count`: by default as many points as the fit needs, for least squares three per term; `seed`: of the random points.
    """

    nested: ClassVar[bool] = True

    @override
    def levels(self, count: int, variables: int) -> Float[np.ndarray, "count variables"]:
        return np.random.default_rng(self.seed).random((count, variables))


def _halton(index: np.ndarray, variables: int) -> Float[np.ndarray, "count variables"]:
    columns = [radical_inverse(index, base) for base in _primes(variables)]
    return np.stack(columns, axis=1) if columns else np.zeros((len(index), 0))


def radical_inverse(index: np.ndarray, base: int) -> Float[np.ndarray, " count"]:
    """The digits of each index in `base`, mirrored at the radix point (van der Corput)."""
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
