"""Results in files: labelled arrays as netCDF for programs, designs as JSON for people; what can be saved, by name."""

import functools
import uuid
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from typing_extensions import TypeIs

from aleator._core.border import one_of, refusal
from aleator._core.errors import ProblemError
from aleator.design import Problem, functionals_of, path_of, statistics_in
from aleator.dynamics import LinkedGrid, phase_of
from aleator.reporting._documents import RESIDUALS, environment, evidence_on, solution_document
from aleator.reporting._files import write_together
from aleator.reporting._numbers import unit_of, unit_of_decision, unit_of_limit
from aleator.solution import Solution
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import PERCENTILES, Evidence, Share

if TYPE_CHECKING:
    import xarray

Arrays = dict[str, Any]
Result: TypeAlias = "Solution | Evidence | Front | TradeOff | Calibration | xarray.Dataset"

# This halves time histories; stronger compression takes longer and saves little more.
_PACKED = {"zlib": True, "complevel": 1, "shuffle": True}

KINDS = (Solution, Evidence, Front, TradeOff, Calibration)
"""The kinds of results that have labelled arrays."""

PAGE = "report.html"
"""The page of a study, beside its results."""

_RESULTS, _DESIGNS = "results.nc", "designs.json"


def is_group(result: Any) -> TypeIs[Mapping[str, Any]]:
    """Whether it is results by name; a dataset is a mapping of its variables, but one result."""
    return isinstance(result, Mapping) and not hasattr(result, "data_vars")


def leaves(results: Mapping[str, Any], *outer: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Each result with the names under which it stands, the outermost first."""
    for name, result in results.items():
        if is_group(result):
            yield from leaves(result, *outer, str(name))
        else:
            yield (*outer, str(name)), result


def by_place(results: Mapping[str, Any]) -> dict[str, Any]:
    """Each result by its place, such as `designs/robust`."""
    return {"/".join(names): result for names, result in leaves(results)}


@functools.singledispatch
def dataset(result: Any) -> Any:
    """Any result of `KINDS` as a dataset; a dataset, or an array that a study has labelled itself, as it is."""
    return result


def _array(axes: Any, values: Any, unit: str = "", **more: str) -> Any:
    """A variable of a dataset: its axes, its values, their unit, and more of its attributes."""
    array = np.asarray(values)
    return axes, array, {"units": unit or "1", **more}, _PACKED if array.size > 1000 else {}


def _dataset(
    arrays: Arrays, attributes: Mapping[str, Any], solution: Solution | None = None, **coordinates: Any
) -> Any:
    """A dataset of arrays by name; `solution`: whose instants times are."""
    import xarray

    data = xarray.Dataset({_key(name): array for name, array in arrays.items()}, coordinates, attributes)
    for phase in () if solution is None else solution.problem.simulation.phases:
        if (time := _time(phase)) in data.dims:
            instants = solution.instants[solution.problem.grid.where(f"{phase}.")]  # type: ignore[union-attr]
            data = data.assign_coords({time: (time, instants, {"long_name": time, "units": "s"})})
    return data


def _key(text: str) -> str:
    """A name valid in netCDF, where a slash would open a group."""
    return text.replace("/", "∕")


def _entries(name: str, value: Any) -> tuple[str, ...]:
    """The axes of a decision."""
    return tuple(f"{_key(name)} axis {i}" for i in range(np.ndim(value)))


def _components(shape: Sequence[int]) -> tuple[str, ...]:
    """The axes of a vector or a matrix, named after their length, so that equal ones are shared."""
    return tuple(f"component of {size}, {i}" for i, size in enumerate(shape))


def _time(phase: str) -> str:
    """The axis of the instants of a phase, or of a motion without phases."""
    return f"time of {phase}" if phase else "time"


def _axes(problem: Problem, one: Any, values: Any) -> tuple[str, ...]:
    """The axes of numbers of a functional, a statistic or a limit: first that of time, where it is on a path."""
    path, shape = path_of(one), np.shape(values)
    if not path:
        return _components(shape)
    return (_time(phase_of(path) if isinstance(problem.grid, LinkedGrid) else ""), *_components(shape[1:]))


# --- One design ------------------------------------------------------------------------------------------------------


@dataset.register(Solution)
def _(solution: Solution) -> "xarray.Dataset":
    """Decisions, constraints with their bounds, multipliers and activity, and the moments of a solution."""
    problem, known = solution.problem, solution_document(solution)
    objective, effort = known["objective"], solution.effort
    arrays: Arrays = {"objective": _array((), objective["value"], objective["unit"], long_name=objective["expression"])}
    for name, one in known["decisions"].items():
        axes = _entries(name, one["value"])
        arrays[f"decision {name}"] = _array(axes, one["value"], one["unit"])
        arrays[f"multiplier {name}"] = _array(axes, solution.bound_multipliers.get(name, np.nan))
    every = zip(solution.constraints, problem.constraints, known["constraints"], strict=True)
    for i, (limit, declared, one) in enumerate(every):
        axes, label = _axes(problem, declared, limit.values), f"constraint {i} {limit.name}"
        if limit.times is not None and len(limit.times) > len(solution.instants):  # Limits on a mesh have more instants
            axes = ("point of limits", *axes[1:])
            arrays["times of limits"] = _array(axes[0], limit.times, "s")
        arrays[label] = _array(axes, limit.values, one["unit"], long_name=limit.text, **_ends(limit))
        arrays[f"{label} multiplier"] = _array(axes, limit.multipliers)
        arrays[f"{label} active"] = _array(axes, np.asarray(limit.active, dtype=np.int8))
    functionals = {one.text(): one for one in functionals_of(problem.expressions)}
    for text, moments in solution.moments.items():
        axes, unit = _axes(problem, functionals[text], moments.mean), unit_of(functionals[text], problem)
        arrays[f"mean {text}"] = _array(axes, moments.mean, unit)
        arrays[f"std {text}"] = _array(axes, moments.std, unit)
    for one in statistics_in(problem.expressions):
        if not one.is_moment:
            values = solution.statistics[one.text()]
            axes = _axes(problem, one.functionals[0], values)
            arrays[f"statistic {one.text()}"] = _array(axes, values, unit_of(one, problem))
    for i, mesh in enumerate(solution.meshes, 1):
        arrays[f"mesh {i}"] = _array(f"node of mesh {i}", mesh.nodes, "s", long_name=str(mesh.scheme))
        axes = f"realisation of mesh {i}", f"interval of mesh {i}"
        arrays[f"mesh {i} drift"] = _array(axes, mesh.drifts, asked=f"{mesh.asked:g}")
    if effort.searched is not None:
        arrays["searched objective"] = _array("evaluation", effort.searched.objectives, objective["unit"])
        arrays["searched violation"] = _array("evaluation", effort.searched.violations)
    residuals = {name: known["certificate"][name] for name in RESIDUALS}
    attributes = {"status": known["status"], "solver": effort.solver, **residuals, "problem": solution.problem_text}
    return _dataset(arrays | _histories(solution), attributes, solution)


def _histories(solution: Solution) -> Arrays:
    """States, costates and switching functions of a simultaneous program, each along its own instants."""
    kinds = {"state": solution.mesh_states, "costate": solution.costates, "switching function": solution.switching}
    arrays: Arrays = {}
    for kind, histories in kinds.items():
        if histories is None:
            continue
        for name, values in histories.values.items():
            of = f" of {phase_of(name)}" if histories.phases else ""
            along = f"point of {kind}s{of}"
            arrays[f"times of {kind}s{of}"] = _array(along, histories.times_of(name), "s")
            axes = (along,) if histories is solution.switching else ("realisation", along)
            arrays[f"{kind} {name}"] = _array((*axes, *_components(values.shape[len(axes) :])), values)
    if solution.mesh_states is not None:
        arrays["germ"] = _array(("realisation", "germ variable"), solution.mesh_states.germs)
    return arrays


@dataset.register(Evidence)
def _(evidence: Evidence) -> "xarray.Dataset":
    """Violations with their intervals, sampled statistics, percentiles and the kept trajectories."""
    problem, shares = evidence.solution.problem, dict(evidence.violations)
    shares |= {"any": evidence.joint} if shares else {}
    arrays = _shares("limit", list(shares.values()))
    functionals = {one.text(): one for one in functionals_of(problem.expressions)}
    for text, sampled in evidence.functionals.items():
        axes, unit = _axes(problem, functionals[text], sampled.mean), unit_of(functionals[text], problem)
        parts = {"sampled mean": sampled.mean, "sampled std": sampled.std, "standard error": sampled.standard_error}
        arrays |= {f"{part} {text}": _array(axes, values, unit) for part, values in parts.items()}
        if sampled.percentiles is not None:
            arrays[f"percentiles {text}"] = _array("percent", sampled.percentiles, unit)
    for text, sampled in evidence.statistics.items():
        unit = unit_of(sampled.statistic, problem)
        arrays[f"sampled {text}"] = _array((), sampled.estimate, unit)
        arrays[f"standard error {text}"] = _array((), sampled.standard_error, unit)
    limits = {one.name: one for one in problem.constraints if one.is_path}
    for i, kept in enumerate(evidence.trajectories):
        axes, unit = _axes(problem, limits[kept.name], kept.values[0]), unit_of_limit(kept.name, problem)
        arrays[f"trajectory {i} {kept.name}"] = _array(("system", *axes), kept.values, unit, **_ends(kept))
        arrays[f"trajectory {i} violating"] = _array("system", np.asarray(kept.violating, dtype=np.int8))
    attributes = {"samples": evidence.samples, "seed": evidence.seed, "seconds": evidence.seconds}
    attributes |= {} if evidence.instants is None else {"instants": evidence.instants}
    return _dataset(arrays, attributes, evidence.solution, limit=list(shares), percent=list(PERCENTILES))


def _ends(limit: Any) -> dict[str, str]:
    """The bounds of a limit."""
    return {"lower": f"{limit.lower:g}", "upper": f"{limit.upper:g}"}


def _shares(axis: str, shares: Sequence[Share]) -> Arrays:
    """Shares of systems that violate, with their intervals."""
    ends = {"confidence": f"{shares[0].confidence:g}"} if shares else {}
    return {
        "violation": _array(axis, [one.estimate for one in shares]),
        "violation_lower": _array(axis, [one.lower for one in shares], **ends),
        "violation_upper": _array(axis, [one.upper for one in shares], **ends),
    }


# --- Many designs ----------------------------------------------------------------------------------------------------


@dataset.register(Front)
def _(front: Front) -> "xarray.Dataset":
    """Objective, shadow price, status and decisions along the values of a bound."""
    problem = front.solutions[0].problem
    bound_unit, unit = unit_of_limit(front.bound, problem), unit_of(problem.objective, problem)
    price_unit = f"{unit or '1'} per {bound_unit or '1'}"
    arrays = {
        "objective": _array("bound", front.objectives, unit, long_name=str(problem.objective)),
        "shadow_price": _array("bound", front.shadow_prices, price_unit),
        "violation": _array("bound", front.violations),
        "status": _array("bound", [one.status.name for one in front.points]),
        "active": _array("bound", [", ".join(getattr(one, "active", ())) for one in front.points]),
        "why": _array("bound", ["" if one.ok else one.why() for one in front.points]),
    }
    bound = _array("bound", front.values, bound_unit, long_name=f"limit of {front.bound}")
    return _dataset(arrays | _decisions("bound", front.points), {"interrupted": int(front.interrupted)}, bound=bound)


@dataset.register(Calibration)
def _(calibration: Calibration) -> "xarray.Dataset":
    """Objective and violation for each margin tried; the chosen one, and its violation on fresh samples."""
    trials, problem = sorted(calibration.trials, key=lambda trial: trial.sigmas), calibration.solution.problem
    objectives, unit = [trial.solution.objective for trial in trials], unit_of(problem.objective, problem)
    arrays = _shares("sigmas", [trial.violation for trial in trials])
    arrays["objective"] = _array("sigmas", objectives, unit)
    attributes = {
        "constraint": calibration.name,
        "target": calibration.target,
        "chosen": calibration.sigmas,
        **{f"chosen for {name}": sigmas for name, sigmas in calibration.margins.items()},
        "confirmed": int(calibration.confirmed),
        "verdict": calibration.sentence(),
        "interrupted": int(calibration.interrupted),
    }
    if (fresh := calibration.confirmation) is not None:
        attributes |= {"fresh": fresh.estimate, "fresh_lower": fresh.lower, "fresh_upper": fresh.upper}
        attributes |= {"fresh_samples": fresh.samples, "fresh_confidence": fresh.confidence}
    return _dataset(arrays, attributes, sigmas=[trial.sigmas for trial in trials])


@dataset.register(TradeOff)
def _(front: TradeOff) -> "xarray.Dataset":
    """The wishes, their weights and the decisions at each design."""
    arrays: Arrays = {}
    for i, (name, wish) in enumerate(zip(front.names, front.wishes, strict=True)):
        unit = unit_of(wish, front.solutions[0].problem)
        arrays[f"wish {name}"] = _array("design", front.values[:, i], unit, long_name=str(wish))
        arrays[f"weight {name}"] = _array("design", front.weights[:, i])
    attributes = {"dominated": front.dominated, "failed": " ".join(front.failed), "interrupted": int(front.interrupted)}
    return _dataset(arrays | _decisions("design", front.solutions), attributes)


def _decisions(along: str, points: Sequence[Any]) -> Arrays:
    """The decisions of several solutions along an axis; NaN for what is none."""
    solved, arrays = [one for one in points if isinstance(one, Solution)], dict[str, Any]()
    for name, value in solved[0].decisions.items():
        # A control has as many values as its mesh has nodes: the rest of shorter ones is NaN.
        shape = np.max([np.shape(one.decisions[name]) for one in solved], axis=0).astype(int)
        stacked = np.full((len(points), *shape), np.nan)
        for i, one in enumerate(points):
            if isinstance(one, Solution):
                stacked[(i, *map(slice, np.shape(one.decisions[name])))] = one.decisions[name]
        unit = unit_of_decision(name, solved[0].problem)
        arrays[f"decision {name}"] = _array((along, *_entries(name, value)), stacked, unit)
    return arrays


# --- What can be saved -----------------------------------------------------------------------------------------------


def tree(results: Mapping[str, Any]) -> "xarray.DataTree":
    """Nested mappings of results as a tree of datasets, without empty branches."""
    import xarray

    nodes = {
        "/".join(["", *map(_key, names)]): dataset(result)
        for names, result in leaves(results)
        # A front may have been interrupted before its first point.
        if result is not None and not (isinstance(result, Front | TradeOff) and not result.solutions)
    }
    return xarray.DataTree.from_dict(nodes)


def savable(what: str, results: Any) -> tuple[dict[str, Any], list[ProblemError]]:
    """The results that can be saved, and a refusal for each of the others, beginning with `what` and its place."""
    if not is_group(results):
        raise refusal(what, "results by name: a mapping", results)
    accepted: dict[str, Any] = {}
    refused: list[ProblemError] = []
    for name, result in results.items():
        place = f"{what}: '{name}'"
        try:
            if not isinstance(name, str | int | float) or str(name) in ("", ".", ".."):  # those stand for other groups
                raise refusal(what, "results by name", name)
            if is_group(result):
                accepted[str(name)], inside = savable(place, result)
                refused += inside
            else:
                accepted[str(name)] = _checked(place, result)
        except ProblemError as error:
            refused.append(error)
    return accepted, refused


def _checked(what: str, result: Any) -> Any:
    """A result, or a user's own data in a form that netCDF can hold."""
    import xarray

    if not isinstance(result, xarray.Dataset | xarray.DataArray):
        return None if result is None else one_of(what, result, KINDS, "what `solve` gives, or a dataset of xarray")
    try:
        xarray.DataTree.from_dict({"/one": result}).to_netcdf(engine="h5netcdf")
    except (TypeError, ValueError, NotImplementedError) as error:
        raise ProblemError(f"{what}: expected data that netCDF can hold; received other data: {error}") from error
    return result


# --- Files -----------------------------------------------------------------------------------------------------------


def save(folder: str | Path, /, **results: "Result | Mapping[str, Any] | None") -> tuple[Path, ...]:
    """Write results into a folder and return the paths: `results.nc`, and `designs.json` if there is a solution.

    Each keyword is a result, a dataset, or a mapping of these by name, nested as needed: a group of the netCDF file.
    Solutions become entries of the JSON file, with the violations in their evidence. Both files always belong to the
    same call, and carry a common identifier; files of an earlier run are kept until the new ones are complete.

    Raises `ProblemError` for anything that is not a result, naming its place, if the folder cannot be written to, or if
    another process keeps writing into it.
    """
    kept, refused = savable("save", results)
    if refused:
        raise refused[0]
    return save_all(folder, kept)


def save_all(folder: str | Path, results: Mapping[str, Any], *outdated: str) -> tuple[Path, ...]:
    """Write results that are `savable`; outdated files, such as the page of an earlier set, go with that set."""
    generation, nodes = uuid.uuid4().hex, tree(results)
    nodes.attrs |= {"generation": generation, **environment()}
    document = {place: {**one, "generation": generation} for place, one in designs_document(results).items()}
    files = {
        # In memory, since on a full disk HDF5 fails to close its file and ends the process.
        _RESULTS: bytes(nodes.to_netcdf(engine="h5netcdf")),
        _DESIGNS: json_text(document).encode("utf-8") if document else None,
    }
    return write_together(folder, files | dict.fromkeys(outdated))


def json_text(document: Any) -> str:
    """Strict, readable JSON: non-finite numbers become null."""
    from pydantic_core import to_json

    def in_python(value: Any) -> Any:
        return dict(value) if isinstance(value, Mapping) else np.asarray(value).tolist()

    return to_json(document, indent=2, inf_nan_mode="null", fallback=in_python).decode() + "\n"


def designs_document(results: Mapping[str, Any]) -> dict[str, Any]:
    """Every solution among the results by its place, in human-readable form."""
    found = by_place(results)
    evidence = [one for one in reversed(found.values()) if isinstance(one, Evidence)]  # the last counts
    designs = {place: one for place, one in found.items() if isinstance(one, Solution)}
    return {place: solution_document(one, evidence_on(one, evidence)) for place, one in designs.items()}
