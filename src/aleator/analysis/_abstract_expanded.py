"""`AbstractExpanded`: the statistics of an expanded function of uncertain inputs."""

import abc
import threading
from collections.abc import Callable, Mapping
from typing import Any
from weakref import WeakKeyDictionary

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator._core.module import Module
from aleator._core.shown import Drawn
from aleator.analysis._inputs import germ_of
from aleator.ensemble import at_levels, part, random_levels
from aleator.expansion import Basis
from aleator.statistics import AbstractMeasured, AbstractStatistic, Correlation, Covariance
from aleator.uncertainty import AbstractDistribution, AbstractGerm

_PREPARED: "WeakKeyDictionary[Basis, dict[Any, Pytree]]" = WeakKeyDictionary()
_LOCK = threading.Lock()


def prepared(preparation: Callable[[Basis], Pytree] | None, basis: Basis) -> Pytree:
    """The constants that a statistic needs of a basis: prepared on first use, and kept as long as the basis."""
    if preparation is None:
        return ()
    with _LOCK:
        known = _PREPARED.setdefault(basis, {})
    if preparation not in known:
        # Kept values must not belong to a function that is being traced.
        with jax.ensure_compile_time_eval():
            known[preparation] = preparation(basis)
    return known[preparation]


class AbstractExpanded(Module, Drawn, AbstractMeasured[Pytree]):
    """An uncertain output, or a dict of them, as polynomials of the uncertain inputs.

    Every statistic has the structure of the outputs: an array, entry by entry, or a dict; `expanded["y"]` selects one
    output of a dict. All are JAX functions of the distributions' parameters: apply `jax.grad` to a function that builds
    the distributions, expands and takes a statistic.
    """

    distributions: eqx.AbstractVar[dict[str, AbstractDistribution]]

    @property
    @abc.abstractmethod
    def germs(self) -> Mapping[str, AbstractGerm]:
        """The distribution of each germ variable by name, in the order of a germ vector."""

    @abc.abstractmethod
    @override
    def statistic(self, kind: AbstractStatistic) -> Pytree:
        """Any other statistic of each output."""

    @abc.abstractmethod
    def __getitem__(self, name: str) -> "AbstractExpanded":
        """One output by name, if the outputs are a dict."""

    @abc.abstractmethod
    def at_germ(self, points: Float[np.ndarray, "n variables"]) -> Pytree:
        """The expansion at germ points given as plain numbers: shape (n, *shape) for each output."""

    def sample(self, count: int, seed: int) -> Pytree:
        """The expansion at `count` random germ points: shape (count, *shape) for each output."""
        levels = random_levels(np.random.default_rng(seed), len(self.germs), count).T
        return self.at_germ(at_levels(self.germs.values(), levels))

    def __call__(self, inputs: Mapping[str, Any]) -> Pytree:
        """The expansion as a surrogate: the outputs at one plain value of each uncertain input, by name.

        Raises `ProblemError` for a value outside its distribution, and for dependent inputs: use `at_germ` for these.
        """
        point = germ_of(self.distributions, inputs)
        return jax.tree.map(lambda values: values[0], self.at_germ(np.array([[point[name] for name in self.germs]])))

    @abc.abstractmethod
    def cdf(self, values: Float[Array, " n"]) -> Pytree:
        """The distribution function at each value: shape (n, *shape) for each output."""

    @abc.abstractmethod
    def pdf(self, values: Float[Array, " n"]) -> Pytree:
        """The probability density at each value, per unit of the output: shape (n, *shape) for each output."""

    def covariance(self, first: str, second: str) -> Array:
        """The covariance of two outputs of equal shape, entry by entry."""
        return self._both(first, second).statistic(Covariance())

    def correlation(self, first: str, second: str) -> Array:
        """The correlation coefficient of two outputs of equal shape, entry by entry: between -1 and 1."""
        return self._both(first, second).statistic(Correlation())

    @abc.abstractmethod
    def _both(self, first: str, second: str) -> "AbstractExpanded":
        """Two outputs as one, along a new last axis."""


def paired(outputs: Pytree, first: str, second: str) -> Array:
    """Two outputs of a dict, stacked along a new last axis."""
    one, other = part(outputs, first), part(outputs, second)
    shapes = [jax.tree.map(lambda values: values.shape[1:], output) for output in (one, other)]
    if shapes[0] != shapes[1]:
        raise ProblemError(f"'{first}' and '{second}' have different shapes: {shapes[0]} and {shapes[1]}.")
    return jnp.stack([one, other], axis=-1)


def checked_points(points: Any, germs: Mapping[str, AbstractGerm]) -> Float[np.ndarray, "n variables"]:
    """Germ points as an array of the right shape."""
    array = np.asarray(points, dtype=float)
    if array.ndim != 2 or array.shape[1] != len(germs):
        raise ProblemError(
            f"at_germ: expected germ points of shape (n, {len(germs)}), for {list(germs)}; received {array.shape}."
        )
    return array
