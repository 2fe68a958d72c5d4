"""Numbers and tables of the four-bar study, and its verdict."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

import aleator as al
from aleator.design import value_at
from aleator.reporting import Card, Table, Verdict, count, given, number, percent, share_text, words
from aleator.reporting import interval as interval_text
from aleator.studies._shared import no_recommendation, signed, violation_rows
from aleator.studies.four_bar import COST, FORCE, SIGMAS, TORQUE, TRANSMISSION, WIDTHS, ZONE
from aleator.studies.four_bar._run import (
    ALLOCATED,
    DESIGNS,
    LEVELS,
    NOMINAL,
    PUBLISHED,
    ROBUST,
    TARGET,
    Counts,
    FourBarResults,
    lengths_of,
    widths_of,
)

if TYPE_CHECKING:
    import xarray

TEXTS = {
    "crank": "Crank",
    "coupler": "Coupler",
    "rocker": "Rocker",
    "ground": "Ground",
    "along": "Tool, along the coupler",
    "across": "Tool, across the coupler",
}
PLAYS = {"crank_play": "Radial clearance, crank's pin", "rocker_play": "Radial clearance, rocker's pin"}
BESIDE = ("stroke", "transmission", "crank pin", "rocker pin", "torque")
"""All limits but the zone, which is each design's own."""


def cost(solution: al.Solution) -> float:
    """What a design's tolerances and clearances cost, $."""
    return value_at(COST, solution.problem, solution.vector)


def zone(solution: al.Solution) -> float:
    """Half the width of the zone that a design promises, mm."""
    return float(solution.decisions["zone"])


def extreme(solution: al.Solution, path: str, sign: float) -> str:
    """The largest (`sign` 1) or smallest (-1) mean of a path, and its σ there: `108.8 ± 4.4`."""
    found = solution.moments[f"{path}(t)"]
    at = int(np.argmax(sign * found.mean))
    return f"{number(found.mean[at], 4)} ± {number(found.std[at], 2)}"


def designs_table(results: FourBarResults) -> Table:
    """The three designs in an engineer's terms."""
    every = list(results.designs.values())
    lengths, widths = [lengths_of(one) for one in every], [widths_of(one) for one in every]
    rows = [["Status", *("solved" if one.ok else "not solved: see the verdict" for one in every)]]
    rows += [
        [
            f"{text} (mm)",
            *(_toleranced(one[name], two[f"{name}.tolerance"]) for one, two in zip(lengths, widths, strict=True)),
        ]
        for name, text in TEXTS.items()
    ]
    rows += [[f"{text} (mm)", *(number(one[name], 3) for one in widths)] for name, text in PLAYS.items()]
    rows += [
        ["Zone that it promises, ± (mm)", *(number(zone(one), 4) for one in every)],
        ["Cost of tolerances and clearances", *(f"${cost(one):.2f}" for one in every)],
        [
            f"Least angle of transmission, μ ± σ (°), limit {given(TRANSMISSION)}",
            *(extreme(one, "transmission", -1) for one in every),
        ],
        [
            f"Largest force in the crank's pin, μ ± σ (N), limit {given(FORCE)}",
            *(extreme(one, "crank_pin", 1) for one in every),
        ],
        [
            f"Largest force in the rocker's pin, μ ± σ (N), limit {given(FORCE)}",
            *(extreme(one, "rocker_pin", 1) for one in every),
        ],
        [
            f"Largest torque of the motor, μ ± σ (N m), limit {given(TORQUE)}",
            *(extreme(one, "crank_torque", 1) for one in every),
        ],
        [
            "Active limits",
            *(words([name for name in one.active if name not in one.at_bounds], "none") for one in every),
        ],
    ]
    rows += violation_rows([results.evidence.get(name) for name in results.designs], "Linkages that break")
    note = (
        f"Limits hold with a margin of {given(SIGMAS)} σ, for dOpt in the mean only. ± of a length is its tolerance, "
        "three standard deviations. The limit 'line' is each design's own zone. Intervals are 95 % confidence (Clopper "
        "and Pearson); linkages were simulated with their constraints."
    )
    return Table("Decisions, performance and violations", ["", *results.designs], rows, note)


def _toleranced(length: float, tolerance: float) -> str:
    return f"{number(length, 5)} ± {number(tolerance, 3)}"


def counts_table(results: FourBarResults) -> Table:
    """The paths of all designs, counted by elimination."""
    every = list(results.counts.values())
    rows = [
        [f"Linkages that leave ±{given(ZONE, 'mm')} on the stroke", *(share_text(one.outside) for one in every)],
        [f"Linkages below {given(TRANSMISSION)}° of transmission", *(share_text(one.flat) for one in every)],
    ]
    rows.append([f"Zone of μ ± {given(SIGMAS)} σ at each place, ± (mm)", *(number(one.zone, 4) for one in every)])
    for i, level in enumerate(LEVELS):
        rows.append(
            [f"Largest deviation that {given(100 * level)} % keep (mm)", *(number(one.largest[i], 3) for one in every)]
        )
    note = (
        f"{count(every[0].outside.samples)} linkages of each design, by the triangle of coupler and rocker: without "
        f"constraints, multipliers or expansion. {PUBLISHED} has the published lengths and the given tolerances."
    )
    return Table("Paths counted by elimination", ["", *results.counts], rows, note)


def counts_dataset(counts: Mapping[str, Counts]) -> "xarray.Dataset":
    """What was counted, for the file of results."""
    import xarray

    every = list(counts.values())
    return xarray.Dataset(
        {
            "outside": ("design", [one.outside.count for one in every], {"units": "1"}),
            "flat": ("design", [one.flat.count for one in every], {"units": "1"}),
            "zone": ("design", [one.zone for one in every], {"units": "mm"}),
            "linkages": ("design", [one.outside.samples for one in every], {"units": "1"}),
            "largest_deviation": (("design", "share"), [one.largest for one in every], {"units": "mm"}),
        },
        coords={"design": list(counts), "share": list(LEVELS)},
    )


def verdict(results: FourBarResults) -> Verdict:
    """Which design to build and why, from the results available so far."""
    sentences, cards = list(_sentences(results)), list(_cards(results))
    missing = no_recommendation(results.designs, results.evidence, DESIGNS, sentences, cards)
    if missing:
        return missing
    if not {*DESIGNS} <= {*results.counts}:
        return Verdict("caution", "Incomplete", "The study was stopped before its counts.", sentences, cards)
    joint, headline = results.evidence[ALLOCATED].joint, _headline(results)
    if joint.upper <= TARGET:
        return Verdict("good", "Build", headline, sentences, cards)
    if joint.lower <= TARGET:
        said = f"Too few linkages were simulated to be sure of {percent(TARGET)} beyond any limit. {headline}"
        return Verdict("caution", "Not confirmed yet", said, sentences, cards)
    said = f"{share_text(joint)} of the linkages break a limit, more than {percent(TARGET)}."
    return Verdict("bad", "Not confirmed", said, sentences, cards)


def _headline(results: FourBarResults) -> str:
    allocated, robust = results.designs[ALLOCATED], results.designs[ROBUST]
    change = cost(allocated) / cost(robust) - 1
    broken, outside = results.evidence[ALLOCATED].joint, results.counts[ALLOCATED].outside
    return (
        f"aOpt, for ${cost(allocated):.2f} instead of ${cost(robust):.2f} ({signed(change)}):"
        f" {share_text(broken)} of {count(broken.samples)} linkages simulated break any limit, and"
        f" {share_text(outside)} of {count(outside.samples)} assembled leave ±{given(ZONE, 'mm')} of the line."
    )


def _sentences(results: FourBarResults) -> Iterator[str]:
    counts, designs = results.counts, results.designs
    if set(counts) >= {PUBLISHED, *DESIGNS}:
        yield (
            f"With the given tolerances, {share_text(counts[PUBLISHED].outside)} of the published linkages and"
            f" {share_text(counts[NOMINAL].outside)} of those of dOpt leave ±{given(ZONE, 'mm')}; of uOpt"
            f" {share_text(counts[ROBUST].outside)}. ({count(counts[ROBUST].outside.samples)} linkages each, by"
            " elimination.)"
        )
    if set(counts) >= {NOMINAL, ROBUST} and designs[ROBUST].ok:
        yield (
            f"uOpt keeps ±{number(counts[ROBUST].zone, 3, 'mm')} at {given(SIGMAS)} σ where dOpt keeps"
            f" ±{number(counts[NOMINAL].zone, 3, 'mm')}: the mean linkage of dOpt alone stays within"
            f" ±{number(zone(designs[NOMINAL]), 3, 'mm')}."
        )
    if set(results.evidence) >= {NOMINAL, ROBUST}:
        nominal, robust = (results.evidence[name].violation(*BESIDE) for name in (NOMINAL, ROBUST))
        yield (
            f"Of dOpt {share_text(nominal)} of the linkages miss the stroke, the angle of transmission, or a limit on"
            f" forces and torque, because its mean linkage lies on such limits; of uOpt {share_text(robust)}."
        )
    if ALLOCATED in designs and designs[ALLOCATED].ok:
        one = designs[ALLOCATED]
        widths = widths_of(one)
        wide = max(widths, key=widths.__getitem__)
        tightened = [
            f"{_words(name)} to {number(width, 3, 'mm')}" for name, width in widths.items() if width < WIDTHS[name]
        ]
        yield (
            "aOpt widens tolerances and clearances that the path feels little or that are dear, up to"
            f" {number(widths[wide], 3, 'mm')} ({_words(wide)}), and tightens {words(tightened, 'none')}."
            f" Active: {words([name for name in one.active if name not in one.at_bounds], 'none')}."
        )


def _words(width: str) -> str:
    return width.replace("_play", "'s pin, clearance").replace(".tolerance", "")


def _cards(results: FourBarResults) -> Iterator[Card]:
    for name in DESIGNS:
        if one := results.counts.get(name):
            stay = f"99 % of the linkages stay within ±{number(one.largest[-1], 3, 'mm')}"
            yield _share_card(f"{name}: leave ±{given(ZONE, 'mm')}", one.outside, stay)
    if ALLOCATED in results.evidence:
        joint = results.evidence[ALLOCATED].joint
        yield _share_card("aOpt: break any limit", joint, f"forces up to {given(FORCE, 'N')} included")
    if ALLOCATED in results.designs and results.designs[ALLOCATED].ok:
        solution = results.designs[ALLOCATED]
        yield Card(
            "Cost of tolerances, aOpt",
            f"${cost(solution):.2f}",
            f"the limit 'zone' costs ${_price(solution):.2f} per mm",
        )


def _share_card(label: str, share: al.results.Proportion, note: str) -> Card:
    return Card(label, percent(share.estimate), f"95 % interval: {interval_text(share)}; {note}")


def _price(solution: al.Solution) -> float:
    return next(one.shadow_price for one in solution.constraints if one.name == "zone")
