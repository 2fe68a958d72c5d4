"""The four-bar study: three designs, their linkages simulated and counted, and which to build."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

import aleator as al
from aleator import reporting
from aleator.design import value_at
from aleator.journalling import kept
from aleator.reporting import Drawing, Table, given, number, share_text, words
from aleator.studies import four_bar
from aleator.studies._shared import add_trust, comparison, gathered, sampled, system, to_build
from aleator.studies._study import Draft
from aleator.studies.four_bar import HEIGHT, LENGTHS, SIGMAS, WIDTHS, ZONE

NOMINAL, ROBUST, ALLOCATED, HOEKEN = "dOpt", "uOpt", "aOpt", "Hoeken"
PARTS = {**{name: name for name in LENGTHS}, "along": "tool along the coupler", "across": "tool across the coupler"}
PINS = {"crank_play": "crank's pin", "rocker_play": "rocker's pin"}
BARS = {**{f"{name}.tolerance": text for name, text in PARTS.items()}, **PINS}
"""What lengths, clearances, and the widths of both are called."""

PUBLISHED = {f"Half the range of the mean deviation, {HOEKEN} (mm)": f"{0.00096 * four_bar.STROKE / 2:.3f}"}
"""0.096 % of the stroke, above and below the line together (Norton, Design of Machinery, chapter 3)."""

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
    ("Tolerance", "A length is normal about its nominal value with a standard deviation of a third of its tolerance."),
    ("Clearance", "A pin sits at a random place: both components normal, with σ a third of the radial clearance."),
    ("Angle of transmission", "Between coupler and rocker: the smaller, the larger are the forces in the pins."),
)
LEFT_OUT = "most of its samples"


def problems() -> dict[str, al.Problem]:
    """The problems of the three designs."""
    return {
        NOMINAL: four_bar.nominal_problem(),
        ROBUST: four_bar.robust_problem(),
        ALLOCATED: four_bar.allocation_problem(),
    }


def chapter(page: Draft, quick: bool) -> None:
    """The linkage, its three designs, their paths and forces."""
    samples = 1_500 if quick else 20_000

    told = (
        f"To scale. The motor turns the crank by half a turn in {given(four_bar.DURATION, 's')}, from rest to rest, "
        "and back. θ is its angle, τ the motor's torque. Uncertain: six lengths, the place of each pin in its "
        "clearance, and the mass of the tool."
    )
    page.section("The linkage", system(page, "four_bar/linkage.svg", "Hoeken's linkage", told))

    page.section("The three designs")
    designs = gathered(page, "designs", al.solve, page.study.problems)
    evidence = sampled(page, designs, samples)
    page.add(reporting.designs_table(designs, evidence), printed=True)
    allocated, cheapest = designs[ALLOCATED], cost(designs[ALLOCATED])
    price = next(one for one in allocated.constraints if one.name == "zone").shadow_price
    tightened = [text for width, text in BARS.items() if allocated.decisions[width] < WIDTHS[width]]
    page.recommend(
        to_build(
            None,
            allocated,
            evidence[ALLOCATED],
            labels={f"{name}.nominal": f"{text} (mm)" for name, text in PARTS.items()}
            | {name: f"clearance of the {text} (mm)" for name, text in PINS.items()},
            who="linkages",
            objective="cost of tolerances and clearances, in $:",
            not_verified=["the prices of tolerances and clearances, which are assumed"],
            sentences=[
                f"Tolerances and clearances cost ${cheapest:.2f} instead of the ${cost(designs[ROBUST]):.2f} of the "
                f"given ones; a zone wider by 0.1 mm saves about ${price / 10:.2f}. Tightened are: "
                f"{words(tightened)}; all the others are widened."
            ],
        )
    )

    page.section("The path")
    # The search starts from the published linkage.
    published = replace(designs[ROBUST], vector=designs[ROBUST].problem.placements.vector("initial"))
    families = {
        name: kept(f"linkages, {name}", al.simulate_systems, one, samples, seed=5)
        for name, one in {HOEKEN: published, **designs}.items()
    }
    page.add(compared(families), printed=True)
    told = (
        "Line: mean. Dark band: one σ to each side. Light band: from the minimum to the maximum. dOpt minimises the "
        "largest deviation of the line in the middle, uOpt that of the whole band."
    )
    figures = [
        reporting.bands_figure(
            np.asarray(one.times),
            {"mean": one.systems["deviation"]},
            y="Deviation",
            unit="mm",
            limits=(-ZONE, ZONE),
            title=name,
        )
        for name, one in families.items()
    ]
    page.add(Drawing(figures, "Deviation from the line", told))

    figures = [
        reporting.trajectory_figure(evidence[ALLOCATED], limit, who="linkages", every=1)
        for limit in ("crank pin", "rocker pin", "torque")
    ]
    told = (
        "Random linkages of aOpt, by inverse dynamics of the closed loop: the multipliers are the force in the "
        "rocker's pin, and Newton's second law for coupler and tool gives that in the crank's pin."
    )
    page.section("Forces and torque", Drawing(figures, "Reactions and driving torque", told))

    page.section("Evidence", reporting.evidence_table(evidence))
    add_trust(page, designs)


def cost(solution: al.Solution) -> float:
    """What a design's tolerances and clearances cost, $."""
    return value_at(four_bar.COST, solution.problem, solution.vector)


def compared(families: Mapping[str, al.results.Motions]) -> Table:
    """The paths of random linkages of each design beside the published one."""
    ours = {}
    for name, family in families.items():
        away, moments = np.abs(family.systems["deviation"]).max(axis=1), family.moments["deviation"]
        reach = np.abs(moments.mean) + SIGMAS * moments.std
        outside = al.results.Proportion(int(np.sum(away > ZONE)), len(away))
        ours[f"Half the range of the mean deviation, {name} (mm)"] = number(float(np.ptp(moments.mean)) / 2, 3)
        ours[f"Zone of μ ± {given(SIGMAS)} σ at each place, {name}, ± (mm)"] = number(float(reach.max()), 3)
        ours[f"Linkages that leave ±{given(ZONE, 'mm')}, {name}"] = share_text(outside)
    note = "Random linkages at the instants of the grid, of the given tolerances; aOpt chooses its own."
    return comparison(("Published", "Ours"), PUBLISHED, ours, note)
