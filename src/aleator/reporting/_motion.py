"""Figures of motion in the plane: an animated family of linkages, and the paths of a point."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.reporting._style import ALARM, CLOUD, INK, LIMIT, SIZE, Look, blank, draw, label, legend_at, padded

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

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
