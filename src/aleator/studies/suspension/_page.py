"""The chapters of the suspension's page: the designs, and every figure of chapters 6 and 7 that is recomputed."""

from collections.abc import Iterator

import numpy as np

from aleator.reporting import (
    Block,
    Code,
    Drawing,
    Schematic,
    Section,
    certificate_table,
    evidence_table,
    percentile_figure,
)
from aleator.studies._shared import second_way
from aleator.studies.suspension import nominal, road
from aleator.studies.suspension._built import built_table
from aleator.studies.suspension._chapters import apportionment, projections, robust_design, violations
from aleator.studies.suspension._drawing import car_drawing
from aleator.studies.suspension._facts import (
    HOLDING_TEXT,
    RIDE_TEXT,
    RIDE_UNIT,
    designs_table,
)
from aleator.studies.suspension._published import published_table
from aleator.studies.suspension._run import (
    HOLDING,
    HOLDING_BOXES,
    NARROW_TRAVEL,
    RIDE,
    SuspensionResults,
)

GLOSSARY = (
    ("dOpt", "Deterministic optimum: the nominal spring and damper with the best ride for the nominal car only."),
    ("uOpt", "Robust optimum: the same two decisions, for all cars that the uncertainty allows."),
    ("aOpt", "Apportioned optimum: the means and the manufacturing spreads are chosen together at minimum cost."),
    (
        "Ride",
        "Integral of the squared acceleration of the passenger over the road, m²/s³. Smaller is more comfortable.",
    ),
    ("Travel (rattle), R", "Distance between body and wheel from rest, m; limited to ±R at every instant."),
    ("Holding, H", "Root mean square of the tyre's deflection, m; at most H. Smaller keeps the wheel on the ground."),
    ("μ, σ", "Mean and standard deviation over all cars."),
    ("Margin a", "The limit applies to μ + a·σ. It makes violations rare; only counting shows how rare."),
    (
        "To build",
        "With the smallest margins, in a fixed ratio, at which fresh cars confirm that at most 1 % break any limit.",
    ),
    ("Half-width", "A uniform distribution extends from the mean minus to the mean plus its half-width."),
    ("Active", "A limit that the design meets with equality: without it, a better design would exist."),
    ("Shadow price", "The improvement of the objective per unit by which an active limit is relaxed."),
    ("95 % interval", "Clopper and Pearson: encloses the true share of cars in at least 95 of 100 such countings."),
)


def sections(results: SuspensionResults) -> list[Section]:
    """The sections for the results available so far."""
    return [
        Section("The car", [_schematic(results)]),
        Section("The designs to build", [built_table(results)] if results.built else []),
        Section("The three designs", _designs(results)),
        Section("Comparison with published values", [published_table(results)] if results.designs else []),
        Section("Robust design (chapter 6)", list(robust_design(results))),
        Section("How often cars violate", list(violations(results))),
        Section("Apportionment (chapter 7)", list(apportionment(results))),
        Section("Evidence", list(_evidence(results))),
        Section("Certificate", _certificate(results)),
        second_way("dOpt", results.second_way),
    ]


def cut_short(results: SuspensionResults) -> Iterator[str]:
    """How much of each interrupted front is available."""
    points = results.effort.front_points
    groups = (
        (results.travel_fronts, "over travel", points),
        (results.holding_fronts, "over holding", points),
        (results.boxes, "of boxes over holding", len(HOLDING_BOXES)),
    )
    for fronts, what, count in groups:
        for name, front in fronts.items():
            if front.interrupted:
                yield f"Of the front {what} of {name}, {len(front.values)} of {count} points are finished and shown."


def _schematic(results: SuspensionResults) -> Schematic:
    profile = road()
    drawing = car_drawing(nominal(), np.asarray(profile.times), np.asarray(profile.values))
    caption = (
        "Schematic: the size of boxes shows their masses; the road is that of the model. ± is the half-width of a "
        "uniform distribution; means that a design chooses have the index 0. The damper is η times as strong in "
        "compression as in extension."
    )
    beside = [Code(f"The problem of {name} as mathematics", one.problem_text) for name, one in results.designs.items()]
    return Schematic([drawing], "Quarter car on its road", caption, "6.1 and 6.3", beside)


def _designs(results: SuspensionResults) -> list[Block]:
    blocks: list[Block] = [designs_table(results)] if results.designs else []
    if len(results.designs) > 1:
        caption = (
            "Points are means, boxes extend one σ to each side. dOpt has no box: it has no spread, and lies on the "
            "holding limit. The box of uOpt ends at the travel limit, so its mean had to move inward. aOpt has the "
            "largest box: its spreads grow until they meet the ride and travel limits."
        )
        blocks.append(projections(results, list(results.designs), "The designs among their limits", "7.2", caption))
    return blocks


def _evidence(results: SuspensionResults) -> Iterator[Block]:
    if results.evidence:
        yield evidence_table(results.evidence)
        for text, label, unit, limit in ((RIDE_TEXT, "Ride", RIDE_UNIT, RIDE), (HOLDING_TEXT, "Holding", "m", HOLDING)):
            sampled = {name: one.functionals[text] for name, one in results.evidence.items()}
            figure = percentile_figure(sampled, x=label, unit=unit, limit=limit)
            caption = "Bars: 1 to 99 %, 5 to 95 % and 25 to 75 % of the cars."
            if label == "Ride":
                caption += " The ride limit binds aOpt only."
            yield Drawing([figure], f"{label} over random cars", caption)
    if built := {f"{name} to build": one.evidence for name, one in results.built.items() if one.evidence}:
        yield evidence_table(built)
    if results.narrow_evidence:
        yield evidence_table({f"{name} (±{NARROW_TRAVEL:g} m)": one for name, one in results.narrow_evidence.items()})


def _certificate(results: SuspensionResults) -> list[Block]:
    blocks: list[Block] = [certificate_table(results.designs)] if results.designs else []
    if results.built:
        blocks.append(certificate_table({f"{name} to build": one.solution for name, one in results.built.items()}))
    if results.narrow:
        blocks.append(
            certificate_table({f"{name} (±{NARROW_TRAVEL:g} m)": one for name, one in results.narrow.items()})
        )
    return blocks
