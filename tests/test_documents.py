"""What documents show runs as it stands, and the site has every page, every public class and every link."""

import json
import re
import runpy
import subprocess
import sys
import types
from pathlib import Path

import pytest

import aleator as al
from aleator.studies import STUDIES

ROOT = Path(__file__).parents[1]
# The page on FMUs needs one: see foreign/test_fmu_systems.py.
DOCUMENTS = sorted(
    str(path.relative_to(ROOT))
    for path in (ROOT / "docs").glob("*.md")
    if "```python" in path.read_text("utf-8") and path.name != "fmu.md"
)
TUTORIALS = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs/tutorials").glob("*.ipynb"))
EXAMPLES = sorted(str(path.relative_to(ROOT)) for path in (ROOT / "examples").glob("*.py"))
IN_SMALL = {"examples/ride_travel_holding.py": (3, 200)}  # points, samples


# --- Code ------------------------------------------------------------------------------------------------------------


def code_of(document: str) -> str:
    """All Python shown in a document or a notebook, as one program; an example as it is."""
    text = (ROOT / document).read_text(encoding="utf-8")
    if document.endswith(".ipynb"):
        return "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code")
    return text if document.endswith(".py") else "\n".join(re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL))


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Run all Python of a document, or an example, as `python shown.py` would, in this process and its own folder."""

    def run(document: str) -> None:
        text = code_of(document)
        path = tmp_path / "shown.py"
        path.write_text(text, encoding="utf-8")
        module = types.ModuleType("__main__")
        module.__file__ = str(path)
        with monkeypatch.context() as patch:
            patch.chdir(tmp_path)
            patch.syspath_prepend(tmp_path)
            patch.setitem(sys.modules, "__main__", module)
            exec(compile(text, str(path), "exec"), module.__dict__)

    return run


@pytest.mark.parametrize(
    "document", ["README.md", *(pytest.param(one, marks=pytest.mark.slow) for one in [*DOCUMENTS, *TUTORIALS])]
)
def test_code_shown_in_documents_runs(document: str, run):
    run(document)


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES)
def test_examples_run(example: str, run, capsys):
    if example in IN_SMALL:
        runpy.run_path(str(ROOT / example))["main"](*IN_SMALL[example])
    else:
        run(example)
    assert "solved" in capsys.readouterr().out


# --- The site --------------------------------------------------------------------------------------------------------


@pytest.mark.slow  # the site's own libraries are of test-slow
def test_every_page_is_in_the_navigation_and_links_to_files_that_exist():
    listed = set(re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    pages = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").rglob("*.ipynb")]
    written = {str(path.relative_to(ROOT / "docs").with_suffix(".md").as_posix()) for path in pages}
    assert written | {*runpy.run_path(str(ROOT / "docs/hooks.py"))["OF_ROOT"].values()} == listed
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]:
        links = r"\]\((?!http)([^)#]+)\)" if page.parent == ROOT else r"\]\((\.\./[^)#]+)\)"
        for target in re.findall(links, page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_every_way_in_which_a_solve_ends_is_on_the_page_of_failures():
    page = (ROOT / "docs/solving.md").read_text(encoding="utf-8").lower()
    against = {
        "between": types.SimpleNamespace(holds=False),
        "grid_error": types.SimpleNamespace(is_usable=False, steps=9),
        "opinion": types.SimpleNamespace(broken="a limit", samples=9, remedy="Raise the order"),
        "worst_case": types.SimpleNamespace(is_found=False, rounds=1, realisations=[types.SimpleNamespace(beyond=0.1)]),
    }
    quality = al.results.ExpansionQuality(3, 4, 12, 1.0)
    certificates = [al.results.Certificate(0.0, 0.0, 0.0, quality, **{name: one}) for name, one in against.items()]
    ends = [one.objection.phrase for one in certificates if one.objection]
    assert len(ends) == len(against)
    judgement = (ROOT / "src/aleator/certification/_judgement.py").read_text(encoding="utf-8")
    others = re.findall(r'Objection\("([^"]+)"|^ {8}"([a-z][^"]+)": ', judgement, flags=re.MULTILINE)
    assert len(others) == 5
    ends += ["".join(one) for one in others]
    ends += [status.value for status in al.Status if status is not al.Status.SOLVED]
    assert [end for end in ends if end.lower() not in page] == []


def test_every_public_name_is_on_a_page():
    pages = [page.read_text(encoding="utf-8") for page in (ROOT / "docs/api").glob("*.md")]
    described = {name for page in pages for name in re.findall(r"::: aleator\.(\w+)", page)}
    # Errors and warnings are described where they are raised.
    names = {name for name in dir(al) if not name.startswith("_") and not name.endswith(("Error", "Warning"))}
    assert described == names | {"extending"}


def test_the_gallery_is_what_its_script_writes_of_every_example_and_study_with_a_small_picture():
    gallery = runpy.run_path(str(ROOT / "docs/gallery.py"))
    assert (ROOT / "docs/gallery.md").read_text(encoding="utf-8") == gallery["page"]()
    assert set(gallery["EVERY"]["Examples"]) == {path.stem for path in (ROOT / "examples").glob("*.py")}
    assert set(gallery["EVERY"]["Studies"]) == set(STUDIES)
    pictures = {path.stem: path for path in (ROOT / "docs/pictures").iterdir()}
    assert set(pictures) == {gallery["FIRST"], *(name for chapter in gallery["EVERY"].values() for name in chapter)}
    for name, path in pictures.items():
        assert "<svg" in path.read_text(encoding="utf-8")
        assert path.stat().st_size < 60_000, name


@pytest.mark.slow
def test_the_site_is_built_without_a_warning(tmp_path: Path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Solve a design problem" in (tmp_path / "site/api/solving/index.html").read_text(encoding="utf-8")
    formulas = (tmp_path / "site/mathematics/index.html").read_text(encoding="utf-8")
    assert formulas.count("<math") > 100
    assert "arithmatex" not in formulas
    assert ">Lift<" in (tmp_path / "site/source/examples/co_design/index.html").read_text(encoding="utf-8")
