"""`report`: the results of any problem as one page, verdict first."""

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from itertools import combinations
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from aleator._core.border import a_name, one_of, positive
from aleator._core.errors import ProblemError
from aleator.reporting import _fronts, _tables
from aleator.reporting._documents import HEADINGS, evidence_on, objective_text, rows_of, solution_document, status_words
from aleator.reporting._files import as_path, check_writable
from aleator.reporting._first_screen import TARGET, proposal
from aleator.reporting._numbers import units_of_moments, words
from aleator.reporting._page import (
    Block,
    Choice,
    Code,
    Drawing,
    Linked,
    Page,
    Section,
    Table,
    Text,
    Verdict,
    templates,
    write_page,
)
from aleator.reporting._paths import trajectory_figure
from aleator.reporting._samples import percentile_figure
from aleator.reporting._solutions import mesh_drawing, over_time, search_drawings
from aleator.reporting._tables import provenance
from aleator.solution import Solution
from aleator.sweep import SAME, EvidenceOfAll, Front, Refused, TradeOff
from aleator.uncertainty import placements
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


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
    swept = {name: one for name, one in fronts.items() if isinstance(one, Front) and one.solutions}
    traded = {name: one for name, one in fronts.items() if isinstance(one, TradeOff)}
    optima = [Text(said, lead="Several local optima.")] if (said := disagreements(designs, swept)) else []
    # Known of designs on fronts, and where these open: at the page's own design.
    known = [*along, *evidence.values()], next((one for one in reversed(list(designs.values())) if one.ok), None)
    every = [
        Section("Designs", [*failed, *_motions(designs), _tables.designs_table(designs, evidence)]),
        Section("Trajectories", [*_trajectories(evidence)]),
        Section("Trade-offs", [*optima, *front_blocks(swept, *known), *trade_off_blocks(traded, *known)]),
        Section("Evidence", [*_counted(evidence)]),
        Section("Certificate", [_tables.certificate_table(designs), *meshes, *search_drawings(designs)]),
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


def _trajectories(evidence: Mapping[str, Evidence]) -> Iterator[Drawing]:
    """Each limit over time, with the systems that were sampled."""
    told = "Sampled systems over time; those that violate a limit are highlighted."
    for name, one in evidence.items():
        for limit in dict.fromkeys(kept.name for kept in one.trajectories):
            yield Drawing([trajectory_figure(one, limit)], f"{limit} of {name}", told)


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

    how_to_read = templates().get_template("how_to_read.txt").render().splitlines()
    last = [replace(provenance(results), folded=True), Section("How to read this", [Text(how_to_read), *glossary])]
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
        yield _tables.evidence_table(evidence)
        yield from filter(None, [_tables.statistics_table(evidence)])
    told = "Whiskers: 5 to 95 % of the systems; boxes: 25 to 75 %, with the median; dashed: the mean."
    units = {text: unit for one in evidence.values() for text, unit in units_of_moments(one.solution.problem).items()}
    for text in dict.fromkeys(text for one in evidence.values() for text in one.functionals):
        group = {name: one.functionals[text] for name, one in evidence.items() if text in one.functionals}
        if not any(np.ndim(one.mean) or one.percentiles is None for one in group.values()):
            figure = percentile_figure(group, x=text, unit=units.get(text, ""))
            yield Drawing([figure], f"Spread of {text} over random systems", told)


# --- Fronts whose designs a reader chooses ---------------------------------------------------------------------------

_UNCHECKED = "No fresh systems were simulated at this design: see al.validate_all."


def choice(
    name: str,
    point: Solution | Refused,
    evidence: Evidence | None = None,
    wishes: Mapping[str, str] = MappingProxyType({}),
) -> Choice:
    """All that is known of a design, or why there is none.

    - `evidence`: on this design; `wishes`: their values and rates, where the objective is a weighted sum of wishes.
    """
    if isinstance(point, Refused):
        return Choice(name, [Table("Certificate", ["", ""], [["Status", status_words(point)]], point.reason)])
    rows = list(rows_of(solution_document(point, evidence)))
    alarms = [] if evidence is None or evidence.agrees else [evidence.alarm()]
    alarms += [one.sentence() for one in evidence.compared] if evidence else [_UNCHECKED]
    notes = {"Evidence": " ".join(alarms), "Certificate": "" if point.ok else point.why()}
    headed = {heading: [[row.name, row.text] for row in rows if row.heading == heading] for heading in HEADINGS}
    captions = {heading: heading for heading in HEADINGS}
    if wishes:
        headed["Objective"] = [[*one] for one in wishes.items()]
        captions |= {"Objective": "Wishes", "Shadow prices": "Shadow prices in the weighted sum of the wishes"}
    tables = [Table(captions[one], ["", ""], headed[one], notes.get(one, "")) for one in HEADINGS]
    # That there is no design comes first.
    every = tables if point.ok else [tables[-1], *tables[:-1]]
    figures = [one.draw(point, one.name).update_layout(height=300, meta=one.name) for one in over_time(point)]
    return Choice(name, [one for one in every if one.rows or one.note], figures)


def front_blocks(
    fronts: Mapping[str, Front], evidence: Sequence[Evidence] = (), recommended: Solution | None = None
) -> list[Linked]:
    """For each swept bound: the optimum and the shadow price along it, and the designs."""
    blocks = []
    for bound in dict.fromkeys(one.bound for one in fronts.values()):
        # A study names the front of its design by the bound.
        group = {"design" if name == bound else name: one for name, one in fronts.items() if one.bound == bound}
        caption = (
            f"Filled markers: {bound} is active; open markers: it is not, and something else, or nothing, limits the "
            f"design. Crosses on the axis: no design meets all limits there. The shadow price is what relaxing {bound} "
            "is worth: zero where it is not active."
        )
        heading = f"Optimum against the limit of {bound}"
        figures = [_fronts.front_figure(group), _fronts.shadow_price_figure(group)]
        blocks.append(linked_front(group, figures, heading, caption, "", evidence, recommended))
    return blocks


def linked_front(
    fronts: Mapping[str, Front],
    figures: "Sequence[Figure]",
    heading: str,
    caption: str = "",
    number: str = "",
    evidence: Sequence[Evidence] = (),
    recommended: Solution | None = None,
) -> Linked:
    """Figures of fronts along one bound, linked with the designs.

    - `figures`: of all these fronts in the same order, by `front_figure` or `shadow_price_figure`; `evidence`: on some
      of the designs; `recommended`: the design to build: the one nearest to it is shown first.
    """
    points = _fronts.points_of(fronts)
    choices = [
        choice(f"{before}{front.bound}: {bound}", point, evidence_on(point, evidence))
        for before, bound, front, point in points
    ]
    told = " ".join([caption, *(f"{name}: {one}." for name, front in fronts.items() for one in front.doubts())])
    chosen = _nearest([point for *_, point in points], recommended)
    return Linked(figures, heading, _fronts.front_table(fronts, evidence), choices, chosen, told, number)


def trade_off_blocks(
    fronts: Mapping[str, TradeOff], evidence: Sequence[Evidence] = (), recommended: Solution | None = None
) -> list[Linked]:
    """For each trade-off: a figure for each pair of wishes, and the designs."""
    blocks = []
    caption = "Each point is a certified design: none other is better in all wishes."
    for name, front in fronts.items():
        if not front.solutions:
            continue
        table, choices = _fronts.trade_off_table(front, f"Designs of {name}"), []
        for place, (row, one) in enumerate(zip(table.rows, front.solutions, strict=True)):
            wishes = dict(zip(front.names, row, strict=False))
            title = ", ".join(f"{wish}: {value}" for wish, value in wishes.items())
            wishes |= _fronts.rates_of(front, place)
            choices.append(choice(title, one, evidence_on(one, evidence), wishes))
        figures = [_fronts.pair_figure(front, *pair) for pair in combinations(range(len(front.names)), 2)]
        first = _nearest(front.solutions, recommended)
        blocks.append(Linked(figures, f"Trade-off: {name}", table, choices, first, caption))
    return blocks


def _nearest(designs: Sequence[Solution | Refused], recommended: Solution | None) -> int:
    """The place of the design that is nearest to the recommended one, among those with its decisions, and before others
    those with its objective and its uncertain numbers; of the first design where there is none.
    """
    solved = {i: one for i, one in enumerate(designs) if isinstance(one, Solution) and one.ok}
    if recommended is not None:
        names, size = list(recommended.decisions), len(recommended.vector)
        alike = {i: one for i, one in solved.items() if list(one.decisions) == names and len(one.vector) == size}
        if alike:
            vectors = np.array([one.vector for one in alike.values()])
            scale = np.ptp(vectors, axis=0)
            far = np.max(np.abs(vectors - recommended.vector) / np.where(scale > 0, scale, 1.0), axis=1)
            other = [_kind(one) != _kind(recommended) for one in alike.values()]
            return min(zip(other, far.tolist(), alike, strict=True))[-1]
    return next(iter(solved), 0)


def _kind(design: Solution) -> tuple[str, Sequence[str]]:
    return str(design.problem.objective), design.problem.placements.germ_names


def disagreements(designs: Mapping[str, Solution], fronts: Mapping[str, Front]) -> list[str]:
    """Where a design and a point of a front solve the same problem, but one is better: the other is a local optimum."""
    sentences = []
    for name, design in designs.items():
        for _, bound, front, point in _fronts.points_of(fronts):
            if not (design.ok and isinstance(point, Solution) and point.ok and point.problem == design.problem):
                continue
            gap = abs(design.objective - point.objective)
            if gap > SAME * max(abs(design.objective), abs(point.objective)):
                both = f"{objective_text(design)} and {objective_text(point)}"
                sentences.append(
                    f"'{name}' and the front at {front.bound} = {bound} are optima of one problem, {both}: the higher "
                    "one is local, and neither need be the least. al.multistart and al.portfolio look for others."
                )
    return sentences
