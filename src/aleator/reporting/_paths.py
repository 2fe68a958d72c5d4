"""Figures over time: the paths of a problem with their limits, means with bands, histories of systems; and of motion in
the plane: an animated family of linkages, the paths of a point.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.design import AbstractFunctional, Constraint, Problem, Statistic, functionals_of, is_worst_case
from aleator.reporting._numbers import given, share_text, unit_of, unit_of_limit
from aleator.reporting._style import (
    ALARM,
    CLOUD,
    DASHES,
    INK,
    LIMIT,
    SIZE,
    Look,
    add_band,
    blank,
    draw,
    label,
    legend_at,
    limit_line,
    looks,
    padded,
    plain,
    short,
)
from aleator.solution import Moments
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# The multiple of the standard deviation in a band, where no limit says another.
_USUAL = 2.0
DRAWN = 60
"""Systems that are drawn of many."""
# Instants of theirs.
_SHOWN = 350


# --- What a problem has over time ------------------------------------------------------------------------------------


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
    texts, names, sigmas = dict[float, str](), set[str](), 0.0
    unit = unit_of(functional, problem)
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


# --- What figures over time are made of ------------------------------------------------------------------------------


def timeline(y: str, unit: str = "", limits: Mapping[float, str] | None = None, title: str = "") -> "Figure":
    """An empty figure over time, with limits as lines."""
    figure = blank(label("Time", "s"), label(y, unit), title=plain(title), height=380)
    for bound, text in (limits or {}).items():
        limit_line(figure, bound, text)
    return figure.update_layout(showlegend=True)


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


def add_means(figure: "Figure", times: np.ndarray, paths: Mapping[str, Moments], sigmas: float = _USUAL) -> "Figure":
    """The mean of each path as a line, with the band of `sigmas` standard deviations about it."""
    styles = looks(paths)
    for name, path in paths.items():
        if np.any(path.std):
            low, high = (path.mean + sign * sigmas * path.std for sign in (-1, 1))
            add_band(figure, times, low, high, styles[name].fill(0.25))
    for dash, (name, path) in zip(itertools.cycle(DASHES), paths.items(), strict=False):
        shown: dict[str, Any] = {"name": name, "line_dash": dash}
        if np.any(path.std):
            shown |= {
                "name": f"{name} ± {sigmas:.3g} σ",
                "customdata": short(path.std),
                "hover": "σ: %{customdata:.2~g}",
            }
        draw(figure, short(times), short(path.mean), styles[name], mode="lines", **shown)
    return figure


def add_histories(
    figure: "Figure", times: np.ndarray, values: np.ndarray, colour: str, name: str, width: float = 0.8
) -> "Figure":
    """Histories that are drawn alike, shape (systems, instants, ...): one trace with gaps."""
    rows, _ = curves(values, np.zeros(len(values), dtype=bool))
    # The entry of the legend is thick enough for the colour to be seen.
    draw(figure, [None], [None], colour, name=name, mode="lines", line_width=4)
    gap, along = np.full((len(rows), 1), np.nan), np.broadcast_to(times, rows.shape)
    x, y = (short(np.hstack([part, gap]).ravel()) for part in (along, rows))
    thin = {"line_width": width, "opacity": 0.7, "showlegend": False}
    draw(figure, x, y, colour, name=name, mode="lines", hover=None, **thin)
    return figure


# --- Figures ---------------------------------------------------------------------------------------------------------


def histories_figure(
    times: Float[np.ndarray, " instants"],
    histories: Float[np.ndarray, "systems instants ..."],
    *,
    y: str,
    unit: str = "",
    who: str = "systems",
    limits: Mapping[float, str] | None = None,
    title: str = "",
) -> "Figure":
    """The histories of some realisations, one line for each; of a vector, one for each component too."""
    name = f"{len(histories)} {who if len(histories) != 1 else who.removesuffix('s')}"
    figure, width = timeline(y, unit, limits, title), 0.8 if np.size(histories[:, 0]) > 1 else 2.0
    return add_histories(figure, times, histories, looks([y])[y].colour, name, width)


def bands_figure(
    times: Float[np.ndarray, " instants"],
    families: Mapping[str, Float[np.ndarray, "systems instants"]],
    *,
    y: str,
    unit: str = "",
    limits: Sequence[float] = (),
    targets: Mapping[str, float] | None = None,
    title: str = "",
) -> "Figure":
    """Histories of a family of systems: their mean, the band of one standard deviation about it, and their range.

    - `families`: each quantity on its systems, shape (systems, instants);
    - `limits`: drawn as lines; `targets`: the final value wanted of a quantity, drawn as a ring.
    """
    figure, styles = timeline(y, unit, limits_text(limits, unit), title), looks(families)
    for name, rows in families.items():
        add_band(figure, times, rows.min(axis=0), rows.max(axis=0), styles[name].fill(0.08))
    moments = {name: Moments(rows.mean(axis=0), rows.std(axis=0)) for name, rows in families.items()}
    add_means(figure, times, moments, sigmas=1.0)
    for name, target in (targets or {}).items():
        ring = {"marker_symbol": "circle-open", "marker_size": 12, "marker_line_width": 2, "cliponaxis": False}
        named = {"name": f"{name}, target", "mode": "markers", "showlegend": False}
        draw(figure, [float(times[-1])], [target], styles[name], **named, **ring)
    return figure


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
    unit, share = unit_of_limit(name, solution.problem) if unit is None else unit, evidence.violations.get(name)
    limits = (one for one in solution.problem.constraints if one.name == name and one.is_path)
    instants = next((solution.times_of(one) for one in limits), solution.instants)
    step = every or math.ceil(len(instants) / _SHOWN)
    bounds = limits_text([bound for one in sampled for bound in (one.upper, one.lower)], unit)
    title = "" if share is None else f"{share_text(share)} of {who} violate {name}"
    figure = timeline(y or name, unit, bounds, title)
    # Both sides of a pair of bounds measure the same quantity.
    values = {one.values.tobytes(): one for one in sampled}.values()
    pairs = [curves(one.values[:DRAWN, ::step], one.violating[:DRAWN]) for one in values]
    if pairs:
        rows, broken = (np.concatenate(part) for part in zip(*pairs, strict=True))
        # All quantities have the same systems, which are counted once.
        many, few = len(pairs[0][1]), int(pairs[0][1].sum())
        for said, these, colour in (("within the limits", ~broken, CLOUD), ("violating", broken, ALARM)):
            if these.any():
                counted = f"{said} ({few if colour == ALARM else many - few} of {many} drawn)"
                add_histories(figure, instants[::step], rows[these], colour, counted)
    return figure


# --- Motion in the plane ---------------------------------------------------------------------------------------------

# Instants and systems of an animation, and systems whose paths are drawn.
_FRAMES, _SYSTEMS, _PATHS = 60, 25, 100
Polyline = tuple[list[float | None], list[float | None]]


class Scene(NamedTuple):
    """The fixed objects in the plane: round obstacles as `(x, y, radius)`, m, and a wall to the left of `wall`."""

    discs: Sequence[tuple[float, float, float]] = ()
    wall: float | None = None


def plane_figure(
    paths: Float[np.ndarray, "systems instants 2"],
    nominal: Float[np.ndarray, "instants 2"],
    *,
    look: Look,
    scene: Scene | None = None,
    target: Sequence[float] | None = None,
    broken: np.ndarray | None = None,
    title: str = "",
) -> "Figure":
    """The paths of a point in the plane (m), of each system and of the nominal one.

    Systems that are `broken`, shape (systems,), are highlighted.
    """
    rows = paths[:_PATHS]
    bad = np.zeros(len(rows), bool) if broken is None else np.asarray(broken, bool)[:_PATHS]
    figure = _plane(title, [rows, nominal], scene or Scene(), target)
    for chosen, name, colour in ((~bad, "within the limits", CLOUD), (bad, "violating", ALARM)):
        if chosen.any():
            counted = f"{name} ({int(chosen.sum())} of {len(bad)} drawn)"
            thin = {"name": counted, "line_width": 0.9, "opacity": 0.8}
            draw(figure, *_strokes(rows[chosen]), colour, mode="lines", hover=None, **thin)
    draw(figure, *_listed(nominal), look, name="nominal system", mode="lines", line_width=2.5)
    return figure


def linkage_animation(
    times: Float[np.ndarray, " instants"],
    joints: Float[np.ndarray, "systems instants joints 2"],
    nominal: Float[np.ndarray, "instants joints 2"],
    *,
    look: Look,
    scene: Scene | None = None,
    target: Sequence[float] | None = None,
    title: str = "",
) -> "Figure":
    """A planar linkage in motion, with a button that plays it and a slider over time.

    - `joints`: positions of its joints, from the fixed one to the tip, m; the first 25 systems are shown;
    - `nominal`: the same for the nominal system, which is highlighted.
    """
    chosen = np.unique(np.linspace(0, len(times) - 1, _FRAMES).round().astype(int))
    cloud, mechanism = np.moveaxis(joints[:_SYSTEMS], 1, 0)[chosen], nominal[chosen]
    figure = _plane(title, [cloud, mechanism], scene or Scene(), target, height=640)
    dotted = {"name": "path of the nominal tip", "line_dash": "dot", "line_width": 1.2}
    draw(figure, *_listed(nominal[:, -1]), look, mode="lines", hover=None, **dotted)
    many = {"name": f"{len(joints[:_SYSTEMS])} systems", "line_width": 1.2, "opacity": 0.8}
    draw(figure, *_strokes(cloud[0]), CLOUD, mode="lines", hover=None, **many)
    thick = {"name": "nominal system", "line_width": 5, "marker_line_color": "white", "marker_line_width": 1}
    draw(figure, *_listed(mechanism[0]), Look(look.colour, "circle"), **thick)
    names, moving = [f"{times[i]:.2f}" for i in chosen], [len(figure.data) - 2, len(figure.data) - 1]  # type: ignore[arg-type]
    poses = [(_strokes(family), _listed(arm)) for family, arm in zip(cloud, mechanism, strict=True)]
    figure.frames = [
        {"data": [{"x": x, "y": y, "type": "scatter"} for x, y in pose], "traces": moving, "name": name}
        for pose, name in zip(poses, names, strict=True)
    ]
    _add_controls(figure, names, 1000 * float(times[-1] - times[0]) / len(names))
    return figure


def _add_controls(figure: "Figure", names: Sequence[str], pause: float) -> None:
    """Play and pause below the plot, and a slider over the frames."""
    still: dict[str, Any] = {"frame": {"duration": 0, "redraw": False}, "transition": {"duration": 0}}
    playing = still | {"frame": {"duration": pause, "redraw": False}, "fromcurrent": True}
    still["mode"] = "immediate"
    buttons = [
        {"label": "▶ Play", "method": "animate", "args": [None, playing]},
        {"label": "❚❚ Pause", "method": "animate", "args": [[None], still]},
    ]
    place = {"x": 0, "y": 0, "xanchor": "left", "yanchor": "top"}
    slider = {
        **{"len": 1, "ticklen": 0, "minorticklen": 0, "font": {"color": "rgba(0,0,0,0)", "size": 1}},
        "currentvalue": {"prefix": "t = ", "suffix": " s", "xanchor": "right", "font": {"size": SIZE, "color": INK}},
        "steps": [{"label": name, "method": "animate", "args": [[name], still]} for name in names],
    }
    menu = {"type": "buttons", "direction": "right", "showactive": False, "buttons": buttons}
    # The legend of a figure with a title is below it, as the buttons are.
    figure.update_layout(margin={"b": 150}, legend=legend_at(is_below=False))
    figure.update_layout(updatemenus=[menu | place | {"pad": {"t": 92}}], sliders=[slider | place | {"pad": {"t": 42}}])


def _plane(
    title: str, parts: Sequence[np.ndarray], scene: Scene, target: Sequence[float] | None, height: int = 520
) -> "Figure":
    """A plane with equal scales that contains some points, with its obstacles, its wall and the target of the tip."""
    discs = [np.add([(x, y)], radius * np.array([(-1, -1), (1, 1)])) for x, y, radius in scene.discs]
    every = np.concatenate([np.reshape(part, (-1, 2)) for part in (*parts, *discs)])
    left, right = padded([*every[:, 0], *([] if scene.wall is None else [scene.wall - 0.12])], 0.05)
    low, high = padded(every[:, 1], 0.05)
    figure = blank(label("x", "m"), label("y", "m"), title=title, height=height)
    figure.update_xaxes(range=[left, right], constrain="domain")
    figure.update_yaxes(range=[low, high], scaleanchor="x", scaleratio=1, constrain="domain")
    solid = {"fillcolor": "rgba(51,64,77,0.18)", "line_color": LIMIT, "layer": "below"}
    written = {"font": {"size": SIZE - 2, "color": LIMIT}}
    for (x0, y0), (x1, y1) in discs:
        ends, said = {"x0": x0, "x1": x1, "y0": y0, "y1": y1}, written | {"text": "obstacle"}
        figure.add_shape(type="circle", label=said, line_width=1.3, **ends, **solid)
    if scene.wall is not None:
        ends, said = {"x0": left, "x1": scene.wall, "y0": low, "y1": high}, written | {"text": "wall", "textangle": -90}
        figure.add_shape(type="rect", label=said, line_width=0, **ends, **solid)
    if target is not None:
        thin = {"marker_symbol": "x-thin", "marker_size": 13, "marker_line_width": 2.5, "marker_line_color": INK}
        x, y = ([float(one)] for one in target)
        draw(figure, x, y, INK, name="target of the tip", mode="markers", **thin)
    return figure


def _strokes(rows: Float[np.ndarray, "systems points 2"]) -> Polyline:
    """Many polylines as one, with a gap after each."""
    gap = np.full((len(rows), 1, 2), np.nan)
    return _listed(np.concatenate([rows, gap], axis=1).reshape(-1, 2))


def _listed(points: Float[np.ndarray, "points 2"]) -> Polyline:
    """Coordinates rounded to the resolution of a screen, with None for gaps."""
    x, y = ([None if one != one else round(one, 3) for one in column] for column in np.asarray(points).T.tolist())
    return x, y
