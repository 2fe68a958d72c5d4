"""Study files: TOML that names a problem and overrides its numbers, with quantities in units of their own.

What a file may say are pydantic models, whose JSON Schema lets editors complete it.
"""

import inspect
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, TypeVar

import equinox as eqx
import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from aleator import solvers, uncertainty
from aleator._core.border import content_of, meant
from aleator._core.errors import AleatorError, ProblemError
from aleator.design import Problem, declared_anew, deterministic, units_of
from aleator.dynamics import Grid
from aleator.nlp import AbstractSolver
from aleator.reporting import TARGET
from aleator.studies._own import Study
from aleator.studies._quantities import amount, plain
from aleator.uncertainty import Decision, fields_of

Result = TypeVar("Result")


# --- What a file may say ---------------------------------------------------------------------------------------------

# Texts and truth values are no numbers.
Real: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Truth: TypeAlias = Annotated[bool, Field(strict=True)]
Quantity: TypeAlias = Annotated[
    Real | Annotated[str, Field(strict=True)],
    Field(description='A number in the unit of the model, or with its own: "30 kN/m".'),
]
Whole: TypeAlias = Annotated[int, Field(strict=True)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)


class DecisionTable(_Table):
    """A number that is decided: `{ start = "30 kN/m", lower = "20 kN/m", upper = "90 kN/m" }`."""

    start: Quantity
    lower: Quantity | None = None
    upper: Quantity | None = None


def _kind(value: Any) -> str:
    """What a value of the model is meant to be, so that errors speak of that alone."""
    if isinstance(value, dict):
        return "<distribution>" if "distribution" in value else "<decision>"
    return "<quantity>"


_NUMBERS = Annotated[DecisionTable, Tag("<decision>")] | Annotated[Quantity, Tag("<quantity>")]


class DistributionTable(BaseModel):
    """A number that is uncertain: `{ distribution = "Uniform", mean = "2 kg", half_width = "0.1 kg" }`."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[_NUMBERS, Discriminator(_kind)]]  # pyright: ignore
    distribution: Literal[
        "Uniform",
        "Normal",
        "Beta",
        "Gamma",
        "LogNormal",
        "Triangular",
        "TruncatedNormal",
        "Toleranced",
        "Exponential",
        "Gumbel",
        "Weibull",
    ]


class SolverTable(BaseModel):
    """A solver by its name, with its options."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Truth | Whole | Real]  # pyright: ignore
    name: Literal[
        "FilterSQP",
        "Ipopt",
        "Slsqp",
        "InteriorPoint",
        "NelderMead",
        "Direct",
        "DifferentialEvolution",
        "DualAnnealing",
        "CmaEs",
    ]


_VALUE = Annotated[_NUMBERS | Annotated[DistributionTable, Tag("<distribution>")], Discriminator(_kind)]


class StudyFile(_Table):
    """A study: a problem by the name of its module, and what is different from it."""

    problem: Annotated[str, Field(description="The problem, or a function that makes it: `package.module:name`.")]
    title: str = ""
    subtitle: str = ""
    samples: Annotated[Whole, Field(ge=2, le=10_000_000_000)] = 20_000
    seed: Annotated[Whole, Field(ge=0)] = 0
    target: Annotated[Real, Field(gt=0, lt=1, description="The largest share of systems that may break a limit.")] = (
        TARGET
    )
    workers: Annotated[Whole, Field(ge=1, le=10_000)] | None = None
    deterministic: Annotated[Truth, Field(description="Solve the problem at the means too, for comparison.")] = False
    model: Annotated[
        dict[str, _VALUE], Field(description="Numbers, distributions and decisions by the names of the model's fields.")
    ] = {}
    limits: Annotated[
        dict[str, Quantity | tuple[Quantity, Quantity]], Field(description="Bounds by the names of constraints.")
    ] = {}
    sigmas: Annotated[
        dict[str, Annotated[Real, Field(gt=0)]], Field(description="Margins by the names of constraints.")
    ] = {}
    sweeps: Annotated[
        dict[str, Annotated[list[Quantity], Field(min_length=1)]], Field(description="Values of bounds for fronts.")
    ] = {}
    grid: dict[Literal["t_final", "steps"], Whole | Quantity] = {}
    expansion: dict[Literal["order"], Annotated[Whole, Field(ge=0, le=50)]] = {}
    solver: SolverTable | None = None


def schema() -> dict[str, Any]:
    """The JSON Schema of study files, by which editors complete them."""
    return StudyFile.model_json_schema()


# --- The file --------------------------------------------------------------------------------------------------------


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
    """The study of a TOML file, whose problem `loaded` gives by its name; modules beside the file can be imported.

    Raises `ProblemError`: one sentence with the file, the line, the key, what was expected and the nearest valid name.
    """
    try:
        file = _File(path, content_of(path).decode("utf-8"))
    except FileNotFoundError as error:
        raise ProblemError(f"There is no file '{path}'.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ProblemError(f"'{path}' cannot be read as text in UTF-8 ({error}).") from error
    data = _checked(file)
    problem = file.about(["problem"], _one_problem, data.problem, loaded)
    for table, change in _CHANGES.items():
        for key, value in getattr(data, table).items():
            problem = file.about([table, key], change, problem, key, value)
    sweeps = {name: file.about(["sweeps", name], _swept, problem, name, values) for name, values in data.sweeps.items()}
    solver = None if data.solver is None else file.about(["solver"], _solver_of, data.solver)
    options = {name: getattr(data, name) for name in ("subtitle", "samples", "seed", "target", "workers")}
    return file.about(
        [],
        lambda: Study(
            {"nominal": deterministic(problem), "robust": problem} if data.deterministic else problem,
            title=data.title or path.stem.replace("_", " ").capitalize(),
            sweeps=sweeps,
            solver=solver,
            **options,
        ),
    )


def _one_problem(name: str, loaded: Callable[[str], Any]) -> Problem:
    declared = loaded(name)
    if not isinstance(declared, Study) or len(declared.problems) != 1:
        raise ProblemError(f"expected one problem, as `module:name`; received '{name}'.")
    (problem,) = declared.problems.values()
    return problem


def _checked(file: _File) -> StudyFile:
    try:
        return StudyFile.model_validate(tomllib.loads(file.text))
    except tomllib.TOMLDecodeError as error:
        raise ProblemError(f"{file.path}: expected TOML; {error}.") from error
    except RecursionError as error:
        raise ProblemError(f"{file.path}: expected TOML; it is nested too deeply.") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
    # Without the names of alternatives, of which pydantic tells one by one.
    place = [part for part in first["loc"] if not (isinstance(part, str) and _KIND.search(part))]
    if first["type"] == "extra_forbidden":
        known = list(StudyFile.model_fields) if len(place) == 1 else []
        raise file.refusal(place, f"is unknown.{meant(str(place[-1]), known)}")
    if first["type"] == "missing":
        raise file.refusal(place, "is missing: the file needs it.")
    message = first["msg"][0].lower() + first["msg"][1:]
    raise file.refusal(place, f"{message}; received {first['input']!r:.80}.")


_KIND = re.compile(r"[<\[]|^(float|str|constrained-\w+)$")


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


# --- What a file changes ---------------------------------------------------------------------------------------------


def _overridden(problem: Problem, name: str, value: Any) -> Problem:
    """The problem with another number, distribution or decision in the place of a field of its model."""
    system = problem.simulation.system
    units = {place: field.metadata.get("unit", "") for place, field, _ in fields_of(system)}
    if name not in units:
        raise ProblemError(f"the model has no number of this name.{meant(name, list(units))}")

    def where(tree: Any) -> Any:
        for part in name.split("."):
            tree = tree[part] if isinstance(tree, dict) else tree[int(part)] if part.isdigit() else getattr(tree, part)
        return tree

    changed = eqx.tree_at(where, system, _leaf(value, units[name]), is_leaf=lambda node: node is None)
    return declared_anew(problem, replace(problem.simulation, system=changed))


def _leaf(value: Any, unit: str) -> Any:
    """A quantity, a decision or a distribution in the unit of the model."""
    if isinstance(value, DecisionTable):
        lower = -np.inf if value.lower is None else plain(value.lower, unit)
        upper = np.inf if value.upper is None else plain(value.upper, unit)
        return Decision(plain(value.start, unit), lower, upper)
    if isinstance(value, DistributionTable):
        family = getattr(uncertainty, value.distribution)
        options = value.__pydantic_extra__ or {}
        _check_known(value.distribution, "parameter", options, family, "unnamed", "shared_name")
        return family(**{name: _parameter(name, one, unit) for name, one in options.items()})
    return amount(value, unit)


def _parameter(name: str, value: Any, unit: str) -> Any:
    """A parameter of a distribution; some are pure numbers."""
    unit = "" if (is_pure := name in ("alpha", "beta", "shape", "cp", "cpk", "sigmas")) else unit
    if is_pure and isinstance(value, str):
        raise ProblemError(f"{name}: expected a number; received the text '{value}'. Leave out the quotation marks.")
    return _leaf(value, unit) if isinstance(value, DecisionTable) else plain(value, unit)


def _check_known(owner: str, what: str, options: Mapping[str, Any], family: Any, *without: str) -> None:
    known = [name for name in inspect.signature(family).parameters if name not in without]
    for name in options:
        if name not in known:
            raise ProblemError(f"{owner} has no {what} '{name}'.{meant(name, known)} Expected some of {known}.")


def _limited(problem: Problem, name: str, bound: Any) -> Problem:
    both = _swept(problem, name, bound if isinstance(bound, tuple) else [bound])
    return problem.with_bound(name, (both[0], both[1]) if isinstance(bound, tuple) else both[0])


def _swept(problem: Problem, name: str, values: Sequence[Any]) -> list[float]:
    """Values of a bound, in its unit."""
    expression = problem.named(name)[0].expression
    return [plain(one, expression.unit(units_of(expression, problem))) for one in values]


def _on_grid(problem: Problem, name: str, value: Any) -> Problem:
    grid = problem.grid
    if not isinstance(grid, Grid):
        raise ProblemError("expected a model with one grid; received one without time, or in phases.")
    given = {"t_final": grid.t_final, "steps": grid.steps}
    given[name] = plain(value, "s") if name == "t_final" else value
    return declared_anew(problem, replace(problem.simulation, grid=Grid(**given)))


def _expanded(problem: Problem, _: str, order: int) -> Problem:
    return eqx.tree_at(lambda tree: tree.expansion, problem, replace(problem.expansion, order=order))


def _solver_of(table: SolverTable) -> AbstractSolver:
    family, options = getattr(solvers, table.name), dict(table.__pydantic_extra__ or {})
    _check_known(table.name, "option", options, family)
    return family(**options)


# How each table of a file changes the problem, in this order.
_CHANGES: Mapping[str, Callable[[Problem, str, Any], Problem]] = {
    "model": _overridden,
    "grid": _on_grid,
    "expansion": _expanded,
    "limits": _limited,
    "sigmas": Problem.with_sigmas,
}
