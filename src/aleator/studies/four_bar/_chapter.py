"""The four-bar study: three designs, their linkages simulated and counted by elimination, and which to build."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

import aleator as al
from aleator.design import value_at
from aleator.journalling import kept
from aleator.reporting import (
    Code,
    Drawing,
    Schematic,
    Table,
    Verdict,
    bands_figure,
    bars_figure,
    certificate_table,
    count,
    evidence_table,
    front_figure,
    given,
    linkage_animation,
    linked_front,
    looks,
    number,
    recommendation,
    share_text,
    side_by_side,
    trajectory_figure,
    violations_table,
    words,
)
from aleator.studies._shared import add_second_way, gathered, picture, requirements_active, sampled, signed, stored
from aleator.studies._study import Draft
from aleator.studies.four_bar import (
    COST,
    DURATION,
    FORCE,
    HEIGHT,
    LENGTHS,
    SIGMAS,
    STROKE,
    TORQUE,
    TRANSMISSION,
    WIDTHS,
    ZONE,
    allocation_problem,
    mean_problem,
    nominal_problem,
    robust_problem,
)
from aleator.studies.four_bar._elimination import (
    LEVELS,
    Counts,
    Posture,
    count_linkages,
    drawn_postures,
    posture_of,
    swing,
)

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

NOMINAL, ROBUST, ALLOCATED = "dOpt", "uOpt", "aOpt"
DESIGNS = (NOMINAL, ROBUST, ALLOCATED)
PUBLISHED = "Hoeken"
MEAN = "dOpt at the means"
TARGET = 0.01
"""The share of linkages that may break any limit."""

TEXTS = {
    "crank": "Crank",
    "coupler": "Coupler",
    "rocker": "Rocker",
    "ground": "Ground",
    "along": "Tool along the coupler",
    "across": "Tool across the coupler",
}
PLAYS = {"crank_play": "Radial clearance of the crank's pin", "rocker_play": "Radial clearance of the rocker's pin"}
EXTREMES = {
    "transmission": (np.argmin, f"Least angle of transmission, μ ± σ (°), limit {given(TRANSMISSION)}"),
    "crank_pin": (np.argmax, f"Largest force in the crank's pin, μ ± σ (N), limit {given(FORCE)}"),
    "rocker_pin": (np.argmax, f"Largest force in the rocker's pin, μ ± σ (N), limit {given(FORCE)}"),
    "crank_torque": (np.argmax, f"Largest torque of the motor, μ ± σ (N m), limit {given(TORQUE)}"),
}
BESIDE = ("stroke", "transmission", "crank pin", "rocker pin", "torque")
"""All limits but the zone, which is each design's own."""

COUNT_UNITS = {"outside": "1", "flat": "1", "linkages": "1", "zone": "mm"}
COUNT_UNITS |= {f"deviation_of_{100 * level:.0f}_percent": "mm" for level in LEVELS}
"""What is stored of each count, with units."""

Dimensions = tuple[Mapping[str, float], Mapping[str, float]]
"""Lengths, and tolerances and clearances, mm."""

TITLE = "Four-bar linkage on a straight line: robust lengths and the cheapest tolerances"
SUBTITLE = (
    f"Hoeken's linkage: a stroke of {given(STROKE, 'mm')} at a height of {given(HEIGHT, 'mm')}, within "
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
    ("Shadow price", "The decrease in cost per unit by which a limit is relaxed."),
)
LEFT_OUT = "the mean linkage by direct collocation, and the cost of a narrower zone"


def problems() -> dict[str, al.Problem]:
    """The problems of the three designs."""
    return {NOMINAL: nominal_problem(), ROBUST: robust_problem(), ALLOCATED: allocation_problem()}


def chapter(page: Draft, quick: bool) -> None:
    """The linkage, its three designs, their paths, forces and tolerances, and the mean linkage in a second way."""
    simulated, counted = (1_500, 100_000) if quick else (20_000, 1_000_000)
    page.section("The linkage")
    told = (
        f"To scale. The motor turns the crank by half a turn in {given(DURATION, 's')}, from rest to rest, and back. "
        "θ is its angle, τ the motor's torque. "
        "Uncertain: six lengths, the place of each pin in its clearance, and the mass of the tool."
    )
    beside = [
        Code(f"The problem of {name} as mathematics", str(problem)) for name, problem in page.study.problems.items()
    ]
    page.add(Schematic([picture("four_bar/linkage.svg")], "Hoeken's linkage", told, "", beside))

    page.section("The three designs")
    designs = gathered(page, "designs", al.solve, page.study.problems)
    evidence = sampled(page, designs, simulated)
    page.add(designs_table(designs), violations_table(evidence), printed=True)
    chosen: dict[str, Dimensions] = {name: (lengths_of(one), widths_of(one)) for name, one in designs.items()}
    told = (
        "Press play, or drag the slider: mean linkages and random ones, to scale. Their deviations are too small "
        "to be seen here; the next chapter enlarges them."
    )
    page.add(Drawing([animation(name, *chosen[name]) for name in (ROBUST, ALLOCATED)], "The linkage in motion", told))

    page.section("The path")
    every: dict[str, Dimensions] = {PUBLISHED: (LENGTHS, WIDTHS), **chosen}
    counts = dict[str, Counts]()
    for name, (lengths, widths) in every.items():
        counts[name] = kept(f"linkages, {name}", count_linkages, lengths, widths, counted, progress=page.progress)
    rows = {
        name: (one.outside.count, one.flat.count, one.outside.samples, one.zone, *one.largest)
        for name, one in counts.items()
    }
    page.keep("counts", stored("design", rows, COUNT_UNITS))
    page.recommend(recommended(designs, evidence, counts))
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
        trajectory_figure(evidence[ALLOCATED], limit, y=text, unit=unit, who="linkages", every=1)
        for limit, (text, unit) in quantities.items()
    ]
    told = (
        "Random linkages of aOpt, by inverse dynamics of the closed loop: the multipliers are the force in the "
        "rocker's pin, and Newton's second law for coupler and tool gives that in the crank's pin."
    )
    page.add(Drawing(figures, "Reactions and driving torque", told))

    page.section("Tolerances")
    bars = {"given": WIDTHS, ALLOCATED: chosen[ALLOCATED][1]}
    bars = {name: {_part(width): size for width, size in widths.items()} for name, widths in bars.items()}
    told = (
        "Pins: their radial clearances. All others: tolerances, three standard deviations. "
        f"Every limit keeps a margin of {given(SIGMAS)} σ. Prices are assumed: see the problem as mathematics."
    )
    page.add(Drawing([bars_figure(bars, y="Width ±", unit="mm")], "Tolerances before and after", told))
    if not quick:
        front = al.pareto(allocation_problem(), "zone", np.linspace(0.8, 0.3, 7), progress=page.progress)
        page.keep("front", front)
        figure = front_figure({ALLOCATED: front}, x="Zone allowed ±", x_unit="mm", y="Cost", y_unit="$")
        page.add(linked_front({ALLOCATED: front}, [figure], "The cost of a narrower zone", "Each point is an optimum."))

    page.section("Evidence")
    page.add(evidence_table(evidence))

    if not quick:  # the coordinates that follow the crank are variables too, its closed loop has multipliers
        add_second_way(page, MEAN, mean_problem())

    page.section("Certificate", folded=True)
    page.add(certificate_table(designs))


# --- Designs and counts ----------------------------------------------------------------------------------------------


def lengths_of(solution: al.Solution) -> dict[str, float]:
    """The lengths that a design chose, mm."""
    return {name: float(solution.decisions[f"{name}.nominal"]) for name in LENGTHS}


def widths_of(solution: al.Solution) -> dict[str, float]:
    """The tolerances and clearances of a design, mm."""
    return {name: float(solution.decisions[name]) for name in WIDTHS}


def cost(solution: al.Solution) -> float:
    """What a design's tolerances and clearances cost, $."""
    return value_at(COST, solution.problem, solution.vector)


def designs_table(designs: Mapping[str, al.Solution]) -> Table:
    """The three designs in an engineer's terms."""
    note = (
        f"Limits hold with a margin of {given(SIGMAS)} σ, for dOpt in the mean only. ± of a length is its tolerance, "
        "three standard deviations. The limit 'line' is each design's own zone."
    )
    return side_by_side("Decisions and performance", {name: dict(_column(one)) for name, one in designs.items()}, note)


def _column(design: al.Solution) -> Iterator[tuple[str, str]]:
    lengths, widths = lengths_of(design), widths_of(design)
    for name, text in TEXTS.items():
        yield f"{text} (mm)", f"{number(lengths[name], 5)} ± {number(widths[f'{name}.tolerance'], 3)}"
    for name, text in PLAYS.items():
        yield f"{text} (mm)", number(widths[name], 3)
    yield "Zone that it promises, ± (mm)", number(float(design.decisions["zone"]), 4)
    yield "Cost of tolerances and clearances", f"${cost(design):.2f}"
    for path, (most, text) in EXTREMES.items():
        moments = design.moments[f"{path}(t)"]
        at = int(most(moments.mean))
        yield text, f"{number(moments.mean[at], 4)} ± {number(moments.std[at], 2)}"
    yield "Active limits", words(requirements_active(design))


def counts_table(counts: Mapping[str, Counts]) -> Table:
    """The paths of all designs, counted by elimination."""
    note = (
        f"{count(counts[PUBLISHED].outside.samples)} linkages of each design, by the triangle of coupler and rocker: "
        f"without constraints, multipliers or expansion. {PUBLISHED} has the published lengths and the given "
        "tolerances."
    )
    columns = {
        name: {
            f"Linkages that leave ±{given(ZONE, 'mm')} on the stroke": share_text(one.outside),
            f"Linkages below {given(TRANSMISSION)}° of transmission": share_text(one.flat),
            f"Zone of μ ± {given(SIGMAS)} σ at each place, ± (mm)": number(one.zone, 4),
        }
        | {
            f"Largest deviation that {given(100 * level)} % keep (mm)": number(size, 3)
            for level, size in zip(LEVELS, one.largest, strict=True)
        }
        for name, one in counts.items()
    }
    return side_by_side("Paths counted by elimination", columns, note)


def recommended(
    designs: Mapping[str, al.Solution], evidence: Mapping[str, al.results.Evidence], counts: Mapping[str, Counts]
) -> Verdict:
    """The cheapest tolerances with the lengths that suit them, beside the robust and the nominal design."""
    allocated, robust, zone = designs[ALLOCATED], designs[ROBUST], given(ZONE, "mm")
    outside = {name: share_text(one.outside) for name, one in counts.items()}
    beside = {name: share_text(evidence[name].violation(*BESIDE)) for name in (NOMINAL, ROBUST)}
    promised = {name: number(counts[name].zone, 3, "mm") for name in (NOMINAL, ROBUST)}
    widths, price = widths_of(allocated), next(one for one in allocated.constraints if one.name == "zone").shadow_price
    tightened = [f"{_part(name)} to {number(size, 3, 'mm')}" for name, size in widths.items() if size < WIDTHS[name]]
    widest = max(widths, key=widths.__getitem__)
    labels = {f"{name}.nominal": text for name, text in TEXTS.items()} | PLAYS
    sentences = [
        f"Tolerances and clearances cost ${cost(allocated):.2f} instead of the ${cost(robust):.2f} of the given ones "
        f"({signed(cost(allocated) / cost(robust) - 1)}); a zone wider by 0.1 mm saves about ${price / 10:.2f}. "
        f"Some are widened, up to {number(widths[widest], 3, 'mm')} ({_part(widest)}); tightened: {words(tightened)}.",
        f"Of {count(counts[ALLOCATED].outside.samples)} linkages assembled by elimination {outside[ALLOCATED]} leave "
        f"±{zone} of the line. With the given tolerances it is {outside[PUBLISHED]} of the published linkages, "
        f"{outside[NOMINAL]} of those of the best mean linkage, and {outside[ROBUST]} of those of the robust one.",
        f"With the given tolerances the robust lengths keep ±{promised[ROBUST]} at {given(SIGMAS)} σ, those of the "
        f"best mean linkage ±{promised[NOMINAL]}, although it stays within "
        f"±{number(float(designs[NOMINAL].decisions['zone']), 3, 'mm')} itself.",
        f"Of its linkages {beside[NOMINAL]} miss the stroke, the angle of transmission, or a limit on forces and "
        f"torque, because the mean one lies on such limits; of the robust ones {beside[ROBUST]}.",
    ]
    return recommendation(
        allocated,
        evidence[ALLOCATED],
        labels={name: f"{text.lower()} (mm)" for name, text in labels.items()},
        target=TARGET,
        who="linkages",
        objective="cost of tolerances and clearances, in $:",
        not_verified=["the prices of tolerances and clearances, which are assumed"],
        sentences=sentences,
    )


def _part(width: str) -> str:
    name = width.removesuffix(".tolerance").replace("_play", "'s pin")
    return f"tool {name}" if name in ("along", "across") else name


# --- Figures ---------------------------------------------------------------------------------------------------------


def animation(name: str, lengths: Mapping[str, float], widths: Mapping[str, float]) -> "Figure":
    """The mean linkage and random ones in motion."""
    angles, times = swing()
    family = drawn_postures(lengths, widths, 25, seed=4, instants=angles)
    joints, mean = (_joints(one, lengths["ground"]) for one in (family, posture_of(lengths, angles)))
    return linkage_animation(times, joints, mean, look=looks(DESIGNS)[name], title=name)


def _joints(one: Posture, ground: float) -> np.ndarray:
    """Rocker's bearing and pin, crank's pin, its bearing, its pin again, and the tool, m: one line through all bars."""
    still = np.zeros_like(one.tool)
    support = still + np.array([ground, 0.0])
    return 1e-3 * np.stack([support, one.rocker_pin, one.crank_pin, still, one.crank_pin, one.tool], axis=-2)


def deviation(name: str, lengths: Mapping[str, float], widths: Mapping[str, float]) -> "Figure":
    """The height of random linkages' tools above the line over time."""
    angles, times = swing()
    heights = drawn_postures(lengths, widths, 400, seed=5, instants=angles).tool[..., 1] - HEIGHT
    return bands_figure(times, {"mean": heights}, y="Deviation", unit="mm", limits=(-ZONE, ZONE), title=name)
