"""Figures of motion: an animated family of mechanisms, paths in the plane, histories with their spread."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.reporting._numbers import given
from aleator.reporting._style import (
    ALARM,
    INK,
    LIMIT,
    SIZE,
    Look,
    add_band,
    blank,
    label,
    limit_line,
    looks,
    padded,
    plain,
    short,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

FRAMES, DRAWN = 60, 25
_CLOUD = "#a9b4bf"
_SHADE = "rgba(51,64,77,0.18)"

Systems = Float[np.ndarray, "systems instants"]


class Scene(NamedTuple):
    """The fixed objects in the plane: round obstacles as `(x, y, radius)`, m, and a wall to the left of `wall`."""

    discs: Sequence[tuple[float, float, float]] = ()
    wall: float | None = None


def bands_figure(
    times: Float[np.ndarray, " instants"],
    families: Mapping[str, Systems],
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
    figure = blank(label("Time", "s"), label(y, unit), title=title, height=380)
    styles = looks(families)
    for name, rows in families.items():
        mean, std = rows.mean(axis=0), rows.std(axis=0)
        add_band(figure, times, rows.min(axis=0), rows.max(axis=0), styles[name].fill(0.08))
        add_band(figure, times, mean - std, mean + std, styles[name].fill(0.25))
    for name, rows in families.items():
        mean, std = rows.mean(axis=0), rows.std(axis=0)
        figure.add_scatter(
            x=short(times),
            y=short(mean),
            customdata=short(std),
            mode="lines",
            name=plain(name),
            line={"color": styles[name].colour, "width": 2},
            hovertemplate=(
                f"{plain(name)}: %{{y:.4~g}} ± %{{customdata:.2~g}} {plain(unit)} at %{{x:.3f}} s<extra></extra>"
            ),
        )
        if targets and name in targets:
            _ring(figure, float(times[-1]), targets[name], styles[name], f"{plain(name)}, target")
    for limit in limits:
        limit_line(figure, limit, f"limit {given(limit, unit)}", under=limit < 0)
    reached = [edge(rows) for rows in families.values() for edge in (np.min, np.max)]
    figure.update_yaxes(range=padded([*reached, *limits], 0.1))
    return figure


def _ring(figure: "Figure", x: float, y: float, look: Look, text: str) -> None:
    figure.add_scatter(
        x=[x],
        y=[y],
        mode="markers",
        marker={"symbol": "circle-open", "size": 12, "color": look.colour, "line": {"width": 2}},
        showlegend=False,
        cliponaxis=False,
        hovertemplate=f"{text}: %{{y:.4~g}}<extra></extra>",
    )


def plane_figure(
    paths: Float[np.ndarray, "systems instants 2"],
    nominal: Float[np.ndarray, "instants 2"],
    *,
    look: Look,
    scene: Scene | None = None,
    target: Sequence[float] | None = None,
    broken: np.ndarray | None = None,
    title: str = "",
    drawn: int = 4 * DRAWN,
) -> "Figure":
    """The paths of a point in the plane (m), of each system and of the nominal one.

    Systems that are `broken`, shape (systems,), are highlighted.
    """
    scene = scene or Scene()
    figure = _plane(title, _extent([paths[:drawn], nominal], scene), scene)
    bad = np.zeros(len(paths), bool) if broken is None else np.asarray(broken, bool)
    rows, bad = paths[:drawn], bad[:drawn]
    for chosen, name, colour in (
        (rows[~bad], f"within the limits ({int((~bad).sum())} of {len(bad)} drawn)", _CLOUD),
        (rows[bad], f"violating ({int(bad.sum())} of {len(bad)} drawn)", ALARM),
    ):
        if len(chosen):
            x, y = _strokes(chosen)
            line = {"color": colour, "width": 0.9}
            figure.add_scatter(x=x, y=y, mode="lines", name=name, line=line, opacity=0.8, hoverinfo="skip")
    figure.add_scatter(
        x=short(nominal[:, 0]),
        y=short(nominal[:, 1]),
        mode="lines",
        name="nominal system",
        line={"color": look.colour, "width": 2.5},
        hovertemplate="x %{x:.3f} m, y %{y:.3f} m<extra></extra>",
    )
    if target is not None:
        _cross(figure, target)
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
    frames: int = FRAMES,
    drawn: int = DRAWN,
) -> "Figure":
    """A planar linkage in motion, with a button that plays it and a slider over time.

    - `joints`: positions of its joints, from the fixed one to the tip, m; the first `drawn` systems are shown;
    - `nominal`: the same for the nominal system, which is highlighted.
    """
    from plotly.graph_objects import Frame

    scene = scene or Scene()
    chosen = np.unique(np.linspace(0, len(times) - 1, frames).round().astype(int))
    cloud, mechanism = np.moveaxis(joints[:drawn], 1, 0)[chosen], nominal[chosen]
    figure = _plane(title, _extent([cloud, mechanism], scene), scene, height=640)
    figure.add_scatter(
        x=_listed(nominal[:, -1, 0]),
        y=_listed(nominal[:, -1, 1]),
        mode="lines",
        name="path of the nominal tip",
        line={"color": look.colour, "width": 1.2, "dash": "dot"},
        hoverinfo="skip",
    )
    moving = [_pose(cloud[i], mechanism[i], look) for i in range(len(chosen))]
    for trace in moving[0]:
        figure.add_scatter(**trace)
    if target is not None:
        _cross(figure, target)
    names = [f"{times[i]:.2f}" for i in chosen]
    figure.frames = [
        Frame(data=[{"x": one["x"], "y": one["y"], "type": "scatter"} for one in pose], traces=[1, 2], name=name)
        for pose, name in zip(moving, names, strict=True)
    ]
    _add_controls(figure, names, 1000 * float(times[-1] - times[0]) / len(names))
    return figure


def _pose(cloud: np.ndarray, nominal: np.ndarray, look: Look) -> list[dict[str, Any]]:
    """The family and the nominal mechanism at one instant, as traces."""
    x, y = _strokes(cloud)
    family = {"x": x, "y": y, "name": f"{len(cloud)} systems", "line": {"color": _CLOUD, "width": 1.2}, "opacity": 0.8}
    marker = {"size": 9, "color": look.colour, "line": {"color": "white", "width": 1}}
    arm = {
        "x": _listed(nominal[:, 0]),
        "y": _listed(nominal[:, 1]),
        "name": "nominal system",
        "line": {"color": look.colour, "width": 5},
        "marker": marker,
    }
    shared = {"hoverinfo": "skip"}
    return [{**family, **shared, "mode": "lines"}, {**arm, **shared, "mode": "lines+markers"}]


def _add_controls(figure: "Figure", names: Sequence[str], pause: float) -> None:
    """Play and pause below the plot, and a slider over the frames."""

    def jump(duration: float) -> dict[str, Any]:
        return {"frame": {"duration": duration, "redraw": False}, "transition": {"duration": 0}, "fromcurrent": True}

    still = {**jump(0), "mode": "immediate"}
    figure.update_layout(
        margin={"b": 150},
        updatemenus=[
            {
                "type": "buttons",
                "direction": "right",
                "showactive": False,
                "x": 0,
                "y": 0,
                "xanchor": "left",
                "yanchor": "top",
                "pad": {"t": 92},
                "buttons": [
                    {"label": "▶ Play", "method": "animate", "args": [None, jump(pause)]},
                    {"label": "❚❚ Pause", "method": "animate", "args": [[None], still]},
                ],
            }
        ],
        sliders=[
            {
                "x": 0,
                "len": 1,
                "y": 0,
                "pad": {"t": 42, "l": 6, "r": 6},
                "ticklen": 0,
                "minorticklen": 0,
                "font": {"color": "rgba(0,0,0,0)", "size": 1},
                "currentvalue": {
                    "prefix": "t = ",
                    "suffix": " s",
                    "xanchor": "right",
                    "offset": 4,
                    "font": {"size": SIZE, "color": INK},
                },
                "steps": [{"label": name, "method": "animate", "args": [[name], still]} for name in names],
            }
        ],
    )


def _plane(title: str, extent: tuple[list[float], list[float]], scene: Scene, height: int = 520) -> "Figure":
    """An empty plane with equal scales, its obstacles and its wall."""
    figure = blank(label("x", "m"), label("y", "m"), title=title, height=height)
    figure.update_xaxes(range=extent[0], constrain="domain")
    figure.update_yaxes(range=extent[1], scaleanchor="x", scaleratio=1, constrain="domain")
    for x, y, radius in scene.discs:
        ends = {"x0": x - radius, "x1": x + radius, "y0": y - radius, "y1": y + radius}
        figure.add_shape(type="circle", **ends, fillcolor=_SHADE, line={"color": LIMIT, "width": 1.3}, layer="below")
        figure.add_annotation(x=x, y=y, text="obstacle", showarrow=False, font={"size": SIZE - 2, "color": LIMIT})
    if scene.wall is not None:
        ends = {"x0": extent[0][0], "x1": scene.wall, "y0": extent[1][0], "y1": extent[1][1]}
        figure.add_shape(type="rect", **ends, fillcolor=_SHADE, line={"width": 0}, layer="below")
        middle = (extent[0][0] + scene.wall) / 2
        note = {"text": "wall", "showarrow": False, "textangle": -90, "font": {"size": SIZE - 2, "color": LIMIT}}
        figure.add_annotation(x=middle, y=(extent[1][0] + extent[1][1]) / 2, **note)
    return figure


def _extent(parts: Sequence[np.ndarray], scene: Scene) -> tuple[list[float], list[float]]:
    """Ranges that contain all points and fixed objects."""
    xs = [edge(part[..., 0]) for part in parts for edge in (np.min, np.max)]
    ys = [edge(part[..., 1]) for part in parts for edge in (np.min, np.max)]
    xs += [x + side * radius for x, _, radius in scene.discs for side in (-1, 1)]
    ys += [y + side * radius for _, y, radius in scene.discs for side in (-1, 1)]
    xs += [] if scene.wall is None else [scene.wall - 0.12]
    return padded(xs, 0.05), padded(ys, 0.05)


def _cross(figure: "Figure", target: Sequence[float]) -> None:
    figure.add_scatter(
        x=[float(target[0])],
        y=[float(target[1])],
        mode="markers",
        name="target of the tip",
        marker={"symbol": "x-thin", "size": 13, "line": {"color": INK, "width": 2.5}},
        hoverinfo="skip",
    )


def _strokes(rows: Float[np.ndarray, "systems points 2"]) -> tuple[list[float | None], list[float | None]]:
    """Many polylines as one, with a gap after each."""
    gap = np.full((len(rows), 1, 2), np.nan)
    joined = np.concatenate([rows, gap], axis=1).reshape(-1, 2)
    return _listed(joined[:, 0]), _listed(joined[:, 1])


def _listed(values: np.ndarray) -> list[float | None]:
    """Coordinates rounded to the resolution of a screen, with None for gaps."""
    return [None if value != value else round(value, 3) for value in np.asarray(values, dtype=float).tolist()]
