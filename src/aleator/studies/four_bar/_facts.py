"""The tables of the four-bar's page, all computed from its results."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

import aleator as al
from aleator.design import value_at
from aleator.reporting import Table, count, given, number, share_text, words
from aleator.studies._shared import violation_rows
from aleator.studies.four_bar import COST, FORCE, SIGMAS, TORQUE, TRANSMISSION, ZONE
from aleator.studies.four_bar._counts import LEVELS, Counts, lengths_of, widths_of
from aleator.studies.four_bar._run import PUBLISHED, FourBarResults

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
