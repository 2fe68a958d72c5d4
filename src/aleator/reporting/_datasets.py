"""Results as labelled arrays with units, and which can be saved: by name, nested as needed."""

import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from typing_extensions import TypeIs

from aleator._core.border import one_of, refusal
from aleator._core.errors import ProblemError
from aleator.design import Problem, functionals_of, path_of, statistics_in
from aleator.dynamics import LinkedGrid, phase_of
from aleator.reporting._numbers import (
    unit_of_decision,
    unit_of_expression,
    unit_of_functional,
    unit_of_limit,
    unit_of_objective,
    unit_of_statistic,
)
from aleator.solution import Solution
from aleator.sweep import Calibration, Front, TradeOff
from aleator.validation import PERCENTILES, Evidence, Share

if TYPE_CHECKING:
    import xarray

# This halves time histories; stronger compression takes longer and saves little more.
_PACKED = {"zlib": True, "complevel": 1, "shuffle": True}

KINDS = (Solution, Evidence, Front, TradeOff, Calibration)
"""The kinds of results that have labelled arrays."""


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


@final
class _Arrays:
    """The arrays of a dataset, as they are added: name, axes, values, and what they are in which unit."""

    def __init__(self) -> None:
        self._arrays: dict[str, Any] = {}

    def add(self, name: str, axes: Any, values: Any, about: str, unit: str = "", **more: str) -> None:
        array = np.asarray(values)
        packing = _PACKED if array.size > 1000 else {}
        self._arrays[_key(name)] = axes, array, {"long_name": about, "units": unit or "1", **more}, packing

    def add_decisions(self, along: str, solutions: Sequence[Any], first: Solution) -> None:
        """The decisions of several solutions along an axis; NaN for what is none."""
        for name, value in first.decisions.items():
            each = [
                np.asarray(one.decisions[name] if isinstance(one, Solution) else np.nan, float) for one in solutions
            ]
            # A control has as many values as its mesh has nodes: the rest of shorter ones is NaN.
            shape = np.max([one.shape for one in each if one.ndim == np.ndim(value)], axis=0).astype(int)
            stacked = np.full((len(each), *shape), np.nan)
            for i, one in enumerate(each):
                stacked[(i, *map(slice, one.shape))] = one
            axes = (along, *_entries(name, value))
            self.add(f"decision {name}", axes, stacked, name, unit_of_decision(name, first.problem))

    def add_shares(self, axis: str, shares: Sequence[Share]) -> None:
        """Shares of systems that violate, with their intervals."""
        level = f"{100 * shares[0].confidence:g} %" if shares else ""
        self.add("violation", axis, [one.estimate for one in shares], "share of systems that violate")
        self.add("violation_lower", axis, [one.lower for one in shares], f"lower end of its {level} interval")
        self.add("violation_upper", axis, [one.upper for one in shares], f"upper end of its {level} interval")

    def dataset(
        self, attributes: Mapping[str, Any], solution: Solution | None = None, **coordinates: Any
    ) -> "xarray.Dataset":
        """The dataset of the arrays, some of which may be coordinates; `solution`: whose instants times are."""
        import xarray

        coordinates |= {name: self._arrays.pop(name) for name in coordinates if name in self._arrays}
        data = xarray.Dataset(self._arrays, coords=coordinates, attrs=attributes)
        for phase in () if solution is None else solution.problem.simulation.phases:
            if (time := _time(phase)) in data.dims:
                instants = solution.instants[solution.problem.grid.where(f"{phase}.")]  # type: ignore[union-attr]
                data = data.assign_coords({time: (time, instants, {"long_name": time, "units": "s"})})
        return data


def _key(text: str) -> str:
    """A name valid in netCDF, where a slash would open a group."""
    return text.replace("/", "∕")


def _entries(name: str, value: Any) -> tuple[str, ...]:
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


@dataset.register(Solution)
def _(solution: Solution) -> "xarray.Dataset":
    """Decisions, constraints with their bounds, multipliers and activity, and the moments of a solution."""
    problem, arrays = solution.problem, _Arrays()
    objective_unit = unit_of_objective(problem)
    arrays.add("objective", (), solution.objective, str(problem.objective), objective_unit)
    for name, value in solution.decisions.items():
        axes, multiplier = _entries(name, value), solution.bound_multipliers.get(name, np.nan)
        arrays.add(f"decision {name}", axes, value, name, unit_of_decision(name, problem))
        arrays.add(f"multiplier {name}", axes, multiplier, f"multiplier of the bounds of {name}")
    for i, (limit, declared) in enumerate(zip(solution.constraints, problem.constraints, strict=True)):
        unit, label = unit_of_expression(declared.expression, problem), f"constraint {i} {limit.name}"
        axes = _axes(problem, declared, limit.values)
        if limit.times is not None and len(limit.times) > len(solution.instants):  # Limits on a mesh have more instants
            axes = ("point of limits", *axes[1:])
            arrays.add("times of limits", axes[0], limit.times, "instants of limits over time", "s")
        arrays.add(label, axes, limit.values, limit.text, unit, lower=f"{limit.lower:g}", upper=f"{limit.upper:g}")
        arrays.add(f"{label} multiplier", axes, limit.multipliers, "minus the objective per bound")
        arrays.add(f"{label} active", axes, np.asarray(limit.active, dtype=np.int8), "1 where active")
    functionals = {one.text(): one for one in functionals_of(problem.expressions)}
    for text, moments in solution.moments.items():
        axes, unit = _axes(problem, functionals[text], moments.mean), unit_of_functional(functionals[text], problem)
        arrays.add(f"mean {text}", axes, moments.mean, f"mean of {text} by the expansion", unit)
        arrays.add(f"std {text}", axes, moments.std, f"standard deviation of {text} by the expansion", unit)
    for statistic in statistics_in(problem.expressions):
        if not statistic.is_moment:
            text, unit = statistic.text(), unit_of_statistic(statistic, problem)
            axes = _axes(problem, statistic.functionals[0], solution.statistics[text])
            arrays.add(f"statistic {text}", axes, solution.statistics[text], f"{text} by the expansion", unit)
    for i, mesh in enumerate(solution.meshes, 1):
        arrays.add(f"mesh {i}", f"node of mesh {i}", mesh.nodes, f"nodes of mesh {i}, {mesh.scheme}", "s")
        axes, about = (f"realisation of mesh {i}", f"interval of mesh {i}"), f"drift of the states on mesh {i}"
        arrays.add(f"mesh {i} drift", axes, mesh.drifts, about, asked=f"{mesh.asked:g}")
    if (searched := solution.effort.searched) is not None:
        about = f"by {searched.method}"
        arrays.add("searched objective", "evaluation", searched.objectives, about, objective_unit)
        arrays.add("searched violation", "evaluation", searched.violations, "largest violation")
    _add_histories(arrays, solution)
    attributes = {
        "status": solution.status.value,
        "solver": solution.effort.solver,
        "violation": solution.certificate.violation,
        "stationarity": solution.certificate.stationarity,
        "complementarity": solution.certificate.complementarity,
        "problem": solution.problem_text,
    }
    return arrays.dataset(attributes, solution)


def _add_histories(arrays: _Arrays, solution: Solution) -> None:
    """States, costates and switching functions of a simultaneous program, each along its own instants."""
    kinds = {"state": solution.mesh_states, "costate": solution.costates, "switching function": solution.switching}
    for kind, histories in kinds.items():
        if histories is None:
            continue
        for name, values in histories.values.items():
            of = f" of {phase_of(name)}" if histories.phases else ""
            points = f"point of {kind}s{of}"
            arrays.add(f"times of {kind}s{of}", points, histories.times_of(name), f"instants of {kind}s{of}", "s")
            along = (points,) if histories is solution.switching else ("realisation", points)
            arrays.add(
                f"{kind} {name}", (*along, *_components(values.shape[len(along) :])), values, f"{kind} of {name}"
            )
    if solution.mesh_states is not None:
        axes = ("realisation", "germ variable")
        arrays.add("germ", axes, solution.mesh_states.germs, "germ points of the realisations")


@dataset.register(Evidence)
def _(evidence: Evidence) -> "xarray.Dataset":
    """Violations with their intervals, sampled statistics, percentiles and the kept trajectories."""
    problem, arrays = evidence.solution.problem, _Arrays()
    shares = {**evidence.violations, "any": evidence.joint}
    arrays.add_shares("limit", list(shares.values()))
    functionals = {one.text(): one for one in functionals_of(problem.expressions)}
    for text, sampled in evidence.functionals.items():
        axes, unit = _axes(problem, functionals[text], sampled.mean), unit_of_functional(functionals[text], problem)
        parts = {"sampled mean": sampled.mean, "sampled std": sampled.std, "standard error": sampled.standard_error}
        for part, values in parts.items():
            arrays.add(f"{part} {text}", axes, values, f"{part} of {text}", unit)
        if sampled.percentiles is not None:
            arrays.add(f"percentiles {text}", "percent", sampled.percentiles, f"percentiles of {text}", unit)
    for text, sampled in evidence.statistics.items():
        unit = unit_of_statistic(sampled.statistic, problem)
        arrays.add(f"sampled {text}", (), sampled.estimate, f"{text} of the samples", unit)
        arrays.add(f"standard error {text}", (), sampled.standard_error, f"standard error of {text}", unit)
    limits = {one.name: one for one in problem.constraints if one.is_path}
    for i, kept in enumerate(evidence.trajectories):
        axes, label = ("system", *_axes(problem, limits[kept.name], kept.values[0])), f"trajectory {i}"
        unit, bounds = unit_of_limit(kept.name, problem), {"lower": f"{kept.lower:g}", "upper": f"{kept.upper:g}"}
        arrays.add(f"{label} {kept.name}", axes, kept.values, f"sampled systems: {kept.name}", unit, **bounds)
        broken = np.asarray(kept.violating, dtype=np.int8)
        arrays.add(f"{label} violating", "system", broken, f"1 if the system violates {kept.name}")
    attributes = {"samples": evidence.samples, "seed": evidence.seed, "seconds": evidence.seconds}
    if evidence.instants is not None:
        attributes["instants"] = evidence.instants
    return arrays.dataset(attributes, evidence.solution, limit=list(shares), percent=list(PERCENTILES))


@dataset.register(Front)
def _(front: Front) -> "xarray.Dataset":
    """Objective, shadow price, status and decisions along the values of a bound."""
    first, arrays = front.solutions[0], _Arrays()
    bound_unit, unit = unit_of_limit(front.bound, first.problem), unit_of_objective(first.problem)
    price_unit = f"{unit or '1'} per {bound_unit or '1'}"
    active = [", ".join(one.active) if isinstance(one, Solution) else "" for one in front.points]
    why = ["" if one.ok else one.why() for one in front.points]
    arrays.add("bound", "bound", front.values, f"limit of {front.bound}", bound_unit)
    arrays.add("objective", "bound", front.objectives, str(first.problem.objective), unit)
    arrays.add("shadow_price", "bound", front.shadow_prices, f"shadow price of {front.bound}", price_unit)
    arrays.add("violation", "bound", front.violations, "scaled violation")
    arrays.add("status", "bound", [one.status.name for one in front.points], "how each solve ended")
    arrays.add("active", "bound", active, "active constraints")
    arrays.add("why", "bound", why, "why there is no optimum")
    arrays.add_decisions("bound", front.points, first)
    return arrays.dataset({"interrupted": int(front.interrupted)}, bound=None)


@dataset.register(Calibration)
def _(calibration: Calibration) -> "xarray.Dataset":
    """Objective and violation for each margin tried; the chosen one, and its violation on fresh samples."""
    trials, arrays = sorted(calibration.trials, key=lambda trial: trial.sigmas), _Arrays()
    unit = unit_of_objective(trials[0].solution.problem)
    arrays.add_shares("sigmas", [trial.violation for trial in trials])
    objectives = [trial.solution.objective for trial in trials]
    arrays.add("objective", "sigmas", objectives, "optimum at this margin", unit)
    arrays.add("sigmas", "sigmas", [trial.sigmas for trial in trials], "multiple of the standard deviation")
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
    return arrays.dataset(attributes, sigmas=None)


@dataset.register(TradeOff)
def _(front: TradeOff) -> "xarray.Dataset":
    """The wishes, their weights and the decisions at each design."""
    first, arrays = front.solutions[0], _Arrays()
    for i, (name, wish) in enumerate(zip(front.names, front.wishes, strict=True)):
        arrays.add(f"wish {name}", "design", front.values[:, i], str(wish), unit_of_expression(wish, first.problem))
        arrays.add(f"weight {name}", "design", front.weights[:, i], f"how much {name} counts")
    arrays.add_decisions("design", front.solutions, first)
    attributes = {"dominated": front.dominated, "failed": " ".join(front.failed), "interrupted": int(front.interrupted)}
    return arrays.dataset(attributes)


def tree(results: Mapping[str, Any]) -> "xarray.DataTree":
    """Nested mappings of results as a tree of datasets, without empty branches."""
    import xarray

    nodes = {
        "/".join(["", *map(_key, names)]): dataset(result)
        for names, result in leaves(results)
        # A front may have been interrupted before its first point.
        if result is not None and not (isinstance(result, Front) and not result.solutions)
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
