"""What the site adds to its pages: formulas as MathML, which needs no script, the sources that pages link to, the
tutorials, which are notebooks, and the pages of the tree's root, of which the README is the first of the site.
"""

import html
import json
import re
from pathlib import Path, PurePosixPath
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
# Links from a page to a source of the tree, as they work in the tree.
_LINK = re.compile(r"\]\(\.\./((?:examples|src|benchmarks)/[\w/]+\.py)\)")
_NOTEBOOK = re.compile(r"\]\((tutorials/\w+\.ipynb)\)")
# Pages of the root of the tree, by their names on the site, and links from and to them.
OF_ROOT = {"README.md": "index.md", "ARCHITECTURE.md": "architecture.md", "CHANGELOG.md": "changelog.md"}
_FROM_ROOT = re.compile(rf"\]\((?:docs/|({'|'.join(OF_ROOT)})(?=\)))")
# What pymdownx.arithmatex leaves of a formula, in a line or on its own.
_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)
_NUMBER = re.compile(r"\\tag\{(.*?)\}")


def on_files(files: Any, config: Any) -> Any:
    """A page for each of the root, for each source that a page links to, and for each notebook."""
    pages = [Path(one.abs_src_path).read_text(encoding="utf-8") for one in files if one.src_uri.endswith(".md")]
    for name, page in OF_ROOT.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        content = _FROM_ROOT.sub(lambda found: f"]({OF_ROOT.get(found[1] or '', '')}", text)
        files.append(File.generated(config, page, content=content))
    for notebook in [one for one in files if one.src_uri.endswith(".ipynb")]:
        files.append(File.generated(config, _page_of(notebook.src_uri), content=_shown(Path(notebook.abs_src_path))))
    for source in sorted({found for text in pages for found in _LINK.findall(text)}):
        text = (ROOT / source).read_text(encoding="utf-8")
        content = f"# {source}\n\n```python\n{text}```\n"
        files.append(File.generated(config, f"source/{_page_of(source)}", content=content))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Links to sources and notebooks lead to their pages."""
    markdown = _NOTEBOOK.sub(lambda found: f"]({_page_of(found[1])})", markdown)
    return _LINK.sub(lambda found: f"](source/{_page_of(found[1])})", markdown)


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
    return str(PurePosixPath(source).with_suffix(".md"))


def _shown(notebook: Path) -> str:
    """The cells of a notebook as Markdown, with a link to the file."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    texts = [("".join(cell["source"]), cell["cell_type"] == "code") for cell in cells]
    shown = [f"```python\n{text}\n```" if is_code else text for text, is_code in texts]
    return "\n\n".join([*shown, f"[This page as a notebook]({notebook.name})"])
