"""Orthonormal polynomials of any measure: the recurrence by a discretised Stieltjes procedure.

Source: Gautschi, Orthogonal Polynomials: Computation and Approximation (2004), sections 2.2.3 and 2.2.4. The inner
products of Stieltjes's procedure are taken on the nodes of a fine quadrature, and each new polynomial is made
orthogonal to all before it (as in the Lanczos process), which keeps the basis orthonormal to rounding.
"""

import abc
import functools

import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.uncertainty._measure import Measure
from aleator.uncertainty._polynomials import AbstractGerm

_HALVINGS = 7
_AGREEMENT = 1e-11  # of two rules; the coefficients taken are those of the finer one, which is far more accurate


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
            "jumps. Smooth it, or lower the order."
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
                "need do not exist. Bound the density by `lower` and `upper`, or lower the order."
            )
    return a, b
