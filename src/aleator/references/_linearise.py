"""The direct linearisation method: spreads of outputs from exact sensitivities at the means."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, Scalar
from aleator._core.errors import ProblemError
from aleator.ensemble import Function, part
from aleator.references._inputs import Inputs, traceable
from aleator.statistics._moments import root
from aleator.uncertainty import AbstractDistribution, HermiteGerm

_NODES = 40


@final
class Linearised(eqx.Module):
    """Outputs as linear functions of the uncertain inputs, about their means.

    - `names`: of the inputs; `means`, shape (inputs,), and `covariance`, shape (inputs, inputs), in their units;
    - `mean`: the value of each output at the means, shape (*shape);
    - `jacobian`: the derivative of each output with respect to each input, shape (inputs, *shape).

    Results have the structure of the outputs, an array or a dict; `linearised["y"]` selects one output of a dict. All
    are JAX functions of the distributions' parameters.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    means: Float[Array, " inputs"]
    covariance: Float[Array, "inputs inputs"]
    mean: Pytree
    jacobian: Pytree

    def __getitem__(self, name: str) -> "Linearised":
        """One output by name, if the outputs are a dict."""
        return Linearised(self.names, self.means, self.covariance, part(self.mean, name), part(self.jacobian, name))

    @property
    def sensitivities(self) -> dict[str, Pytree]:
        """The derivative of the outputs with respect to each input, by its name, in the outputs' unit over its unit."""
        return {name: jax.tree.map(lambda leaf, i=i: leaf[i], self.jacobian) for i, name in enumerate(self.names)}

    @property
    def variance(self) -> Pytree:
        """`S Sigma S^T`, entry by entry."""
        return jax.tree.map(lambda shares: jnp.sum(shares, axis=0), self._shares())

    @property
    def std(self) -> Pytree:
        """The standard deviation, `sqrt(S Sigma S^T)`."""
        return jax.tree.map(root, self.variance)

    @property
    def contributions(self) -> dict[str, Pytree]:
        """The share of each input in the variance, in percent: `100 S_i (Sigma S^T)_i / (S Sigma S^T)`.

        They add up to 100. The share of a correlated input may be negative. If nothing varies they are 0.
        """

        def percent(shares: Float[Array, "inputs *shape"]) -> Float[Array, "inputs *shape"]:
            total = jnp.sum(shares, axis=0)
            return 100 * shares / jnp.where(total > 0, total, 1.0)[None]

        parts = jax.tree.map(percent, self._shares())
        return {name: jax.tree.map(lambda leaf, i=i: leaf[i], parts) for i, name in enumerate(self.names)}

    def worst_case(self, limits: Mapping[str, Scalar]) -> Pytree:
        """The largest deviation within tolerances, `sum |S_i| T_i`; `limits`: the tolerance of each input by name."""
        tolerances = self._tolerances("worst_case", limits)
        return jax.tree.map(lambda leaf: jnp.tensordot(tolerances, jnp.abs(leaf), axes=1), self.jacobian)

    def rss(self, limits: Mapping[str, Scalar]) -> Pytree:
        """The statistical deviation `sqrt(sum (S_i T_i)^2)` (root sum square), as for independent inputs."""
        tolerances = self._tolerances("rss", limits)
        return jax.tree.map(lambda leaf: root(jnp.tensordot(tolerances**2, leaf**2, axes=1)), self.jacobian)

    def _shares(self) -> Pytree:
        return jax.tree.map(lambda leaf: leaf * jnp.tensordot(self.covariance, leaf, axes=1), self.jacobian)

    def _tolerances(self, verb: str, limits: Mapping[str, Any]) -> Float[Array, " inputs"]:
        if set(limits) != set(self.names):
            raise ProblemError(
                f"{verb}: expected one tolerance for each of {list(self.names)}; received {list(limits)}."
            )
        return jnp.stack([jnp.asarray(limits[name], dtype=float) for name in self.names])


def linearise(function: Function, model: Pytree) -> Linearised:
    """The direct linearisation method (DLM): the first-order Taylor expansion at the means, with exact derivatives.

    - `function`: takes the model with plain numbers in the place of its distributions and returns an array or a dict of
      arrays, written with jax.numpy;
    - `model`: a dict or any other pytree with distributions in it. Decisions are held at their initial values.

    Means and standard deviations are those of the distributions, whatever their form; correlations are those of
    `al.correlated`. The method is exact for linear functions. Source: dissertation, section 7.2; Chase, Gao and
    Magleby, General 2-D tolerance analysis of mechanical assemblies with small kinematic adjustments, Journal of Design
    and Manufacturing 5 (1995).

    Raises `ProblemError` if nothing is uncertain or JAX cannot differentiate the function, and `SimulationError` if its
    value or derivative at the means is not finite.
    """
    inputs = Inputs("linearise", function, model)
    distributions = tuple(inputs.distributions.values())
    means = jnp.stack([jnp.asarray(distribution.mean(), dtype=float) for distribution in distributions])
    stds = jnp.stack([jnp.asarray(distribution.std(), dtype=float) for distribution in distributions])
    outputs = traceable("linearise", inputs.outputs)
    mean = outputs(means)
    jacobian = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), jax.jacfwd(outputs)(means))
    inputs.refuse_nonfinite((mean, jacobian))
    covariance = _correlation(distributions) * stds[:, None] * stds[None, :]
    return Linearised(tuple(inputs.distributions), means, covariance, mean, jacobian)


def _correlation(distributions: Sequence[AbstractDistribution]) -> Float[Array, "inputs inputs"]:
    """The correlation of the inputs; of correlated ones by Gauss quadrature of their copula."""
    matrix = jnp.eye(len(distributions))
    for (i, one), (j, other) in itertools.combinations(enumerate(distributions), 2):
        first, second = one.dependence, other.dependence
        if first is not None and second is not None and first.group == second.group:
            factor = jnp.asarray(first.factor)
            rho = factor[first.index] @ factor[second.index]
            matrix = matrix.at[jnp.array([i, j]), jnp.array([j, i])].set(_pearson(one, other, rho))
    return matrix


def _pearson(one: AbstractDistribution, other: AbstractDistribution, rho: Float[Array, ""]) -> Float[Array, ""]:
    """The correlation of two numbers whose normal variables have the correlation `rho`."""
    nodes, weights = map(jnp.asarray, HermiteGerm().gauss(_NODES))
    second = rho * nodes[:, None] + jnp.sqrt(1 - rho**2) * nodes[None, :]
    left = jax.vmap(one.value_at_normal)(nodes)
    right = jax.vmap(jax.vmap(other.value_at_normal))(second)
    # Moments by the same quadrature, so that its error cancels.
    left = left - weights @ left
    right = right - weights @ right @ weights
    both = jnp.sum(weights[:, None] * weights[None, :] * left[:, None] * right)
    return both / jnp.sqrt((weights @ left**2) * (weights @ right**2 @ weights))
