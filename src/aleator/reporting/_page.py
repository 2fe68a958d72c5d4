"""A page: the verdict on designs, then sections of text, tables and figures, in one HTML file without a network."""

import html
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from aleator.nlp import Status
from aleator.reporting._blocks import Card, Drawing, Linked, Section, Verdict
from aleator.reporting._choices import choices_data, stages
from aleator.reporting._files import write_text
from aleator.reporting._numbers import count, interval, number, percent, unit_of_objective, words
from aleator.reporting._tables import unresolved
from aleator.solution import Solution
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

OFTEN = 0.05
"""A share of violating systems above which a page does not show green."""


def verdict(designs: Mapping[str, Solution], evidence: Mapping[str, Evidence]) -> Verdict:
    """The verdict: is everything solved, how often are limits violated, can the moments be trusted?

    The last design is the one that is proposed; the others stand beside it for comparison.
    """
    failed = {name: one for name, one in designs.items() if not one.ok}
    coarse = unresolved(designs)
    # The headline says why, where it is one.
    sentences = [f"{name}: {one.why()}" for name, one in failed.items()] if len(failed) > 1 else []
    contradicted = {name: one for name, one in evidence.items() if not one.agrees}
    sentences += [f"{name}: {one.alarm()}" for name, one in contradicted.items()]
    sentences += [_violation_sentence(name, one) for name, one in evidence.items()]
    sentences += [
        f"The expansion of {name} misses new samples of {text} by {percent(error)} of their standard deviation: "
        "raise its order before trusting its means and spreads."
        for name, (text, error) in coarse.items()
    ]
    if not evidence:
        sentences.append("There is no Monte Carlo evidence: how often single systems violate the limits is not known.")
    cards = [*_solution_cards(designs), *_violation_cards(evidence)][:4]
    if failed:
        return Verdict("bad", "Not solved", _unsolved(failed, len(designs)), sentences, cards)
    solved = {1: "The design is solved", 2: "Both designs are solved"}.get(
        len(designs), f"All {len(designs)} designs are solved"
    )
    if coarse:
        return Verdict("bad", "Not resolved", f"{solved}, but the expansion is too coarse to trust.", sentences, cards)
    if contradicted:
        headline = f"{solved}, but fresh simulations contradict {words(list(contradicted))}: do not trust the numbers."
        return Verdict("bad", "Contradicted", headline, sentences, cards)
    unchecked = [name for name in designs if name not in evidence]
    if unchecked:
        headline = f"{solved} to tolerance, but there is no Monte Carlo evidence for {words(unchecked)}."
        return Verdict("caution", "Solved, not checked", headline, sentences, cards)
    proposed, *others = list(designs)[::-1]
    of = "" if not others else f" of {proposed}"
    compared = _comparison({name: evidence[name] for name in others})
    if not evidence[proposed].violations:
        headline = f"{solved} to tolerance; no limit applies to single systems{of}, so none was counted.{compared}"
        return Verdict("good", "Solved", headline, sentences, cards)
    joint = evidence[proposed].joint
    share = f"{percent(joint.estimate)} [{interval(joint)}] of {'systems' if not others else f'the systems{of}'}"
    if joint.estimate > OFTEN:
        headline = f"{solved} to tolerance, but {share} break a limit: check the margin.{compared}"
        return Verdict("caution", "Solved, limits often broken", headline, sentences, cards)
    headline = f"{solved} to tolerance; {share} break a limit.{compared}"
    return Verdict("good", "Solved and checked", headline, sentences, cards)


def _unsolved(failed: Mapping[str, Solution], designs: int) -> str:
    """How many designs are solved, and what the others are."""
    told = [f"'{name}' is {_UNSOLVED.get(one.status, 'not solved')}" for name, one in failed.items()]
    why = f": {next(iter(failed.values())).why().rstrip('.')}" if len(failed) == 1 else ""
    if designs == 1:
        return f"{told[0]}{why}. Do not use it as a design."
    return f"{designs - len(failed)} of {designs} designs are solved; {words(told)}{why}."


_UNSOLVED = {Status.INFEASIBLE: "infeasible", Status.INTERRUPTED: "interrupted"}


def _comparison(others: Mapping[str, Evidence]) -> str:
    """How often the designs break a limit that are shown beside the proposed one, which is the last."""
    shares = [f"{percent(one.joint.estimate)} of {name}" for name, one in others.items() if one.violations]
    return f" For comparison: {words(shares[::-1])}." if shares else ""


def _violation_sentence(name: str, evidence: Evidence) -> str:
    if not evidence.violations:
        why = "; ".join(f"{text}: {reason}" for text, reason in evidence.uncounted.items())
        return f"{name}: no limit applies to single systems, so there is nothing to count{f' ({why})' if why else ''}."
    parts = [f"{limit} {percent(share.estimate)}" for limit, share in evidence.violations.items()]
    over_time = f", limits over time counted at {count(evidence.instants)} instants" if evidence.instants else ""
    return (
        f"{name}: of {count(evidence.samples)} random systems {percent(evidence.joint.estimate)}"
        f" [{interval(evidence.joint)}] violate at least one limit ({words(parts)}){over_time}."
    )


def _solution_cards(designs: Mapping[str, Solution]) -> list[Card]:
    cards = []
    for name, one in list(designs.items())[:2]:
        unit = unit_of_objective(one.problem)
        note = f"held by {words(one.active, 'nothing')}" if one.ok else "not solved"
        cards.append(Card(f"Objective of {name}", number(one.objective, 4, unit), note))
    return cards


def _violation_cards(evidence: Mapping[str, Evidence]) -> list[Card]:
    return [
        Card(
            f"Systems of {name} that violate a limit",
            percent(one.joint.estimate),
            f"95 % confidence: {interval(one.joint)}",
        )
        for name, one in list(evidence.items())[:2]
        if one.violations
    ]


_PARTS = ("page.html.j2", "page.css", "page.js", "linked.js")


@final
@dataclass(frozen=True)
class Page:
    """Everything on a page, as text: the template escapes it."""

    title: str
    subtitle: str
    verdict: Verdict
    sections: Sequence[Section]
    footer: str = ""


def page_html(page: Page) -> str:
    """The page as one HTML document that contains styles, scripts and data."""
    import jinja2
    from plotly.offline import get_plotlyjs

    folder = resources.files("aleator.reporting") / "templates"
    source = {one: (folder / one).read_text(encoding="utf-8") for one in _PARTS}
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    blocks = [block for section in page.sections for block in section.blocks if isinstance(block, Drawing | Linked)]
    drawings = [_drawn(block, i) for i, block in enumerate(blocks)]
    return environment.from_string(source["page.html.j2"]).render(
        page=page,
        anchors=_anchors(page),
        next_drawn=iter(drawings).__next__,
        css=_raw(source["page.css"]),
        script=_raw(source["page.js"] + source["linked.js"]),
        plotly=_raw(get_plotlyjs()) if drawings else "",
    )


def write_page(page: Page, path: str | Path) -> Path:
    """Write the page; see `page_html`. An earlier page at `path` is replaced atomically."""
    return write_text(path, page_html(page))


def _anchors(page: Page) -> list[str]:
    """A unique anchor for each section."""
    found: list[str] = []
    for section in page.sections:
        repeats = sum(re.fullmatch(rf"{re.escape(section.anchor)}(-\d+)?", one) is not None for one in found)
        found.append(f"{section.anchor}-{repeats + 1}" if repeats else section.anchor)
    return found


def _drawn(block: Drawing | Linked, place: int) -> dict[str, Any]:
    """What the template needs to draw a block: its name, its panels, and what a reader can choose."""
    name = f"figure-{place}"
    panels = [_panel(one, f"{name}-{i}", block.heading, block.caption) for i, one in enumerate(block.figures)]
    if isinstance(block, Drawing):
        return {"name": name, "panels": panels}
    bands = [
        _panel(one, f"{name}-band-{i}", f"{block.heading}: {path} of the chosen design", "")
        for i, (path, one) in enumerate(stages(block).items())
    ]
    return {"name": name, "panels": panels, "bands": bands, "json": _json(choices_data(block))}


def _panel(figure: "Figure", name: str, heading: str, caption: str) -> dict[str, Any]:
    """The data of a figure for the template. Titles become HTML, which wraps on narrow screens."""
    content = json.loads(figure.to_json() or "{}")
    title = html.unescape((content["layout"].pop("title", None) or {}).get("text", ""))
    if title:
        content["layout"]["margin"]["t"] = 40
    return {
        "id": name,
        "title": title,
        "height": content["layout"].get("height", 420),
        "alt": ". ".join(part for part in (heading, title, caption) if part),
        "json": _json(content),
    }


def _json(content: Any) -> Any:
    """Data that a script element may hold."""
    return _raw(json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"))


def _raw(text: str) -> Any:
    """Trusted text that the template inserts without escaping: our own styles and scripts, and JSON without any `<`."""
    from markupsafe import Markup

    return Markup(text)
