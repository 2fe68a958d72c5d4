"""The paths of a problem, with their limits; and figures over time: means with bands, and histories of systems."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from aleator.design import AbstractFunctional, Constraint, Problem, Statistic, functionals_of, is_worst_case
from aleator.reporting._numbers import given, share_text, unit_of_functional
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
    padded,
    plain,
    short,
)
from aleator.solution import Moments, Motions
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
    sigmas, names, unit = 0.0, set(), unit_of_functional(functional, problem)
    for limit in problem.constraints:
        if functionals_of((limit.expression,)) != (functional,) or not _has_values_of_path(limit):
            continue
        multiple = limit.expression.sigmas or 0.0
        sigmas = max(sigmas, multiple)
        names.add(limit.name)
        for bound in (float(limit.lower), float(limit.upper)):
            if np.isfinite(bound):
                texts[bound] = f"{limit.name}: {given(bound, unit)}{_systems_text(limit, multiple)}"
    return Limits(texts, sigmas or _USUAL, names, unit)


def _systems_text(limit: Constraint, multiple: float) -> str:
    """For which systems a limit holds, in words."""
    if multiple:
        return f" at {multiple:.3g} σ"
    return " in the worst case" if is_worst_case(limit) else ""


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


def components(
    name: str, mean: Float[np.ndarray, "instants ..."], std: Float[np.ndarray, "instants ..."]
) -> dict[str, Moments]:
    """A path by its name; of a vector over time, each component by its own."""
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
    for name, strokes in histories.items():
        _add_strokes(figure, times, name, strokes)
    styles = looks(paths)
    edges = [edge for strokes in histories.values() for edge in ends(strokes.rows)]
    for name, path in paths.items():
        low, high = (path.mean + sign * sigmas * path.std for sign in (-1, 1))
        if name in ranges:
            add_band(figure, times, *ranges[name], styles[name].fill(0.08))
        if np.any(path.std):
            add_band(figure, times, low, high, styles[name].fill(0.25))
        edges += ends(low, high, *ranges.get(name, ()))
    for dash, (name, path) in zip(itertools.cycle(DASHES), paths.items(), strict=False):
        spread = f" ± {sigmas:.3g} σ" if np.any(path.std) else ""
        hover = f"{plain(name)}: %{{y:.4~g}}, σ %{{customdata:.2~g}} {plain(unit)} at %{{x:.3f}} s"
        shown = {"name": f"{name}{spread}", "customdata": short(path.std), "line_dash": dash, "hover": hover}
        draw(figure, short(times), short(path.mean), styles[name], mode="lines", **shown)
    for bound, text in limits.items():
        limit_line(figure, bound, text)
    figure.update_layout(showlegend=True)
    return figure.update_yaxes(range=padded([*edges, *limits], 0.1))


def _add_strokes(figure: "Figure", times: np.ndarray, name: str, strokes: Strokes) -> None:
    """Many curves as one trace, separated by gaps; its legend entry is thick enough for the colour to be seen."""
    if not len(strokes.rows):
        return
    draw(figure, [None], [None], strokes.colour, name=name, mode="lines", line_width=4)
    gap = np.full((len(strokes.rows), 1), np.nan)
    x, y = (np.hstack([part, gap]).ravel() for part in (np.broadcast_to(times, strokes.rows.shape), strokes.rows))
    shown = {"name": name, "line_width": strokes.width, "opacity": 0.7, "showlegend": False}
    draw(figure, short(x), short(y), strokes.colour, mode="lines", **shown)


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
    styles = looks(families)
    for name, target in targets.items():
        ring = {"marker_symbol": "circle-open", "marker_size": 12, "marker_line_width": 2, "cliponaxis": False}
        hover = f"{plain(name)}, target: %{{y:.4~g}}"
        draw(figure, [float(times[-1])], [target], styles[name], mode="markers", hover=hover, showlegend=False, **ring)
    return figure


def signal_figure(times: np.ndarray, values: np.ndarray, *, name: str, unit: str = "") -> "Figure":
    """An input over time (figure 6.2)."""
    figure = blank(label("Time", "s"), label(name, unit), height=300)
    hover = f"%{{y:.4~g}} {plain(unit)} at %{{x:.3f}} s"
    draw(figure, short(times), short(values), looks([name])[name], name=name, mode="lines", hover=hover, line_width=1.5)
    return figure


def trajectory_figure(
    evidence: Evidence,
    name: str,
    *,
    y: str = "",
    unit: str = "",
    who: str = "systems",
    every: int | None = None,
) -> "Figure":
    """Sampled systems over time against the bounds of the constraints called `name` (figures 6.9 and 6.10).

    The first 60 are drawn; those that violate any bound are highlighted. The title gives the share of all samples.

    - `every`: so many instants are drawn as one, by default so many that at most 350 remain.
    """
    sampled, solution = [one for one in evidence.trajectories if one.name == name], evidence.solution
    limits = (one for one in solution.problem.constraints if one.name == name and one.is_path)
    instants = next((solution.times_of(one) for one in limits), solution.instants)
    step = every or math.ceil(len(instants) / _SHOWN)
    # Both sides of a pair of bounds measure the same quantity.
    values = {one.values.tobytes(): one for one in sampled}.values()
    pairs = [curves(one.values[:_DRAWN, ::step], one.violating[:_DRAWN]) for one in values]
    share = evidence.violations.get(name)
    return path_figure(
        instants[::step],
        {},
        y=y or name,
        unit=unit,
        histories=_split(pairs) if pairs else {},
        limits=limits_text([bound for one in sampled for bound in (one.upper, one.lower)], unit),
        title="" if share is None else f"{share_text(share)} of {who} violate {name}",
    )


def _split(
    pairs: Sequence[tuple[Float[np.ndarray, "curves instants"], Bool[np.ndarray, " curves"]]],
) -> dict[str, Strokes]:
    """Curves of systems that keep limits, and of those that break them: with how many there are of the first quantity,
    for all quantities have the same systems.
    """
    rows, broken = (np.concatenate(part) for part in zip(*pairs, strict=True))
    first = pairs[0][1]
    inside, outside = (f"({int(np.sum(one))} of {len(first)} drawn)" for one in (~first, first))
    return {
        f"within the limits {inside}": Strokes(rows[~broken], CLOUD),
        f"violating {outside}": Strokes(rows[broken], ALARM, 0.9),
    }


def ends(*values: np.ndarray) -> Iterator[float]:
    """The least and the largest of the finite values."""
    for one in values:
        known = one[np.isfinite(one)]
        if known.size:
            yield float(known.min())
            yield float(known.max())
