"""The design to build of a motion study: the plan whose limits hold as often as required, and its cost.

The dissertation's margin of one standard deviation leaves a fifth to two fifths of the systems beyond a limit. So every
study calibrates a margin until fresh systems confirm it for `TARGET`, counting all limits of the problem jointly.
"""

from collections.abc import Iterator, Mapping, Sequence

import aleator as al
from aleator.reporting import (
    Block,
    Card,
    Table,
    Verdict,
    given,
    number,
    percent,
    share_text,
)
from aleator.studies._shared import margin_drawing, signed

TARGET = 0.01
"""The share of systems that may break any limit."""

CALIBRATED = "calibrated"

TRIED = 1.6
"""The margin at which the search starts: four in a hundred of a uniform distribution lie beyond it on one side."""


def meets(found: al.results.Calibration | None) -> bool:
    """Whether fresh systems confirm a calibrated plan, and its other limits hold as often as the calibrated ones."""
    if found is None or found.evidence is None:
        return False
    return found.confirmed and found.evidence.joint.upper <= found.target


def price(built: float, printed: float, unit: str) -> str:
    """A plan's cost compared with that at the published margin: `113.0 J, 0.8 % more than with a = 1 (112.1 J)`."""
    change = built / printed - 1
    side = "more" if change >= 0 else "less"
    return f"{number(built, 4, unit)}, {percent(abs(change))} {side} than with a = 1 ({number(printed, 4, unit)})"


def build_verdict(
    found: al.results.Calibration | None,
    printed: al.Solution,
    *,
    unit: str,
    who: str,
    beside: str = "",
    sentences: Sequence[str] = (),
    cards: Sequence[Card] = (),
) -> Verdict:
    """Whether there is a design to build, which it is, and its cost compared with the `printed` one.

    - `unit`: of the objective; `who`: what the systems are called; `beside`: a further sentence about the plan.
    """
    if found is None:
        headline = (
            f"No design to build yet: no margin was calibrated at which at most {given(100 * TARGET)} % of the {who} "
            "break a limit."
        )
        return Verdict("caution", "Not calibrated", headline, sentences, cards)
    cost = price(found.solution.objective, printed.objective, unit)
    plan = f"the calibrated plan, a = {number(found.sigmas, 3)}, for {cost}"
    if meets(found):
        headline = f"{plan[0].upper()}{plan[1:]}: {found.sentence(who)}.{beside}"
        return Verdict("good", "Build", headline, sentences, cards)
    why = found.sentence(who)
    if found.confirmed and found.evidence is not None:
        why = f"confirmed for its margins alone: {share_text(found.evidence.joint)} of the {who} break some limit"
    headline = f"No design to build: the best is {plan}. It is {why}."
    return Verdict("bad", "Not confirmed", headline, sentences, cards)


def price_table(
    plans: Mapping[str, al.Solution],
    evidence: Mapping[str, al.results.Evidence],
    sigmas: Mapping[str, float],
    printed: str,
    measure: str,
) -> Table:
    """The cost of each margin, and how often it fails; `sigmas` are those of the plans to show."""
    rows = []
    for name, margin in sigmas.items():
        if name in plans and printed in plans:
            change = plans[name].objective / plans[printed].objective - 1
            found = evidence.get(name)
            rows.append(
                [
                    name,
                    number(margin, 4),
                    number(plans[name].objective, 5),
                    "–" if name == printed else signed(change),
                    share_text(found.joint) if found else "–",
                ]
            )
    header = ["Plan", "Margin a", measure[:1].upper() + measure[1:], "Beside a = 1", "Systems that break any limit"]
    return Table("What a margin costs", header, rows)


def margin_blocks(found: al.results.Calibration | None, prices: Table, who: str) -> Iterator[Block]:
    """The chapter on margins: their costs, and the search for the confirmed one."""
    if prices.rows:
        yield prices
    if found is not None:
        yield margin_drawing(found, "The margin for a tolerated share of violations", who)
