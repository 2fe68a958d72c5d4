"""The suspension study: its verdict, the chapters of its page, and its declaration."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, final

import numpy as np
from typing_extensions import override

import aleator as al
from aleator.reporting import (
    Block,
    Card,
    Code,
    Drawing,
    Schematic,
    Section,
    Table,
    Verdict,
    certificate_table,
    evidence_table,
    given,
    number,
    percent,
    percentile_figure,
    words,
)
from aleator.reporting import interval as interval_text
from aleator.studies._shared import collocated, no_recommendation, second_way, signed
from aleator.studies._study import AbstractStudy, Stage
from aleator.studies.suspension import nominal, road
from aleator.studies.suspension._facts import (
    HOLDING_TEXT,
    RIDE_TEXT,
    RIDE_UNIT,
    ROBUST_NARROW,
    SPREADS,
    UNITS,
    WITHIN,
    built_cards,
    built_headline,
    built_sentences,
    built_table,
    confirmed,
    cost,
    designs_table,
    dollars,
    figure_of,
    published_table,
    saving,
    solved,
    start_of,
)
from aleator.studies.suspension._figures import apportionment, car_drawing, projections, robust_design, violations
from aleator.studies.suspension._run import (
    BUILT,
    DESIGNS,
    FULL,
    HOLDING,
    HOLDING_BOXES,
    NARROW_TRAVEL,
    QUICK,
    RIDE,
    TRAVEL,
    Effort,
    SuspensionResults,
    problems,
    stages,
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


def verdict(results: SuspensionResults) -> Verdict:
    """Which design to build and why, from the results available so far."""
    sentences, cards = list(_sentences(results)), _cards(results)
    built = {f"{name} to build": one.solution for name, one in results.built.items()}
    if missing := no_recommendation(results.designs, results.evidence, DESIGNS, sentences, cards, also=built):
        return missing
    if not results.effort.calibration_samples:
        return Verdict("caution", "A first look", _printed(results), sentences, cards)
    if not set(BUILT) <= set(results.built) or any(one.interrupted for one in results.built.values()):
        said = f"The study was stopped before its margins were found: no recommendation yet. {_printed(results)}"
        return Verdict("caution", "Incomplete", said, sentences, cards)
    if not confirmed(results):
        doubtful = [name for name, one in results.built.items() if not one.confirmed]
        said = f"For {words(doubtful)} no margin is confirmed to leave at most {WITHIN} of the cars beyond a limit."
        return Verdict("caution", "Do not build yet", f"{said} {_printed(results)}", sentences, cards)
    return Verdict("good", "Build", built_headline(results), sentences, cards)


def _printed(results: SuspensionResults) -> str:
    """The violations at the published margins."""
    shares = {name: percent(results.evidence[name].joint.estimate) for name in BUILT}
    return (
        f"At the published margins of 1 σ, {shares['uOpt']} of the cars of uOpt and {shares['aOpt']} of those of aOpt "
        "break a limit."
    )


def _cards(results: SuspensionResults) -> list[Card]:
    kinds = {"dOpt": "deterministic", "uOpt": "robust", "aOpt": "apportioned"}
    cards = []
    for name, kind in kinds.items():
        if one := results.evidence.get(name):
            note = f"95 % interval {interval_text(one.joint)}. Limits: {words(list(one.violations))}."
            cards.append(Card(f"{name}, {kind}: cars beyond a limit", percent(one.joint.estimate), note))
    if (apportioned := solved(results, "aOpt")) and (part := saving(results)) is not None:
        initial = cost(solved(results, "uOpt") or results.designs["dOpt"])
        cards.append(
            Card(
                "Cost of the spreads, aOpt",
                dollars(cost(apportioned)),
                f"{signed(-part)} from {dollars(initial)} for dOpt and uOpt",
            )
        )
    return [*built_cards(results), *cards]


def _sentences(results: SuspensionResults) -> Iterator[str]:
    yield from built_sentences(results)
    if (one := results.evidence.get("dOpt")) and "uOpt" in results.evidence:
        robust = results.evidence["uOpt"]
        yield (
            f"Do not build dOpt: it has the best ride for the nominal car, but {percent(one.joint.estimate)} "
            f"[{interval_text(one.joint)}] of all cars leave ±{given(TRAVEL, 'm')} of travel or {given(HOLDING, 'm')} "
            f"of holding. uOpt {_damper(results)} and brings that to {percent(robust.joint.estimate)} "
            f"[{interval_text(robust.joint)}]."
        )
    if apportioned := solved(results, "aOpt"):
        ride = apportioned.moments[RIDE_TEXT]
        wider = [f"{text} ×{number(factor, 2)}" for text, factor in _factors(apportioned).items()]
        yield (
            f"The printed aOpt has other spreads ({words(wider)}), for {dollars(cost(apportioned))}; the mean + σ of"
            f" its ride is {number(float(ride.mean + ride.std), 4, RIDE_UNIT)} where {given(RIDE)} is allowed."
            + _beside(results)
        )
    if narrow := results.narrow_evidence.get(ROBUST_NARROW):
        share = narrow.violations["travel"]
        text = (
            f"The effect of a margin of 1 σ: designed for ±{given(NARROW_TRAVEL, 'm')} at mean + 1 σ, "
            f"{percent(share.estimate)} [{interval_text(share)}] of the cars still exceed it."
        )
        yield text + _calibrated(results)


def _damper(results: SuspensionResults) -> str:
    """How the robust design changes the damper."""
    before, after = (figure_of(results.designs[name], "b_s.mean") for name in ("dOpt", "uOpt"))
    return (
        f"takes a {'stiffer' if after > before else 'softer'} damper ({number(after, 4)} for"
        f" {number(before, 4, UNITS['b_s'])})"
    )


def _factors(apportioned: al.Solution) -> dict[str, float]:
    return {text: float(apportioned.decisions[name]) / start_of(apportioned, name) for name, text in SPREADS.items()}


def _beside(results: SuspensionResults) -> str:
    """The apportioned design compared with the robust one, limit by limit."""
    ours, robust = results.evidence.get("aOpt"), results.evidence.get("uOpt")
    if ours is None or robust is None:
        return ""
    pairs = [
        f"{name} in {percent(ours.violations[name].estimate)} (uOpt {percent(share.estimate)})"
        for name, share in robust.violations.items()
    ]
    pairs += [
        f"{name}, a limit of aOpt only, in {percent(share.estimate)}"
        for name, share in ours.violations.items()
        if name not in robust.violations
    ]
    return f" Its cars break {words(pairs)}."


def _calibrated(results: SuspensionResults) -> str:
    if results.calibration is None:
        return ""
    one = results.calibration
    trial = results.narrow.get(ROBUST_NARROW)
    price = (
        ""
        if trial is None
        else f"; ride rises from {number(trial.objective, 4)} to {number(one.solution.objective, 4, RIDE_UNIT)}"
    )
    return f" A margin of a = {number(one.sigmas, 3)} is {one.sentence('cars')}{price}."


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


@final
class SuspensionStudy(AbstractStudy):
    """Three designs, their evidence, calibration and fronts."""

    title = "Suspension of a quarter car: robust design and apportioned spreads"
    subtitle = (
        f"Travel within ±{TRAVEL:g} m, holding at most {HOLDING:g} m, ride at most {RIDE:g} m²/s³ (aOpt); "
        "five uncertain parameters; dissertation, sections 6.4 and 7.4"
    )
    glossary = GLOSSARY
    full, quick = FULL, QUICK

    def __init__(self, effort: Effort):
        self.found = SuspensionResults(effort)

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
        if self.found.effort.calibration_samples:
            return ""
        return "the margins to build with, and dOpt by direct collocation"

    @override
    def results(self) -> Mapping[str, Any]:
        found = self.found
        return {
            "designs": found.designs,
            "evidence": found.evidence,
            "built": {name: one.solution for name, one in found.built.items()},
            "built_evidence": {name: one.evidence for name, one in found.built.items()},
            "margins": found.built,
            "narrow": found.narrow,
            "narrow_evidence": found.narrow_evidence,
            "calibration": found.calibration,
            "travel_fronts": found.travel_fronts,
            "holding_fronts": found.holding_fronts,
            "boxes": found.boxes,
            "collocated": collocated("dOpt", found.second_way),
        }

    @override
    def verdict(self) -> Verdict:
        return verdict(self.found)

    @override
    def sections(self) -> Sequence[Section]:
        results = self.found
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

    @override
    def cut_short(self) -> Iterator[str]:
        results = self.found
        points = results.effort.front_points
        groups = (
            (results.travel_fronts, "over travel", points),
            (results.holding_fronts, "over holding", points),
            (results.boxes, "of boxes over holding", len(HOLDING_BOXES)),
        )
        for fronts, what, count in groups:
            for name, front in fronts.items():
                if front.interrupted:
                    done = f"{len(front.values)} of {count} points are finished and shown."
                    yield f"Of the front {what} of {name}, {done}"

    @override
    def tables(self) -> list[Table]:
        found = self.found
        shown = [designs_table(found)] if found.designs else []
        shown += [built_table(found)] if found.built else []
        return [*shown, published_table(found)] if found.designs else shown
