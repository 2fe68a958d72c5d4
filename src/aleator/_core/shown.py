"""How results and models are shown: as text, as a small table in a notebook, and in figures.

The classes below only say *that* something can be shown. How is the task of `aleator.reporting`, which is far above the
results in the order of imports, and brings Plotly along. It is therefore loaded by its name at the first use, and finds
what belongs to a result by its type, in one registry: results know nothing of figures, and a new type of result is made
known there, in one place. A property typed by the drawers themselves would turn the order of imports around.
"""

import importlib
from typing import Any


class Printed:
    """Something that a notebook shows as a table; `print` shows the same as text."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return _showing().page_of(self)


class _Figures:
    """The figures of a result: `result.plot()` is the usual one, and the methods of `result.plot` are the others.

    Each returns a figure of Plotly, or with `backend="matplotlib"` one of Matplotlib, for papers. It is a descriptor of
    its own, not a property, because notebooks complete `result.plot.` only if looking it up is no property's code.
    """

    def __get__(self, result: Any, owner: Any = None) -> Any:
        return self if result is None else _showing().plots_of(result)


class Drawn(Printed):
    """A result of which there are figures."""

    __slots__ = ()

    plot = _Figures()


def _showing() -> Any:
    return importlib.import_module("aleator.reporting.drawn")
