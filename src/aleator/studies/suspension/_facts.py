"""The numbers on the suspension's page: costs, boxes and tables, all computed from the results."""

from collections.abc import Iterator, Sequence

import numpy as np

import aleator as al
from aleator.design import value_at
from aleator.reporting import Box, Table, given, number, words
from aleator.studies._shared import violation_rows
from aleator.studies.suspension import COST
from aleator.studies.suspension._run import HOLDING, RIDE, TRAVEL, SuspensionResults

RIDE_TEXT, HOLDING_TEXT = "∫comfort dt", "rms(grip)"
RIDE_UNIT = "m²/s³"
ROBUST_NARROW, WIDER_NARROW = "uOpt, 1 σ", "uOpt, 1.25 σ"
SPREADS = {
    "k_s.half_width": "spring kₛ",
    "b_s.half_width": "damper bₛ",
    "eta.half_width": "damping ratio η",
}
UNITS = {"k_s": "N/m", "b_s": "N s/m", "eta": ""}


def cost(solution: al.Solution) -> float:
    """The manufacturing cost of a design's spreads, $: equation (125), for dOpt and uOpt with the initial spreads."""
    return value_at(COST, solution.problem, solution.vector)


def figure_of(solution: al.Solution, name: str) -> float:
    """A number of a design's model, such as `k_s.half_width`, decided or not."""
    return value_at(al.value(name), solution.problem, solution.vector)


def start_of(solution: al.Solution, name: str) -> float:
    """The initial value of a decision."""
    return float(solution.problem.placements.decisions[name].decision.initial)


def box(solution: al.Solution, design: str, dash: str = "solid", note: str = "") -> Box:
    """A design among its requirements: centre and half-widths of ride, holding and travel.

    Travel is taken at the instant at which the printed constraint (119) is most critical: centre `μ_zs - μ_zu`,
    half-width `σ_zs + σ_zu`.
    """
    sprung, unsprung = solution.moments["z_s(t)"], solution.moments["z_u(t)"]
    middle, spread = sprung.mean - unsprung.mean, sprung.std + unsprung.std
    at = int(np.argmax(np.abs(middle) + spread))
    ride, holding = solution.moments[RIDE_TEXT], solution.moments[HOLDING_TEXT]
    return Box(
        design=design,
        centre={"travel": abs(float(middle[at])), "ride": float(ride.mean), "holding": float(holding.mean)},
        half={"travel": float(spread[at]), "ride": float(ride.std), "holding": float(holding.std)},
        dash=dash,
        note=note,
    )


def saving(results: SuspensionResults) -> float | None:
    """The saving of the apportioned design as a share of the initial cost."""
    apportioned, robust = solved(results, "aOpt"), solved(results, "uOpt") or solved(results, "dOpt")
    return None if apportioned is None or robust is None else 1 - cost(apportioned) / cost(robust)


def solved(results: SuspensionResults, name: str) -> al.Solution | None:
    """A design of the study, if it is available and solved."""
    found = results.designs.get(name)
    return found if found is not None and found.ok else None


def constraints_active(solution: al.Solution) -> tuple[str, ...]:
    """The active requirements of a design, without decisions at their bounds."""
    return tuple(name for name in solution.active if name not in solution.at_bounds)


def dollars(value: float) -> str:
    """A cost: `$5.40`."""
    return f"${value:.2f}"


def designs_table(results: SuspensionResults) -> Table:
    """The three designs in an engineer's terms."""
    every = list(results.designs.values())
    boxes = [box(one, name) for name, one in results.designs.items()]
    rows = [["Status", *("solved" if one.ok else "not solved: see the verdict" for one in every)]]
    rows += decision_rows(every)
    rows.append([f"Ride, μ ± σ ({RIDE_UNIT})", *(_spread(one, "ride") for one in boxes)])
    rows.append(["Ride, μ + σ", *(number(one.centre["ride"] + one.half["ride"], 4) for one in boxes)])
    rows.append([f"Travel, μ ± σ (m), limit ±{TRAVEL:g}", *(_spread(one, "travel") for one in boxes)])
    rows.append([f"Holding, μ ± σ (m), limit {HOLDING:g}", *(_spread(one, "holding") for one in boxes)])
    rows.append(["Cost of the spreads", *(dollars(cost(one)) for one in every)])
    rows.append(["Active limits", *(words(constraints_active(one), "none") for one in every)])
    rows += violation_rows([results.evidence.get(name) for name in results.designs], "Cars beyond")
    note = (
        "dOpt is evaluated on the nominal car, so its σ is 0. Travel is at its most critical instant, with the spread "
        "of equation (119): σ of z_s plus σ of z_u. Intervals are 95 % confidence (Clopper and Pearson). Ride is a "
        f"limit ({given(RIDE, RIDE_UNIT)}) for aOpt only; for dOpt and uOpt it is the objective."
    )
    return Table("Decisions, performance and violations", ["", *results.designs], rows, note)


def decision_rows(designs: Sequence[al.Solution]) -> Iterator[list[str]]:
    """Means and spreads of spring, damper and damping ratio, as rows of a table with designs as columns."""
    means = {"k_s.mean": "Spring, mean kₛ", "b_s.mean": "Damper, mean bₛ"}
    for name, text in (means | {name: f"± half-width, {text}" for name, text in SPREADS.items()}).items():
        yield [text, *(_decided(one, name) for one in designs)]


def _decided(solution: al.Solution, name: str) -> str:
    """A number of a design, and whether it was decided: `2.334e4 N/m (at its bound)`."""
    text = number(figure_of(solution, name), 4, UNITS[name.split(".")[0]])
    if name in solution.at_bounds:
        return f"{text} (at its bound)"
    return text if name in solution.decisions else f"{text} (given)"


def _spread(one: Box, key: str) -> str:
    digits = 4 if key == "ride" else 3
    spread = f" ± {number(one.half[key], 3)}" if one.half[key] > 0 else ""
    return f"{number(one.centre[key], digits)}{spread}"
