"""Germ distributions: standard random variables with their orthonormal polynomials (dissertation, table 4.1 and
equation 12), and the germ variables of correlated groups.

A *germ* is the standard random variable xi behind an uncertain number. Each germ class has the quantile function and
the three-term recurrence `b[n+1] p[n+1] = (xi - a[n]) p[n] - b[n] p[n-1]` of the polynomials orthonormal under its
distribution: `<p_i, p_j> = 1` for `i = j`, else 0. Source of the coefficients: Gautschi, Orthogonal Polynomials (2004).
"""

import abc
import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import final

import equinox as eqx
import numpy as np
import scipy
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array
from aleator._core.leaves import Module

_NORMAL = NormalDist()
# SciPy takes as long to load as a solve of a small problem; so many normal quantiles or levels are not worth it.
_FEW = 10_000


class AbstractGerm(abc.ABC):
    """The distribution of one germ variable and its orthonormal polynomials."""

    @abc.abstractmethod
    def recurrence(self, order: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Coefficients `a[0..order]` and `b[0..order]` of the recurrence; `b[0]` is not used and is 0."""

    @abc.abstractmethod
    def quantile(self, level: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Germ values at probability levels in (0, 1)."""

    @abc.abstractmethod
    def cumulative(self, germ: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Probability levels of germ values: the inverse of `quantile`, 0 below the support and 1 above."""

    @abc.abstractmethod
    def support(self) -> tuple[float, float]:
        """Smallest and largest germ value; they may be infinite."""

    def polynomials(self, order: int, germ: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n terms"]:
        """Values `p_0 .. p_order` of the orthonormal polynomials at the points `germ`: shape (n, order + 1)."""
        a, b = self.recurrence(order)
        values = np.ones((germ.size, order + 1))
        previous = np.zeros(germ.size)
        for n in range(order):
            values[:, n + 1] = ((germ - a[n]) * values[:, n] - b[n] * previous) / b[n + 1]
            previous = values[:, n]
        return values

    def gauss(self, count: int) -> tuple[Float[np.ndarray, " count"], Float[np.ndarray, " count"]]:
        """Gauss nodes and probability weights, exact to degree `2 count - 1` (Golub and Welsch, 1969)."""
        a, b = self.recurrence(count - 1)
        nodes, vectors = scipy.linalg.eigh_tridiagonal(a, b[1:])
        return nodes, vectors[0] ** 2


@final
@dataclass(frozen=True)
class LegendreGerm(AbstractGerm):
    """Uniform on [-1, 1]: Legendre polynomials."""

    @override
    def recurrence(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        n = np.arange(order + 1.0)
        return np.zeros(order + 1), n / np.sqrt(np.abs(4 * n**2 - 1))

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        return 2 * level - 1

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        return np.clip((1 + germ) / 2, 0, 1)

    @override
    def support(self) -> tuple[float, float]:
        return -1.0, 1.0


@final
@dataclass(frozen=True)
class HermiteGerm(AbstractGerm):
    """Standard normal: probabilists' Hermite polynomials."""

    @override
    def recurrence(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(order + 1), np.sqrt(np.arange(order + 1.0))

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        level = np.asarray(level)
        if level.size > _FEW or not np.all((level > 0) & (level < 1)):
            return scipy.special.ndtri(level)
        quantiles = map(_NORMAL.inv_cdf, level.ravel().tolist())
        return np.fromiter(quantiles, float, level.size).reshape(level.shape)

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        germ = np.asarray(germ, dtype=float)
        if germ.size > _FEW:
            return scipy.special.ndtr(germ)
        levels = (0.5 * math.erfc(one) for one in (-germ / math.sqrt(2)).ravel().tolist())
        return np.fromiter(levels, float, germ.size).reshape(germ.shape)

    @override
    def support(self) -> tuple[float, float]:
        return -np.inf, np.inf


@final
@dataclass(frozen=True)
class JacobiGerm(AbstractGerm):
    """Beta on [-1, 1], density proportional to `(1 + xi)^(alpha - 1) (1 - xi)^(beta - 1)`: Jacobi polynomials."""

    alpha: float
    beta: float

    @override
    def recurrence(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        left, right = self.alpha - 1, self.beta - 1
        total = left + right
        n = np.arange(1.0, order + 1)
        pole = 2 * n + total
        a = np.empty(order + 1)
        a[0] = (left - right) / (total + 2)
        a[1:] = (left**2 - right**2) / (pole * (pole + 2))
        b = np.zeros(order + 1)
        if order >= 1:
            # Written out, since for n = 1 the general formula is 0/0 when alpha + beta = 1.
            b[1] = 2 * np.sqrt((left + 1) * (right + 1) / ((total + 2) ** 2 * (total + 3)))
        n, pole = n[1:], pole[1:]
        b[2:] = 2 * np.sqrt(n * (n + left) * (n + right) * (n + total) / (pole**2 * (pole**2 - 1)))
        return a, b

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        return 2 * scipy.special.betaincinv(self.alpha, self.beta, level) - 1

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        return scipy.special.betainc(self.alpha, self.beta, np.clip((1 + germ) / 2, 0, 1))

    @override
    def support(self) -> tuple[float, float]:
        return -1.0, 1.0


@final
@dataclass(frozen=True)
class LaguerreGerm(AbstractGerm):
    """Gamma on [0, inf) with unit scale, density proportional to `xi^(shape - 1) exp(-xi)`: Laguerre polynomials."""

    shape: float

    @override
    def recurrence(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        n = np.arange(order + 1.0)
        return 2 * n + self.shape, np.sqrt(n * (n + self.shape - 1))

    @override
    def quantile(self, level: np.ndarray) -> np.ndarray:
        return scipy.special.gammaincinv(self.shape, level)

    @override
    def cumulative(self, germ: np.ndarray) -> np.ndarray:
        return scipy.special.gammainc(self.shape, np.maximum(germ, 0))

    @override
    def support(self) -> tuple[float, float]:
        return 0.0, np.inf


@final
class Dependence(Module):
    """A member's place in a group of correlated distributions.

    The group has one standard normal germ variable for each member. Member `index` is a function of the normal variable
    `factor[index] @ germs`, where `factor` is the Cholesky factor of the normals' correlation matrix. So it depends on
    its own germ variable and on those of the members before it.
    """

    group: str = eqx.field(static=True)
    members: tuple[str, ...] = eqx.field(static=True)
    index: int = eqx.field(static=True)
    factor: Float[np.ndarray, "members members"] | Float[Array, "members members"]

    @property
    def germ_names(self) -> tuple[str, ...]:
        """The germ variables on which the member depends."""
        return tuple(f"{self.group}.{member}" for member in self.members[: self.index + 1])

    @property
    def germs(self) -> dict[str, AbstractGerm]:
        """Their distributions, by name."""
        return {name: HermiteGerm() for name in self.germ_names}

    def normal(self, germs: Sequence[Float[Array, ""]]) -> Float[Array, ""]:
        """The member's standard normal variable at the values of its germ variables."""
        library, factor, germs = in_library(self.factor, list(germs))
        return jax_array(library.asarray(factor)[self.index, : self.index + 1] @ library.stack(germs))

    def __str__(self) -> str:
        return f"'{self.members[self.index]}' of the correlated group '{self.group}'"
