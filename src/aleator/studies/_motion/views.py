"""The figures of every motion study: the linkage in motion, paths of its tip, histories of its family."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from aleator.reporting import Drawing, Scene, bands_figure, linkage_animation, looks, plane_figure
from aleator.studies._motion.results import Family

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Outputs = Mapping[str, Float[np.ndarray, "..."]]

SHADES = "Line: mean. Dark band: one σ to each side. Light band: from the minimum to the maximum over all systems."


def linkage(elbow: Float[np.ndarray, "... 2"], outputs: Outputs) -> Float[np.ndarray, "... joints 2"]:
    """Base, elbow and tip of two links, m."""
    tip = np.stack([outputs["tip_x"], outputs["tip_y"]], axis=-1)
    return np.stack([np.zeros_like(tip), elbow, tip], axis=-2)


Joints = Callable[[Outputs], Float[np.ndarray, "... joints 2"]]


def animations(
    families: Mapping[str, Family],
    names: Sequence[str],
    joints: Joints,
    target: Sequence[float],
    scene: Scene,
    every: Sequence[str],
    figure: str = "",
) -> Drawing:
    """Some plans flown on their families, side by side; `every` are all plans of the study, which determines the
    colours.

    `figure` is the number of the figure in the dissertation that shows the same.
    """
    figures = [
        linkage_animation(
            families[name].times,
            joints(families[name].systems),
            joints(families[name].nominal),
            look=looks(every)[name],
            scene=scene,
            target=target,
            title=name.capitalize(),
        )
        for name in names
    ]
    caption = "Press play, or drag the slider. Thin: random systems under the same plan. Thick: the nominal one."
    return Drawing(figures, "The plans in motion", caption, figure)


def tip_paths(
    family: Family,
    name: str,
    joints: Joints,
    target: Sequence[float],
    scene: Scene,
    broken: np.ndarray,
    every: Sequence[str],
) -> "Figure":
    """The path of each system's tip, and which systems break a limit."""
    return plane_figure(
        joints(family.systems)[..., -1, :],
        joints(family.nominal)[..., -1, :],
        look=looks(every)[name],
        scene=scene,
        target=target,
        broken=broken,
        title=name.capitalize(),
    )


def angles_figure(family: Family, title: str, targets: Mapping[str, float] | None = None) -> "Figure":
    """Both joints' angles over time."""
    angles = {"q₁": family.systems["q1"], "q₂": family.systems["q2"]}
    return bands_figure(family.times, angles, y="Joint angle", unit="rad", targets=targets or {}, title=title)


def joints_and_tip(family: Family, angles: Sequence[float], tip: Sequence[float]) -> list["Figure"]:
    """Both joints' angles and the position of the tip over time, with their targets (rad, m)."""
    places = {"x": family.systems["tip_x"], "y": family.systems["tip_y"]}
    ends = {"x": float(tip[0]), "y": float(tip[1])}
    return [
        angles_figure(family, "Joints", {"q₁": angles[0], "q₂": angles[1]}),
        bands_figure(family.times, places, y="Place of the tip", unit="m", targets=ends, title="Tip"),
    ]


def torques_figure(
    times: Float[np.ndarray, " instants"],
    torques: Mapping[str, Float[np.ndarray, "systems instants"]],
    limit: float,
    title: str = "",
) -> "Figure":
    """Torques over time, between their limits (N m)."""
    return bands_figure(times, torques, y="Torque", unit="N m", limits=(-limit, limit), title=title)
