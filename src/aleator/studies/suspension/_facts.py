"""Numbers and tables of the suspension study: its designs, those to build, and the published ones beside ours."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

import aleator as al
from aleator.design import value_at
from aleator.reporting import Box, Card, Table, given, number, percent, share_text, words
from aleator.studies._shared import signed, violation_rows
from aleator.studies.suspension import COST
from aleator.studies.suspension._run import BUILT, HOLDING, NARROW_TRAVEL, RIDE, TARGET, TRAVEL, SuspensionResults

RIDE_TEXT, HOLDING_TEXT = "∫comfort dt", "rms(grip)"
RIDE_UNIT = "m²/s³"
ROBUST_NARROW, WIDER_NARROW = "uOpt, 1 σ", "uOpt, 1.25 σ"
SPREADS = {
    "k_s.half_width": "spring kₛ",
    "b_s.half_width": "damper bₛ",
    "eta.half_width": "damping ratio η",
}
UNITS = {"m_s": "kg", "m_u": "kg", "k_s": "N/m", "b_s": "N s/m", "eta": "", "k_u": "N/m"}
WITHIN = f"{given(100 * TARGET)} %"
VIOLATIONS = {"dOpt": 0.596, ROBUST_NARROW: 0.114, WIDER_NARROW: 0.035}
HELD = {"dOpt": {"holding"}, "uOpt": {"travel"}, "aOpt": {"ride"}}
PRINTED_COST, SAVING = 17.70, 0.74
CHANGES = {"k_s.half_width": 11_250.0, "b_s.half_width": 423.08, "eta.half_width": 0.5213}
ALIKE = 2.0
"""Two numbers within this factor count as of similar size."""


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


def built_headline(results: SuspensionResults) -> str:
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


def built_sentences(results: SuspensionResults) -> Iterator[str]:
    """Sentences on each design to build."""
    for name, one in results.built.items():
        price = f" Its price: {price_text(results, name)}." if name in results.designs else ""
        yield (
            f"{name} to build: {margins_text(one.margins)}, {one.sentence('cars')} (any of {words(list(one.names))})."
            f"{price}"
        )


def built_cards(results: SuspensionResults) -> Iterator[Card]:
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


class Pair(NamedTuple):
    """A number of the dissertation and ours, None where not available."""

    text: str
    published: float
    published_text: str
    ours: float | None
    ours_text: str

    @property
    def ratio(self) -> float | None:
        """Ours over the published one."""
        return None if self.ours is None else self.ours / self.published

    def row(self) -> list[str]:
        """As a row of the table."""
        compared = "–" if self.ratio is None else f"×{number(self.ratio, 3)}"
        return [self.text, self.published_text, self.ours_text, compared]


def published_table(results: SuspensionResults) -> Table:
    """The dissertation's values compared with the computed ones."""
    shares, others, changes = list(_shares(results)), list(_costs(results)), list(_changes(results))
    rows = [one.row() for one in shares]
    for i, (name, printed) in enumerate(HELD.items()):
        start = f"Held by, at R = {TRAVEL:g} m, H = {HOLDING:g} m: " if i == 0 else "– "
        text = "ride (in the text: ride and holding)" if name == "aOpt" else words(sorted(printed))
        rows.append([f"{start}{name}", text, *_held(results, name)])
    rows += [one.row() for one in others]
    part = saving(results)
    rows.append([f"Saving at R = {TRAVEL:g} m", "not printed", "–" if part is None else percent(part), "–"])
    rows += [one.row() for one in changes]
    rows.append(["Spring at its lower bound, figure 6.8", "most designs", *_spring_at_bound(results)])
    note = " ".join(
        [
            "The dissertation's road is not published; this study's road has the same bumps and another noise, so that "
            "digits cannot agree.",
            *agreement(results, shares, others, changes),
            "Published violations are of 1000 samples. Erratum: 20.19 % in table 7.4 is a misprint, for 423.08 N s/m"
            " are 169.2 % of the initial 250 N s/m.",
        ]
    )
    return Table("Chapters 6 and 7, printed and recomputed", ["", "Dissertation", "This study", "Compared"], rows, note)


def agreement(results: SuspensionResults, shares: list[Pair], others: list[Pair], changes: list[Pair]) -> Iterator[str]:
    """Sentences on agreement and disagreement, computed from the numbers available."""
    ours = [one.ours for one in shares]
    if None not in ours:
        found = np.argsort(np.array(ours, dtype=float)).tolist()
        same = found == np.argsort([one.published for one in shares]).tolist()
        yield f"The three shares of violating cars stand {'' if same else 'not '}in the printed order."
    if any(one.ratio is not None for one in changes):
        same_sign = sum(one.ratio is not None and one.ratio > 0 for one in changes)
        yield f"Of {len(changes)} changes of a spread {same_sign} have the printed sign."
    known = [one for one in (*shares, *others, *changes) if one.ratio is not None]
    unlike = [one for one in known if not 1 / ALIKE <= (one.ratio or 0.0) <= ALIKE]
    if known:
        exceptions = f"; not: {words([one.text.lstrip('– ') for one in unlike])}" if unlike else ""
        yield (
            f"Of {len(known)} printed numbers {len(known) - len(unlike)} are met within a factor of"
            f" {given(ALIKE)}{exceptions}."
        )
    if reached := [name for name in HELD if solved(results, name)]:
        same_held = [name for name in reached if set(constraints_active(results.designs[name])) == HELD[name]]
        yield f"Of {len(reached)} designs {len(same_held)} are held by exactly the printed limits."


def _shares(results: SuspensionResults) -> Iterator[Pair]:
    texts = {
        "dOpt": f"Violate travel ±{NARROW_TRAVEL:g} m: dOpt",
        ROBUST_NARROW: "– uOpt, a = 1",
        WIDER_NARROW: "– uOpt, a = 1.25",
    }
    for name, text in texts.items():
        one = results.narrow_evidence.get(name)
        share = one.violations.get("travel") if one else None
        ours = None if share is None else share.estimate
        yield Pair(text, VIOLATIONS[name], percent(VIOLATIONS[name]), ours, "–" if share is None else share_text(share))


def _costs(results: SuspensionResults) -> Iterator[Pair]:
    one = results.designs.get("uOpt") or results.designs.get("dOpt")
    initial = cost(one) if one else None
    shown = "–" if initial is None else dollars(initial)
    yield Pair("Cost of the initial spreads", PRINTED_COST, dollars(PRINTED_COST), initial, shown)
    front, start = results.travel_fronts.get("aOpt"), results.designs.get("uOpt")
    text, printed = "Largest saving along figure 7.3", f"up to {percent(SAVING)}"
    if front is None or start is None or not front.solved.any():
        yield Pair(text, SAVING, printed, None, "–")
        return
    best = int(np.nanargmin(front.objectives))
    part = 1 - float(front.objectives[best]) / cost(start)
    yield Pair(text, SAVING, printed, part, f"{percent(part)} at R = {number(front.values[best], 3, 'm')}")


def _changes(results: SuspensionResults) -> Iterator[Pair]:
    printed = {
        "k_s.half_width": "11 250 N/m (300 %)",
        "b_s.half_width": "423.08 N s/m (printed: 20.19 %)",
        "eta.half_width": "0.5213 (300.12 %)",
    }
    one = solved(results, "aOpt")
    for name, spread in SPREADS.items():
        text = f"Table 7.4, wider by: {spread}"
        if one is None:
            yield Pair(text, CHANGES[name], printed[name], None, "–")
            continue
        start = start_of(one, name)
        change = float(one.decisions[name]) - start
        shown = f"{number(change, 4, UNITS[name.split('.')[0]])} ({percent(change / start)})"
        yield Pair(text, CHANGES[name], printed[name], change, shown)


def _held(results: SuspensionResults, name: str) -> tuple[str, str]:
    one = solved(results, name)
    if one is None:
        return "–", "–"
    found = set(constraints_active(one))
    if found == HELD[name]:
        compared = "the same"
    elif found > HELD[name]:
        compared = f"{words(sorted(found - HELD[name]))} as well"
    else:
        compared = "not the same"
    return words(constraints_active(one), "nothing"), compared


def _spring_at_bound(results: SuspensionResults) -> tuple[str, str]:
    found: list[al.Solution] = [one for front in results.holding_fronts.values() for one in front.solutions if one.ok]
    if not found:
        return "–", "–"
    count = sum("k_s.mean" in one.at_bounds for one in found)
    return f"{count} of {len(found)} designs", "the same" if 2 * count > len(found) else "not the same"
