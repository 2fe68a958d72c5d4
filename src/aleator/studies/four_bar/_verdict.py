"""The first screen of the four-bar's page: which lengths and tolerances to build, and how far to trust the numbers."""

from collections.abc import Iterator

import aleator as al
from aleator.reporting import Card, Verdict, count, given, number, percent, share_text, words
from aleator.reporting import interval as interval_text
from aleator.studies._shared import no_recommendation, signed
from aleator.studies.four_bar import FORCE, SIGMAS, WIDTHS, ZONE
from aleator.studies.four_bar._counts import widths_of
from aleator.studies.four_bar._facts import cost, zone
from aleator.studies.four_bar._run import ALLOCATED, DESIGNS, NOMINAL, PUBLISHED, ROBUST, TARGET, FourBarResults

BESIDE = ("stroke", "transmission", "crank pin", "rocker pin", "torque")
"""All limits but the zone, which is each design's own."""


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
