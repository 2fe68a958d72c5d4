"""What the site adds to its pages: formulas as MathML, which needs no script, and the sources that pages link to."""

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
# Links from a page to a source of the tree, as they work in the tree.
_LINK = re.compile(r"\]\(\.\./((?:examples|src|benchmarks)/[\w/]+\.py)\)")
# What pymdownx.arithmatex leaves of a formula, in a line or on its own.
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_NUMBER = re.compile(r"\\tag\{(.*?)\}")


def on_files(files: Any, config: Any) -> Any:
    """A page for each source that a page links to."""
    pages = [Path(one.abs_src_path).read_text(encoding="utf-8") for one in files if one.src_uri.endswith(".md")]
    for source in sorted({found for text in pages for found in _LINK.findall(text)}):
        text = (ROOT / source).read_text(encoding="utf-8")
        files.append(File.generated(config, _page_of(source), content=f"# {source}\n\n```python\n{text}```\n"))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to sources lead to their pages."""
    return _LINK.sub(lambda found: f"]({_page_of(found[1])})", markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Formulas in TeX become MathML."""
    return _FORMULA.sub(lambda found: formula(html.unescape(found[2]), own_line=found[1] == "div"), content)


def formula(tex: str, *, own_line: bool) -> str:
    """A formula as MathML; one of its own line with its number, given by TeX's `tag`, at the right."""
    number = _NUMBER.search(tex)
    shown = convert(_NUMBER.sub("", tex).strip(), display="block" if own_line else "inline")
    if not own_line:
        return shown
    return f'<div class="formula">{shown}<span>{f"({number[1]})" if number else ""}</span></div>'


def _page_of(source: str) -> str:
    return f"source/{source.removesuffix('.py')}.md"
