"""Studies from TOML files: read, checked, and made of a problem with other numbers."""

import re
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from aleator._core.errors import AleatorError, ProblemError
from aleator._core.given import meant
from aleator.design import Problem, deterministic
from aleator.studies._own import Study
from aleator.studies._toml._lines import line_of
from aleator.studies._toml._overridden import expanded, limited, on_grid, overridden, solver_of, swept

Result = TypeVar("Result")

_KIND = re.compile(r"[<\[]|^(float|str|constrained-\w+)$")

# What pydantic says, in our words.
_SAID = {
    "missing": "is missing",
    "extra_forbidden": "is unknown",
    "literal_error": "is none of the names that may stand there",
}


class _File(NamedTuple):
    """A study file and its text, for errors with their lines."""

    path: Path
    text: str

    def refusal(self, place: Sequence[str | int], said: str) -> ProblemError:
        """The error about a place of the file."""
        name = ".".join(str(one) for one in place)
        return ProblemError(f"{self.path}, line {line_of(self.text, place)}: {name + ': ' if name else ''}{said}")

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
    sweeps = {name: file.about(["sweeps", name], swept, problem, name, values) for name, values in data.sweeps.items()}
    solver = None if data.solver is None else file.about(["solver"], solver_of, data.solver)
    return file.about(
        [],
        lambda: Study(
            {"nominal": deterministic(problem), "robust": problem} if data.deterministic else problem,
            title=data.title or path.stem.replace("_", " ").capitalize(),
            subtitle=data.subtitle,
            samples=data.samples,
            seed=data.seed,
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
        problem = file.about(["model", name], overridden, problem, name, value)
    if data.grid is not None:
        problem = file.about(["grid"], on_grid, problem, data.grid.t_final, data.grid.steps)
    if data.expansion is not None:
        problem = file.about(["expansion", "order"], expanded, problem, data.expansion.order)
    for name, bound in data.limits.items():
        problem = file.about(["limits", name], limited, problem, name, bound)
    for name, sigmas in data.sigmas.items():
        problem = file.about(["sigmas", name], problem.with_sigmas, name, sigmas)
    return problem


def _read(path: Path) -> _File:
    try:
        return _File(path, path.read_bytes().decode("utf-8"))
    except FileNotFoundError as error:
        raise ProblemError(f"There is no file '{path}'.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ProblemError(f"'{path}' cannot be read as text in UTF-8 ({error}).") from error


def _checked(file: _File) -> Any:
    from pydantic import ValidationError

    from aleator.studies._toml._schema import StudyFile

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
