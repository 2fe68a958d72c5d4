"""Common parts of design studies: missing recommendations, violation rates, relative changes."""

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

    - `awaited`: the designs that need evidence; `also`: further solutions whose expansions must be resolved.
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
    """Rows of a table with designs as columns: how often fresh systems break each limit, and any limit.

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
    """The search for a margin, with the result on fresh systems for the chosen one; `margin` names it in words."""
    chosen = margin or f"a = {number(found.sigmas, 4)}"
    caption = (
        f"Each trial is a full design, counted on the same random {who}, until at most {given(100 * found.target)} % "
        f"of them break a limit. The chosen margin, {chosen}, is {found.sentence(who)}. Bars: 95 % intervals; on fresh "
        f"{who} at the confidence stated."
    )
    return Drawing([calibration_figure(found, who=who)], heading, caption)
