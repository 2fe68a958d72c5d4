"""Figures over time: the paths of a problem with their limits, means with bands, and histories of systems."""

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.design import AbstractFunctional, Constraint, Problem, Statistic, functionals_of, is_worst_case
from aleator.reporting._numbers import given, share_text, unit_of, unit_of_limit
from aleator.reporting._style import (
    ALARM,
    CLOUD,
    DASHES,
    add_band,
    blank,
    draw,
    label,
    limit_line,
    looks,
    plain,
    short,
)
from aleator.solution import Moments, Motions, Solution
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# The multiple of the standard deviation in a band, where no limit says another.
_USUAL = 2.0
# Systems drawn of many, and instants of theirs.
_DRAWN, _SHOWN = 60, 350


class Limits(NamedTuple):
    """The limits on a path: by their values, in words; the largest multiple of the standard deviation in them; their
    names; and the unit of the path.
    """

    texts: dict[float, str]
    sigmas: float
    names: set[str]
    unit: str


def paths_of(problem: Problem) -> dict[str, AbstractFunctional]:
    """The paths in a problem, each under the name of its output, or under its text where several are of one output."""
    every = [one for one in functionals_of(problem.expressions) if one.is_path]
    outputs = [one.output for one in every]
    return {one.output if outputs.count(one.output) == 1 else one.text(): one for one in every}


def limits_of(problem: Problem, functional: AbstractFunctional) -> Limits:
    """The limits on one path alone: on its mean, with a multiple of its standard deviation or without, or on its worst
    case.
    """
    texts: dict[float, str] = {}
    sigmas, names, unit = 0.0, set(), unit_of(functional, problem)
    for limit in problem.constraints:
        if functionals_of((limit.expression,)) != (functional,) or not _has_values_of_path(limit):
            continue
        multiple = limit.expression.sigmas or 0.0
        which = f" at {multiple:.3g} σ" if multiple else " in the worst case" if is_worst_case(limit) else ""
        sigmas = max(sigmas, multiple)
        names.add(limit.name)
        for bound in (float(limit.lower), float(limit.upper)):
            if np.isfinite(bound):
                texts[bound] = f"{limit.name}: {given(bound, unit)}{which}"
    return Limits(texts, sigmas or _USUAL, names, unit)


def _has_values_of_path(limit: Constraint) -> bool:
    """Whether what is limited has the path's own values: its worst case, or one statistic of it, not in proportion, and
    its spreads.
    """
    if is_worst_case(limit):
        return True
    pairs = list(zip(limit.expression.factors, limit.expression.atoms, strict=True))
    located = [float(factor) for factor, atom in pairs if not atom.is_spread]
    return located == [1.0] and all(isinstance(atom, Statistic) for _, atom in pairs)


def limits_text(bounds: Sequence[float], unit: str) -> dict[float, str]:
    """The text of each finite limit."""
    return {bound: f"limit {given(bound, unit)}" for bound in dict.fromkeys(bounds) if np.isfinite(bound)}


def components(name: str, mean: Float[np.ndarray, "instants ..."], std: Any = 0.0) -> dict[str, Moments]:
    """A path by its name, by default without a spread; of a vector over time, each component by its own."""
    std = np.broadcast_to(std, mean.shape)
    if mean.ndim == 1:
        return {name: Moments(mean, std)}
    means, stds = (part.reshape(len(part), -1) for part in (mean, std))
    return {f"{name}[{i}]": Moments(means[:, i], stds[:, i]) for i in range(means.shape[1])}


def curves(values: np.ndarray, violating: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One row per curve, and whether its system violates; a vector over time gives one curve per component."""
    broken = np.asarray(violating, dtype=bool)
    if values.ndim == 2:
        return values, broken
    flat = values.reshape(*values.shape[:2], -1)
    return np.moveaxis(flat, 2, 1).reshape(-1, values.shape[1]), np.repeat(broken, flat.shape[2])


class Strokes(NamedTuple):
    """Histories that are drawn alike, shape (curves, instants)."""

    rows: Float[np.ndarray, "curves instants"]
    colour: str
    width: float = 0.8


def path_figure(
    times: Float[np.ndarray, " instants"],
    paths: Mapping[str, Moments],
    *,
    y: str,
    unit: str = "",
    sigmas: float = 0.0,
    histories: Mapping[str, Strokes] = MappingProxyType({}),
    ranges: Mapping[str, tuple[np.ndarray, np.ndarray]] = MappingProxyType({}),
    limits: Mapping[float, str] = MappingProxyType({}),
    title: str = "",
) -> "Figure":
    """The mean of each path, shape (instants,), with the band of `sigmas` standard deviations about it.

    - `histories`: of some systems, drawn behind; `ranges`: a lighter band between two curves, by the name of a path;
      `limits`: drawn as lines, with their names.
    """
    figure = blank(label("Time", "s"), label(y, unit), title=plain(title), height=380)
    for name, (rows, colour, width) in histories.items():
        # All curves are one trace with gaps; its legend entry is thick enough for the colour to be seen.
        draw(figure, [None], [None], colour, name=name, mode="lines", line_width=4)
        gap, along = np.full((len(rows), 1), np.nan), np.broadcast_to(times, rows.shape)
        x, y_of_all = (short(np.hstack([part, gap]).ravel()) for part in (along, rows))
        thin = {"line_width": width, "opacity": 0.7, "showlegend": False}
        draw(figure, x, y_of_all, colour, name=name, mode="lines", hover=None, **thin)
    styles = looks(paths)
    for name, path in paths.items():
        if name in ranges:
            add_band(figure, times, *ranges[name], styles[name].fill(0.08))
        if np.any(path.std):
            low, high = (path.mean + sign * sigmas * path.std for sign in (-1, 1))
            add_band(figure, times, low, high, styles[name].fill(0.25))
    for dash, (name, path) in zip(itertools.cycle(DASHES), paths.items(), strict=False):
        shown: dict[str, Any] = {"name": name, "line_dash": dash}
        if np.any(path.std):
            shown |= {
                "name": f"{name} ± {sigmas:.3g} σ",
                "hover": "σ: %{customdata:.2~g}",
                "customdata": short(path.std),
            }
        draw(figure, short(times), short(path.mean), styles[name], mode="lines", **shown)
    for bound, text in limits.items():
        limit_line(figure, bound, text)
    return figure.update_layout(showlegend=True)


def band_figure(solution: Solution, name: str, title: str = "", sigmas: float | None = None) -> "Figure":
    """The mean of a path in the problem over time with its band, by default that of its limits, and these."""
    functional = paths_of(solution.problem)[name]
    limits, moments = limits_of(solution.problem, functional), solution.moments[functional.text()]
    shown = {"sigmas": limits.sigmas if sigmas is None else sigmas, "unit": limits.unit, "limits": limits.texts}
    paths = components(f"mean of {name}", moments.mean, moments.std)
    return path_figure(solution.times_of(functional), paths, y=name, title=title, **shown)


def limit_figure(solution: Solution, name: str, title: str = "") -> "Figure":
    """What the limits of a name are on, such as mean + 2 σ, over time, with their bounds and where they are active."""
    every = zip(solution.constraints, solution.problem.constraints, strict=True)
    # Both sides of a limit, or limits on several paths, may have one name.
    named = [(one, declared.expression) for one, declared in every if one.name == name and one.times is not None]
    times, unit = np.asarray(named[0][0].times), unit_of(named[0][1], solution.problem)
    parts = [(one, str(text)) for one, text in named if np.array_equal(np.asarray(one.times), times)]
    paths = {text: line for one, of in parts for text, line in components(of, one.values).items()}
    bounds = limits_text([bound for one, _ in parts for bound in (one.lower, one.upper)], unit)
    figure = path_figure(times, paths, y=name, unit=unit, limits=bounds, title=title)
    active = [np.reshape(one.active, (len(times), -1)) for one, _ in parts]
    values = [np.reshape(one.values, where.shape)[where] for (one, _), where in zip(parts, active, strict=True)]
    places = [np.repeat(times, where.sum(axis=1)) for where in active]
    marks = {"name": "active", "mode": "markers", "marker_size": 8}
    draw(figure, np.concatenate(places), np.concatenate(values), ALARM, **marks)
    return figure


class OverTime(NamedTuple):
    """One figure of a design over time: its name, its active limits, whether it has any, how to draw it."""

    name: str
    active: set[str]
    is_limited: bool
    draw: "Callable[..., Figure]"


def over_time(solution: Solution) -> list[OverTime]:
    """The figures of a design over time: what is limited, active limits first; then the other paths in the problem.

    A limit is drawn with its path where it is on one alone.
    """
    problem, paths = solution.problem, paths_of(solution.problem)
    limits = dict.fromkeys(one.name for one in solution.constraints if one.times is not None)
    active = {one.name for one in solution.constraints if one.times is not None and np.any(one.active)}
    alone = {name: limits_of(problem, path).names for name, path in paths.items()}
    together = [name for name in limits if name not in set().union(*alone.values())]
    seen = functionals_of(tuple(one.expression for one in problem.constraints if one.name in together))
    drawn = [(path, names, band_figure) for path, names in alone.items() if names or paths[path] not in seen]
    drawn += [(name, {name}, limit_figure) for name in together]
    every = [
        OverTime(name, names & active, bool(names), functools.partial(how, solution, name))
        for name, names, how in drawn
    ]
    return sorted(every, key=lambda one: (not one.is_limited, not one.active))


def held_path(solution: Solution) -> str | None:
    """A path on which alone there is an active limit; None without one."""
    paths = paths_of(solution.problem)
    return next((one.name for one in over_time(solution) if one.active and one.name in paths), None)


def motion_figure(motions: Motions, *names: str, title: str = "") -> "Figure":
    """Means of inputs, states or outputs of one unit over time, with bands of two standard deviations about them."""
    paths = [components(name, motions.moments[name].mean, motions.moments[name].std) for name in names]
    every, unit = {part: one for each in paths for part, one in each.items()}, motions.units.get(names[0], "")
    times = np.asarray(motions.times_of(names[0]))
    return path_figure(times, every, y=", ".join(names), unit=unit, sigmas=_USUAL, title=title)


def histories_figure(
    times: Float[np.ndarray, " instants"],
    histories: Float[np.ndarray, "systems instants ..."],
    *,
    y: str,
    unit: str = "",
    who: str = "systems",
    limits: Mapping[float, str] = MappingProxyType({}),
    title: str = "",
) -> "Figure":
    """The histories of some realisations, one line for each; of a vector, one for each component too."""
    rows, _ = curves(histories, np.zeros(len(histories), dtype=bool))
    name = f"{len(histories)} {who if len(histories) != 1 else who.removesuffix('s')}"
    strokes = Strokes(rows, looks([y])[y].colour, 0.8 if len(rows) > 1 else 2.0)
    return path_figure(times, {}, y=y, unit=unit, histories={name: strokes}, limits=limits, title=title)


def cloud(histories: Float[np.ndarray, "systems instants ..."]) -> dict[str, Strokes]:
    """The first 60 of some systems, to be drawn behind a path."""
    shown = histories[:_DRAWN]
    return {f"{len(shown)} systems": Strokes(curves(shown, np.zeros(len(shown), dtype=bool))[0], CLOUD)}


def bands_figure(
    times: Float[np.ndarray, " instants"],
    families: Mapping[str, Float[np.ndarray, "systems instants"]],
    *,
    y: str,
    unit: str = "",
    limits: Sequence[float] = (),
    targets: Mapping[str, float] = MappingProxyType({}),
    title: str = "",
) -> "Figure":
    """Histories of a family of systems: their mean, the band of one standard deviation about it, and their range.

    - `families`: each quantity on its systems, shape (systems, instants);
    - `limits`: drawn as lines; `targets`: the final value wanted of a quantity, drawn as a ring.
    """
    moments = {name: Moments(rows.mean(axis=0), rows.std(axis=0)) for name, rows in families.items()}
    ranges = {name: (rows.min(axis=0), rows.max(axis=0)) for name, rows in families.items()}
    texts = limits_text(limits, unit)
    figure = path_figure(times, moments, y=y, unit=unit, sigmas=1.0, ranges=ranges, limits=texts, title=title)
    for name, target in targets.items():
        ring = {"marker_symbol": "circle-open", "marker_size": 12, "marker_line_width": 2, "cliponaxis": False}
        named = {"name": f"{name}, target", "mode": "markers", "showlegend": False}
        draw(figure, [float(times[-1])], [target], looks(families)[name], **named, **ring)
    return figure


def signal_figure(times: np.ndarray, values: np.ndarray, *, name: str, unit: str = "") -> "Figure":
    """One certain history over time."""
    figure = path_figure(times, components(name, values), y=name, unit=unit)
    return figure.update_layout(showlegend=False, height=300)


def trajectory_figure(
    evidence: Evidence,
    name: str,
    *,
    y: str = "",
    unit: str | None = None,
    who: str = "systems",
    every: int | None = None,
) -> "Figure":
    """Sampled systems over time against the bounds of the constraints called `name` (figures 6.9 and 6.10), in the unit
    of these.

    The first 60 are drawn; those that violate any bound are highlighted. The title gives the share of all samples.

    - `every`: so many instants are drawn as one, by default so many that at most 350 remain.
    """
    sampled, solution = [one for one in evidence.trajectories if one.name == name], evidence.solution
    unit = unit_of_limit(name, solution.problem) if unit is None else unit
    limits = (one for one in solution.problem.constraints if one.name == name and one.is_path)
    instants = next((solution.times_of(one) for one in limits), solution.instants)
    step = every or math.ceil(len(instants) / _SHOWN)
    # Both sides of a pair of bounds measure the same quantity.
    values = {one.values.tobytes(): one for one in sampled}.values()
    pairs = [curves(one.values[:_DRAWN, ::step], one.violating[:_DRAWN]) for one in values]
    histories, share = dict[str, Strokes](), evidence.violations.get(name)
    if pairs:
        rows, broken = (np.concatenate(part) for part in zip(*pairs, strict=True))
        # All quantities have the same systems, which are counted once.
        many, few = len(pairs[0][1]), int(pairs[0][1].sum())
        histories[f"within the limits ({many - few} of {many} drawn)"] = Strokes(rows[~broken], CLOUD)
        histories[f"violating ({few} of {many} drawn)"] = Strokes(rows[broken], ALARM, 0.9)
    return path_figure(
        instants[::step],
        {},
        y=y or name,
        unit=unit,
        histories={name: strokes for name, strokes in histories.items() if len(strokes.rows)},
        limits=limits_text([bound for one in sampled for bound in (one.upper, one.lower)], unit),
        title="" if share is None else f"{share_text(share)} of {who} violate {name}",
    )
