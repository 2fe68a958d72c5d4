"""Where the distributions and decisions of a model stand: its germ variables and its decision vector.

A model is any pytree. `placements` finds the distributions and decisions among its leaves and names each by its place;
`realise` replaces them with numbers, on which the physics runs unchanged.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator._core.given import refuse_missing
from aleator._core.leaves import AbstractLeaf, is_leaf, is_traced, named_leaves
from aleator.uncertainty._at_mean import free
from aleator.uncertainty._decision import Decision, start_given
from aleator.uncertainty._dependence import check_groups
from aleator.uncertainty._distribution import AbstractDistribution
from aleator.uncertainty._polynomials import AbstractGerm


class Place(NamedTuple):
    """One decision of a model: its name, the decision itself, and its slice of the decision vector."""

    name: str
    decision: Decision
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
        refuse_missing(name, leaf)
        if name in named:
            _refuse_conflict(name, named[name], leaf)
            continue
        for key, owner in _named_by(name, leaf):
            if owner is not named.setdefault(key, owner):
                _refuse_conflict(key, named[key], owner)
        if not is_leaf(leaf):
            continue
        if isinstance(leaf, AbstractDistribution):
            distributions[name] = leaf
        for key, decision in _decisions_in(name, leaf):
            if key in decisions:
                continue
            length = np.size(decision.initial)
            decisions[key] = Place(key, decision, slice(size, size + length))
            size += length
    check_groups({name: distribution.dependence for name, distribution in distributions.items()})
    return Placements(distributions, decisions)


def _decisions_in(name: str, leaf: Any) -> Iterator[tuple[str, Decision]]:
    """The decisions in one leaf, each with its own name: `k_s`, or `k_s.half_width` inside a distribution."""
    if isinstance(leaf, Decision):
        yield name, leaf
        return
    for parameter, decision in free(leaf).decisions.items():
        yield decision.shared_name or f"{name}.{parameter}", decision


def _named_by(name: str, leaf: Any) -> Iterator[tuple[str, Any]]:
    """Everything that one leaf names: itself and, for a distribution, its parameters, moments and decisions."""
    yield name, leaf
    distribution = free(leaf)
    if isinstance(distribution, AbstractDistribution):
        parts = {"mean": distribution, "std": distribution} | distribution.parameters
        yield from ((f"{name}.{part}", owner) for part, owner in parts.items())
        yield from _decisions_in(name, distribution)


def _is_shared(owner: Any) -> bool:
    return isinstance(owner, AbstractLeaf) and owner.shared_name is not None


def _refuse_conflict(name: str, first: Any, second: Any) -> None:
    if not (_is_shared(first) and _is_shared(second)):
        raise ProblemError(
            f"'{name}' names two placements: {first} and {second}. Rename one of them, or give both the same `shared` "
            "name if they are one number."
        )
    if not (is_traced(first) or eqx.tree_equal(first, second)):
        raise ProblemError(
            f"'{name}' is shared by two placements that differ: {first} and {second}. "
            "Give the same distribution or decision in both places, or two names."
        )
