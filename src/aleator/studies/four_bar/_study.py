"""The four-bar study: a drawing to scale, the chapters of its page, and its declaration."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import numpy as np
from typing_extensions import override

import aleator as al
from aleator.reporting import (
    Block,
    Code,
    Drawing,
    Schematic,
    Section,
    Table,
    Verdict,
    bands_figure,
    bars_figure,
    certificate_table,
    evidence_table,
    front_figure,
    given,
    linkage_animation,
    linked_front,
    looks,
    sketch,
    trajectory_figure,
)
from aleator.reporting.sketch import Point, View
from aleator.studies._shared import collocated, second_way
from aleator.studies._staged import AbstractStagedStudy, Stage
from aleator.studies.four_bar import ANGLES, DURATION, HEIGHT, LENGTHS, SIGMAS, STROKE, WIDTHS, ZONE
from aleator.studies.four_bar._facts import counts_dataset, counts_table, designs_table, verdict
from aleator.studies.four_bar._run import (
    ALLOCATED,
    DESIGNS,
    FULL,
    MEAN,
    QUICK,
    ROBUST,
    Effort,
    FourBarResults,
    Posture,
    crank_angles,
    dimensions,
    drawn_postures,
    lengths_of,
    posture,
    problems,
    stages,
    widths_of,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_WIDTH, _HEIGHT = 460.0, 400.0
SHOWN = 2.3
"""The crank's angle in the drawing, rad."""

GLOSSARY = (
    ("dOpt", "Deterministic optimum: the lengths for which the mean linkage keeps the narrowest zone about the line."),
    ("uOpt", "Robust optimum: the same lengths chosen for all linkages of the given tolerances."),
    ("aOpt", "Apportioned optimum: tolerances and clearances are chosen too, at minimum cost, for the given zone."),
    ("Hoeken", "The published linkage: coupler, rocker and ground are 2.8, 2.8 and 2.2 cranks long."),
    ("Zone", "The tool stays within plus and minus half its width of the line, at each place of the stroke."),
    ("x, deviation", "The tool's place along the line from the crank's bearing, and its height above the line, mm."),
    ("Tolerance", "A length is normal about its nominal value with a standard deviation of a third of its tolerance."),
    ("Clearance", "A pin sits at a random place: both components normal, with σ a third of the radial clearance."),
    ("Angle of transmission", "Between coupler and rocker: the smaller, the larger are the forces in the pins."),
    ("Multipliers", "The forces that close the loop: that in the rocker's pin, along x and y."),
    ("Shadow price", "The decrease in cost per unit by which a limit is relaxed."),
)
DRAWN = 25
SPREAD = 400


def posture_of(lengths: Mapping[str, float], angles: np.ndarray) -> Posture:
    """The mean linkage of some lengths (mm) at crank angles."""
    none = np.zeros(2)
    return posture(angles, {name: np.asarray(one) for name, one in lengths.items()}, none, none)


def linkage_drawing(lengths: Mapping[str, float] = LENGTHS) -> str:
    """The linkage of some lengths (mm) as SVG, its tool's path dashed."""
    at = View((150.0, 350.0), 0.62)
    now, path = posture_of(lengths, np.array(SHOWN)), posture_of(lengths, crank_angles()).tool
    bearing, support = at(0, 0), at(lengths["ground"], 0)
    pin, end, tool = (_point(at, one) for one in (now.crank_pin, now.rocker_pin, now.tool))
    parts = [
        sketch.path([_point(at, one) for one in path], kind="line", width=1.4, dash=sketch.DASHED),
        sketch.path([bearing, pin], kind="crank", width=5.0),
        sketch.path([pin, end, tool], kind="coupler", width=5.0),
        sketch.path([support, end], kind="rocker", width=5.0),
        *(sketch.circle(one, 5.0, filled=True) for one in (bearing, support, pin, end)),
        sketch.circle(tool, 10.0, kind="tool"),
        *(sketch.ground((x + 18, y + 14), (x - 18, y + 14)) for x, y in (bearing, support)),
        sketch.arc(bearing, 30.0, 0.0, float(np.rad2deg(SHOWN)), arrow=True, kind="angle"),
        sketch.label((bearing[0] + 44, bearing[1] - 12), "θ, τ", anchor="start"),
        sketch.label(_between(bearing, pin, -16), "crank", anchor="end"),
        sketch.label(_between(pin, end, -12), "coupler", anchor="end"),
        sketch.label(_between(support, end, 12), "rocker", anchor="start"),
        sketch.label((tool[0], tool[1] - 18), "tool"),
    ]
    ends = " to ".join(f"{np.rad2deg(one):.0f}°" for one in ANGLES)
    title = f"Four-bar linkage whose tool follows an almost straight line while the crank swings from {ends}"
    return sketch.drawing(parts, width=_WIDTH, height=_HEIGHT, title=title)


def _point(at: View, place: np.ndarray) -> Point:
    return at(float(place[0]), float(place[1]))


def _between(start: Point, end: Point, aside: float) -> Point:
    return (start[0] + end[0]) / 2 + aside, (start[1] + end[1]) / 2


def _schematic(results: FourBarResults) -> Schematic:
    caption = (
        f"To scale. The motor turns the crank by half a turn in {given(DURATION, 's')}, from rest to rest, and back. "
        "θ is its angle, τ the motor's torque. "
        "Uncertain: six lengths, the place of each pin in its clearance, and the mass of the tool."
    )
    beside = [Code(f"The problem of {name} as mathematics", one.problem_text) for name, one in results.designs.items()]
    return Schematic([linkage_drawing()], "Hoeken's linkage", caption, "", beside)


def _designs(results: FourBarResults) -> Iterator[Block]:
    if results.designs:
        yield designs_table(results)
        figures = [_animation(results, name) for name in (ROBUST, ALLOCATED) if name in results.designs]
        caption = (
            "Press play, or drag the slider: mean linkages and random ones, to scale. Their deviations are too small "
            "to be seen here; the next chapter enlarges them."
        )
        if figures:
            yield Drawing(figures, "The linkage in motion", caption)


def _animation(results: FourBarResults, name: str) -> "Figure":
    angles, times = _motion()
    lengths, widths = lengths_of(results.designs[name]), widths_of(results.designs[name])
    family = drawn_postures(lengths, widths, DRAWN, seed=4, instants=angles)
    mean = posture_of(lengths, angles)
    return linkage_animation(
        times,
        _joints(family, lengths["ground"]),
        _joints(mean, lengths["ground"]),
        look=looks(DESIGNS)[name],
        title=name,
    )


def _motion(count: int = 61) -> tuple[np.ndarray, np.ndarray]:
    """Angles of the crank, rad, evenly spaced in time, and the instants, s: the quintic from rest to rest."""
    share = np.linspace(0.0, 1.0, count)
    angles = crank_angles(2)
    return angles[0] + (angles[1] - angles[0]) * share**3 * (10 - 15 * share + 6 * share**2), DURATION * share


def _joints(one: Posture, ground: float) -> np.ndarray:
    """Rocker's bearing and pin, crank's pin, its bearing, its pin again, and the tool, m: one line through all bars."""
    still = np.zeros_like(one.tool)
    support = still + np.array([ground, 0.0])
    return 1e-3 * np.stack([support, one.rocker_pin, one.crank_pin, still, one.crank_pin, one.tool], axis=-2)


def _paths(results: FourBarResults) -> Iterator[Block]:
    if not results.counts:
        return
    yield counts_table(results)
    angles, times = _motion()
    figures = []
    for name, (lengths, widths) in dimensions(results).items():
        heights = drawn_postures(lengths, widths, SPREAD, seed=5, instants=angles).tool[..., 1] - HEIGHT
        figures.append(
            bands_figure(times, {"mean": heights}, y="Deviation", unit="mm", limits=(-ZONE, ZONE), title=name)
        )
    caption = (
        f"{SPREAD} linkages of each design. Line: mean. Dark band: one σ to each side. Light band: from the minimum to "
        "the maximum. dOpt minimises the largest deviation of the line in the middle, uOpt that of the whole band."
    )
    yield Drawing(figures, "Deviation from the line", caption)


def _forces(results: FourBarResults) -> Iterator[Block]:
    one = results.evidence.get(ALLOCATED)
    if one is None:
        return
    figures = [
        trajectory_figure(one, name, y=text, unit=unit, who="linkages", every=1)
        for name, text, unit in (
            ("crank pin", "Force in the crank's pin", "N"),
            ("rocker pin", "Force in the rocker's pin", "N"),
            ("torque", "Torque of the motor", "N m"),
        )
    ]
    caption = (
        "Random linkages of aOpt, by inverse dynamics of the closed loop: the multipliers are the force in the "
        "rocker's pin, and Newton's second law for coupler and tool gives that in the crank's pin."
    )
    yield Drawing(figures, "Reactions and driving torque", caption)


def _tolerances(results: FourBarResults) -> Iterator[Block]:
    if ALLOCATED in results.designs and results.designs[ALLOCATED].ok:
        chosen = widths_of(results.designs[ALLOCATED])
        bars = {
            name: {_short(key): value for key, value in one.items()}
            for name, one in {"given": WIDTHS, ALLOCATED: chosen}.items()
        }
        caption = (
            "Pins: their radial clearances. All others: tolerances, three standard deviations. "
            f"Every limit keeps a margin of {given(SIGMAS)} σ. Prices are assumed: see the problem as mathematics."
        )
        yield Drawing([bars_figure(bars, y="Width ±", unit="mm")], "Tolerances before and after", caption)
    if results.front is not None:
        fronts = {ALLOCATED: results.front}
        figure = front_figure(fronts, x="Zone allowed ±", x_unit="mm", y="Cost", y_unit="$")
        yield linked_front(fronts, [figure], "The cost of a narrower zone", "Each point is an optimum.")


def _short(width: str) -> str:
    name = width.removesuffix(".tolerance").replace("_play", "'s pin")
    return f"tool {name}" if name in ("along", "across") else name


@final
class FourBarStudy(AbstractStagedStudy):
    """Three designs of a straight-line linkage, their evidence, and the cost of a narrower zone."""

    title = "Four-bar linkage on a straight line: robust lengths and the cheapest tolerances"
    subtitle = (
        f"Hoeken's linkage: a stroke of {given(STROKE, 'mm')} at a height of {given(HEIGHT, 'mm')}, within "
        f"±{given(ZONE, 'mm')}; eleven uncertain numbers; inverse dynamics of a closed loop"
    )
    glossary = GLOSSARY
    full, quick = FULL, QUICK

    def __init__(self, effort: Effort):
        self.found = FourBarResults(effort)

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return problems()

    @property
    @override
    def stages(self) -> Mapping[str, Stage]:
        return stages(self.found)

    @property
    @override
    def left_out(self) -> str:
        if self.found.effort.front_points:
            return ""
        return "the mean linkage by direct collocation, and the cost of a narrower zone"

    @override
    def results(self) -> Mapping[str, Any]:
        found = self.found
        return {
            "designs": found.designs,
            "evidence": found.evidence,
            "counts": counts_dataset(found.counts) if found.counts else None,
            "front": found.front,
            "collocated": collocated(MEAN, found.second_way),
        }

    @override
    def verdict(self) -> Verdict:
        return verdict(self.found)

    @override
    def sections(self) -> Sequence[Section]:
        results = self.found
        return [
            Section("The linkage", [_schematic(results)]),
            Section("The three designs", list(_designs(results))),
            Section("The path", list(_paths(results))),
            Section("Forces and torque", list(_forces(results))),
            Section("Tolerances", list(_tolerances(results))),
            Section("Evidence", [evidence_table(results.evidence)] if results.evidence else []),
            Section("Certificate", [certificate_table(results.designs)] if results.designs else []),
            second_way(MEAN, results.second_way),
        ]

    @override
    def cut_short(self) -> Iterator[str]:
        front = self.found.front
        if front is not None and front.interrupted:
            done = len(front.values)
            yield f"Of the front {done} of {self.found.effort.front_points} points are finished and shown."

    @override
    def tables(self) -> list[Table]:
        found = self.found
        shown = [designs_table(found)] if found.designs else []
        return [*shown, counts_table(found)] if found.counts else shown
