"""The case studies by name, and how a study is loaded or begun: by its name, Python file, TOML file or module.

A study file in TOML names a problem and overrides its numbers, with quantities in units of their own. It is read key by
key: each makes a part of the study, and whatever refuses it is told with its line.
"""

import importlib
import importlib.util
import inspect
import re
import sys
import tomllib
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx

from aleator import solvers, uncertainty
from aleator._core.border import content_of, meant, one_of
from aleator._core.errors import AleatorError, ProblemError
from aleator.design import Problem, declared_anew, deterministic, units_of
from aleator.reporting import TARGET
from aleator.studies._own import Study
from aleator.studies._quantities import amount, plain
from aleator.studies._study import AbstractStudy, CaseStudy
from aleator.uncertainty import Decision, fields_of
from aleator_command._studies import STUDIES as STUDIES

Result = TypeVar("Result")

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
        study = load_toml(Path(name))
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
    count, as `module.py:name` too. Raises `ProblemError`, naming the place, if there is none.
    """
    name, _, attribute = place.replace(".py:", ":").partition(":")
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


# --- In TOML ----------------------------------------------------------------------------------------------------------

_FAMILIES = (
    *("Uniform", "Normal", "Beta", "Gamma", "LogNormal", "Triangular", "TruncatedNormal", "Toleranced"),
    *("Exponential", "Gumbel", "Weibull"),
)
# Their parameters that are pure numbers.
_PURE = ("alpha", "beta", "shape", "cp", "cpk", "sigmas")
_SOLVERS = (
    *("FilterSQP", "Ipopt", "Slsqp", "InteriorPoint", "NelderMead", "Direct", "DifferentialEvolution"),
    *("DualAnnealing", "CmaEs"),
)
_DECISION = ("start", "lower", "upper")


def schema() -> dict[str, Any]:
    """The JSON Schema of study files, by which editors complete them."""

    def table(names: Mapping[str, Any], needed: Sequence[str] = (), *, others: Any = False) -> dict[str, Any]:
        return {"type": "object", "properties": names, "required": [*needed], "additionalProperties": others}

    about = 'A number in the unit of the model, or with its own: "30 kN/m".'
    number, whole, truth, text = ({"type": name} for name in ("number", "integer", "boolean", "string"))
    quantity = {"type": ["number", "string"], "description": about}
    decision = table(dict.fromkeys(_DECISION, quantity), _DECISION[:1])
    single = {"anyOf": [quantity, decision]}
    uncertain = table({"distribution": {"enum": [*_FAMILIES]}}, ["distribution"], others=single)
    pair = {"type": "array", "items": quantity, "minItems": 2, "maxItems": 2}
    keys = {
        "problem": {**text, "description": "The problem, or a function that makes it: `package.module:name`."},
        **{"title": text, "subtitle": text},
        "samples": {**whole, "minimum": 2},
        "seed": {**whole, "minimum": 0},
        "target": {**number, "default": TARGET, "description": "The largest share of systems that may break a limit."},
        "workers": {**whole, "minimum": 1},
        "deterministic": {**truth, "description": "Solve the problem at the means too, for comparison."},
        "model": table({}, others={"anyOf": [quantity, decision, uncertain]}),
        "expansion": table({"order": whole}),
        "limits": table({}, others={"anyOf": [quantity, pair]}),
        "sigmas": table({}, others=number),
        "sweeps": table({}, others={"type": "array", "items": quantity, "minItems": 1}),
        "solver": table({"name": {"enum": [*_SOLVERS]}}, ["name"], others={"type": ["number", "boolean"]}),
    }
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "StudyFile", **table(keys, ["problem"])}


class _File(NamedTuple):
    """A study file and its text, for errors with their lines."""

    path: Path
    text: str

    def made(self, place: Sequence[str], make: Callable[..., Result], *given: Any, **named: Any) -> Result:
        """What is made of a place of the file. Raises `ProblemError` that names it, whatever refuses."""
        try:
            return make(*given, **named)
        except Exception as error:
            said = f"{error}" if isinstance(error, AleatorError) else f"{type(error).__name__}: {error}"
            name = f"{'.'.join(place)}: " if place else ""
            raise ProblemError(f"{self.path}, line {self._line_of(place)}: {name}{said}") from error

    def _line_of(self, place: Sequence[str]) -> int:
        """The line on which a place begins, or the nearest table around it."""
        lines, at = self.text.splitlines(), 0
        for part in place:
            begins = re.compile(rf"\s*\[?\s*[\"']?{re.escape(part)}[\"']?\s*[\].=]")
            at = next((i for i in range(at, len(lines)) if begins.match(lines[i])), at)
        return at + 1


def load_toml(path: Path) -> Study:
    """The study of a TOML file; modules beside it can be imported.

    Raises `ProblemError`: one sentence with the file, the line, the key, what was expected and the nearest valid name.
    """
    try:
        file = _File(path, content_of(path).decode("utf-8"))
        data = tomllib.loads(file.text)
    except FileNotFoundError as error:
        raise ProblemError(f"There is no file '{path}'.") from error
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise ProblemError(f"{path}: expected TOML; {error}.") from error
    keys = schema()["properties"]
    for key, value in data.items():
        file.made([key], _known, key, keys)
        if keys[key].get("type") == "object":
            file.made([key], one_of, "a table", value, dict)
    problem = file.made(["problem"], _one_problem, data.get("problem", ""))
    for table, change in _CHANGES.items():
        for key, value in data.get(table, {}).items():
            problem = file.made([table, key], change, problem, key, value)
    options: dict[str, Any] = {"title": path.stem.replace("_", " ").capitalize()}
    options |= {name: data[name] for name in _OPTIONS if name in data}
    options["sweeps"] = {
        key: file.made(["sweeps", key], _swept, problem, key, values) for key, values in data.get("sweeps", {}).items()
    }
    if "solver" in data:
        options["solver"] = file.made(["solver"], _named, solvers, "name", _SOLVERS, data["solver"], lambda _, one: one)
    for name, value in options.items():
        file.made([name], Study, problem, **{name: value})
    is_beside = file.made(["deterministic"], one_of, "deterministic", data.get("deterministic", False), bool)
    return Study({"nominal": deterministic(problem), "robust": problem} if is_beside else problem, **options)


# What goes to `Study` as it is.
_OPTIONS = ("title", "subtitle", "samples", "seed", "target", "workers")


def _one_problem(name: str) -> Problem:
    declared = load_module(name) if name else None
    if not isinstance(declared, Study) or len(declared.problems) != 1:
        raise ProblemError(f"expected one problem, as `module:name`; received '{name}'.")
    (problem,) = declared.problems.values()
    return problem


def _known(name: str, names: Collection[str], said: str = "is unknown.") -> str:
    if name not in names:
        raise ProblemError(f"{said}{meant(name, names)} Expected one of {', '.join(names)}; received '{name}'.")
    return name


def _named(library: Any, key: str, names: Sequence[str], table: Any, read: Callable[[str, Any], Any]) -> Any:
    """A distribution or a solver by its name, with its parameters."""
    family = getattr(library, _known(table.get(key, ""), names))
    known = [one for one in inspect.signature(family).parameters if one not in ("unnamed", "shared_name")]
    parameters = {name: value for name, value in table.items() if name != key}
    return family(**{_known(name, known, f"{name} is unknown."): read(name, one) for name, one in parameters.items()})


# --- What a file changes ---------------------------------------------------------------------------------------------


def _overridden(problem: Problem, name: str, value: Any) -> Problem:
    """The problem with another number, distribution or decision in the place of a field of its model."""
    system = problem.simulation.system
    units = {place: field.metadata.get("unit", "") for place, field, _ in fields_of(system)}
    _known(name, units, "the model has no number of this name.")

    def where(tree: Any) -> Any:
        for part in name.split("."):
            tree = tree[part] if isinstance(tree, dict) else tree[int(part)] if part.isdigit() else getattr(tree, part)
        return tree

    changed = eqx.tree_at(where, system, _leaf(value, units[name]), is_leaf=lambda node: node is None)
    return declared_anew(problem, replace(problem.simulation, system=changed))


def _leaf(value: Any, unit: str) -> Any:
    """A quantity, a decision or a distribution in the unit of the model."""

    def parameter(name: str, one: Any) -> Any:
        if isinstance(one, dict):
            return _leaf(one, unit)
        return plain(one, "" if name in _PURE else unit)

    if not isinstance(value, dict):
        return amount(value, unit)
    if "distribution" in value:
        return _named(uncertainty, "distribution", _FAMILIES, value, parameter)
    numbers: dict[str, Any] = {
        _known(name, _DECISION, f"{name} is unknown."): plain(one, unit) for name, one in value.items()
    }
    return Decision(numbers.pop("start", None), **numbers)


def _limited(problem: Problem, name: str, bound: Any) -> Problem:
    values = _swept(problem, name, bound if isinstance(bound, list) else [bound])
    return problem.with_bound(name, tuple(values) if isinstance(bound, list) else values[0])  # pyright: ignore


def _swept(problem: Problem, name: str, values: Sequence[Any]) -> list[float]:
    """Values of a bound, in its unit."""
    expression = problem.named(name)[0].expression
    unit = expression.unit(units_of(expression, problem))
    return [plain(one, unit) for one in one_of("values", values, list)]


def _expanded(problem: Problem, name: str, value: Any) -> Problem:
    changed = replace(problem.expansion, **{_known(name, ["order"]): value})
    return eqx.tree_at(lambda tree: tree.expansion, problem, changed)


# How each table of a file changes the problem, in this order.
_CHANGES: Mapping[str, Callable[[Problem, str, Any], Problem]] = {
    "model": _overridden,
    "expansion": _expanded,
    "limits": _limited,
    "sigmas": Problem.with_sigmas,
}
