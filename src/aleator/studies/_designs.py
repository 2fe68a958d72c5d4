"""What studies of designs say alike: when there is no recommendation, how often limits are broken, what changes."""

from collections.abc import Iterator, Mapping, Sequence

import aleator as al
from aleator.reporting import (
    Card,
    Drawing,
    Verdict,
    calibration_figure,
    given,
    number,
    percent,
    share_text,
    unresolved,
    words,
)


def no_recommendation(
    designs: Mapping[str, al.Solution],
    evidence: Mapping[str, al.results.Evidence],
    awaited: Sequence[str],
    sentences: Sequence[str],
    cards: Sequence[Card],
    also: Mapping[str, al.Solution] | None = None,
) -> Verdict | None:
    """The verdict where something is missing, not solved or not resolved; None where all designs can be judged.

    - `awaited`: the designs that evidence is awaited of; `also`: further solutions that have to be resolved.
    """
    if failed := [name for name, one in designs.items() if not one.ok]:
        why = [f"{name}: {designs[name].why()}" for name in failed]
        headline = f"{words(failed)} could not be solved: no recommendation."
        return Verdict("bad", "Not solved", headline, [*why, *sentences], cards)
    if not set(awaited) <= set(evidence):
        headline = "The study was stopped before its evidence: no recommendation yet."
        return Verdict("caution", "Incomplete", headline, sentences, cards)
    if coarse := unresolved({**designs, **(also or {})}):
        headline = f"The expansion of {words(list(coarse))} is too coarse to trust."
        return Verdict("bad", "Not resolved", headline, sentences, cards)
    return None


def violation_rows(evidence: Sequence[al.results.Evidence | None], broken: str) -> Iterator[list[str]]:
    """Rows of a table whose columns are designs: how often fresh systems break each limit, and any of them.

    `broken` begins each row: `Cars beyond`, `Systems that break`.
    """
    found = [one for one in evidence if one is not None]
    for limit in dict.fromkeys(limit for one in found for limit in one.violations):
        yield [f"{broken} {limit}", *(share_text(one.violations.get(limit)) if one else "–" for one in evidence)]
    if found:
        yield [f"{broken} any limit", *(share_text(one.joint) if one else "–" for one in evidence)]


def signed(change: float) -> str:
    """A relative change with its sign: `+3.9 %`."""
    return f"{'+' if change >= 0 else '−'}{percent(abs(change))}"


def margin_drawing(found: al.results.Calibration, heading: str, who: str, margin: str = "") -> Drawing:
    """The search for a margin, with what fresh systems say of the one chosen; `margin` names that in words."""
    chosen = margin or f"a = {number(found.sigmas, 4)}"
    caption = (
        f"Each trial is a full design, counted on the same random {who}, until at most {given(100 * found.target)} % of"
        f" them break a limit. The margin chosen, {chosen}, is {found.sentence(who)}. Bars: 95 % intervals, on fresh"
        f" {who} at their own confidence."
    )
    return Drawing([calibration_figure(found, who=who)], heading, caption)
