"""A page: a verdict, then sections of text, tables and figures, in one HTML file without a network."""

import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from aleator.reporting._blocks import Drawing, Linked, Section, Verdict
from aleator.reporting._choices import choices_data, stages
from aleator.reporting._files import write_text

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_PARTS = ("page.html.j2", "page.css", "page.js", "linked.js")


@final
@dataclass(frozen=True)
class Page:
    """Everything on a page, as text: the template escapes it."""

    title: str
    subtitle: str
    verdict: Verdict
    sections: Sequence[Section]
    footer: str = ""


def page_html(page: Page) -> str:
    """The page as one HTML document that contains styles, scripts and data."""
    import jinja2
    from plotly.offline import get_plotlyjs

    folder = resources.files("aleator.reporting") / "templates"
    source = {one: (folder / one).read_text(encoding="utf-8") for one in _PARTS}
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    blocks = [block for section in page.sections for block in section.blocks if isinstance(block, Drawing | Linked)]
    drawings = [_drawn(block, i) for i, block in enumerate(blocks)]
    return environment.from_string(source["page.html.j2"]).render(
        page=page,
        anchors=_anchors(page),
        next_drawn=iter(drawings).__next__,
        css=_raw(source["page.css"]),
        script=_raw(source["page.js"] + source["linked.js"]),
        plotly=_raw(get_plotlyjs()) if drawings else "",
    )


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page; see `page_html`. An earlier page at `path` is replaced atomically."""
    return write_text(path, page_html(page))


def _anchors(page: Page) -> list[str]:
    """A unique anchor for each section."""
    found: list[str] = []
    for section in page.sections:
        repeats = sum(re.fullmatch(rf"{re.escape(section.anchor)}(-\d+)?", one) is not None for one in found)
        found.append(f"{section.anchor}-{repeats + 1}" if repeats else section.anchor)
    return found


def _drawn(block: Drawing | Linked, place: int) -> dict[str, Any]:
    """What the template needs to draw a block: its name, its panels, and what a reader can choose."""
    name = f"figure-{place}"
    panels = [_panel(one, f"{name}-{i}", block.heading, block.caption) for i, one in enumerate(block.figures)]
    if isinstance(block, Drawing):
        return {"name": name, "panels": panels}
    bands = [
        _panel(one, f"{name}-band-{i}", f"{block.heading}: {path} of the chosen design", "")
        for i, (path, one) in enumerate(stages(block).items())
    ]
    return {"name": name, "panels": panels, "bands": bands, "json": _json(choices_data(block))}


def _panel(figure: "Figure", name: str, heading: str, caption: str) -> dict[str, Any]:
    """The data of a figure for the template. Titles become HTML, which wraps on narrow screens."""
    content = json.loads(figure.to_json() or "{}")
    title = html.unescape((content["layout"].pop("title", None) or {}).get("text", ""))
    if title:
        content["layout"]["margin"]["t"] = 40
    return {
        "id": name,
        "title": title,
        "height": content["layout"].get("height", 420),
        "alt": ". ".join(part for part in (heading, title, caption) if part),
        "json": _json(content),
    }


def _json(content: Any) -> Any:
    """Data that a script element may hold."""
    return _raw(json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def _raw(text: str) -> Any:
    """Trusted text that the template inserts without escaping: our own styles and scripts, and JSON without any `<`."""
    from markupsafe import Markup

    return Markup(text)
