"""The first screen of the clutch's page: which tolerances to specify, and how far to trust the numbers."""

from collections.abc import Iterator

from aleator.reporting import Card, Verdict, count, given, number, percent, words
from aleator.studies.clutch import LIMITS, NAMES, TOLERANCES
from aleator.studies.clutch._counts import CHEAPEST, GIVEN, SAFE, tolerances_of
from aleator.studies.clutch._facts import (
    REFERENCE_ORDER,
    counted,
    given_cost,
    method,
    per_million,
    rejects_of,
    times_cheaper,
    worst_text,
)
from aleator.studies.clutch._run import ClutchResults

SURPRISE = 4.0
"""The difference between a count and its prediction, in standard errors, that counts as significant."""


def verdict(results: ClutchResults) -> Verdict:
    """What to build and why, from the results available so far."""
    sentences, cards = list(_sentences(results)), list(_cards(results))
    solution = results.allocation
    if solution is None or results.evidence is None:
        return Verdict("caution", "Incomplete", "The study was stopped before its allocation.", sentences, cards)
    if not solution.ok:
        return Verdict("bad", "Not solved", f"No allocation: {solution.why()}", sentences, cards)
    share, predicted = counted(results.evidence), rejects_of(solution)
    if abs(share.share - predicted) > SURPRISE * share.standard_error:
        said = f"Of fresh assemblies {percent(share.share)} are rejects; the expansion says {percent(predicted)}."
        return Verdict("bad", "Not confirmed", said, sentences, cards)
    return Verdict("good", "Build", _headline(results), sentences, cards)


def _headline(results: ClutchResults) -> str:
    solution = results.allocation
    assert solution is not None
    chosen = tolerances_of(solution)
    wider = [NAMES[name] for name in chosen if chosen[name] > TOLERANCES[name]]
    tighter = [NAMES[name] for name in chosen if chosen[name] < TOLERANCES[name]]
    return (
        f"Tighten the {words(tighter)}, widen the {words(wider)}: as few rejects as before for"
        f" {percent(1 - solution.objective / given_cost())} less.{_safe_headline(results)}"
    )


def _safe_headline(results: ClutchResults) -> str:
    """The cost of tolerances whose worst case meets the limits, where that of the cheapest ones does not."""
    if SAFE not in results.counts or CHEAPEST not in results.counts or not results.counts[CHEAPEST].broken():
        return ""
    cost = results.counts[SAFE].cost
    lower, upper = map(given, LIMITS)
    change = 1 - cost / given_cost()
    return (
        f" If even the worst case must stay within {lower}° to {upper}°, build the worst-case tolerances, for "
        f"{percent(abs(change))} {'less' if change > 0 else 'more'} than the given ones."
    )


def _sentences(results: ClutchResults) -> Iterator[str]:
    if results.analyses:
        one = results.analyses["limits"]
        yield (
            f"With the given tolerances the pressure angle is {number(one.mean, 5)}° ± {number(3 * one.std, 4)}° (3σ):"
            f" within 6° to 8° with Cpk {number(one.cpk, 3)}; within nominal ± 0.6° only for"
            f" {percent(1 - results.given)} of the assemblies."
        )
    yield from _worst_sentences(results)
    if results.allocation is not None and results.allocation.ok and results.evidence is not None:
        share = counted(results.evidence)
        yield (
            f"The cheapest tolerances were checked on {count(results.evidence.samples)} fresh assemblies:"
            f" {percent(share.share)} are rejects, where {percent(rejects_of(results.allocation))} was predicted."
        )
    if method(results, "Monte Carlo") and method(results, REFERENCE_ORDER):
        yield (
            f"An expansion of order 3 on 60 assemblies is {number(times_cheaper(results), 2)} times cheaper than plain"
            " Monte Carlo of the same error (its measured speed and standard error, scaled up)."
        )


def _worst_sentences(results: ClutchResults) -> Iterator[str]:
    """By how much each set of tolerances can exceed the function's limits, and how often it does."""
    lower, upper = map(given, LIMITS)
    for name, one in ((name, results.counts[name]) for name in (GIVEN, CHEAPEST, SAFE) if name in results.counts):
        title = {GIVEN: "The given", CHEAPEST: "The cheapest", SAFE: "The worst-case"}[name]
        chosen = ", ".join(f"{NAMES[part]} ± {number(width, 3, 'mm')}" for part, width in one.tolerances.items())
        yield (
            f"{title} tolerances ({chosen}; cost {number(one.cost, 4, '1/mm')}): the worst case of parts within them"
            f" is {worst_text(one)}; of {count(one.function.low.samples)} assemblies counted,"
            f" {per_million(one.function.either)} in a million lie outside {lower}° to {upper}°."
        )


def _cards(results: ClutchResults) -> Iterator[Card]:
    if expanded := method(results, REFERENCE_ORDER):
        error = abs(expanded.variation - results.exact)
        yield Card("3σ of the angle, order 3", f"{expanded.variation:.5f}°", f"error {number(error, 2, '°')}")
    if results.analyses:
        yield Card("Rejects, given tolerances", percent(results.given), "specification nominal ± 0.6°")
    if GIVEN in results.counts:
        one = results.counts[GIVEN]
        outside = f"{per_million(one.function.either)} ppm counted outside {given(LIMITS[0])}° to {given(LIMITS[1])}°"
        yield Card("Worst case, given tolerances", f"{number(one.worst_case[0], 4)}°", outside)
    if results.allocation is not None and results.allocation.ok:
        cost = results.allocation.objective
        yield Card("Cost Σ 1/T", number(cost, 4, "1/mm"), f"instead of {number(given_cost(), 4, '1/mm')}")
