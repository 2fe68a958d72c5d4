"""A page: the verdict, then sections of text, tables and figures, in one HTML file that needs no network."""

import html
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, final

from aleator.reporting._blocks import Drawing, Section, Verdict
from aleator.reporting._files import write_text


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
    source = {one: (folder / one).read_text(encoding="utf-8") for one in ("page.html.j2", "page.css", "page.js")}
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    drawings = [_panels(block, i) for i, block in enumerate(_drawings(page))]
    return environment.from_string(source["page.html.j2"]).render(
        page=page,
        anchors=_anchors(page),
        next_panels=iter(drawings).__next__,
        css=_raw(source["page.css"]),
        script=_raw(source["page.js"]),
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


def _drawings(page: Page) -> list[Drawing]:
    return [block for section in page.sections for block in section.blocks if isinstance(block, Drawing)]


def _panels(drawing: Drawing, place: int) -> list[dict[str, Any]]:
    """The data of each figure in a drawing for the template. Titles become HTML, which wraps on narrow screens."""
    panels = []
    for i, figure in enumerate(drawing.figures):
        content = json.loads(figure.to_json() or "{}")
        title = html.unescape((content["layout"].pop("title", None) or {}).get("text", ""))
        if title:
            content["layout"]["margin"]["t"] = 40
        panels.append(
            {
                "id": f"figure-{place}-{i}",
                "title": title,
                "height": content["layout"].get("height", 420),
                "alt": ". ".join(part for part in (drawing.heading, title, drawing.caption) if part),
                "json": _raw(json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")),
            }
        )
    return panels


def _raw(text: str) -> Any:
    """Trusted text that the template inserts without escaping: our own styles and scripts, and JSON without any `<`."""
    from markupsafe import Markup

    return Markup(text)
