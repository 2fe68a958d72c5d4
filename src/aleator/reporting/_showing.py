"""The figures and the facts of each type of result: `figure` and `facts_of` register them."""

import functools
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MethodType
from typing import TYPE_CHECKING, Any, TypeVar, final

import numpy as np

from aleator._core.border import meant, refusal, shown
from aleator._core.errors import ProblemError
from aleator.design import Problem, problem_rows
from aleator.dynamics import AbstractSystem
from aleator.mechanics import AbstractMechanical
from aleator.reporting._numbers import given
from aleator.reporting._page import Table, templates
from aleator.uncertainty import AbstractDecision, AbstractDistribution, fields_of

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Value = TypeVar("Value")
Draw = TypeVar("Draw", bound="Callable[..., Figure]")

_FIGURES = dict[type, dict[str, "Callable[..., Figure]"]]()


def figure(kind: type, name: str | None = None) -> Callable[[Draw], Draw]:
    """A decorator: a function of a result of this type draws `result.plot.name()`, by default under its own name.

    The first one of a type is the usual figure, `result.plot()`; one with an empty name is that alone.
    """

    def registered(function: Draw) -> Draw:
        _FIGURES.setdefault(kind, {})[function.__name__ if name is None else name] = function
        return function

    return registered


@final
class Figures:
    """The figures of a result, each a method. Called, it draws the usual one."""

    def __init__(self, result: Any, functions: "Mapping[str, Callable[..., Figure]]"):
        self._result, self._usual = result, next(iter(functions.values()))
        self._named = {name: MethodType(function, result) for name, function in functions.items() if name}
        vars(self).update(self._named)

    def __call__(self) -> "Figure":
        """The usual figure."""
        return self._usual(self._result)

    def __repr__(self) -> str:
        named = ", ".join(f".{name}()" for name in self._named)
        return f"figures of {type(self._result).__name__}: plot() and {named}"


def plots_of(result: Any) -> Figures:
    """The figures of a result, by its type."""
    kind = next((kind for kind in type(result).__mro__ if kind in _FIGURES), None)
    if kind is None:
        raise refusal("plot", "a result whose figures are registered", result)
    return Figures(result, _FIGURES[kind])


def chosen(
    what: str, name: str | None, known: Mapping[str, Value], nothing: str = "there is nothing to draw."
) -> tuple[str, Value]:
    """What is known by a name, with the name; the first where none is asked for.

    Raises `ProblemError` for an unknown name, with the nearest one, and with the sentence `nothing` if there is none.
    """
    if not known:
        raise ProblemError(f"{what}: {nothing}")
    if name is None:
        return next(iter(known.items()))
    if name not in known:
        raise unknown(what, name, known)
    return name, known[name]


def unknown(what: str, name: str, known: Collection[str]) -> ProblemError:
    """The refusal of a name that is not known, with those that are."""
    listed = list(known)
    expected = f"one of {listed}" if len(listed) <= 8 else f"one of {listed[:8]} and {len(listed) - 8} others"
    return ProblemError(f"{what}: expected {expected}; received '{name}'.{meant(name, known)}")


@dataclass(frozen=True)
class Facts:
    """A heading, a sentence that matters most, and small tables. All of it is plain text, escaped when it is shown."""

    heading: str
    sentence: str = ""
    tables: Sequence[Table] = ()


@functools.singledispatch
def facts_of(result: Any) -> Facts:
    """The facts of a result, by its type: by default its type alone, above what is printed of it."""
    return Facts(type(result).__name__)


def page_of(result: Any) -> str:
    """A result as markup for a notebook: its facts, then what `print` shows of it."""
    try:
        facts = facts_of(result)
    except Exception:
        # A notebook would show the trace of this in the place of the result, which can be printed all the same.
        facts = Facts(type(result).__name__)
    early = ", interrupted" if getattr(result, "interrupted", False) is True else ""
    return templates().get_template("notebook.html.j2").render(facts=facts, early=early, printed=str(result))


@facts_of.register(AbstractMechanical)
@facts_of.register(AbstractSystem)
def _(system: AbstractMechanical | AbstractSystem) -> Facts:
    rows = [[name, _value(value), str(field.metadata.get("unit", ""))] for name, field, value in fields_of(system)]
    name, sentence = type(system).__name__, (type(system).__doc__ or "").strip().split("\n")[0]
    # A class without a docstring is given its signature as one.
    sentence = "" if sentence.startswith(f"{name}(") else sentence
    return Facts(name, sentence, [Table("", ["number", "value", "unit"], rows)] if rows else [])


@facts_of.register(Problem)
def _(problem: Problem) -> Facts:
    rows = [list(row) for row in problem_rows(problem)]
    return Facts(f"Problem: {type(problem.system).__name__}", "", [Table("", ["", ""], rows)])


def _value(value: Any) -> str:
    """A number, distribution or decision in words; arrays and others shortened."""
    if isinstance(value, AbstractDistribution):
        return str(value)
    if isinstance(value, AbstractDecision) and not value.is_designed:
        return str(value)
    if isinstance(value, AbstractDecision):
        many = f"{np.size(value.initial)} numbers" if np.ndim(value.initial) else f"from {float(value.initial):g}"
        return f"Decision in [{np.min(value.lower):g}, {np.max(value.upper):g}], {many}"
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return given(float(value))
    return shown(value)
