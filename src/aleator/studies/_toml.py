"""Study files: TOML that names a problem and overrides its numbers, with quantities in units of their own."""

import inspect
import re
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import numpy as np

from aleator import solvers, uncertainty
from aleator._core.border import content_of, meant
from aleator._core.errors import AleatorError, ProblemError
from aleator.design import Problem, declared_anew, deterministic, units_of
from aleator.dynamics import Grid
from aleator.nlp import AbstractSolver
from aleator.studies._own import Study
from aleator.studies._quantities import amount, plain
from aleator.uncertainty import Decision, fields_of

Result = TypeVar("Result")
_KIND = re.compile(r"[<\[]|^(float|str|constrained-\w+)$")
# What pydantic says, in our words.
_SAID = {
    "missing": "is missing",
    "extra_forbidden": "is unknown",
    "literal_error": "is none of the names that may stand there",
}
# Parameters of distributions that are pure numbers.
_PURE = ("alpha", "beta", "shape", "cp", "cpk", "sigmas")


class _File(NamedTuple):
    """A study file and its text, for errors with their lines."""

    path: Path
    text: str

    def refusal(self, place: Sequence[str | int], said: str) -> ProblemError:
        """The error about a place of the file."""
        name = ".".join(str(one) for one in place)
        return ProblemError(f"{self.path}, line {_line_of(self.text, place)}: {name + ': ' if name else ''}{said}")

    def about(self, place: Sequence[str | int], make: Callable[..., Result], *given: Any) -> Result:
        """What is made of a place of the file; refusals name it."""
        try:
            return make(*given)
        except AleatorError as error:
            raise self.refusal(place, str(error)) from error
        except (TypeError, ValueError, OverflowError) as error:
            raise self.refusal(place, f"{type(error).__name__}: {error}") from error


def load_toml(path: Path, loaded: Callable[[str], Any]) -> Study:
    """The study of a TOML file, whose problem `loaded` gives by its name; modules beside the file count.

    Raises `ProblemError`: one sentence with the file, the line, the key, what was expected and the nearest valid name.
    """
    file = _read(path)
    data = _checked(file)
    folder = str(path.parent.resolve())
    if folder not in sys.path:
        sys.path.insert(0, folder)
    problem = _changed(file, data, file.about(["problem"], _one_problem, data.problem, loaded))
    sweeps = {name: file.about(["sweeps", name], _swept, problem, name, values) for name, values in data.sweeps.items()}
    solver = None if data.solver is None else file.about(["solver"], _solver_of, data.solver)
    return file.about(
        [],
        lambda: Study(
            {"nominal": deterministic(problem), "robust": problem} if data.deterministic else problem,
            title=data.title or path.stem.replace("_", " ").capitalize(),
            subtitle=data.subtitle,
            samples=data.samples,
            seed=data.seed,
            target=data.target,
            sweeps=sweeps,
            solver=solver,
            workers=data.workers,
        ),
    )


def _one_problem(name: str, loaded: Callable[[str], Any]) -> Problem:
    declared = loaded(name)
    if not isinstance(declared, Study) or len(declared.problems) != 1:
        raise ProblemError(f"expected one problem, as `module:name`; received '{name}'.")
    (problem,) = declared.problems.values()
    return problem


def _changed(file: _File, data: Any, problem: Problem) -> Problem:
    """The problem with all that the file says otherwise."""
    for name, value in data.model.items():
        problem = file.about(["model", name], _overridden, problem, name, value)
    if data.grid is not None:
        problem = file.about(["grid"], _on_grid, problem, data.grid.t_final, data.grid.steps)
    if data.expansion is not None:
        problem = file.about(["expansion", "order"], _expanded, problem, data.expansion.order)
    for name, bound in data.limits.items():
        problem = file.about(["limits", name], _limited, problem, name, bound)
    for name, sigmas in data.sigmas.items():
        problem = file.about(["sigmas", name], problem.with_sigmas, name, sigmas)
    return problem


def _read(path: Path) -> _File:
    try:
        return _File(path, content_of(path).decode("utf-8"))
    except FileNotFoundError as error:
        raise ProblemError(f"There is no file '{path}'.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ProblemError(f"'{path}' cannot be read as text in UTF-8 ({error}).") from error


def _checked(file: _File) -> Any:
    from pydantic import ValidationError

    from aleator.studies._toml_schema import StudyFile

    try:
        data = tomllib.loads(file.text)
    except tomllib.TOMLDecodeError as error:
        raise ProblemError(f"{file.path}: expected TOML; {error}.") from error
    except RecursionError as error:
        raise ProblemError(f"{file.path}: expected TOML; it is nested too deeply.") from error
    try:
        return StudyFile.model_validate(data)
    except ValidationError as error:
        raise _first(file, error.errors(include_url=False), StudyFile.model_fields) from None


def _first(file: _File, errors: Sequence[Any], known: Mapping[str, Any]) -> ProblemError:
    """The error about the first thing that is wrong."""
    one = errors[0]
    # Without the names of alternatives, of which pydantic tells one by one.
    place = [part for part in one["loc"] if not (isinstance(part, str) and _KIND.search(part))]
    said = _SAID.get(one["type"], "")
    name = str(place[-1]) if place else ""
    if one["type"] == "extra_forbidden":
        beside = known if len(place) == 1 else {}
        return file.refusal(place, f"{said}.{meant(name, list(beside))}")
    if one["type"] == "missing":
        return file.refusal(place, f"{said}: the file needs it.")
    message = one["msg"][0].lower() + one["msg"][1:]
    return file.refusal(place, f"{message}; received {one['input']!r:.80}.")


def _line_of(text: str, place: Sequence[str | int]) -> int:
    """The line on which a place begins, or the nearest table around it; 1 if it is nowhere."""
    lines = text.splitlines()
    best, deepest, read = 1, 0, 0
    for number in range(1, len(lines) + 1):
        try:
            data: Any = tomllib.loads("\n".join(lines[:number]))
        except tomllib.TOMLDecodeError:  # within a value of several lines
            continue
        depth = 0
        for part in place:
            if not isinstance(data, dict) or str(part) not in data:
                break
            data, depth = data[str(part)], depth + 1
        if depth > deepest:
            best, deepest = read + 1, depth
        read = number
    return best


def _overridden(problem: Problem, name: str, value: Any) -> Problem:
    """The problem with another number, distribution or decision in the place of a field of its model."""
    system = problem.simulation.system
    fields = {place: (field, now) for place, field, now in fields_of(system)}
    if name not in fields:
        raise ProblemError(f"the model has no number of this name.{meant(name, list(fields))}")
    field, _ = fields[name]
    new = _leaf(value, field.metadata.get("unit", ""))
    path = name.split(".")

    def where(tree: Any) -> Any:
        for part in path:
            tree = tree[part] if isinstance(tree, dict) else tree[int(part)] if part.isdigit() else getattr(tree, part)
        return tree

    changed = eqx.tree_at(where, system, new, is_leaf=lambda node: node is None)
    return declared_anew(problem, replace(problem.simulation, system=changed))


def _leaf(value: Any, unit: str) -> Any:
    if hasattr(value, "distribution"):
        return _distribution(value, unit)
    if hasattr(value, "start"):
        return _decision(value, unit)
    return amount(value, unit)


def _decision(table: Any, unit: str) -> Decision:
    lower = -np.inf if table.lower is None else plain(table.lower, unit)
    upper = np.inf if table.upper is None else plain(table.upper, unit)
    return Decision(plain(table.start, unit), lower, upper)


def _distribution(table: Any, unit: str) -> Any:
    family = getattr(uncertainty, table.distribution)
    given = {
        name: _decision(one, unit) if hasattr(one, "start") else _parameter(name, one, unit)
        for name, one in (table.__pydantic_extra__ or {}).items()
    }
    known = [name for name in inspect.signature(family).parameters if name not in ("unnamed", "shared_name")]
    for name in given:
        if name not in known:
            raise ProblemError(f"{table.distribution} has no parameter '{name}'; expected some of {known}.")
    return family(**given)


def _parameter(name: str, value: Any, unit: str) -> float:
    """A parameter of a distribution."""
    if name in _PURE and isinstance(value, str):
        raise ProblemError(f"{name}: expected a number; received the text '{value}'. Leave out the quotation marks.")
    return plain(value, "" if name in _PURE else unit)


def _limited(problem: Problem, name: str, bound: Any) -> Problem:
    """The problem with another bound."""
    unit = _unit(problem, name)
    if isinstance(bound, tuple):
        lower, upper = (plain(one, unit) for one in bound)
        return problem.with_bound(name, (lower, upper))
    return problem.with_bound(name, plain(bound, unit))


def _swept(problem: Problem, name: str, values: Sequence[Any]) -> list[float]:
    """Values of a bound."""
    return [plain(one, _unit(problem, name)) for one in values]


def _unit(problem: Problem, name: str) -> str:
    expression = problem.named(name)[0].expression
    return expression.unit(units_of(expression, problem))


def _on_grid(problem: Problem, t_final: Any, steps: int | None) -> Problem:
    """The problem on another grid."""
    grid = problem.grid
    if not isinstance(grid, Grid):
        raise ProblemError("expected a model with one grid; received one without time, or in phases.")
    changed = Grid(grid.t_final if t_final is None else plain(t_final, "s"), grid.steps if steps is None else steps)
    return declared_anew(problem, replace(problem.simulation, grid=changed))


def _expanded(problem: Problem, order: int) -> Problem:
    """The problem with another order of its expansion."""
    return eqx.tree_at(lambda tree: tree.expansion, problem, replace(problem.expansion, order=order))


def _solver_of(table: Any) -> AbstractSolver:
    """A solver by its name, with its options."""
    family, options = getattr(solvers, table.name), dict(table.__pydantic_extra__ or {})
    known = list(inspect.signature(family).parameters)
    for name in options:
        if name not in known:
            raise ProblemError(f"{table.name} has no option '{name}'.{meant(name, known)} Expected some of {known}.")
    return family(**options)


def schema() -> dict[str, Any]:
    """The JSON Schema of study files, by which editors complete them."""
    from aleator.studies._toml_schema import StudyFile  # pydantic is imported late

    return StudyFile.model_json_schema()
