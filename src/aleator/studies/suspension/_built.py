"""The designs to build, with calibrated margins, compared with the published ones."""

from collections.abc import Iterator

import aleator as al
from aleator.reporting import Card, Table, given, number, percent, words
from aleator.studies._shared import signed, violation_rows
from aleator.studies.suspension._facts import (
    RIDE_TEXT,
    RIDE_UNIT,
    cost,
    decision_rows,
    dollars,
)
from aleator.studies.suspension._run import BUILT, RIDE, TARGET, SuspensionResults

WITHIN = f"{given(100 * TARGET)} %"


def confirmed(results: SuspensionResults) -> bool:
    """Whether fresh cars confirm the margins of all designs to build."""
    return all(name in results.built and results.built[name].confirmed for name in BUILT)


def measure(name: str, solution: al.Solution) -> float:
    """A design's objective: the ride of uOpt, μ + σ in m²/s³, the cost of the spreads of aOpt in $."""
    if name == "aOpt":
        return cost(solution)
    ride = solution.moments[RIDE_TEXT]
    return float(ride.mean + ride.std)


def measure_text(name: str, value: float) -> str:
    """The same with its unit: `193.6 m²/s³`, `$5.40`."""
    return dollars(value) if name == "aOpt" else number(value, 4, RIDE_UNIT)


def price_text(results: SuspensionResults, name: str) -> str:
    """The cost of the margin of a design to build: `192.5 m²/s³ instead of 185.3 m²/s³ (+3.9 %)`."""
    before, after = measure(name, results.designs[name]), measure(name, results.built[name].solution)
    change = after / before - 1
    said = f"×{number(after / before, 3)}" if change > 1 else signed(change)
    return f"{measure_text(name, after)} instead of {measure_text(name, before)} ({said})"


def margins_text(margins: dict[str, float]) -> str:
    """Margins in words, equal ones together: `1.6 σ on travel and holding, 2.4 σ on ride`."""
    together: dict[str, list[str]] = {}
    for name, sigmas in margins.items():
        together.setdefault(number(sigmas, 3), []).append(name)
    return ", ".join(f"{sigmas} σ on {words(names)}" for sigmas, names in together.items())


def headline(results: SuspensionResults) -> str:
    """Which designs to build and at which cost, once their margins are confirmed."""
    shares = {name: percent(one.confirmation.estimate) for name, one in results.built.items() if one.confirmation}
    before = {name: percent(results.evidence[name].joint.estimate) for name in BUILT}
    today, apportioned = cost(results.built["uOpt"].solution), cost(results.built["aOpt"].solution)
    against = "more" if apportioned > today else "less"
    return (
        f"uOpt with {margins_text(results.built['uOpt'].margins)}: {shares['uOpt']} of its cars break a limit,"
        f" not {before['uOpt']} as of the printed one, for a ride of {price_text(results, 'uOpt')}. Where ride has to"
        f" stay within {given(RIDE, RIDE_UNIT)} as well, aOpt with {margins_text(results.built['aOpt'].margins)}:"
        f" {shares['aOpt']}, not {before['aOpt']}, for {price_text(results, 'aOpt')}; that is"
        f" {percent(abs(apportioned / today - 1))} {against} than today's spreads cost."
    )


def sentences(results: SuspensionResults) -> Iterator[str]:
    """Sentences on each design to build."""
    for name, one in results.built.items():
        price = f" Its price: {price_text(results, name)}." if name in results.designs else ""
        yield (
            f"{name} to build: {margins_text(one.margins)}, {one.sentence('cars')} (any of {words(list(one.names))})."
            f"{price}"
        )


def cards(results: SuspensionResults) -> Iterator[Card]:
    """How often the designs to build break a limit, and their cost."""
    for name, one in results.built.items():
        if one.confirmation is None or name not in results.designs:
            continue
        said = "confirmed" if one.confirmed else "not confirmed"
        label = f"{name} to build: cars beyond a limit"
        yield Card(label, percent(one.confirmation.estimate), f"{said} for {WITHIN}; {price_text(results, name)}")


def built_table(results: SuspensionResults) -> Table:
    """The designs to build and the published ones from which they are derived."""
    columns: dict[str, tuple[al.Solution, al.results.Evidence | None, dict[str, float]]] = {}
    for name, one in results.built.items():
        if name in results.designs:
            printed = dict.fromkeys(one.names, 1.0)
            columns[f"{name}, printed"] = (results.designs[name], results.evidence.get(name), printed)
        columns[f"{name}, to build"] = (one.solution, one.evidence, one.margins)
    every = list(columns.values())
    rows = [["Margins", *(margins_text(margins) for _, _, margins in every)]]
    rows += decision_rows([one for one, _, _ in every])
    rows.append([f"Ride, μ + σ ({RIDE_UNIT})", *(number(measure("uOpt", one), 4) for one, _, _ in every)])
    rows.append(["Cost of the spreads", *(dollars(cost(one)) for one, _, _ in every)])
    rows += violation_rows([one for _, one, _ in every], "Cars beyond")
    note = (
        "The margins to build with are the smallest, in a fixed ratio, at which fresh cars confirm that at most "
        f"{WITHIN} of them break any limit of their design. Intervals are 95 % confidence."
    )
    return Table("The designs to build and the printed ones", ["", *columns], rows, note)
