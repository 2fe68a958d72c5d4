"""`AbstractPlots`: the figures of a result, one method for each; and by which library they are drawn."""

import abc
import functools
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any, Generic, Literal, TypeVar, get_args

from aleator._core.errors import ProblemError
from aleator._core.given import meant, refusal, shown
from aleator.reporting._paper import paper_figure

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Result = TypeVar("Result")
Value = TypeVar("Value")
Backend = Literal["plotly", "matplotlib"]


class AbstractPlots(abc.ABC, Generic[Result]):
    """The figures of a result. Called, it draws the usual one; its methods draw the others.

    Each takes `backend`: `"plotly"`, a figure to hover over, or `"matplotlib"`, the same one for papers.
    """

    def __init__(self, result: Result):
        self._result = result

    @abc.abstractmethod
    def __call__(self, *, backend: Backend = "plotly") -> Any:
        """The usual figure."""

    def __repr__(self) -> str:
        named = ", ".join(f".{name}()" for name in vars(type(self)) if not name.startswith("_"))
        return f"figures of {type(self._result).__name__}: plot() and {named}"


@functools.singledispatch
def plots_of(result: Any) -> AbstractPlots[Any]:
    """The figures of a result, by its type."""
    raise refusal("plot", "a result whose figures are known to aleator.reporting.drawn", result)


def drawn_by(backend: Backend, figure: "Figure") -> Any:
    """A figure by one library or the other.

    Raises `ProblemError` for an unknown one, and `MissingExtraError` if Matplotlib is not installed.
    """
    if backend not in get_args(Backend):
        raise refusal("plot: backend", " or ".join(map(repr, get_args(Backend))), backend)
    return figure if backend == "plotly" else paper_figure(figure)


def chosen(what: str, name: str | None, known: Mapping[str, Value], nothing: str) -> tuple[str, Value]:
    """What is known by a name, with the name; the first where none is asked for.

    Raises `ProblemError` for an unknown name, with the nearest one, and with the sentence `nothing` if there is none.
    """
    if not known:
        raise ProblemError(f"{what}: {nothing}")
    if name is None:
        return next(iter(known.items()))
    if not isinstance(name, str) or name not in known:
        raise unknown(what, name, known)
    return name, known[name]


def unknown(what: str, name: Any, known: Collection[str]) -> ProblemError:
    """The refusal of a name that is not known, with those that are."""
    listed = list(known)
    told = f"one of {listed}" if len(listed) <= 8 else f"one of {listed[:8]} and {len(listed) - 8} others"
    near = meant(name, known) if isinstance(name, str) else ""
    return ProblemError(f"{what}: expected {told}; received {shown(name)}.{near}")
