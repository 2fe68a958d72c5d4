"""Whatever a document or example shows must run, as it stands, from a bare install."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def code_of(document: str) -> str:
    """All Python shown in a document, as one program."""
    text = (ROOT / document).read_text(encoding="utf-8")
    return "\n".join(re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL))


def run(program: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONWARNINGS": "error"}
    return subprocess.run(
        [sys.executable, *program], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    "document",
    [
        "README.md",
        "docs/index.md",
        "docs/guide.md",
        "docs/extending.md",
        pytest.param("docs/uncertainty.md", marks=pytest.mark.slow),
        "docs/algebraic.md",
        "docs/black_boxes.md",
        "docs/choosing.md",
        "docs/figures.md",
        "docs/motion.md",
        "docs/openmdao.md",
        "docs/robots.md",
        "docs/scaling.md",
        "docs/solvers.md",
        "docs/studies.md",
        "docs/sympy.md",
        "docs/transcriptions.md",
    ],
)
def test_code_shown_in_documents_runs(document: str, tmp_path: Path):
    (tmp_path / "shown.py").write_text(code_of(document), encoding="utf-8")
    finished = run(["shown.py"], tmp_path)
    assert finished.returncode == 0, finished.stderr


@pytest.mark.parametrize("document", ["README.md", "docs/index.md"])
def test_the_first_program_has_fifteen_lines_and_ends_in_a_picture(document: str):
    text = (ROOT / document).read_text(encoding="utf-8")
    (program, shown), *_ = re.findall(r"```python\n(.*?)```\n\n!\[.+?\]\((.+?)\)", text, flags=re.DOTALL)
    assert text.index(program) == text.index("```python\n") + len("```python\n")
    lines = [line for line in program.splitlines() if line.strip()]
    assert len(lines) <= 15
    assert ".plot()" in lines[-1]
    assert (ROOT / document).parent.joinpath(shown).is_file()


@pytest.mark.slow
@pytest.mark.parametrize("example", sorted(path.name for path in (ROOT / "examples").glob("*.py")))
def test_examples_run(example: str, tmp_path: Path):
    finished = run([str(ROOT / "examples" / example)], tmp_path)
    assert finished.returncode == 0, finished.stderr
    assert "solved" in finished.stdout


def test_documents_link_to_files_that_exist():
    for document in ROOT.glob("*.md"):
        for target in re.findall(r"\]\((?!http)([^)#]+)\)", document.read_text(encoding="utf-8")):
            assert (ROOT / target).exists(), f"{document.name} links to {target}"
