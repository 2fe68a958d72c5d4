"""Whatever a document or an example shows must run, as it stands: README and the first tutorial by default."""

import re
import sys
import types
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FIRST = ("README.md", "docs/index.md")
# The page on FMUs needs one: see foreign/test_fmu_document.py.
DOCUMENTS = sorted(
    str(path.relative_to(ROOT))
    for path in (ROOT / "docs").glob("*.md")
    if "```python" in path.read_text("utf-8") and path.name != "fmu.md"
)
EXAMPLES = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "examples").glob("*.py"))


def code_of(document: str) -> str:
    """All Python shown in a document, as one program; an example as it is."""
    text = (ROOT / document).read_text(encoding="utf-8")
    return text if document.endswith(".py") else "\n".join(re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Run a document as `python shown.py` would, in this process and a folder of its own."""

    def run(document: str) -> None:
        path = tmp_path / "shown.py"
        path.write_text(code_of(document), encoding="utf-8")
        module = types.ModuleType("__main__")
        module.__file__ = str(path)
        with monkeypatch.context() as patch:
            patch.chdir(tmp_path)
            patch.syspath_prepend(tmp_path)
            patch.setitem(sys.modules, "__main__", module)
            exec(compile(path.read_text("utf-8"), str(path), "exec"), module.__dict__)

    return run


@pytest.mark.parametrize(
    "document", [*FIRST, *(pytest.param(one, marks=pytest.mark.slow) for one in DOCUMENTS if one not in FIRST)]
)
def test_code_shown_in_documents_runs(document: str, run):
    run(document)


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_run(example: str, run, capsys):
    run(example)
    assert "solved" in capsys.readouterr().out


@pytest.mark.parametrize("document", FIRST)
def test_the_first_program_has_fifteen_lines_and_ends_in_a_picture(document: str):
    text = (ROOT / document).read_text(encoding="utf-8")
    (program, shown), *_ = re.findall(r"```python\n(.*?)```\n\n!\[.+?\]\((.+?)\)", text, flags=re.DOTALL)
    assert text.index(program) == text.index("```python\n") + len("```python\n")
    lines = [line for line in program.splitlines() if line.strip()]
    assert len(lines) <= 15
    assert ".plot()" in lines[-1]
    assert (ROOT / document).parent.joinpath(shown).is_file()


def test_documents_link_to_files_that_exist():
    for document in ROOT.glob("*.md"):
        for target in re.findall(r"\]\((?!http)([^)#]+)\)", document.read_text(encoding="utf-8")):
            assert (ROOT / target).exists(), f"{document.name} links to {target}"
