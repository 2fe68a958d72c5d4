"""Taylor expansions at the means, with exact derivatives: linearisation, and moments of second order."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, Scalar, in_library, jax_array
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.leaves import Module, in_order
from aleator.ensemble import UNTRACEABLE, AbstractBox, Function, is_finite, outputs_of, part, uncertain_places
from aleator.statistics._statistic import root
from aleator.uncertainty import (
    AbstractDistribution,
    AbstractGerm,
    HermiteGerm,
    Normal,
    Placements,
    pearson,
    placements,
    realise,
    uncertain_numbers,
    with_distributions,
)

# Of Gauss quadrature: 4 are exact for moments up to the sixth; their derivatives by the shape of a distribution are no
# polynomials and need more.
_NODES = 32


@final
class Inputs:
    """The uncertain inputs of `function(model)`, with decisions at their initial values.

    - `verb`: who asks;
    - `distributions`: by name, at the initial decisions; `germs`: the distribution of each germ variable, by name;
    - `owned`: germ variables that belong to one input alone, which depends on no other, with that input's name.
    """

    def __init__(self, verb: str, function: Function, model: Pytree):
        if isinstance(function, AbstractBox):
            raise ProblemError(
                f"{verb}: a black box has no derivatives; expand it by al.expand, or sample it by "
                "al.references.monte_carlo."
            )
        model = in_order(model)
        self._places = uncertain_places(verb, function, model)
        self.verb, self._function = verb, function
        # A standard normal number equals its germ, so that values passed as the germ are the numbers themselves.
        self._in_units = with_distributions(model, lambda *_: Normal(0.0, 1.0))
        self.distributions = {name: distribution.initial() for name, distribution in self._places.distributions.items()}
        self.germs = self._places.germs
        needs = {name: distribution.germ_names(name) for name, distribution in self.distributions.items()}
        uses = Counter(germ for names in needs.values() for germ in names)
        self.owned = {germs[0]: name for name, germs in needs.items() if len(germs) == 1 and uses[germs[0]] == 1}

    def numbers(self, germ: Float[Array, " variables"]) -> Float[Array, " inputs"]:
        """The inputs at a germ point, in the order of `distributions`."""
        return jnp.stack(list(uncertain_numbers(self._places, germ, _initial(self._places)).values()))

    def outputs(self, values: Float[Array, " inputs"]) -> Pytree:
        """The outputs at given values of the inputs, in their units and in the order of `distributions`."""
        realised = realise(self._in_units, values, _initial(placements(self._in_units)))
        return outputs_of(self._function, realised, jnp)

    def refuse_nonfinite(self, expanded: Pytree) -> None:
        """Raise `SimulationError` if a value or derivative at the means is not finite, as far as values are known."""
        if not is_finite(expanded):
            where = ", ".join(f"{name} ~ {distribution}" for name, distribution in self.distributions.items())
            raise SimulationError(
                f"{self.verb}: the function or its derivative is not finite at the means of {where}. It needs a "
                "function that is smooth there: use al.references.monte_carlo."
            )


def _initial(places: Placements) -> Float[Array, " n"]:
    """The decisions at their initial values. A model in units has none inside distributions."""
    return jnp.asarray(places.vector("initial"))


def traceable(verb: str, function: Function) -> Function:
    """The function, with a clear error if JAX cannot differentiate it."""

    def checked(*arguments: Array) -> Pytree:
        try:
            return function(*arguments)
        except UNTRACEABLE as error:
            raise ProblemError(
                f"{verb}: JAX cannot differentiate the function ({str(error).splitlines()[0]}) Write it with jax.numpy."
            ) from error

    return checked


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
        _, tolerances, jacobian = in_library(tolerances, self.jacobian)
        return jax.tree.map(lambda leaf: root(_product(tolerances**2, leaf**2)), jacobian)

    def _shares(self) -> Pytree:
        def shares(slopes: Any) -> Any:
            library, covariance, slopes = in_library(self.covariance, slopes)
            return slopes * library.tensordot(covariance, slopes, axes=1)

        return jax.tree.map(shares, self.jacobian)

    def _by_name(self, parts: Pytree) -> dict[str, Pytree]:
        """Values of all inputs along a first axis, split by name."""
        known = in_library(parts)[1]
        return {name: jax.tree.map(lambda leaf, i=i: jax_array(leaf[i]), known) for i, name in enumerate(self.names)}

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
    linear = linear_at_means(inputs)
    inputs.refuse_nonfinite((linear.mean, linear.jacobian))
    return linear


def linear_at_means(inputs: Inputs) -> Linearised:
    """The first-order expansion at the means, whose derivatives need not be finite there."""
    means = _vector([distribution.mean() for distribution in inputs.distributions.values()])
    stds = _vector([distribution.std() for distribution in inputs.distributions.values()])
    outputs = traceable(inputs.verb, inputs.outputs)

    def twice(means: Float[Array, " inputs"]) -> tuple[Pytree, Pytree]:
        values = outputs(means)
        return values, values

    def with_slopes(means: Float[Array, " inputs"]) -> tuple[Pytree, Pytree]:
        slopes, values = jax.jacfwd(twice, has_aux=True)(means)
        return values, jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), slopes)

    mean, jacobian = evaluate(with_slopes, means, use=Use.ONCE)
    library, correlation, stds = in_library(_correlation(inputs.distributions), stds)
    covariance = jax_array(correlation * library.multiply.outer(stds, stds))
    return Linearised(tuple(inputs.distributions), means, covariance, mean, jacobian)


def _product(factors: Float[Array, " inputs"], parts: Any) -> Float[Array, "*shape"]:
    library, factors, parts = in_library(factors, parts)
    return jax_array(library.tensordot(factors, parts, axes=1))


def _vector(numbers: Sequence[Scalar]) -> Float[Array, " n"]:
    library, known = in_library(list(numbers))
    return jax_array(library.stack([library.asarray(number, dtype=float) for number in known]))


def _correlation(distributions: Mapping[str, AbstractDistribution]) -> Float[Array, "inputs inputs"]:
    matrix: Any = np.eye(len(distributions))
    for pair, value in pearson(distributions).items():
        i, j = map(list(distributions).index, pair)
        matrix = jnp.asarray(matrix).at[jnp.array([i, j]), jnp.array([j, i])].set(value)
    return matrix


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
        return SecondOrder(*(part(moment, name) for moment in (self.mean, self.variance, self.skewness)))

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

    outputs = traceable("second_order", lambda values: inputs.outputs(_values(inputs, values)))
    gradient = jax.jacfwd(outputs)

    def taylor(means: Float[Array, " variables"]) -> tuple[Pytree, Pytree, Pytree]:
        return outputs(means), gradient(means), jax.jacfwd(gradient)(means)

    means = variables.means
    expansion = evaluate(taylor, means, use=Use.ONCE)
    inputs.refuse_nonfinite(expansion)
    leaves = zip(*map(jax.tree.leaves, expansion), strict=True)
    moments = [evaluate(_moments, variables, *each, use=Use.ONCE) for each in leaves]
    structure = jax.tree.structure(expansion[0])
    return SecondOrder(*(jax.tree.unflatten(structure, leaves) for leaves in zip(*moments, strict=True)))


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
    nodes, weights = germ.gauss(_NODES)
    few = 0, _NODES - len(nodes)
    return np.pad(nodes, few, mode="edge"), np.pad(weights, few)


def _values(inputs: Inputs, variables: Float[Array, " variables"]) -> Float[Array, " inputs"]:
    """The inputs at given values of the independent variables."""
    germs = list(inputs.germs)
    own = {name: germs.index(germ) for germ, name in inputs.owned.items()}
    numbers: Any = ()
    if len(own) < len(inputs.distributions):
        # The other inputs do not depend on owned germ variables, whose places hold the inputs' own values here.
        numbers = inputs.numbers(jnp.where(jnp.asarray([germ in inputs.owned for germ in germs]), 0.0, variables))
    names = enumerate(inputs.distributions)
    return jnp.stack([variables[own[name]] if name in own else numbers[i] for i, name in names])


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
