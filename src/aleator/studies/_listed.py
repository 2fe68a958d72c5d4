"""The case studies by name, and how a study is loaded or begun: by its name, Python file, TOML file or module."""

import importlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from aleator._core.border import meant, one_of
from aleator._core.errors import AleatorError, ProblemError
from aleator.design import Problem
from aleator.studies._own import Study
from aleator.studies._study import AbstractStudy, CaseStudy
from aleator.studies._toml import load_toml
from aleator_command._studies import STUDIES as STUDIES

# A module with a package or an object, or both.
_MODULE = re.compile(r"\w+(\.\w+)+(:\w+)?|\w+:\w+")


def load(name: str, *, quick: bool = False) -> AbstractStudy:
    """A study ready to run, by its name, its Python file or its module; `quick` makes it small enough for a first look.

    Raises `ProblemError` for an unknown name, and for a file that declares no study, or no quick one if that is asked.
    """
    if name in STUDIES:
        return CaseStudy(importlib.import_module(f"aleator.studies.{name.replace('-', '_')}._chapter"), quick=quick)
    if name.endswith(".py"):
        study = load_file(Path(name))
    elif name.endswith(".toml"):
        importable(Path(name).parent)
        study = load_toml(Path(name), load_module)
    elif _MODULE.fullmatch(name):
        study = load_module(name)
    else:
        own = name if name.isidentifier() else "bracket"
        raise ProblemError(
            f"There is no study '{name}'; expected one of {sorted(STUDIES)} (see `aleator list`), or a file of "
            f"your own, such as {own}.py (`aleator new {own}.py` begins one)."
        )
    if not quick:
        return study
    return one_of(f"{name}: a study with a quick form", study, Study, "al.Study(problem)").quickened()


def load_file(path: Path) -> AbstractStudy:
    """The study that a Python file declares; it is executed as a module of its name, which other processes find.

    Raises `ProblemError`, naming the file and the line, if it cannot be read, raises, or declares no study.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise ProblemError(f"There is no file '{path}'. `aleator new {path}` begins a study there.")
    importable(path.parent)  # modules beside it, as for `python FILE.py`
    before, module = sys.modules.get(path.stem), importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        del sys.modules[path.stem]
        if before is not None:
            sys.modules[path.stem] = before
        raise _refused(str(path), error) from error
    return _study_of(str(path), vars(module))


def load_module(place: str) -> AbstractStudy:
    """The study that an importable module declares: `package.module`, or `package.module:name` for one object in it.

    The object may be a study, a problem, or a function without arguments that makes one. Modules of the present folder
    count. Raises `ProblemError`, naming the place, if there is none.
    """
    name, _, attribute = place.partition(":")
    importable(Path.cwd())
    try:
        module = importlib.import_module(name)
        declared = getattr(module, attribute, None) if attribute else None
        if callable(declared) and not isinstance(declared, AbstractStudy | Problem):
            declared = declared()
    except Exception as error:
        raise _refused(place, error) from error
    if attribute and declared is None:
        raise ProblemError(f"{place}: the module has no '{attribute}'.{meant(attribute, dir(module))}")
    if isinstance(declared, Problem):
        return Study(declared, title=attribute.replace("_", " ").capitalize())
    return _study_of(place, {"study": declared} if attribute else vars(module))


def importable(*folders: Path) -> None:
    """Let modules in these folders be imported from now on."""
    places = [f"{folder.resolve()}" for folder in folders]
    if sys.path[: len(places)] != places:
        sys.path[:0] = places


def _study_of(owner: str, declared: Mapping[str, Any]) -> AbstractStudy:
    """The study that a file declares by its names: `study`, or a `Study` of its problems. Raises `ProblemError`."""
    if declared.get("study") is not None:
        return one_of(f"{owner}: study", declared["study"], AbstractStudy, "al.Study(problem)")
    problems = {name: one for name, one in declared.items() if isinstance(one, Problem) and not name.startswith("_")}
    if not problems:
        raise ProblemError(
            f"{owner}: expected a study, such as `study = al.Study(problem)`, or problems, such as "
            "`problem = al.Problem(...)`; received neither."
        )
    return Study(problems, title=owner)


def _refused(owner: str, error: BaseException) -> ProblemError:
    """The error of a user's own code in a sentence, with the last line of its file that it passed through."""
    kind = "" if isinstance(error, AleatorError) else f"{type(error).__name__}: "
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if Path(frame.filename).resolve() == Path(owner).resolve()]
    if isinstance(error, SyntaxError):  # in no frame yet
        owner, lines, kind = error.filename or owner, [error.lineno], ""
    return ProblemError(f"{owner}{f', line {lines[-1]}' if lines else ''}: {kind}{getattr(error, 'msg', error)}")
