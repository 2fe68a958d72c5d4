"""The documentation site: every page is in it, every link leads somewhere, and every public name has its text."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import aleator as al

ROOT = Path(__file__).parents[1]
# Errors and warnings are told where they are raised; topics have pages or guides of their own.
ELSEWHERE = re.compile(r".*(Error|Warning)$|compilation_cache$|Abstract.*|[a-z_]+$")


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


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site/api/solving/index.html").read_text(encoding="utf-8")
    assert "deterministic_first" in page
    assert "Solve a design problem" in page
