"""Decisions of a model that are not free: tables of values from which some are chosen, and intervals."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.uncertainty._decisions import Choice, Decision, Interval
from aleator.uncertainty._families import Uniform
from aleator.uncertainty._placements import Placements, placements, realise, with_decisions


class Table(NamedTuple):
    """Numbers that are chosen together: those at places `where` of the decision vector are one row of `rows`."""

    where: Int[np.ndarray, " columns"]
    rows: Float[np.ndarray, "rows columns"]

    @property
    def spans(self) -> Float[np.ndarray, " columns"]:
        """The range of each column; 1 where all rows have one number."""
        spans = np.ptp(self.rows, axis=0)
        return np.where(spans > 0, spans, 1.0)


def tables_of(places: Placements) -> tuple[Table, ...]:
    """The tables from which decisions of a model are chosen, those of integers among them.

    Raises `ProblemError` if a column stands in two places, or tables of one name differ in their length.
    """
    columns: dict[tuple[str, bool], dict[str, tuple[int, np.ndarray]]] = {}
    for name, place in places.decisions.items():
        one, values = place.decision, place.decision.values
        if values is None:
            continue
        is_column = isinstance(one, Choice) and one.table_name is not None
        key, column = (str(one.table_name), one.column) if is_column else (name, name)
        group = columns.setdefault((key, is_column), {})
        if column in group:
            raise ProblemError(
                f"The column '{column}' of the table '{key}' stands in two places, '{name}' among them: give a second "
                f"part a table of another name, or both places one number, .shared('{column}')."
            )
        if any(len(values) != len(other) for _, other in group.values()):
            raise ProblemError(f"Two tables called '{key}' have different lengths. Give one of them another name.")
        group[column] = place.where.start, values
    return tuple(
        Table(
            np.array([start for start, _ in group.values()]),
            np.unique(np.stack([values for _, values in group.values()], axis=1), axis=0),
        )
        for group in columns.values()
    )


def refuse_choices(who: str, places: Placements) -> None:
    """Raise `ProblemError` for what looks between the values of integers and choices."""
    if names := [name for name, place in places.decisions.items() if place.decision.values is not None]:
        raise ProblemError(
            f"{who}: expected decisions that may have any value between their bounds; received '{names[0]}', an "
            f"al.{type(places.decisions[names[0]].decision).__name__}. al.solve and al.pareto take these."
        )


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
