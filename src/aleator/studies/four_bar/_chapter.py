"""The four-bar study: three designs, their linkages simulated and counted by elimination, and which to build."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

import aleator as al
from aleator import reporting
from aleator.design import value_at
from aleator.journalling import kept
from aleator.reporting import Drawing, Table, Verdict, count, given, number, share_text, words
from aleator.studies import four_bar
from aleator.studies._shared import add_second_way, gathered, requirements_active, sampled, stored, system
from aleator.studies._study import Draft
from aleator.studies.four_bar import HEIGHT, LENGTHS, SIGMAS, TRANSMISSION, WIDTHS, ZONE
from aleator.studies.four_bar import _elimination as elimination

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

NOMINAL, ROBUST, ALLOCATED = "dOpt", "uOpt", "aOpt"
DESIGNS = (NOMINAL, ROBUST, ALLOCATED)
PUBLISHED = "Hoeken"
MEAN = "dOpt at the means"
TARGET = 0.01
"""The share of linkages that may break any limit."""

PARTS = {**{name: name for name in LENGTHS}, "along": "tool along the coupler", "across": "tool across the coupler"}
PINS = {"crank_play": "crank's pin", "rocker_play": "rocker's pin"}
BARS = {**{f"{name}.tolerance": text for name, text in PARTS.items()}, **PINS}
"""What lengths, clearances, and the widths of both are called."""

EXTREMES = {
    "transmission": (np.argmin, f"least angle of transmission, μ ± σ (°), limit {given(TRANSMISSION)}"),
    "crank_pin": (np.argmax, f"largest force in the crank's pin, μ ± σ (N), limit {given(four_bar.FORCE)}"),
    "rocker_pin": (np.argmax, f"largest force in the rocker's pin, μ ± σ (N), limit {given(four_bar.FORCE)}"),
    "crank_torque": (np.argmax, f"largest torque of the motor, μ ± σ (N m), limit {given(four_bar.TORQUE)}"),
}

COUNT_UNITS = {"outside": "1", "flat": "1", "linkages": "1", "zone": "mm"}
COUNT_UNITS |= {f"deviation_of_{100 * level:.0f}_percent": "mm" for level in elimination.LEVELS}
"""What is stored of each count, with units."""

TITLE = "Four-bar linkage on a straight line: robust lengths and the cheapest tolerances"
SUBTITLE = (
    f"Hoeken's linkage: a stroke of {given(four_bar.STROKE, 'mm')} at a height of {given(HEIGHT, 'mm')}, within "
    f"±{given(ZONE, 'mm')}; eleven uncertain numbers; inverse dynamics of a closed loop"
)
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
)
LEFT_OUT = "the mean linkage by direct collocation, and the cost of a narrower zone"


def problems() -> dict[str, al.Problem]:
    """The problems of the three designs."""
    return {
        NOMINAL: four_bar.nominal_problem(),
        ROBUST: four_bar.robust_problem(),
        ALLOCATED: four_bar.allocation_problem(),
    }


def chapter(page: Draft, quick: bool) -> None:
    """The linkage, its three designs, their paths, forces and tolerances, and the mean linkage in a second way."""
    simulated, counted = (1_500, 100_000) if quick else (20_000, 1_000_000)

    page.section("The linkage")
    told = (
        f"To scale. The motor turns the crank by half a turn in {given(four_bar.DURATION, 's')}, from rest to rest, "
        "and back. θ is its angle, τ the motor's torque. Uncertain: six lengths, the place of each pin in its "
        "clearance, and the mass of the tool."
    )
    page.add(system(page, "four_bar/linkage.svg", "Hoeken's linkage", told))

    page.section("The three designs")
    designs = gathered(page, "designs", al.solve, page.study.problems)
    evidence = sampled(page, designs, simulated)
    page.add(designs_table(designs), reporting.violations_table(evidence), printed=True)
    chosen = {name: dimensions(one) for name, one in designs.items()}
    told = (
        "Press play, or drag the slider: mean linkages and random ones, to scale. Their deviations are too small "
        "to be seen here; the next chapter enlarges them."
    )
    page.add(Drawing([animation(name, *chosen[name]) for name in (ROBUST, ALLOCATED)], "The linkage in motion", told))

    page.section("The path")
    every = {PUBLISHED: (LENGTHS, WIDTHS), **chosen}
    counts = {
        name: kept(f"linkages, {name}", elimination.count_linkages, *one, counted, progress=page.progress)
        for name, one in every.items()
    }
    rows = {
        name: (one.outside.count, one.flat.count, one.outside.samples, one.zone, *one.largest)
        for name, one in counts.items()
    }
    page.keep("counts", stored("design", rows, COUNT_UNITS))
    page.recommend(recommended(designs, evidence))
    page.add(counts_table(counts), printed=True)
    told = (
        "400 linkages of each design. Line: mean. Dark band: one σ to each side. Light band: from the minimum to "
        "the maximum. dOpt minimises the largest deviation of the line in the middle, uOpt that of the whole band."
    )
    page.add(Drawing([deviation(name, *one) for name, one in every.items()], "Deviation from the line", told))

    page.section("Forces and torque")
    quantities = {
        "crank pin": ("Force in the crank's pin", "N"),
        "rocker pin": ("Force in the rocker's pin", "N"),
        "torque": ("Torque of the motor", "N m"),
    }
    figures = [
        reporting.trajectory_figure(evidence[ALLOCATED], limit, y=text, unit=unit, who="linkages", every=1)
        for limit, (text, unit) in quantities.items()
    ]
    told = (
        "Random linkages of aOpt, by inverse dynamics of the closed loop: the multipliers are the force in the "
        "rocker's pin, and Newton's second law for coupler and tool gives that in the crank's pin."
    )
    page.add(Drawing(figures, "Reactions and driving torque", told))

    page.section("Tolerances")
    bars = {"given": WIDTHS, ALLOCATED: chosen[ALLOCATED][1]}
    bars = {name: {BARS[width]: size for width, size in widths.items()} for name, widths in bars.items()}
    told = (
        "Pins: their radial clearances. All others: tolerances, three standard deviations. "
        f"Every limit keeps a margin of {given(SIGMAS)} σ. Prices are assumed: see the problem as mathematics."
    )
    page.add(Drawing([reporting.bars_figure(bars, y="Width ±", unit="mm")], "Tolerances before and after", told))
    if not quick:
        zones = np.linspace(0.8, 0.3, 7)
        fronts = {ALLOCATED: al.pareto(four_bar.allocation_problem(), "zone", zones, progress=page.progress)}
        page.keep("front", fronts[ALLOCATED])
        figure = reporting.front_figure(fronts, x="Zone allowed ±", x_unit="mm", y="Cost", y_unit="$")
        page.add(reporting.linked_front(fronts, [figure], "The cost of a narrower zone", "Each point is an optimum."))

    page.section("Evidence")
    page.add(reporting.evidence_table(evidence))

    if not quick:  # the coordinates that follow the crank are variables too, its closed loop has multipliers
        add_second_way(page, MEAN, four_bar.mean_problem())

    page.section("Certificate", folded=True)
    page.add(reporting.certificate_table(designs))


# --- Designs and counts ----------------------------------------------------------------------------------------------


def dimensions(solution: al.Solution) -> tuple[dict[str, float], dict[str, float]]:
    """The lengths of a design, and its tolerances and clearances, mm."""
    lengths = {name: float(solution.decisions[f"{name}.nominal"]) for name in LENGTHS}
    return lengths, {name: float(solution.decisions[name]) for name in WIDTHS}


def cost(solution: al.Solution) -> float:
    """What a design's tolerances and clearances cost, $."""
    return value_at(four_bar.COST, solution.problem, solution.vector)


def designs_table(designs: Mapping[str, al.Solution]) -> Table:
    """The three designs in an engineer's terms."""
    note = (
        f"Limits hold with a margin of {given(SIGMAS)} σ, for dOpt in the mean only. ± of a length is its tolerance, "
        "three standard deviations. The limit 'line' is each design's own zone."
    )
    columns = {}
    for name, one in designs.items():
        lengths, widths = dimensions(one)
        columns[name] = {
            f"{PARTS[part]} (mm)": f"{number(size, 5)} ± {number(widths[f'{part}.tolerance'], 3)}"
            for part, size in lengths.items()
        }
        columns[name] |= {f"clearance of the {text} (mm)": number(widths[pin], 3) for pin, text in PINS.items()}
        columns[name]["zone that it promises, ± (mm)"] = number(float(one.decisions["zone"]), 4)
        columns[name]["cost of tolerances and clearances"] = f"${cost(one):.2f}"
        for path, (extreme, text) in EXTREMES.items():
            moments = one.moments[f"{path}(t)"]
            at = int(extreme(moments.mean))
            columns[name][text] = f"{number(moments.mean[at], 4)} ± {number(moments.std[at], 2)}"
        columns[name]["active limits"] = words(requirements_active(one))
    return reporting.side_by_side("Decisions and performance", columns, note)


def counts_table(counts: Mapping[str, elimination.Counts]) -> Table:
    """The paths of all designs, counted by elimination."""
    note = (
        f"{count(counts[PUBLISHED].outside.samples)} linkages of each design, by the triangle of coupler and rocker: "
        f"without constraints, multipliers or expansion. {PUBLISHED} has the published lengths and the given "
        "tolerances."
    )
    columns = {}
    for name, one in counts.items():
        columns[name] = {
            f"Linkages that leave ±{given(ZONE, 'mm')} on the stroke": share_text(one.outside),
            f"Linkages below {given(TRANSMISSION)}° of transmission": share_text(one.flat),
            f"Zone of μ ± {given(SIGMAS)} σ at each place, ± (mm)": number(one.zone, 4),
        }
        for level, size in zip(elimination.LEVELS, one.largest, strict=True):
            columns[name][f"Largest deviation that {given(100 * level)} % keep (mm)"] = number(size, 3)
    return reporting.side_by_side("Paths counted by elimination", columns, note)


def recommended(designs: Mapping[str, al.Solution], evidence: Mapping[str, al.results.Evidence]) -> Verdict:
    """The cheapest tolerances with the lengths that suit them."""
    allocated, robust = designs[ALLOCATED], designs[ROBUST]
    price = next(one for one in allocated.constraints if one.name == "zone").shadow_price
    tightened = [BARS[name] for name, size in dimensions(allocated)[1].items() if size < WIDTHS[name]]
    return reporting.recommendation(
        allocated,
        evidence[ALLOCATED],
        labels={f"{name}.nominal": f"{text} (mm)" for name, text in PARTS.items()}
        | {name: f"clearance of the {text} (mm)" for name, text in PINS.items()},
        target=TARGET,
        who="linkages",
        objective="cost of tolerances and clearances, in $:",
        not_verified=["the prices of tolerances and clearances, which are assumed"],
        sentences=[
            f"Tolerances and clearances cost ${cost(allocated):.2f} instead of the ${cost(robust):.2f} of the given "
            f"ones; a zone wider by 0.1 mm saves about ${price / 10:.2f}. Tightened are: {words(tightened)}; all the "
            "others are widened."
        ],
    )


# --- Figures ---------------------------------------------------------------------------------------------------------


def animation(name: str, lengths: Mapping[str, float], widths: Mapping[str, float]) -> "Figure":
    """The mean linkage and random ones in motion."""
    angles, times = elimination.swing()
    family = elimination.drawn_postures(lengths, widths, 25, seed=4, instants=angles)
    joints, mean = (_joints(one, lengths["ground"]) for one in (family, elimination.posture_of(lengths, angles)))
    return reporting.linkage_animation(times, joints, mean, look=reporting.looks(DESIGNS)[name], title=name)


def _joints(one: elimination.Posture, ground: float) -> np.ndarray:
    """Rocker's bearing and pin, crank's pin, its bearing, its pin again, and the tool, m: one line through all bars."""
    still = np.zeros_like(one.tool)
    support = still + np.array([ground, 0.0])
    return 1e-3 * np.stack([support, one.rocker_pin, one.crank_pin, still, one.crank_pin, one.tool], axis=-2)


def deviation(name: str, lengths: Mapping[str, float], widths: Mapping[str, float]) -> "Figure":
    """The height of random linkages' tools above the line over time."""
    angles, times = elimination.swing()
    heights = {"mean": elimination.drawn_postures(lengths, widths, 400, seed=5, instants=angles).tool[..., 1] - HEIGHT}
    return reporting.bands_figure(times, heights, y="Deviation", unit="mm", limits=(-ZONE, ZONE), title=name)
