"""`Interval`: a number of a model of which only two ends are known, without any probability."""

from collections.abc import Mapping
from typing import Any, final

import equinox as eqx
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, Scalar
from aleator._core.border import a_name, real
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf
from aleator.uncertainty._decision import AbstractDecision, Decision
from aleator.uncertainty._families import Uniform
from aleator.uncertainty._placements import Placements, placements, realise, with_decisions


@final
class Interval(AbstractDecision):
    """A number known to lie between two others, without any probability, placed anywhere in a model, or as a parameter
    of a distribution: `Interval(0.1, 0.3)`.

    Nothing is averaged over it, for lack of knowledge is no distribution: every statistic is a function of it. `solve`
    holds every limit for the worst value of each interval, and minimises the worst objective; `expand` and `validate`
    give statistics as the least and the largest over all values. Two placements are two numbers, unless both were made
    with `shared("name")`.

    To the model it is a decision, one that an opponent makes.

    Raises `ProblemError` unless both ends are finite numbers, the lower one below the upper one.
    """

    initial: Scalar
    lower: Scalar
    upper: Scalar
    shared_name: str | None = eqx.field(static=True)

    def __init__(self, lower: Any, upper: Any, *, shared_name: str | None = None):
        for end in (lower, upper):
            if isinstance(end, AbstractLeaf):
                raise ProblemError(
                    f"Interval: its ends are numbers; received {type(end).__name__}. For ends that are decided or "
                    "uncertain, write middle + half_width * share in the model, with share=al.Interval(-1.0, 1.0)."
                )
        self.lower, self.upper = (
            real(f"Interval: {name}", end) for name, end in {"lower": lower, "upper": upper}.items()
        )
        if not self.lower < self.upper:
            raise ProblemError(
                f"Interval: expected lower < upper; received {self.lower:g} and {self.upper:g}. A number that is known "
                "is no interval: write the number."
            )
        self.initial = self.lower / 2 + self.upper / 2
        self.shared_name = None if shared_name is None else a_name("Interval: shared_name", shared_name)

    def shared(self, name: str) -> "Interval":
        """A copy whose placements are all one number, together with any others shared under this name."""
        return Interval(self.lower, self.upper, shared_name=a_name("shared", name))

    @property
    @override
    def is_designed(self) -> bool:
        return False

    @override
    def domain(self) -> str:
        return f"[{self.lower:g}, {self.upper:g}]"

    def __str__(self) -> str:
        return f"Interval({self.lower:g}, {self.upper:g})"

    def at(self, value: Scalar) -> Decision:
        """A decision that has this value alone, in its place."""
        return Decision(value, value, value, shared_name=self.shared_name)


def intervals_of(places: Placements) -> dict[str, int]:
    """The intervals of a model, by name, with their places in the decision vector."""
    return {name: one.where.start for name, one in places.decisions.items() if name not in places.designed}


def at_values(model: Pytree, values: Mapping[str, Any] | None = None) -> Pytree:
    """The model with its intervals as decisions that have given values alone; None for any between their ends."""

    def free(name: str, one: Any) -> Any:
        if not isinstance(one, Interval):
            return one
        if values is None:
            return Decision(one.initial, one.lower, one.upper, shared_name=one.shared_name)
        return one.at(values[name])

    return with_decisions(model, free)


def with_germs(places: Placements) -> Placements:
    """The placements with a germ variable of each interval too, from -1 to 1, after those of the distributions.

    It stands for no probability: polynomials of it tell how statistics depend on the interval (see `realised_over`).
    """
    ends = {name: places.decisions[name].decision for name in intervals_of(places)}
    uniform = {name: Uniform(lower=one.lower, upper=one.upper) for name, one in ends.items()}
    return Placements(places.distributions | uniform, places.decisions)


def realised_over(model: Pytree, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> Pytree:
    """`realise` at a germ point of `with_germs`, whose last numbers say where in its range each interval is."""
    places = placements(model)
    if not (intervals := intervals_of(places)):
        return realise(model, germ, decisions)
    count = len(places.germ_names)
    for i, (name, where) in enumerate(intervals.items(), count):
        one = places.decisions[name].decision
        decisions = decisions.at[where].set((one.lower + one.upper) / 2 + germ[i] * (one.upper - one.lower) / 2)
    return realise(model, germ[:count], decisions)


def refuse_intervals(who: str, places: Placements, instead: str = "Take each end in its place.") -> None:
    """Raise `ProblemError` for what would have to hold intervals at one value."""
    if names := list(intervals_of(places)):
        raise ProblemError(
            f"{who}: '{names[0]}' is an al.Interval, of which no value is more likely than another, so that there is "
            f"no single result. {instead}"
        )
