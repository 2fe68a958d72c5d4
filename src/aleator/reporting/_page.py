"""A page: a verdict, then sections of text, tables and figures, in one HTML file without a network."""

import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final, get_args

import numpy as np

from aleator._core.border import members, refusal
from aleator.reporting._files import write_text
from aleator.reporting._style import padded, short

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Level = Literal["good", "caution", "bad"]
# Points of a curve of a chosen design: there and back, of a band.
_POINTS = 120


@final
@dataclass(frozen=True)
class Verdict:
    """The first screen: a mark and its word, one headline, rows of facts, a few sentences.

    - `rows`: what is said of the proposed design, each with its name.
    """

    level: Level
    word: str
    headline: str
    sentences: Sequence[str] = ()
    rows: Sequence[tuple[str, str]] = ()

    def __post_init__(self) -> None:
        if self.level not in get_args(Level):
            raise refusal("Verdict: level", " or ".join(map(repr, get_args(Level))), self.level)


@final
@dataclass(frozen=True)
class Text:
    """Paragraphs of plain text; `lead` is set in bold before the first."""

    paragraphs: Sequence[str]
    lead: str = ""


@final
@dataclass(frozen=True)
class Code:
    """Text in a fixed-width font, such as a problem printed as mathematics, collapsed unless `opened`."""

    heading: str
    text: str
    opened: bool = False


@final
@dataclass(frozen=True)
class Table:
    """A table of text; the first column names the rows."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    def __post_init__(self) -> None:
        for i, row in enumerate(members(f"Table '{self.caption}': rows", self.rows, Sequence)):
            what = f"Table '{self.caption}': row {i}"
            if len(members(what, row, str)) != len(self.header):
                raise refusal(what, f"{len(self.header)} texts, one a column", row)


@final
@dataclass(frozen=True)
class Drawing:
    """One figure, or several in a row with a common heading and a caption that says what to see in it."""

    figures: "Sequence[Figure]"
    heading: str
    caption: str = ""
    number: str = ""

    def __post_init__(self) -> None:
        from plotly.graph_objects import Figure

        members(f"Drawing '{self.heading}': figures", self.figures, Figure)


@final
@dataclass(frozen=True)
class Schematic:
    """Drawings of a system as SVG, with its mathematics beside them."""

    drawings: Sequence[str]
    heading: str
    caption: str = ""
    number: str = ""
    beside: Sequence[Code] = ()


@final
@dataclass(frozen=True)
class Choice:
    """A design that a reader can choose on a page: its name, what is known of it in tables, and a figure of each of its
    paths, with the path's name in its `meta`.
    """

    name: str
    facts: Sequence[Table]
    bands: "Sequence[Figure]" = ()


@final
@dataclass(frozen=True)
class Linked:
    """Figures of designs and a table of them, one row each, beside all that is known of the one that a reader chooses.

    - `figures`: a trace says by its `meta`, a list of places in `choices`, to which designs its points belong;
    - `table`: a row for each of `choices`, in the same order; without JavaScript it is what is shown;
    - `chosen`: the place of the one shown first.
    """

    figures: "Sequence[Figure]"
    heading: str
    table: Table
    choices: Sequence[Choice]
    chosen: int = 0
    caption: str = ""
    number: str = ""


Block = Text | Code | Table | Drawing | Schematic | Linked


@final
@dataclass(frozen=True)
class Section:
    """A heading and the blocks under it, which a reader opens if they are `folded`."""

    heading: str
    blocks: Sequence[Block]
    folded: bool = False


@final
@dataclass(frozen=True)
class Page:
    """Everything on a page, as text: the template escapes it."""

    title: str
    subtitle: str
    verdict: Verdict
    sections: Sequence[Section]
    footer: str = ""


@cache
def templates() -> Any:
    """Our templates, which escape whatever is inserted."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("aleator.reporting"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "allow_nan": False}
    environment.filters["kind"] = lambda block: type(block).__name__.lower()
    return environment


def page_html(page: Page) -> str:
    """The page as one HTML document that contains styles, scripts and data."""
    from plotly.offline import get_plotlyjs

    blocks = [block for section in page.sections for block in section.blocks if isinstance(block, Drawing | Linked)]
    drawings = [_drawn(block, f"figure-{i}") for i, block in enumerate(blocks)]
    plotly = get_plotlyjs() if drawings else ""
    return templates().get_template("page.html.j2").render(page=page, next_drawn=iter(drawings).__next__, plotly=plotly)


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page; see `page_html`. An earlier page at `path` is replaced atomically."""
    return write_text(path, page_html(page))


def _drawn(block: Drawing | Linked, name: str) -> dict[str, Any]:
    """What the template needs to draw a block: its name, its panels, and what a reader can choose."""
    panels = [_panel(one, f"{name}-{i}", block.heading, block.caption) for i, one in enumerate(block.figures)]
    if isinstance(block, Drawing):
        return {"name": name, "panels": panels}
    paths, every = dict[str, list[Any]](), [figure for choice in block.choices for figure in choice.bands]
    for one in every:
        paths.setdefault(one.layout.meta, []).append(one)  # type: ignore[union-attr]
    bands = [
        _panel(_stage(figures), f"{name}-band-{i}", f"{block.heading}: {path} of the chosen design", "")
        for i, (path, figures) in enumerate(paths.items())
    ]
    choices = [
        {
            "name": one.name,
            "facts": [{"caption": table.caption, "rows": table.rows, "note": table.note} for table in one.facts],
            "bands": {figure.layout.meta: _band(figure) for figure in one.bands},  # type: ignore[union-attr]
        }
        for one in block.choices
    ]
    return {"name": name, "panels": panels, "bands": bands, "json": choices}


def _panel(figure: "Figure", name: str, heading: str, caption: str) -> dict[str, Any]:
    """The data of a figure for the template. Titles become HTML, which wraps on narrow screens."""
    content = json.loads(figure.to_json() or "{}")
    for trace, drawn in zip(content["data"], figure.data, strict=True):
        trace.update(_repeated(drawn))
    title = html.unescape((content["layout"].pop("title", None) or {}).get("text", ""))
    if title:
        content["layout"]["margin"]["t"] = 40
    return {
        "id": name,
        "title": title,
        "height": content["layout"].get("height", 420),
        "alt": ". ".join(part for part in (heading, title, caption) if part),
        "json": content,
    }


def _repeated(trace: Any) -> dict[str, Any]:
    """The instants of many histories in one trace, once, and how often they are repeated: half of its size."""
    x = trace.x if isinstance(getattr(trace, "x", None), np.ndarray) and trace.x.dtype.kind == "f" else np.zeros(0)
    (gaps,) = np.nonzero(np.isnan(x))
    if len(gaps) < 2 or len(x) % (gaps[0] + 1):
        return {}
    first, *others = x.reshape(-1, gaps[0] + 1)
    if not all(np.array_equal(first, one, equal_nan=True) for one in others):
        return {}
    return {"x": [*(float(f"{one:.6g}") for one in first[:-1]), None], "repeated": len(others) + 1}


def _stage(figures: Sequence[Any]) -> "Figure":
    """An empty figure with axes that suit all of some figures of one path."""
    traces = [one for figure in figures for one in figure.data]
    times, values = (np.concatenate([np.asarray(one[axis], float) for one in traces]) for axis in ("x", "y"))
    limits = [one.y0 for figure in figures for one in figure.layout.shapes]
    stage = type(figures[0])(layout=figures[0].layout).update_xaxes(range=[times.min(), times.max()])
    return stage.update_yaxes(range=padded([*values[np.isfinite(values)], *limits], 0.1))


def _band(figure: Any) -> dict[str, Any]:
    """What differs between the designs in the figure of a path: limits, and curves at some instants."""
    shown = type(figure)(figure)
    for curve in shown.data:
        places = np.linspace(0, len(curve.x) - 1, min(len(curve.x), _POINTS)).round().astype(int)
        for key in ("x", "y", "customdata"):
            if curve[key] is not None:
                curve[key] = short(np.asarray(curve[key], float)[places])
    content = json.loads(shown.to_json() or "{}")
    limits = {key: content["layout"].get(key, []) for key in ("shapes", "annotations")}
    return {"data": content["data"], "layout": limits}
