"""The direct linearisation method: spreads of outputs from exact sensitivities at the means."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, Scalar, in_library, jax_array, numbers_to_arrays
from aleator._core.compilation import Use
from aleator._core.errors import ProblemError
from aleator._core.module import Module
from aleator._core.tracing import evaluate, trace
from aleator.ensemble import Function, part
from aleator.references._inputs import Inputs, traceable
from aleator.statistics._moments import root
from aleator.uncertainty import AbstractDistribution, HermiteGerm

_NODES = 40


@final
class Linearised(Module):
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
        return self._by_name(self.jacobian)

    @property
    def variance(self) -> Pytree:
        """`S Sigma S^T`, entry by entry."""
        return jax.tree.map(lambda shares: jax_array(shares.sum(axis=0)), self._shares())

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
            library, shares = in_library(shares)
            total = shares.sum(axis=0)
            return 100 * shares / library.where(total > 0, total, 1.0)[None]

        return self._by_name(jax.tree.map(percent, self._shares()))

    def worst_case(self, limits: Mapping[str, Scalar]) -> Pytree:
        """The largest deviation within tolerances, `sum |S_i| T_i`; `limits`: the tolerance of each input by name."""
        tolerances = self._tolerances("worst_case", limits)
        return jax.tree.map(lambda leaf: _product(tolerances, abs(leaf)), self.jacobian)

    def rss(self, limits: Mapping[str, Scalar]) -> Pytree:
        """The statistical deviation `sqrt(sum (S_i T_i)^2)` (root sum square), as for independent inputs."""
        tolerances = self._tolerances("rss", limits)
        return jax.tree.map(lambda leaf: root(_product(tolerances**2, leaf**2)), self.jacobian)

    def _shares(self) -> Pytree:
        def shares(covariance: Any, slopes: Any) -> Any:
            library, covariance, slopes = in_library(covariance, slopes)
            return slopes * library.tensordot(covariance, slopes, axes=1)

        return jax.tree.map(lambda slopes: shares(self.covariance, slopes), self.jacobian)

    def _by_name(self, parts: Pytree) -> dict[str, Pytree]:
        """Values of all inputs along a first axis, split by name."""

        def of(i: int) -> Pytree:
            return jax.tree.map(lambda leaf: jax_array(in_library(leaf)[1][i]), parts)

        return {name: of(i) for i, name in enumerate(self.names)}

    def _tolerances(self, verb: str, limits: Mapping[str, Any]) -> Float[Array, " inputs"]:
        if set(limits) != set(self.names):
            raise ProblemError(
                f"{verb}: expected one tolerance for each of {list(self.names)}; received {list(limits)}."
            )
        return _vector([limits[name] for name in self.names])


def linearise(function: Function, model: Pytree) -> Linearised:
    """The direct linearisation method (DLM): the first-order Taylor expansion at the means, with exact derivatives.

    - `function`: takes the model with plain numbers in the place of its distributions and returns an array or a dict of
      arrays, written with jax.numpy;
    - `model`: a dict or any other pytree with distributions in it. Decisions are held at their initial values.

    Returns `Linearised`: means, exact sensitivities, spreads and contributions. Means and standard deviations are those
    of the distributions, whatever their form; correlations are those of `al.correlated`. The method is exact for linear
    functions. Source: dissertation, section 7.2; Chase, Gao and Magleby, General 2-D tolerance analysis of mechanical
    assemblies with small kinematic adjustments, Journal of Design and Manufacturing 5 (1995).

    Raises `ProblemError` if nothing is uncertain or JAX cannot differentiate the function, and `SimulationError` if its
    value or derivative at the means is not finite.
    """
    inputs = Inputs("linearise", function, model)
    distributions = tuple(inputs.distributions.values())
    means = _vector([one.mean() for one in distributions])
    stds = _vector([one.std() for one in distributions])
    outputs = traceable("linearise", inputs.outputs)

    def twice(means: Float[Array, " inputs"]) -> tuple[Pytree, Pytree]:
        found = outputs(means)
        return found, found

    def with_slopes(means: Float[Array, " inputs"]) -> tuple[Pytree, Pytree]:
        slopes, found = jax.jacfwd(twice, has_aux=True)(means)
        return found, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), slopes)

    mean, jacobian = trace(with_slopes, means, use=Use.ONCE)(means)
    inputs.refuse_nonfinite((mean, jacobian))
    library, correlation, stds = in_library(_correlation(distributions), stds)
    covariance = jax_array(correlation * library.multiply.outer(stds, stds))
    return Linearised(tuple(inputs.distributions), means, covariance, mean, jacobian)


def _product(factors: Float[Array, " inputs"], parts: Any) -> Float[Array, "*shape"]:
    library, factors, parts = in_library(factors, parts)
    return jax_array(library.tensordot(factors, parts, axes=1))


def _vector(numbers: Sequence[Scalar]) -> Float[Array, " n"]:
    library, known = in_library(list(numbers))
    return jax_array(library.stack([library.asarray(one, dtype=float) for one in known]))


def _correlation(distributions: Sequence[AbstractDistribution]) -> Float[Array, "inputs inputs"]:
    """The correlation of the inputs; of correlated ones by Gauss quadrature of their copula."""
    matrix: Any = np.eye(len(distributions))
    for (i, one), (j, other) in itertools.combinations(enumerate(distributions), 2):
        first, second = one.dependence, other.dependence
        if first is not None and second is not None and first.group == second.group:
            factor = jnp.asarray(first.factor)
            rho = factor[first.index] @ factor[second.index]
            matrix = jnp.asarray(matrix).at[jnp.array([i, j]), jnp.array([j, i])].set(_in_one_program(one, other, rho))
    return matrix


def _in_one_program(one: AbstractDistribution, other: AbstractDistribution, rho: Float[Array, ""]) -> Float[Array, ""]:
    numbers, rest = eqx.partition(numbers_to_arrays((one, other)), eqx.is_array)

    def correlation(numbers: Pytree, rho: Float[Array, ""]) -> Float[Array, ""]:
        first, second = eqx.combine(numbers, rest)
        return _pearson(first, second, rho)

    return evaluate(correlation, numbers, rho, use=Use.ONCE)


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
