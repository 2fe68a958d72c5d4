"""Numbers that are chosen from some: `Integer`, `Choice`, and the tables of values behind them."""

from collections.abc import Mapping
from copy import copy
from typing import Any, NamedTuple, final

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.border import a_name, real, real_array, refusal, refuse_not_finite
from aleator._core.errors import ProblemError
from aleator.uncertainty._decision import AbstractDecision
from aleator.uncertainty._placements import Placements

# The most values that an Integer has between its bounds.
_MOST = 100_000


@final
class Integer(AbstractDecision):
    """A whole number that the optimiser chooses, placed anywhere in a model: `Integer(3, lower=1, upper=8)`.

    `solve` finds it by branch and bound over solves in which it is any number between its bounds, so that the model
    must be defined there too (see `Branching`). Several whole numbers are several `Integer`s.

    Raises `ProblemError` for numbers that are not whole, bounds that are infinite or in the wrong order, and a start
    outside them.
    """

    initial: Scalar
    lower: Scalar
    upper: Scalar
    shared_name: str | None = eqx.field(static=True)

    def __init__(self, initial: Any, lower: Any = -np.inf, upper: Any = np.inf, *, shared_name: str | None = None):
        for name, value in {"initial": initial, "lower": lower, "upper": upper}.items():
            expected = "a whole number, as an integer is sought between finite bounds"
            number = real(f"Integer: {name}", value, expected)
            if not number.is_integer():
                raise refusal(f"Integer: {name}", expected, value)
            setattr(self, name, number)
        if not self.lower <= self.initial <= self.upper:
            raise ProblemError(
                f"Integer: expected lower <= initial <= upper; received {lower} <= {initial} <= {upper}."
            )
        if self.upper - self.lower >= _MOST:
            raise ProblemError(
                f"Integer: expected at most {_MOST:g} values between its bounds; received {lower} to {upper}. A "
                "number so large is an al.Decision, rounded."
            )
        self.shared_name = None if shared_name is None else a_name("Integer: shared_name", shared_name)

    def shared(self, name: str) -> "Integer":
        """A copy whose placements are all one number, together with any others shared under this name."""
        return Integer(self.initial, self.lower, self.upper, shared_name=a_name("shared", name))

    @property
    @override
    def values(self) -> Float[np.ndarray, " rows"]:
        return np.arange(float(self.lower), float(self.upper) + 1)

    @override
    def domain(self) -> str:
        return f"{{{self.lower:g}, …, {self.upper:g}}}"


@final
class Choice(AbstractDecision):
    """A number that the optimiser chooses from some, placed anywhere in a model: `Choice([10e3, 15e3, 22e3])`.

    Catalogue parts, whose rows give several numbers at once, are a `Choice.table`. `solve` solves for each combination
    of choices where these are few, else by branch and bound over solves in which a number is anywhere between those
    that are left (see `Branching`).

    - `values`: the numbers; `initial`: the index of the one from which a search starts.

    Raises `ProblemError` for values that are not finite, none, and an index that is none of theirs.
    """

    initial: Scalar
    lower: Scalar
    upper: Scalar
    among: Float[np.ndarray, " rows"]
    shared_name: str | None = eqx.field(static=True)
    table_name: str | None = eqx.field(static=True)
    column: str = eqx.field(static=True)

    def __init__(self, values: Any, initial: int = 0, *, shared_name: str | None = None):
        self.among = real_array("Choice: values", values, "a list of numbers")
        if self.among.ndim != 1 or not self.among.size:
            raise refusal("Choice: values", "a list of numbers; a table of parts is al.Choice.table(name, ...)", values)
        refuse_not_finite("Choice: values", self.among)
        if isinstance(initial, bool) or not isinstance(initial, int | np.integer) or not 0 <= initial < self.among.size:
            raise refusal("Choice: initial", f"an index of its values, 0 to {self.among.size - 1}", initial)
        self.initial, self.lower, self.upper = map(float, (self.among[initial], self.among.min(), self.among.max()))
        self.shared_name = None if shared_name is None else a_name("Choice: shared_name", shared_name)
        self.table_name, self.column = None, ""

    @classmethod
    def table(cls, name: str, columns: Mapping[str, Any], initial: int = 0) -> "dict[str, Choice]":
        """The columns of a table of parts, each to be placed in a model: all take their values from one row.

            spring = al.Choice.table("spring", {"rate": [10e3, 15e3, 22e3], "mass": [0.8, 1.1, 1.9]})
            model = Car(k_s=spring["rate"], m_s=spring["mass"])

        - `name`: of the part. A second part from the same catalogue is a second table with another name;
        - `columns`: the numbers of all rows by name, in one order; `initial`: the index of the row to start from.

        Raises `ProblemError` for columns of different lengths, and as `Choice`.
        """
        a_name("Choice.table: name", name)
        if not isinstance(columns, Mapping) or not columns:
            raise refusal("Choice.table: columns", "lists of numbers by name, such as {'rate': [10e3, 15e3]}", columns)
        made = {key: cls(values, initial) for key, values in columns.items()}
        lengths = {key: one.among.size for key, one in made.items()}
        if len(set(lengths.values())) > 1:
            raise refusal(f"Choice.table: columns of '{name}'", "lists of one length", lengths)
        return {
            key: one._with(table_name=name, column=a_name("Choice.table: a name in columns", key))
            for key, one in made.items()
        }

    def shared(self, name: str) -> "Choice":
        """A copy whose placements are all one number, together with any others shared under this name."""
        return self._with(shared_name=a_name("shared", name))

    def _with(self, **changes: Any) -> "Choice":
        one = copy(self)
        for field, value in changes.items():
            object.__setattr__(one, field, value)
        return one

    @property
    @override
    def values(self) -> Float[np.ndarray, " rows"]:
        return self.among

    @override
    def domain(self) -> str:
        texts = [f"{value:g}" for value in self.among]
        texts = texts if len(texts) < 7 else [*texts[:3], "…", texts[-1]]
        return f"{{{', '.join(texts)}}}" + (f" (a row of '{self.table_name}')" if self.table_name else "")


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
