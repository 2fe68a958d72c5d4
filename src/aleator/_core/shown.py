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


class Drawn(Printed):
    """A result of which there are figures."""

    __slots__ = ()

    @property
    def plot(self) -> Any:
        """The figures of this result: `result.plot()` is the usual one, and its methods are the others.

        Each returns a figure of Plotly, or with `backend="matplotlib"` one of Matplotlib, for papers.
        """
        return _showing().plots_of(self)


def _showing() -> Any:
    return importlib.import_module("aleator.reporting.drawn")
