"""The documentation site: every page is in it, every link leads somewhere, and every public name has its text."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import aleator as al
from aleator.studies import STUDIES

ROOT = Path(__file__).parents[1]
# Errors and warnings are told where they are raised; topics have pages or guides of their own.
ELSEWHERE = re.compile(r".*(Error|Warning)$|compilation_cache$|Abstract.*|[a-z_]+$")


LARGEST_PICTURE = 60_000  # bytes


def loaded(name: str) -> Any:
    """A script of the site."""
    told = importlib.util.spec_from_file_location(name, ROOT / f"docs/{name}.py")
    assert told is not None
    assert told.loader is not None
    module = importlib.util.module_from_spec(told)
    told.loader.exec_module(module)
    return module


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    pages = {str(path.relative_to(ROOT / "docs").as_posix()) for path in (ROOT / "docs").rglob("*.md")}
    assert pages == listed


def test_every_public_class_is_on_a_page():
    told = {
        name
        for page in (ROOT / "docs/api").glob("*.md")
        for name in re.findall(r"::: aleator\.(\w+)", page.read_text())
    }
    assert {name for name in dir(al) if not ELSEWHERE.match(name) and not name.startswith("_")} <= told
    assert {name for name in told if not hasattr(al, name)} == set()


def test_the_gallery_has_every_example_and_every_study_with_a_small_picture():
    gallery = loaded("gallery")
    assert set(gallery.EVERY["Examples"]) == {path.stem for path in (ROOT / "examples").glob("*.py")}
    assert set(gallery.EVERY["Studies"]) == set(STUDIES)
    entries = {gallery.FIRST, *(name for chapter in gallery.EVERY.values() for name in chapter)}
    pictures = {path.stem: path for path in (ROOT / "docs/pictures").iterdir()}
    assert set(pictures) == entries
    for path in pictures.values():
        assert "<svg" in path.read_text(encoding="utf-8")
        assert path.stat().st_size < LARGEST_PICTURE, path.name


def test_curves_of_pictures_are_thinned_by_less_than_can_be_seen():
    gallery = loaded("gallery")
    x = np.linspace(0.0, 200.0, 1001)
    curve = np.column_stack([x, 50.0 * np.sin(x / 20.0)])
    thinned = gallery._thinned(curve)
    assert len(thinned) < 100
    assert np.abs(np.interp(x, *thinned.T) - curve[:, 1]).max() < 3 * gallery.OFF  # its slope is up to 2.5
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]])
    np.testing.assert_array_equal(gallery._thinned(square), square)


def test_the_gallery_is_the_page_that_its_script_writes():
    assert (ROOT / "docs/gallery.md").read_text(encoding="utf-8") == loaded("gallery").page()


def test_pages_link_to_sources_that_exist():
    for page in (ROOT / "docs").glob("*.md"):
        for target in re.findall(r"\]\((\.\./[^)#]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).is_file(), f"{page.name} links to {target}"


@pytest.mark.slow
def test_formulas_become_mathml_with_their_numbers():
    pytest.importorskip("latex2mathml", reason="latex2mathml is not installed")
    hooks = loaded("hooks")
    in_line, of_its_own = r"\(a &lt; b\)", r"\[\sigma^2 \tag{33, 99}\]"
    content = f'<span class="arithmatex">{in_line}</span><div class="arithmatex">{of_its_own}</div>'
    shown = hooks.on_page_content(content)
    assert "arithmatex" not in shown
    assert "<mi>a</mi><mo>&lt;</mo><mi>b</mi>" in shown.replace("&#x0003C;", "&lt;")
    assert "<span>(33, 99)</span>" in shown
    assert "<msup><mi>&#x003C3;</mi><mn>2</mn></msup>" in shown


def test_numbers_of_equations_are_those_of_the_dissertation():
    text = (ROOT / "docs/mathematics.md").read_text(encoding="utf-8")
    numbers = [int(one) for tag in re.findall(r"\\tag\{(.*?)\}", text) for one in re.findall(r"\d+", tag)]
    assert len(numbers) > 50
    assert set(numbers) <= set(range(1, 144))


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site/api/solving/index.html").read_text(encoding="utf-8")
    assert "deterministic_first" in page
    assert "Solve a design problem" in page
    formulas = (tmp_path / "site/mathematics/index.html").read_text(encoding="utf-8")
    assert formulas.count("<math") > 100
    assert "arithmatex" not in formulas
    assert ">Lift<" in (tmp_path / "site/source/examples/co_design/index.html").read_text(encoding="utf-8")
