"""`report`: the results of any problem as one page, verdict first."""

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from aleator._core.border import a_name, one_of, positive
from aleator._core.errors import ProblemError
from aleator.reporting._files import as_path, check_writable
from aleator.reporting._first_screen import TARGET, proposal
from aleator.reporting._fronts import evidence_on
from aleator.reporting._linked import disagreements, front_blocks, trade_off_blocks
from aleator.reporting._numbers import units_of_moments, words
from aleator.reporting._page import Block, Code, Drawing, Page, Section, Table, Text, Verdict, write_page
from aleator.reporting._paths import trajectory_figure
from aleator.reporting._solutions import mesh_drawing, search_drawings
from aleator.reporting._spreads import percentile_figure
from aleator.reporting._store import provenance
from aleator.reporting._tables import certificate_table, designs_table, evidence_table, statistics_table
from aleator.solution import Solution
from aleator.sweep import EvidenceOfAll, Front, TradeOff
from aleator.uncertainty import placements
from aleator.validation import Evidence

HOW_TO_READ = (
    (
        "The decisions are the numbers that the optimiser chose. μ and σ are mean and standard deviation over the "
        "declared uncertainty, computed by a polynomial chaos expansion."
    ),
    (
        "A limit on mean ± a·σ is a margin, not a guarantee: how often single systems break the limit is counted on "
        "fresh random systems, without the expansion, and given with a 95 % confidence interval."
    ),
    (
        "An active limit is one that the design meets with equality. Its shadow price is the amount by which the "
        "objective would fall for each unit that the limit is relaxed; the shadow price of an inactive limit is zero."
    ),
    (
        "In the figures, hover over a point for its numbers. Drag to zoom, double-click to return. On a front, click "
        "on a point, or choose it in the table by the arrow keys, to see its design."
    ),
)


def report(
    solutions: Solution | Mapping[str, Solution],
    evidence: Evidence | Mapping[str, Evidence] | None = None,
    fronts: Front | TradeOff | Mapping[str, Front | TradeOff] | None = None,
    *,
    along: EvidenceOfAll | Mapping[str, EvidenceOfAll] | None = None,
    path: str | Path,
    title: str = "Design under uncertainty",
    target: float = TARGET,
) -> Path:
    """Write the results of any problem as one HTML page that works offline, and return its path.

    Give one solution with its evidence and front, or several of each by name, with evidence and fronts under the names
    of their designs: the last design is the one that is proposed, on the first screen. Sections without results are
    omitted; a design that was not solved is reported as such, first.

    - `fronts`: of `al.pareto` or `al.trade_off`; a reader who chooses a point sees the design there; `along`: evidence
      on these designs, of `al.validate_all`;
    - `target`: the largest share of systems that may break a limit of the proposed design.

    Raises `ProblemError` if there is no solution, for evidence on a design that is not shown, and if the file cannot be
    written.
    """
    designs = _named(solutions, Solution)
    if not designs:
        raise ProblemError("report: expected at least one solution; received none.")
    first = next(iter(designs))
    sampled, swept = _named(evidence, Evidence, first), _named(fronts, (Front, TradeOff), first)
    for name, one in sampled.items():
        if name not in designs:
            raise ProblemError(f"report: there is evidence on '{name}', but no design of that name: {list(designs)}.")
        if not np.array_equal(designs[name].vector, one.solution.vector):
            raise ProblemError(f"report: the evidence on '{name}' was sampled from another design than the one shown.")
    shown = [*designs.values(), *(point for one in swept.values() for point in one.solutions)]
    checked = [one for each in _named(along, EvidenceOfAll).values() for one in each.by_place.items()]
    for place, one in checked:
        if not any(evidence_on(point, [one]) for point in shown):
            raise ProblemError(
                f"report: along: the evidence at '{place}' was sampled from a design that is on none of the fronts "
                "shown: expected al.validate_all(front) of a front among `fronts`."
            )
    check_writable(as_path(path).parent)
    page = whole_page(
        a_name("report: title", title),
        f"{words(list(designs))}: result and evidence",
        proposal(designs, sampled, positive("report: target", target, below=1.0)),
        sections(designs, sampled, swept, [one for _, one in checked]),
        {"designs": designs, "evidence": sampled, "fronts": swept},
    )
    return write_page(page, path)


def _named(given: Any, kinds: type | tuple[type, ...], name: str = "design") -> dict[str, Any]:
    """One or several results by name; anything else is refused."""
    every = {} if given is None else given if isinstance(given, Mapping) else {name: given}
    return {str(key): one_of(f"report: '{key}'", one, kinds) for key, one in every.items()}


def sections(
    designs: Mapping[str, Solution],
    evidence: Mapping[str, Evidence],
    fronts: Mapping[str, Front | TradeOff],
    along: Sequence[Evidence] = (),
) -> list[Section]:
    """The chapters on any designs: designs side by side, fronts, evidence, trust and mathematics.

    - `along`: evidence on the designs of fronts and trade-offs.
    """
    if not designs:
        return []
    failed = [Text([one.why()], lead=f"{name} is not solved.") for name, one in designs.items() if not one.ok]
    meshes = [mesh_drawing(one.meshes, name) for name, one in designs.items() if any(mesh.worst for mesh in one.meshes)]
    paths, counted = evidence_sections(evidence)
    every = [
        Section("Designs", [*failed, *_motions(designs), designs_table(designs, evidence)]),
        paths,
        trade_offs_section(designs, fronts, [*along, *evidence.values()]),
        counted,
        Section("Certificate", [certificate_table(designs), *meshes, *search_drawings(designs)]),
        Section("The problem as mathematics", [Code(name, one.problem_text, True) for name, one in designs.items()]),
    ]
    return [one for one in every if one.blocks]


def _motions(designs: Mapping[str, Solution]) -> Iterator[Drawing]:
    """The designs that decide inputs over time, in one figure each."""
    for name, one in designs.items():
        if placements(one.problem.inputs).decisions:
            caption = (
                "The inputs, then what is limited over time, then the decisions between their bounds. Bands: two "
                "standard deviations to each side, or as many as the limit has."
            )
            yield Drawing([one.plot()], f"Inputs of {name}, limits and decisions", caption)


def evidence_sections(evidence: Mapping[str, Evidence]) -> tuple[Section, Section]:
    """The chapters on sampled systems: over time, and counted."""
    told = "Sampled systems over time; those that violate a limit are highlighted."
    paths = list[Drawing]()
    for name, one in evidence.items():
        for limit in dict.fromkeys(kept.name for kept in one.trajectories):
            paths.append(Drawing([trajectory_figure(one, limit)], f"{limit} of {name}", told))
    return Section("Trajectories", paths), Section("Evidence", [*_counted(evidence)])


def trade_offs_section(
    designs: Mapping[str, Solution], fronts: Mapping[str, Front | TradeOff], known: Sequence[Evidence]
) -> Section:
    """The chapter on fronts, linked with the evidence that is known of designs on them."""
    swept = {name: one for name, one in fronts.items() if isinstance(one, Front) and one.solutions}
    traded = {name: one for name, one in fronts.items() if isinstance(one, TradeOff)}
    optima = [Text(said, lead="Several local optima.")] if (said := disagreements(designs, swept)) else []
    # The page opens where its design is.
    shown = next((one for one in reversed(list(designs.values())) if one.ok), None)
    return Section("Trade-offs", [*optima, *front_blocks(swept, known, shown), *trade_off_blocks(traded, known, shown)])


def whole_page(
    title: str,
    subtitle: str,
    verdict: Verdict,
    sections: Sequence[Section],
    results: Mapping[str, Any] = MappingProxyType({}),
    glossary: Sequence[Table] = (),
) -> Page:
    """A page: sections that are not empty, then where the numbers of the results come from, and how to read them."""
    import aleator

    last = [replace(provenance(results), folded=True), Section("How to read this", [Text(HOW_TO_READ), *glossary])]
    now = datetime.datetime.now().astimezone()
    footer = (
        f"Written by aleator {aleator.__version__} with JAX {version('jax')} on {now:%Y-%m-%d at %H:%M}. This page is"
        " one file and needs no network."
    )
    return Page(title, subtitle, verdict, [section for section in [*sections, *last] if section.blocks], footer)


def _counted(evidence: Mapping[str, Evidence]) -> Iterator[Block]:
    """What was counted on each design, and sampled of it."""
    alarms = {name: one.alarm() for name, one in evidence.items() if not one.agrees}
    yield from (Text([alarm], lead=f"{name}: samples and solution disagree.") for name, alarm in alarms.items())
    for name, one in evidence.items():
        if one.compared:
            sentences = [each.sentence() for each in one.compared]
            yield Text(sentences, lead=f"{name}: limits on statistics, by the samples.")
    if evidence:
        yield evidence_table(evidence)
        yield from filter(None, [statistics_table(evidence)])
    told = "Bars: 1 to 99 %, 5 to 95 % and 25 to 75 % of the systems."
    units = {text: unit for one in evidence.values() for text, unit in units_of_moments(one.solution.problem).items()}
    for text in dict.fromkeys(text for one in evidence.values() for text in one.functionals):
        group = {name: one.functionals[text] for name, one in evidence.items() if text in one.functionals}
        if not any(np.ndim(one.mean) or one.percentiles is None for one in group.values()):
            figure = percentile_figure(group, x=text, unit=units.get(text, ""))
            yield Drawing([figure], f"Spread of {text} over random systems", told)
