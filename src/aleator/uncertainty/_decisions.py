"""Numbers of a model that are chosen: by the optimiser, `Decision`, `Integer`, `Choice`; by an opponent, `Interval`."""

import abc
from collections.abc import Mapping
from typing import Any, final

import equinox as eqx
import numpy as np
from jaxtyping import Float
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.border import a_name, real, real_array, refusal, refuse_not_finite
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, highest, lowest

# Relative amount by which a start may lie outside its bounds: a computed one may do so by rounding.
_ROUNDING = 1e-9

# The most values that an Integer has between its bounds.
_MOST = 100_000


class AbstractDecision(AbstractLeaf):
    """A number of a model, or an array of numbers, that the optimiser chooses between a lower and an upper bound."""

    initial: eqx.AbstractVar[Any]
    lower: eqx.AbstractVar[Any]
    upper: eqx.AbstractVar[Any]

    @property
    def values(self) -> Float[np.ndarray, " rows"] | None:
        """The values that it may have; None for all between its bounds."""
        return None

    @property
    def is_designed(self) -> bool:
        """Whether the optimiser chooses it, rather than an opponent."""
        return True

    @abc.abstractmethod
    def domain(self) -> str:
        """What it may be, in words."""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the numbers that are chosen."""
        return np.shape(self.initial)

    def lowest(self) -> float | None:
        """The smallest number that may be chosen."""
        return lowest(self.lower)

    def highest(self) -> float | None:
        """The largest number that may be chosen."""
        return highest(self.upper)


@final
class Decision(AbstractDecision):
    """A number (or an array of numbers) that the optimiser chooses, placed anywhere in a model.

    `Decision(30e3, lower=23_339, upper=300e3)` starts at 30 000. An array as `initial` makes one decision of each
    entry, with a common bound or one each. Two placements are two decisions, even of the same object, unless both were
    made with `shared("name")`: then they are one.

    Raises `ProblemError` if a number is not finite (bounds may be infinite), if the bounds are in the wrong order, or
    if the start lies outside them.
    """

    initial: Scalar | np.ndarray
    lower: Scalar | np.ndarray
    upper: Scalar | np.ndarray
    shared_name: str | None = eqx.field(static=True)

    def __init__(
        self,
        initial: Any,
        lower: Any = -np.inf,
        upper: Any = np.inf,
        *,
        shared_name: str | None = None,
    ):
        given = {"initial": initial, "lower": lower, "upper": upper}
        start, *bounds = (real_array(f"Decision: {name}", value) for name, value in given.items())
        refuse_not_finite("Decision: initial", start)
        for name, bound in zip(("lower", "upper"), bounds, strict=True):
            if bound.shape not in ((), start.shape):
                raise refusal(f"Decision: {name}", f"one number or an array of shape {start.shape}", bound)
        _refuse_disorder("Decision", start, *bounds)
        self.initial, self.lower, self.upper = (
            float(value) if start.ndim == 0 else np.broadcast_to(value, start.shape).copy()
            for value in (start, *bounds)
        )
        self.shared_name = None if shared_name is None else a_name("Decision: shared_name", shared_name)

    @override
    def domain(self) -> str:
        return f"[{ends(self.lower)}, {ends(self.upper)}]"


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
        _refuse_disorder("Integer", initial, lower, upper)
        if self.upper - self.lower >= _MOST:
            raise ProblemError(
                f"Integer: expected at most {_MOST:g} values between its bounds; received {lower} to {upper}. A "
                "number so large is an al.Decision, rounded."
            )
        self.shared_name = None if shared_name is None else a_name("Integer: shared_name", shared_name)

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
            key: one.with_fields(table_name=name, column=a_name("Choice.table: a name in columns", key))
            for key, one in made.items()
        }

    @property
    @override
    def values(self) -> Float[np.ndarray, " rows"]:
        return self.among

    @override
    def domain(self) -> str:
        texts = [f"{value:g}" for value in self.among]
        texts = texts if len(texts) < 7 else [*texts[:3], "…", texts[-1]]
        return f"{{{', '.join(texts)}}}" + (f" (a row of '{self.table_name}')" if self.table_name else "")


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


def ends(values: Any) -> str:
    """The smallest and the largest of some numbers, as text."""
    low, high = float(np.min(np.asarray(values))), float(np.max(np.asarray(values)))
    return f"{low:g}" if low == high else f"{low:g}…{high:g}"


def _refuse_disorder(kind: str, initial: Any, lower: Any, upper: Any) -> None:
    """Raise `ProblemError` for a start that is not between its bounds, and for bounds in the wrong order."""
    if not np.all((lower <= initial) & (initial <= upper)):
        raise ProblemError(f"{kind}: expected lower <= initial <= upper; received {lower} <= {initial} <= {upper}.")


def start_given(name: str, value: Any, decision: AbstractDecision) -> Float[np.ndarray, "..."]:
    """Another start of a decision, clipped to its bounds, which it may exceed only by rounding."""
    expected = f"finite numbers of shape {decision.shape}"
    numbers = real_array(f"start: '{name}'", value, expected)
    if numbers.shape != decision.shape or not np.isfinite(numbers).all():
        raise refusal(f"start: '{name}'", expected, value)
    inside = np.clip(numbers, np.asarray(decision.lower), np.asarray(decision.upper))
    beyond = np.abs(inside - numbers) > _ROUNDING * np.maximum(np.abs(numbers), np.abs(inside))
    if beyond.any():
        first = np.flatnonzero(beyond)[0]
        lower, upper, start = (
            np.broadcast_to(value, numbers.shape).flat[first] for value in (decision.lower, decision.upper, numbers)
        )
        raise ProblemError(f"start: expected '{name}' between its bounds {lower:g} and {upper:g}; received {start:g}.")
    return inside
