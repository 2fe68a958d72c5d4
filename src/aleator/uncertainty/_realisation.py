"""From a model to its numbers: at a germ point and decisions, or by name."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, in_library, is_number, jax_array
from aleator._core.leaves import is_leaf, named_leaves
from aleator.uncertainty._at_mean import AtMean, free
from aleator.uncertainty._copula import pearson
from aleator.uncertainty._decision import Decision
from aleator.uncertainty._distribution import AbstractDistribution
from aleator.uncertainty._placements import Placements, placements


def realise(model: Pytree, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> Pytree:
    """The model with each distribution and decision replaced by a plain number (dissertation, equation 26).

    `germ` has one entry for each germ variable and `decisions` one for each decided number, in the order of
    `placements`. Differentiable with respect to both; the parameters of distributions are realised first.
    """
    places = placements(model)
    uncertain = uncertain_numbers(places, germ, decisions)

    def value(name: str, leaf: Any) -> Any:
        if isinstance(leaf, Decision):
            return _chosen(places, decisions, name)
        if isinstance(leaf, AtMean):
            return _decided(leaf.distribution, name, places, decisions).mean()
        return uncertain[name] if is_leaf(leaf) else leaf

    return _with_leaves(model, value)


def uncertain_numbers(
    places: Placements, germ: Float[Array, " variables"], decisions: Float[Array, " n"]
) -> dict[str, Float[Array, ""]]:
    """The values of a model's distributions at one germ point, by name."""
    _, numbers = in_library(germ)
    variables = dict(zip(places.germ_names, numbers, strict=True))
    values = {}
    for name, distribution in places.distributions.items():
        own = tuple(variables[variable] for variable in distribution.germ_names(name))
        values[name] = _decided(distribution, name, places, decisions).realised(own, distribution.reference())
    return values


def _chosen(places: Placements, decisions: Float[Array, " n"], name: str) -> Float[Array, "..."]:
    place = places.decisions[name]
    _, decisions = in_library(decisions)
    return jax_array(decisions[place.where].reshape(np.shape(place.decision.initial)))


def _decided(
    distribution: AbstractDistribution, name: str, places: Placements, decisions: Float[Array, " n"]
) -> AbstractDistribution:
    """The distribution called `name` with its decisions at their current values."""
    return distribution.decided(
        lambda parameter, decision: _chosen(places, decisions, decision.shared_name or f"{name}.{parameter}")
    )


def correlations_at(places: Placements, decisions: Float[np.ndarray, " n"]) -> dict[tuple[str, str], float]:
    """Pearson's correlations of a model's distributions, by pairs of names, at given decisions; no zeros."""
    at = jnp.asarray(decisions)
    return pearson({name: _decided(one, name, places, at) for name, one in places.distributions.items()})


def named_numbers(model: Pytree, decisions: Float[Array, " n"]) -> dict[str, Any]:
    """Every number of a model by name, at given decisions.

    A plain number (integer or real) or decision is named by its place (`m_u`), a distribution's parameters below it
    (`k_s.half_width`), as are its `mean` and `std`, whatever its parameters are.
    """
    places = placements(model)
    numbers: dict[str, Any] = {}
    for name, leaf in named_leaves(model):
        if isinstance(leaf, Decision):
            numbers[name] = _chosen(places, decisions, name)
        elif is_leaf(leaf):
            distribution = _decided(free(leaf), name, places, decisions)
            moments = {"mean": distribution.mean(), "std": distribution.std()}
            numbers |= {f"{name}.{key}": jax_array(value) for key, value in (moments | distribution.parameters).items()}
        elif is_number(leaf) or _is_whole(leaf):
            numbers[name] = jax_array(leaf, float)
    return numbers


def _is_whole(leaf: Any) -> bool:
    """Whether `leaf` is an integer or an array of them; unlike in Python, a bool is not."""
    if isinstance(leaf, bool):
        return False
    return isinstance(leaf, int) or jnp.issubdtype(getattr(leaf, "dtype", None) or bool, jnp.integer)


def with_distributions(model: Pytree, choose: Callable[[str, AbstractDistribution], AbstractDistribution]) -> Pytree:
    """The model with each distribution replaced by `choose(name, distribution)`; sharing is kept."""

    def change(name: str, leaf: Any) -> Any:
        if not isinstance(leaf, AbstractDistribution):
            return leaf
        distribution = choose(name, leaf)
        return distribution.shared(leaf.shared_name) if leaf.shared_name else distribution

    return _with_leaves(model, change)


def _with_leaves(model: Pytree, change: Callable[[str, Any], Any]) -> Pytree:
    """The model with each leaf replaced by `change(name, leaf)`."""
    structure = jax.tree.structure(model, is_leaf=is_leaf)
    return jax.tree.unflatten(structure, [change(name, leaf) for name, leaf in named_leaves(model)])
