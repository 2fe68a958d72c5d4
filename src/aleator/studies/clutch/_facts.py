"""Numbers and tables of the clutch study, and its verdict."""

import math
from collections.abc import Iterator
from typing import NamedTuple

import aleator as al
from aleator.reporting import Card, Table, Verdict, count, given, number, percent, share_text, words
from aleator.studies.clutch import COST, DEVIATION, LIMITS, NAMES, TOLERANCES
from aleator.studies.clutch._run import (
    CHEAPEST,
    GIVEN,
    SAFE,
    ClutchResults,
    Counts,
    Method,
    exact_rejects,
    tolerances_of,
)

PUBLISHED = {
    "DLM": (0.65788, "0.06"),
    "gPC, order 2": (0.65822, "0.34"),
    "gPC, order 3": (0.65900, "0.51"),
    "gPC, order 5": (0.65901, "2.73"),
    "Monte Carlo": (0.65923, "217.42"),
}
REFERENCE_ORDER = "gPC, order 3"
SURPRISE = 4.0
"""The difference between a count and its prediction, in standard errors, that counts as significant."""


def method(results: ClutchResults, name: str) -> Method | None:
    """A row of the comparison, if it was computed."""
    return next((one for one in results.methods if one.name == name), None)


def samples_for(results: ClutchResults, error: float) -> float:
    """The number of Monte Carlo samples for which the standard error of three standard deviations is `error`.

    A standard error falls with the square root of the number of samples.
    """
    sampled = method(results, "Monte Carlo")
    if sampled is None or sampled.standard_error is None or error == 0:
        return math.nan
    return sampled.points * (sampled.standard_error / error) ** 2


def times_cheaper(results: ClutchResults) -> float:
    """The wall time of Monte Carlo for the same error, relative to that of order 3; measured, and scaled up."""
    expanded, sampled = method(results, REFERENCE_ORDER), method(results, "Monte Carlo")
    if expanded is None or sampled is None:
        return math.nan
    needed = samples_for(results, abs(expanded.variation - results.exact))
    return sampled.seconds * needed / sampled.points / expanded.seconds


def methods_table(results: ClutchResults) -> Table:
    """Table 7.2 and its extension, with the published values."""
    rows = [_method_row(one, results.exact) for one in results.methods]
    rows.append(["exact", "–", number(results.exact, 8), "0", "–", "–", "–"])
    note = (
        "Exact: Gauss quadrature of the closed form, independent of the other rows. Times are of this run in a warm "
        "process, most of an expansion's being spent on tracing the equations; the published times are of Mathematica "
        "on a laptop of 2012. A sampled value may be off by a few standard errors. Even with 2.5 million samples the "
        "standard error exceeds the difference between gPC and the exact value, so Monte Carlo cannot be the reference "
        "here. Order 2 depends on the point set in its fourth digit."
    )
    header = ["", "Published (°)", "3σ of χ (°)", "Error (°)", "Assemblies solved", "Time", "Published time (s)"]
    return Table("Table 7.2 and more: three standard deviations of the pressure angle", header, rows, note)


def _method_row(one: Method, exact: float) -> list[str]:
    printed, seconds = PUBLISHED.get(one.name, (None, "–"))
    own = "" if one.standard_error is None else f" ± {number(one.standard_error, 2)}"
    return [
        one.name,
        "–" if printed is None else f"{printed:.5f}",
        f"{number(one.variation, 7)}{own}",
        number(abs(one.variation - exact), 2),
        count(one.points),
        _time(one.seconds),
        seconds,
    ]


def _time(seconds: float) -> str:
    return number(1000 * seconds, 2, "ms") if seconds < 1 else number(seconds, 2, "s")


def analysis_table(results: ClutchResults) -> Table:
    """Capability and rejects under both specifications."""
    every = list(results.analyses.values())
    titles = {"limits": "Function: 6° to 8°", "deviation": "Nominal ± 0.6°"}
    low, high = every[0].worst_case
    rows = [
        ["Limits (°)", *(f"{given(one.lower)} to {given(one.upper)}" for one in every)],
        ["Mean (°)", *(number(one.mean, 6) for one in every)],
        ["3σ (°)", *(number(3 * one.std, 5) for one in every)],
        ["Skewness", *(number(one.skewness, 3) for one in every)],
        ["Cp", *(number(one.cp, 3) for one in every)],
        ["Cpk", *(number(one.cpk, 3) for one in every)],
        ["Rejects low (ppm)", *(number(one.rejects_low, 3) for one in every)],
        ["Rejects high (ppm)", *(number(one.rejects_high, 3) for one in every)],
        ["Worst case, by the expansion (°)", *[f"{number(low, 5)} to {number(high, 5)}"] * len(every)],
        ["Root sum square, ± (°)", *(number(one.rss, 5) for one in every)],
    ]
    note = (
        "Rejects are those of the expansion's distribution, skewness included. The worst case is over all dimensions "
        "within their tolerances at once, enclosed by bounds of the expansion."
    )
    if GIVEN in results.counts:
        tails = results.counts[GIVEN].by_name
        rows.append(["Rejects, counted (ppm)", *(per_million(tails[name].either) for name in results.analyses)])
        rows.append(
            ["Worst case, exact", *(worst_text(results.counts[GIVEN], (one.lower, one.upper)) for one in every)]
        )
    return Table("The given tolerances", ["", *(titles[name] for name in results.analyses)], rows, note)


def contributions_table(results: ClutchResults) -> Table:
    """Which dimensions cause the spread of the angle."""
    parts = results.analyses["limits"].contributions
    rows = [
        [NAMES[name], f"± {given(TOLERANCES[name])}", number(one.sensitivity, 4), *_shares(one)]
        for name, one in parts.items()
    ]
    header = ["", "Tolerance (mm)", "Sensitivity (°/mm)", "Share, linearised", "Share, total Sobol index"]
    return Table("Contributions to the variance of the angle", header, rows)


def _shares(one: al.results.Contribution) -> tuple[str, str]:
    return percent(one.linear / 100), percent(one.total / 100)


def per_million(share: al.results.Proportion) -> str:
    """A count as parts per million, with its confidence interval: `9.1 [8.4 to 9.8]`."""
    ends = (number(1e6 * end, 3) for end in (share.lower, share.upper))
    return f"{number(1e6 * share.estimate, 3)} [{' to '.join(ends)}]"


def rejected_tails(results: ClutchResults, name: str) -> tuple[str, ...]:
    """The rejects of the given tolerances below and above the limits of a specification, in parts per million."""
    if GIVEN not in results.counts:
        return ()
    tails = results.counts[GIVEN].by_name[name]
    return tuple(f"{number(1e6 * one.estimate, 3)}\nppm" for one in (tails.low, tails.high))


def worst_text(counts: Counts, limits: tuple[float, float] = LIMITS) -> str:
    """The exact worst case, and which limits it breaks (default: the function's): `5.957° to 7.938°, breaks 6°`."""
    ends = [f"{number(end, 4)}°" for end in counts.worst_case]
    broken = [f"{number(limit, 4) if limit % 1 else given(limit)}°" for limit in counts.broken(limits)]
    return f"{' to '.join(ends)}, {f'breaks {words(broken)}' if broken else 'within the limits'}"


def counts_table(results: ClutchResults) -> Table:
    """The given, the cheapest and the safe tolerances, each with a count and the exact worst case."""
    shown = {name: results.counts[name] for name in (GIVEN, CHEAPEST, SAFE) if name in results.counts}
    every = list(shown.values())
    rows = [[f"{NAMES[name]}, ± (mm)", *(number(one.tolerances[name], 4) for one in every)] for name in TOLERANCES]
    rows += [
        [f"Cost {COST} (1/mm)", *(number(one.cost, 4) for one in every)],
        ["Worst case", *(worst_text(one) for one in every)],
        [f"Below {given(LIMITS[0])}°, counted (ppm)", *(per_million(one.function.low) for one in every)],
        [f"Above {given(LIMITS[1])}°, counted (ppm)", *(per_million(one.function.high) for one in every)],
        ["Both, counted (ppm)", *(per_million(one.function.either) for one in every)],
        ["Both, exact (ppm)", *(number(1e6 * sum(exact_rejects(one.tolerances)), 3) for one in every)],
        ["Outside nominal ± 0.6°, counted", *(share_text(one.deviation.either) for one in every)],
    ]
    note = (
        f"{count(every[0].function.low.samples)} assemblies counted for each column, in closed form; 95 % confidence "
        "intervals in brackets. The worst case is over all dimensions within their tolerances. Dimensions are normally "
        "distributed, and one part in 370 lies outside its tolerance: a few assemblies may exceed the limits even "
        "where the worst case does not."
    )
    return Table("Three sets of tolerances, counted", ["", *(name.capitalize() for name in shown)], rows, note)


def given_cost() -> float:
    """The cost of the given tolerances, 1/mm."""
    return sum(1 / tolerance for tolerance in TOLERANCES.values())


def allocation_table(results: ClutchResults) -> Table:
    """The given and the cheapest tolerances."""
    solution, evidence = results.allocation, results.evidence
    assert solution is not None
    chosen = tolerances_of(solution)
    rows = [[f"{NAMES[name]}, ± (mm)", given(TOLERANCES[name]), number(chosen[name], 4)] for name in TOLERANCES]
    rows.append([f"Cost {COST}", number(given_cost(), 4, "1/mm"), number(solution.objective, 4, "1/mm")])
    rows.append(["Rejects by the expansion", percent(results.given), percent(rejects_of(solution))])
    if evidence is not None:
        rows.append([f"Rejects counted, {count(evidence.samples)} assemblies", "–", _counted_text(evidence)])
    note = (
        f"Specification: nominal ± 0.6°, that is {number(DEVIATION[0], 5)}° to {number(DEVIATION[1], 5)}°. The "
        "cheapest tolerances have no more rejects than the given ones; ± is one standard error."
    )
    return Table("Allocation of the tolerances", ["", "Given", "Cheapest"], rows, note)


def rejects_of(solution: al.Solution) -> float:
    """The share of rejects of a design by its expansion."""
    return next(one.worst for one in solution.constraints if one.name == "rejects")


class Counted(NamedTuple):
    """A share estimated from samples, and its standard error."""

    share: float
    standard_error: float


def counted(evidence: al.results.Evidence) -> Counted:
    """The share of rejects among fresh assemblies: those too low and those too high."""
    sides = list(evidence.statistics.values())
    return Counted(sum(one.estimate for one in sides), math.hypot(*(one.standard_error for one in sides)))


def _counted_text(evidence: al.results.Evidence) -> str:
    return " ± ".join(map(percent, counted(evidence)))


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
