"""Second-order moments: mean, variance and skewness from the second-order Taylor expansion at the means."""

from typing import NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree
from aleator._core.compilation import Use
from aleator._core.errors import ProblemError
from aleator._core.module import Module
from aleator._core.tracing import evaluate, trace
from aleator.ensemble import Function, part
from aleator.references._inputs import Inputs, traceable
from aleator.statistics._moments import root
from aleator.uncertainty import AbstractGerm, HermiteGerm, SampleGerm

# 4 are exact for moments up to the sixth; their derivatives by the shape of a distribution are no polynomials and need
# more.
_NODES = 32


@final
class SecondOrder(Module):
    """Moments of outputs as quadratic functions of the uncertain inputs, about their means.

    `mean`, `variance` and `skewness` have the structure of the outputs; `moments["y"]` selects one output of a dict.
    The skewness of a constant output is 0. All are JAX functions of the distributions' parameters.
    """

    mean: Pytree
    variance: Pytree
    skewness: Pytree

    def __getitem__(self, name: str) -> "SecondOrder":
        """One output by name, if the outputs are a dict."""
        return SecondOrder(*(part(one, name) for one in (self.mean, self.variance, self.skewness)))

    @property
    def std(self) -> Pytree:
        """The standard deviation."""
        return jax.tree.map(root, self.variance)


def second_order(function: Function, model: Pytree) -> SecondOrder:
    """Moments of the second-order Taylor expansion at the means, with exact derivatives, for any distributions.

    With `u_i` the deviations of independent inputs from their means, `g` the gradient and `H` the Hessian, the output
    is `f + sum a_i + sum_{i<j} H_ij u_i u_j` with `a_i = g_i u_i + H_ii u_i^2 / 2`, of which

        mean     = f + sum_i H_ii s_i^2 / 2
        variance = sum_i (g_i^2 s_i^2 + g_i H_ii m3_i + H_ii^2 (m4_i - s_i^4) / 4) + sum_{i<j} H_ij^2 s_i^2 s_j^2

    and the skewness follow without further approximation. The central moments `s^2`, `m3`, `m4` of each input (up to
    the sixth for the skewness) are exact by Gauss quadrature of its germ. Source: generation of system moments, Hahn
    and Shapiro, Statistical Models in Engineering (1967), chapter 7; Evans, Statistical tolerancing: the state of the
    art, part II (1975).

    Exact for functions of degree 2. For others the mean gains two orders in the spreads over linearisation; the
    variance does not, because third derivatives contribute as much to it as second ones. Correlated inputs must be
    normal, because they are expanded in their germ variables; others raise `ProblemError`. Arguments and other errors
    are those of `linearise`.
    """
    inputs = Inputs("second_order", function, model)
    for name, distribution in inputs.distributions.items():
        if distribution.dependence is not None and not isinstance(distribution.germ(), HermiteGerm):
            raise ProblemError(
                f"second_order: correlated inputs must be normal; received {name} ~ {distribution}. Use "
                "al.references.linearise or al.references.quasi_monte_carlo."
            )
    variables = _variables(inputs)

    def outputs(values: Float[Array, " variables"]) -> Pytree:
        return inputs.outputs(_values(inputs, values))

    checked, means = traceable("second_order", outputs), variables.means
    gradient = jax.jacfwd(checked)

    def taylor(means: Float[Array, " variables"]) -> tuple[Pytree, Pytree, Pytree]:
        return checked(means), gradient(means), jax.jacfwd(gradient)(means)

    expansion = trace(taylor, means, use=Use.ONCE)(means)
    inputs.refuse_nonfinite(expansion)
    leaves = zip(*map(jax.tree.leaves, expansion), strict=True)
    moments = [evaluate(_moments, variables, *each, use=Use.ONCE) for each in leaves]
    structure = jax.tree.structure(expansion[0])
    return SecondOrder(*(jax.tree.unflatten(structure, one) for one in zip(*moments, strict=True)))


class _Variables(NamedTuple):
    """Independent variables: each input, or the germ variables of those that are correlated."""

    means: Float[Array, " variables"]
    deviations: Float[Array, "nodes variables"]
    weights: Float[np.ndarray, "nodes variables"]


def _variables(inputs: Inputs) -> _Variables:
    """Each variable at the nodes of its quadrature."""
    rules = [_rule(germ) for germ in inputs.germs.values()]
    points, weights = (np.stack(parts, axis=1) for parts in zip(*rules, strict=True))
    numbers, names = jax.vmap(inputs.numbers)(jnp.asarray(points)), list(inputs.distributions)
    values = [
        numbers[:, names.index(inputs.owned[germ])] if germ in inputs.owned else jnp.asarray(points[:, i])
        for i, germ in enumerate(inputs.germs)
    ]
    columns = jnp.stack(values, axis=1)
    means = jnp.sum(weights * columns, axis=0)
    return _Variables(means, columns - means[None], weights)


def _rule(germ: AbstractGerm) -> tuple[Float[np.ndarray, " nodes"], Float[np.ndarray, " nodes"]]:
    """Gauss nodes and weights of a germ. Data of few values have fewer nodes; the others get weight zero."""
    count = min(_NODES, germ.values.size) if isinstance(germ, SampleGerm) else _NODES
    nodes, weights = germ.gauss(count)
    return np.pad(nodes, (0, _NODES - count), mode="edge"), np.pad(weights, (0, _NODES - count))


def _values(inputs: Inputs, variables: Float[Array, " variables"]) -> Float[Array, " inputs"]:
    """The inputs at given values of the independent variables."""
    germs = list(inputs.germs)
    owner = {name: germ for germ, name in inputs.owned.items()}
    if len(owner) == len(inputs.distributions):
        return jnp.stack([variables[germs.index(owner[name])] for name in inputs.distributions])
    # The other inputs do not depend on owned germ variables, whose places hold the inputs' own values here.
    numbers = inputs.numbers(jnp.where(jnp.asarray([germ in inputs.owned for germ in germs]), 0.0, variables))
    return jnp.stack(
        [
            variables[germs.index(owner[name])] if name in owner else numbers[i]
            for i, name in enumerate(inputs.distributions)
        ]
    )


def _moments(
    variables: _Variables,
    value: Float[Array, "*shape"],
    gradient: Float[Array, "*shape variables"],
    hessian: Float[Array, "*shape variables variables"],
) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"], Float[Array, "*shape"]]:
    """Mean, variance and skewness of a quadratic function of independent variables."""
    u, weights = variables.deviations, variables.weights

    def expected(nodes: Float[Array, "nodes *shape variables"]) -> Float[Array, "*shape variables"]:
        return jnp.einsum("nv,n...v->...v", weights, nodes)

    u = u.reshape(len(u), *(1,) * value.ndim, -1)
    square = expected(u**2)
    own = jnp.diagonal(hessian, axis1=-2, axis2=-1)
    mixed = hessian * (1 - jnp.eye(u.shape[-1])).reshape(*(1,) * value.ndim, u.shape[-1], -1)
    # The contributions of each variable alone, and of pairs, scaled to unit variances.
    alone = gradient[None] * u + own[None] * (u**2 - square[None]) / 2
    scales = root(square)
    pairs = scales[..., :, None] * mixed * scales[..., None, :]
    variance = jnp.sum(expected(alone**2), axis=-1) + jnp.sum(pairs**2, axis=(-2, -1)) / 2
    # E[(A + B)^3] for A the sum of `alone` and B that of pairs; other terms vanish because deviations have mean 0.
    with_self, with_square, cube = expected(alone * u), expected(alone * u**2), expected(u**3)
    third = (
        jnp.sum(expected(alone**3), axis=-1)
        + 3 * jnp.einsum("...i,...ij,...j->...", with_self, mixed, with_self)
        + 3 * jnp.einsum("...i,...ij,...j->...", with_square, mixed**2, square)
        + jnp.einsum("...i,...ij,...j->...", cube, mixed**3, cube) / 2
        + jnp.einsum("...ij,...jk,...ki->...", pairs, pairs, pairs)
    )
    skewness = third / jnp.where(variance > 0, variance, 1.0) ** 1.5
    return value + jnp.sum(own * square, axis=-1) / 2, variance, skewness
