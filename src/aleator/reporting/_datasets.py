"""Results as labelled arrays with units, and which can be saved: by name, nested as needed."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator._core.border import one_of, refusal
from aleator._core.errors import ProblemError
from aleator.design import statistics_in
from aleator.reporting._numbers import (
    unit_of_decision,
    unit_of_expression,
    unit_of_limit,
    unit_of_objective,
    unit_of_statistic,
    units_of_moments,
)
from aleator.solution import Solution
from aleator.statistics import Mean, Std
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import PERCENTILES, Evidence, Share

if TYPE_CHECKING:
    import xarray


def leaves(results: Mapping[str, Any], *outer: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Each result with the names under which it stands, the outermost first."""
    for name, one in results.items():
        if isinstance(one, Mapping):
            yield from leaves(one, *outer, str(name))
        else:
            yield (*outer, str(name)), one


def by_place(results: Mapping[str, Any]) -> dict[str, Any]:
    """Each result by its place, such as `designs/robust`."""
    return {"/".join(names): one for names, one in leaves(results)}


Variable = tuple[Any, Any, dict[str, str], dict[str, Any]]
# This halves time histories; stronger compression takes longer and saves little more.
_PACKED = {"zlib": True, "complevel": 1, "shuffle": True}


def solution_dataset(solution: Solution) -> "xarray.Dataset":
    """Decisions, constraints with their bounds, multipliers and activity, and the moments of a solution."""
    import xarray

    problem = solution.problem
    data: dict[str, Variable] = {
        "objective": variable((), solution.objective, str(problem.objective), unit_of_objective(solution.problem))
    }
    for name, value in solution.decisions.items():
        data[f"decision {_key(name)}"] = variable(_entries(name, value), value, name, unit_of_decision(name, problem))
        multiplier = solution.bound_multipliers.get(name, np.nan)
        data[f"multiplier {_key(name)}"] = variable(
            _entries(name, value), multiplier, f"multiplier of the bounds of {name}", ""
        )
    for i, (one, declared) in enumerate(zip(solution.constraints, problem.constraints, strict=True)):
        unit, label = unit_of_expression(declared.expression, problem), f"constraint {i} {_key(one.name)}"
        axes = _axes(one.values, one.times is not None)
        if one.times is not None and len(one.times) > len(solution.instants):  # Limits on a mesh have more instants.
            axes = ("point of limits", *axes[1:])
            data["times of limits"] = variable(axes[0], one.times, "instants of limits over time", "s")
        data[label] = variable(axes, one.values, one.text, unit, lower=f"{one.lower:g}", upper=f"{one.upper:g}")
        data[f"{label} multiplier"] = variable(axes, one.multipliers, "minus the objective per bound", "")
        data[f"{label} active"] = variable(axes, np.asarray(one.active, dtype=np.int8), "1 where active", "")
    units = units_of_moments(problem)
    for text, one in solution.moments.items():
        axes = _axes(one.mean, np.ndim(one.mean) > 0)
        data[f"mean {_key(text)}"] = variable(axes, one.mean, f"mean of {text} by the expansion", units.get(text, ""))
        data[f"std {_key(text)}"] = variable(
            axes, one.std, f"standard deviation of {text} by the expansion", units.get(text, "")
        )
    for one in statistics_in(problem.expressions):
        if not isinstance(one.kind, Mean | Std):
            values = solution.statistics[one.text()]
            axes, unit = _axes(values, one.is_path), unit_of_statistic(one, problem)
            data[f"statistic {_key(one.text())}"] = variable(axes, values, f"{one.text()} by the expansion", unit)
    for i, one in enumerate(solution.meshes, 1):
        axes, told = (f"realisation of mesh {i}", f"interval of mesh {i}"), f"drift of the states on mesh {i}"
        data[f"mesh {i}"] = variable(f"node of mesh {i}", one.nodes, f"nodes of mesh {i}, {one.scheme}", "s")
        data[f"mesh {i} drift"] = variable(axes, one.drifts, told, "1", asked=f"{one.asked:g}")
    if (searched := solution.effort.searched) is not None:
        unit = unit_of_objective(problem)
        data["searched objective"] = variable("evaluation", searched.objectives, f"by {searched.method}", unit)
        data["searched violation"] = variable("evaluation", searched.violations, "largest violation", "1")
    data |= _histories(solution)
    attributes = {
        "status": solution.status.value,
        "solver": solution.effort.solver,
        "violation": solution.certificate.violation,
        "stationarity": solution.certificate.stationarity,
        "complementarity": solution.certificate.complementarity,
        "problem": solution.problem_text,
    }
    return _with_time(xarray.Dataset(data, attrs=attributes), solution)


def _histories(solution: Solution) -> dict[str, Variable]:
    """States, costates and switching functions of a simultaneous program, each along its own instants."""
    kinds = {"state": solution.mesh_states, "costate": solution.costates, "switching function": solution.switching}
    data: dict[str, Variable] = {}
    for kind, found in kinds.items():
        if found is None or not found.values:
            continue
        along = (f"point of {kind}s",) if found is solution.switching else ("realisation", f"point of {kind}s")
        data[f"times of {kind}s"] = variable(along[-1], found.times, f"instants of {kind}s", "s")
        for name, values in found.values.items():
            axes = (*along, *(f"component of {size}, {i}" for i, size in enumerate(values.shape[len(along) :])))
            data[f"{kind} {_key(name)}"] = variable(axes, values, f"{kind} of {name}", "")
    if solution.mesh_states is not None:
        germs = "germ points of the realisations"
        data["germ"] = variable(("realisation", "germ variable"), solution.mesh_states.germs, germs, "1")
    return data


def evidence_dataset(evidence: Evidence) -> "xarray.Dataset":
    """Violations with their intervals, sampled statistics, percentiles and the kept trajectories."""
    import xarray

    problem = evidence.solution.problem
    units = units_of_moments(problem)
    shares = {**evidence.violations, "any": evidence.joint}
    data = _share_variables("limit", list(shares.values()))
    for text, one in evidence.functionals.items():
        axes = _axes(one.mean, one.percentiles is None)
        parts = {"sampled mean": one.mean, "sampled std": one.std, "standard error": one.standard_error}
        for part, values in parts.items():
            data[f"{part} {_key(text)}"] = variable(axes, values, f"{part} of {text}", units.get(text, ""))
        if one.percentiles is not None:
            data[f"percentiles {_key(text)}"] = variable(
                "percent", one.percentiles, f"percentiles of {text}", units.get(text, "")
            )
    for text, one in evidence.statistics.items():
        unit = unit_of_statistic(one.statistic, problem)
        data[f"sampled {_key(text)}"] = variable((), one.estimate, f"{text} of the samples", unit)
        data[f"standard error {_key(text)}"] = variable((), one.standard_error, f"standard error of {text}", unit)
    for i, one in enumerate(evidence.trajectories):
        unit = unit_of_limit(one.name, problem)
        bounds = {"lower": f"{one.lower:g}", "upper": f"{one.upper:g}"}
        axes = ("system", *_axes(one.values[0], True))
        data[f"trajectory {i} {_key(one.name)}"] = variable(
            axes, one.values, f"sampled systems: {one.name}", unit, **bounds
        )
        broken = np.asarray(one.violating, dtype=np.int8)
        data[f"trajectory {i} violating"] = variable("system", broken, f"1 if the system violates {one.name}", "")
    coordinates = {"limit": list(shares), "percent": list(PERCENTILES)}
    attributes = {"samples": evidence.samples, "seed": evidence.seed, "seconds": evidence.seconds}
    if evidence.instants is not None:
        attributes["instants"] = evidence.instants
    return _with_time(xarray.Dataset(data, coords=coordinates, attrs=attributes), evidence.solution)


def front_dataset(front: Front) -> "xarray.Dataset":
    """Objective, shadow price, status and decisions along the values of a bound."""
    import xarray

    first = front.solutions[0]
    bound_unit = unit_of_limit(front.bound, first.problem)
    unit = unit_of_objective(first.problem)
    active = [", ".join(one.active) if isinstance(one, Solution) else "" for one in front.points]
    why = ["" if one.ok else one.why() for one in front.points]
    data: dict[str, Variable] = {
        "objective": variable("bound", front.objectives, str(first.problem.objective), unit),
        "shadow_price": variable(
            "bound", front.shadow_prices, f"shadow price of {front.bound}", f"{unit or '1'} per {bound_unit or '1'}"
        ),
        "violation": variable("bound", front.violations, "scaled violation", "1"),
        "status": variable("bound", [one.status.name for one in front.points], "how each solve ended", ""),
        "active": variable("bound", active, "active constraints", ""),
        "why": variable("bound", why, "why there is no optimum", ""),
    }
    for name, value in first.decisions.items():
        values = _side_by_side([one.decisions[name] if isinstance(one, Solution) else np.nan for one in front.points])
        axes = ("bound", *_entries(name, value))
        data[f"decision {_key(name)}"] = variable(axes, values, name, unit_of_decision(name, first.problem))
    bound = variable("bound", front.values, f"limit of {front.bound}", bound_unit)
    return xarray.Dataset(data, coords={"bound": bound}, attrs={"interrupted": int(front.interrupted)})


def _side_by_side(each: Sequence[Any]) -> np.ndarray:
    """Arrays of one kind stacked, the rest of shorter ones NaN: a control has as many values as its mesh has nodes."""
    arrays = [np.asarray(one, dtype=float) for one in each]
    shape = np.max([one.shape for one in arrays if one.ndim == max(other.ndim for other in arrays)], axis=0).astype(int)
    stacked = np.full((len(arrays), *shape), np.nan)
    for i, one in enumerate(arrays):
        stacked[(i, *(slice(size) for size in one.shape))] = one
    return stacked


def calibration_dataset(calibration: Calibration) -> "xarray.Dataset":
    """Objective and violation for each margin tried; the chosen one, and its violation on fresh samples."""
    import xarray

    trials = sorted(calibration.trials, key=lambda one: one.sigmas)
    data = _share_variables("sigmas", [one.violation for one in trials])
    objectives = [one.solution.objective for one in trials]
    data["objective"] = variable(
        "sigmas", objectives, "optimum at this margin", unit_of_objective(trials[0].solution.problem)
    )
    sigmas = variable("sigmas", [one.sigmas for one in trials], "multiple of the standard deviation", "1")
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
    return xarray.Dataset(data, coords={"sigmas": sigmas}, attrs=attributes)


def trade_off_dataset(front: TradeOff) -> "xarray.Dataset":
    """The wishes, their weights and the decisions at each design."""
    import xarray

    data: dict[str, Variable] = {}
    for i, name in enumerate(front.names):
        unit = unit_of_expression(front.wishes[i], front.solutions[0].problem)
        data[f"wish {_key(name)}"] = variable("design", front.values[:, i], str(front.wishes[i]), unit)
        data[f"weight {_key(name)}"] = variable("design", front.weights[:, i], f"how much {name} counts", "")
    for name, value in front.solutions[0].decisions.items():
        values = _side_by_side([one.decisions[name] for one in front.solutions])
        unit = unit_of_decision(name, front.solutions[0].problem)
        data[f"decision {_key(name)}"] = variable(("design", *_entries(name, value)), values, name, unit)
    attributes = {"dominated": front.dominated, "failed": " ".join(front.failed), "interrupted": int(front.interrupted)}
    return xarray.Dataset(data, attrs=attributes)


def dataset(result: "Solution | Evidence | Front | TradeOff | Calibration | xarray.Dataset") -> "xarray.Dataset":
    """Any result as a dataset; a dataset is returned unchanged."""
    if isinstance(result, Solution):
        return solution_dataset(result)
    if isinstance(result, Evidence):
        return evidence_dataset(result)
    if isinstance(result, Front):
        return front_dataset(result)
    if isinstance(result, TradeOff):
        return trade_off_dataset(result)
    if isinstance(result, Calibration):
        return calibration_dataset(result)
    # A study may keep a single array of its own, which becomes a dataset of that array.
    return result


def is_own_data(result: object) -> bool:
    """Whether a result is data that a study has labelled itself."""
    import xarray

    return isinstance(result, xarray.Dataset | xarray.DataArray)


def variable(axes: Any, values: Any, long_name: str, unit: str, **more: str) -> Variable:
    array = np.asarray(values)
    return axes, array, {"long_name": long_name, "units": unit or "1", **more}, _PACKED if array.size > 1000 else {}


def _key(text: str) -> str:
    """A name valid in netCDF, where a slash would open a group."""
    return text.replace("/", "∕")


def _entries(name: str, value: Any) -> tuple[str, ...]:
    return tuple(f"{_key(name)} axis {i}" for i in range(np.ndim(value)))


def _axes(values: Any, is_path: bool) -> tuple[str, ...]:
    """`time` first for a path; further axes are named after their length, so that equal ones are shared."""
    shape = np.shape(values)
    rest = tuple(f"component of {size}, {i}" for i, size in enumerate(shape[1:] if is_path else shape))
    return ("time", *rest) if is_path else rest


def _share_variables(axis: str, shares: list[Share]) -> dict[str, Variable]:
    level = f"{100 * shares[0].confidence:g} %" if shares else ""
    return {
        "violation": variable(axis, [one.estimate for one in shares], "share of systems that violate", "1"),
        "violation_lower": variable(axis, [one.lower for one in shares], f"lower end of its {level} interval", "1"),
        "violation_upper": variable(axis, [one.upper for one in shares], f"upper end of its {level} interval", "1"),
    }


def _with_time(data: "xarray.Dataset", solution: Solution) -> "xarray.Dataset":
    if "time" not in data.dims:
        return data
    times = solution.instants
    return data.assign_coords(time=("time", times, {"long_name": "time", "units": "s"}))


def tree(results: Mapping[str, Any]) -> "xarray.DataTree":
    """Nested mappings of results as a tree of datasets, without empty branches."""
    import xarray

    nodes = {
        "/".join(["", *map(_key, names)]): dataset(one)
        for names, one in leaves(results)
        # A front may have been interrupted before its first point.
        if one is not None and not (isinstance(one, Front) and not one.solutions)
    }
    return xarray.DataTree.from_dict(nodes)


KINDS = (Solution, Evidence, Front, TradeOff, Calibration)
"""The kinds of results that have labelled arrays."""


def savable(what: str, results: Any) -> tuple[dict[str, Any], list[ProblemError]]:
    """The results that can be saved, and a refusal for each of the others, beginning with `what` and its place."""
    if not isinstance(results, Mapping):
        raise refusal(what, "results by name: a mapping", results)
    kept: dict[str, Any] = {}
    refused: list[ProblemError] = []
    for name, one in results.items():
        place = f"{what}: '{name}'"
        try:
            if isinstance(one, Mapping):
                kept[_name(what, name)], inside = savable(place, one)
                refused += inside
            else:
                kept[_name(what, name)] = _leaf(place, one)
        except ProblemError as error:
            refused.append(error)
    return kept, refused


def _name(what: str, name: Any) -> str:
    """A valid name of a group; `.` and `..` stand for other groups."""
    if not isinstance(name, str | int | float) or str(name) in ("", ".", ".."):
        raise refusal(what, "results by name", name)
    return str(name)


def _leaf(what: str, one: Any) -> Any:
    """A result, or a user's own data in a form that netCDF can hold."""
    if one is None or not is_own_data(one):
        return one if one is None else one_of(what, one, KINDS, "what `solve` gives, or a dataset of xarray")
    import xarray

    try:
        xarray.DataTree.from_dict({"/one": one}).to_netcdf(engine="h5netcdf")
    except (TypeError, ValueError, NotImplementedError) as error:
        raise ProblemError(f"{what}: expected data that netCDF can hold; received other data: {error}") from error
    return one
