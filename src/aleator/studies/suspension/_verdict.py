"""The first screen of the study's page, from the results alone: which suspension to build and why."""

from collections.abc import Iterator

import aleator as al
from aleator.reporting import Card, Verdict, given, number, percent, words
from aleator.reporting import interval as interval_text
from aleator.studies._shared import no_recommendation, signed
from aleator.studies.suspension._built import WITHIN, confirmed, headline
from aleator.studies.suspension._built import cards as built_cards
from aleator.studies.suspension._built import sentences as built_sentences
from aleator.studies.suspension._facts import (
    RIDE_TEXT,
    RIDE_UNIT,
    ROBUST_NARROW,
    SPREADS,
    UNITS,
    cost,
    dollars,
    figure_of,
    saving,
    solved,
    start_of,
)
from aleator.studies.suspension._run import BUILT, DESIGNS, HOLDING, NARROW_TRAVEL, RIDE, TRAVEL, SuspensionResults


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
    return Verdict("good", "Build", headline(results), sentences, cards)


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
