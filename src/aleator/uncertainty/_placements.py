"""Where the distributions and decisions of a model stand: its germ variables and its decision vector.

A model is any pytree. `placements` finds the distributions and decisions among its leaves and names each by its place;
`realise` replaces them with numbers, on which the physics runs unchanged; `at_means` holds the distributions at their
means: a deterministic model that retains them.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import Pytree, in_library, is_number, jax_array
from aleator._core.border import refusal, refuse_leaf
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, AbstractPlanned, is_leaf, is_traced, named_leaves
from aleator.uncertainty._copula import pearson
from aleator.uncertainty._decisions import AbstractDecision, start_given
from aleator.uncertainty._distribution import AbstractDistribution
from aleator.uncertainty._polynomials import AbstractGerm, Dependence

# Correlations up to this are zeros.
_UNCORRELATED = 1e-12


def at_means(model: Pytree) -> Pytree:
    """The model with every distribution held at its mean: no germ is left."""
    return _held(model, held=True)


def uncertain_again(model: Pytree) -> Pytree:
    """The inverse of `at_means`."""
    return _held(model, held=False)


def _held(model: Pytree, *, held: bool) -> Pytree:
    def change(leaf: Any) -> Any:
        return leaf.at_mean(held) if isinstance(leaf, AbstractDistribution) else leaf

    return jax.tree.map(change, model, is_leaf=is_leaf)


class Place(NamedTuple):
    """One decision of a model: its name, the decision itself, and its slice of the decision vector."""

    name: str
    decision: AbstractDecision
    where: slice


class Placements(NamedTuple):
    """The uncertain numbers and the decisions of a model, in the order of the germ and of the decision vector."""

    distributions: dict[str, AbstractDistribution]
    decisions: dict[str, Place]

    @property
    def germ_names(self) -> tuple[str, ...]:
        """The name of each germ variable, in the order of the germ vector."""
        names = (name for place, distribution in self.distributions.items() for name in distribution.germ_names(place))
        return tuple(dict.fromkeys(names))

    @property
    def germs(self) -> dict[str, AbstractGerm]:
        """The distribution of each germ variable by name, in the order of the germ vector."""
        return {
            name: germ
            for place, distribution in self.distributions.items()
            for name, germ in distribution.germs(place).items()
        }

    @property
    def designed(self) -> dict[str, Place]:
        """The decisions that the optimiser chooses: all but intervals."""
        return {name: place for name, place in self.decisions.items() if place.decision.is_designed}

    @property
    def size(self) -> int:
        """Length of the decision vector."""
        return sum(np.size(place.decision.initial) for place in self.decisions.values())

    @property
    def of_distributions(self) -> dict[str, int]:
        """The positions in the decision vector of decisions that are parameters of distributions, by `entry_names`."""
        # A set would be ordered differently in each process, and with it the program that is made of this.
        owned = dict.fromkeys(
            name for place, distribution in self.distributions.items() for name, _ in _decisions_in(place, distribution)
        )
        every = self.entry_names()
        return {every[i]: i for name in owned for i in range(self.size)[self.decisions[name].where]}

    def vector(self, attribute: str) -> Float[np.ndarray, " n"]:
        """One attribute of all decisions, `initial`, `lower` or `upper`, as a vector of length `size`."""
        parts = [np.ravel(getattr(place.decision, attribute)) for place in self.decisions.values()]
        return np.concatenate([np.zeros(0), *parts])

    def named(self, vector: Float[np.ndarray, " n"]) -> dict[str, Any]:
        """The entries of a decision vector as numbers (or arrays) by name."""
        return {
            name: vector[place.where].reshape(np.shape(place.decision.initial))[()]
            for name, place in self.decisions.items()
        }

    def moved(self, vector: Float[np.ndarray, " n"], values: Any) -> Float[np.ndarray, " n"]:
        """The decision vector with new values for some decisions, by name.

        Raises `ProblemError` for unknown names, and for values of the wrong shape, non-finite, or outside their bounds
        by more than rounding.
        """
        if not isinstance(values, Mapping) or not set(values) <= set(self.decisions):
            raise ProblemError(
                f"start: expected decisions by their names, some of {list(self.decisions)}; received {values!r}."
            )
        result = vector.copy()
        for name, value in values.items():
            place = self.decisions[name]
            result[place.where] = start_given(name, value, place.decision).ravel()
        return result

    def entry_names(self) -> tuple[str, ...]:
        """One name for each entry of the decision vector: `k` or, in an array, `k[2]`."""
        return tuple(
            name if np.ndim(place.decision.initial) == 0 else f"{name}[{i}]"
            for name, place in self.decisions.items()
            for i in range(np.size(place.decision.initial))
        )


def placements(model: Pytree) -> Placements:
    """Find the distributions and decisions of a model.

    Raises `ProblemError` if one name stands for two distributions, decisions or plain numbers without `shared`, or if
    the group of a correlated distribution is ambiguous.
    """
    named: dict[str, Any] = {}
    distributions: dict[str, AbstractDistribution] = {}
    decisions: dict[str, Place] = {}
    size = 0
    for name, leaf in named_leaves(model):
        refuse_leaf(name, leaf)
        if not (all(name.split(".")) or leaf is model):
            raise refusal("The key of a number in the model", "a name", name)
        if name in named:
            _refuse_conflict(name, named[name], leaf)
            continue
        for key, owner in _named_by(name, leaf):
            if owner is not named.setdefault(key, owner):
                _refuse_conflict(key, named[key], owner)
        if not is_leaf(leaf):
            continue
        if leaf.is_uncertain:
            distributions[name] = leaf
        for key, decision in _decisions_in(name, leaf):
            if key in decisions:
                continue
            length = np.size(decision.initial)
            decisions[key] = Place(key, decision, slice(size, size + length))
            size += length
    check_groups({name: distribution.dependence for name, distribution in distributions.items()})
    return Placements(distributions, decisions)


def _decisions_in(name: str, leaf: Any) -> Iterator[tuple[str, AbstractDecision]]:
    """The decisions in one leaf, each with its own name: `k_s`, or `k_s.half_width` inside a distribution."""
    if isinstance(leaf, AbstractDecision):
        yield name, leaf
        return
    for parameter, decision in leaf.decisions.items():
        yield decision.shared_name or f"{name}.{parameter}", decision


def _named_by(name: str, leaf: Any) -> Iterator[tuple[str, Any]]:
    """Everything that one leaf names: itself and, for a distribution, its parameters, moments and decisions."""
    yield name, leaf
    if isinstance(leaf, AbstractDistribution):
        parts = {"mean": leaf, "std": leaf} | leaf.parameters
        yield from ((f"{name}.{part}", owner) for part, owner in parts.items())
        yield from _decisions_in(name, leaf)


def _is_shared(owner: Any) -> bool:
    return isinstance(owner, AbstractLeaf) and owner.shared_name is not None


def _refuse_conflict(name: str, first: Any, second: Any) -> None:
    if not (_is_shared(first) and _is_shared(second)):
        raise ProblemError(
            f"'{name}' names two placements: {first} and {second}. Rename one of them, or give both the same `shared` "
            "name if they are one number."
        )
    if not _is_same(first, second):
        raise ProblemError(
            f"'{name}' is shared by two placements that differ: {first} and {second}. "
            "Give the same distribution or decision in both places, or two names."
        )


def realise(model: Pytree, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> Pytree:
    """The model with each distribution and decision replaced by a plain number (dissertation, equation 26).

    `germ` has one entry for each germ variable and `decisions` one for each decided number, in the order of
    `placements`. Differentiable with respect to both; the parameters of distributions are realised first.
    """
    places = placements(model)
    uncertain = uncertain_numbers(places, germ, decisions)

    def mean(name: str, leaf: Any) -> Any:
        return _decided(leaf, name, places, decisions).mean() if isinstance(leaf, AbstractDistribution) else None

    def value(name: str, leaf: Any) -> Any:
        if isinstance(leaf, AbstractDecision):
            return _chosen(places, decisions, name)
        if isinstance(leaf, AbstractDistribution):
            return uncertain[name] if leaf.is_uncertain else mean(name, leaf)
        return leaf

    realised = _with_leaves(model, value)
    return realised.beside(lambda: _with_leaves(model, mean)) if isinstance(realised, AbstractPlanned) else realised


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
    at = jax_array(decisions)
    decided = {name: _decided(distribution, name, places, at) for name, distribution in places.distributions.items()}
    return {pair: float(value) for pair, value in pearson(decided).items() if abs(value) > _UNCORRELATED}


def named_numbers(model: Pytree, decisions: Float[Array, " n"]) -> dict[str, Any]:
    """Every number of a model by name, at given decisions.

    A plain number (integer or real) or decision is named by its place (`m_u`), a distribution's parameters below it
    (`k_s.half_width`), as are its `mean` and `std`, whatever its parameters are.
    """
    places = placements(model)
    numbers: dict[str, Any] = {}
    for name, leaf in named_leaves(model):
        if isinstance(leaf, AbstractDecision):
            numbers[name] = _chosen(places, decisions, name)
        elif is_leaf(leaf):
            distribution = _decided(leaf, name, places, decisions)
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
        if not (is_leaf(leaf) and leaf.is_uncertain):
            return leaf
        distribution = choose(name, leaf)
        return distribution.shared(leaf.shared_name) if leaf.shared_name else distribution

    return _with_leaves(model, change)


def with_decisions(model: Pytree, choose: Callable[[str, AbstractDecision], Any]) -> Pytree:
    """The model with each decision, also inside a distribution, replaced by `choose(name, decision)`."""

    def change(name: str, leaf: Any) -> Any:
        if isinstance(leaf, AbstractDecision):
            return choose(name, leaf)
        if isinstance(leaf, AbstractDistribution):
            return leaf.decided(lambda part, decision: choose(decision.shared_name or f"{name}.{part}", decision))
        return leaf

    return _with_leaves(model, change)


def _with_leaves(model: Pytree, change: Callable[[str, Any], Any]) -> Pytree:
    """The model with each leaf replaced by `change(name, leaf)`."""
    structure = jax.tree.structure(model, is_leaf=is_leaf)
    return jax.tree.unflatten(structure, [change(name, leaf) for name, leaf in named_leaves(model)])


def check_groups(dependences: Mapping[str, Dependence | None]) -> None:
    """Refuse two groups of one name, and a member placed twice; `dependences` are keyed by the distributions' names."""
    groups: dict[str, Dependence] = {}
    placed: dict[str, str] = {}
    for place, dependence in dependences.items():
        if dependence is None:
            continue
        if not _is_one_group(dependence, groups.setdefault(dependence.group, dependence)):
            raise ProblemError(
                f"'{dependence.group}' names two groups of correlated distributions. Give `name` to one of them: "
                "correlated(..., name=...)."
            )
        own = dependence.germ_names[-1]
        if own in placed:
            raise ProblemError(
                f"{dependence} is placed twice, at '{placed[own]}' and at '{place}'. Make both one number with "
                '`.shared("name")`, or make two groups with two names: correlated(..., name=...).'
            )
        placed[own] = place
    for dependence in groups.values():
        for germ in (f"{dependence.group}.{member}" for member in dependence.members):
            if germ in dependences and dependences[germ] is None:
                raise ProblemError(
                    f"'{germ}' names a germ variable of a correlated group and an independent distribution. "
                    "Give the group another name: correlated(..., name=...)."
                )


def _is_one_group(first: Dependence, second: Dependence) -> bool:
    return first.members == second.members and _is_same(first.factor, second.factor)


def _is_same(first: Pytree, second: Pytree) -> bool:
    """Whether two parts of a model are equal; traced ones were compared before compilation."""
    if is_traced((first, second)):
        return True
    # By NumPy: JAX would trace the comparison of known numbers too.
    return bool(eqx.tree_equal(*jax.tree.map(np.asarray, (first, second))))
