"""The first screen: `recommendation`, of a design, its evidence and a nominal one; `proposal`, of any designs."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from aleator.design import value, value_at
from aleator.nlp import Status
from aleator.reporting._documents import objective_text, rows_of, solution_document
from aleator.reporting._numbers import count, given, number, percent, share_text, words
from aleator.reporting._page import Verdict
from aleator.reporting._showing import unknown
from aleator.solution import Solution
from aleator.uncertainty import fields_of
from aleator.validation import Evidence, Share

TARGET = 0.05
"""The largest share of systems that may break a limit, where nobody says another."""

_SPREADS = ("half_width", "tolerance", "std")
# What can be read in one breath.
_NAMED = 3
_UNSOLVED = {Status.INFEASIBLE: "infeasible", Status.INTERRUPTED: "interrupted"}


def proposal(designs: Mapping[str, Solution], evidence: Mapping[str, Evidence], target: float = TARGET) -> Verdict:
    """The first screen of any designs: the last is the one that is proposed, the others stand beside it.

    The price is that beside the last of the others with the same objective, such as the nominal design.
    """
    failed = {name: one for name, one in designs.items() if not one.ok}
    if failed and len(designs) > 1:
        reasons = [f"{name}: {one.why()}" for name, one in failed.items()] if len(failed) > 1 else []
        return Verdict("bad", "Not solved", _unsolved(failed, len(designs)), reasons)
    *others, proposed = designs
    design = designs[proposed]
    same = [name for name in others if str(designs[name].problem.objective) == str(design.problem.objective)]
    return recommendation(
        design,
        evidence.get(proposed),
        labels={name: name for name in design.decisions},
        nominal=designs[same[-1]] if same else None,
        compared={f"for {name}": evidence[name] for name in others if name in evidence and evidence[name].violations},
        target=target,
        sentences=[f"{name}: {one.alarm()}" for name, one in evidence.items() if not one.agrees and name != proposed],
    )


def _unsolved(failed: Mapping[str, Solution], designs: int) -> str:
    """How many of several designs are solved, and what the others are."""
    states = [f"'{name}' is {_UNSOLVED.get(one.status, 'not solved')}" for name, one in failed.items()]
    why = f": {next(iter(failed.values())).why().rstrip('.')}" if len(failed) == 1 else ""
    return f"{designs - len(failed)} of {designs} designs are solved; {words(states)}{why}."


def recommendation(
    design: Solution,
    evidence: Evidence | None,
    *,
    labels: Mapping[str, str],
    nominal: Solution | None = None,
    compared: Mapping[str, Evidence] | None = None,
    confirmation: Share | None = None,
    target: float = TARGET,
    who: str = "systems",
    objective: str = "",
    change: tuple[str, str] = ("higher", "lower"),
    not_verified: Sequence[str] = (),
    sentences: Sequence[str] = (),
) -> Verdict:
    """What to build, what it achieves, how often its limits break, what it costs, and what nobody has verified.

    - `design`, `evidence`: the proposed one, sampled; `labels`: what its decisions are called, of those to be named;
    - `nominal`: a design of the same objective, which is called `objective` in a sentence (by default as in the
      problem), and is `change[0]` where the number is larger; `compared`: evidence on other designs, by what is said of
      them (`with the printed margin`);
    - `confirmation`: the share that breaks any limit, if it is not that of `evidence`: of a calibration;
    - `target`: the largest share of `who` that may break a limit; `not_verified`: what the study leaves open.

    Raises `ProblemError` for labels of what is no decision.
    """
    for name in labels:
        if name not in design.decisions:
            raise unknown("recommendation: labels", name, design.decisions)
    if not design.ok:
        return Verdict("bad", "Not solved", f"No design to build: {design.why()}", sentences)
    share = confirmation if confirmation is not None or evidence is None or not evidence.violations else evidence.joint
    achieved = objective_text(design, 4)
    cost = "" if nominal is None else f"{objective} {achieved} instead of {objective_text(nominal, 4)}".lstrip()
    rows = {
        "Build": _decided(design, labels, toleranced=True),
        "Achieves": [f"{objective or f'{design.problem.objective} ='} {achieved}"],
        "Limits broken": _broken(evidence, share, target, who),
        "Other limits": [one.sentence() for one in evidence.compared] if evidence else [],
        "Cost": [cost],
        "Not verified": [*_open(design, evidence), *not_verified],
    }
    texts = [(name, "; ".join(parts)) for name, parts in rows.items()]
    told: Any = {"sentences": sentences, "rows": [(name, text) for name, text in texts if text]}
    quality = design.certificate.expansion
    if quality.points > 1 and quality.unresolved:
        worst = max(quality.unresolved, key=lambda text: quality.leave_one_out[text])
        missed = f"{worst}{quality.since(worst)} are off by {percent(quality.leave_one_out[worst])} of the spread."
        return Verdict("bad", "Not resolved", f"Do not build yet: means and spreads of {missed}", **told)
    if evidence is not None and not evidence.agrees:
        return Verdict("bad", "Contradicted", f"Do not build: {evidence.alarm()}", **told)
    if evidence is None and share is None:
        said = f"Do not build yet: nobody has counted how often {who} exceed a limit."
        return Verdict("caution", "Solved, not checked", said, **told)
    frequency = _NOT_COUNTED if share is None else _frequency(share, target, who, compared or {})
    price = "" if nominal is None else f" {_rougher(design, nominal, objective or 'the objective', change)}"
    if share is not None and share.upper > target:
        return Verdict("caution", "Do not build yet", f"{frequency}{price}", **told)
    return Verdict("good", "Build", f"Build {_named(design, labels)}. {frequency}{price}", **told)


_NOT_COUNTED = "No limit applies to single systems, so none was counted."


def _named(design: Solution, labels: Mapping[str, str]) -> str:
    """The decisions in a sentence, where it can be read in one breath."""
    if not labels or len(labels) > _NAMED:
        return "the design below"
    return ", ".join(_decided(design, labels))


def _decided(design: Solution, labels: Mapping[str, str], toleranced: bool = False) -> Iterator[str]:
    """The decisions with labels, each with its number and unit; and with the tolerance that is assumed, or chosen:
    `1643 ± 250 N s/m`.
    """
    parameters = {place: getattr(one, "parameters", {}) for place, _, one in fields_of(design.problem.system)}
    rows = {row.name: row for row in rows_of(solution_document(design)) if row.heading == "Decisions"}
    for name, label in labels.items():
        at, unit = np.asarray(rows[name].value, float), rows[name].unit
        field, _, kind = name.rpartition(".")
        spread = next((one for one in _SPREADS if one in parameters.get(field, {})), None)
        if at.ndim:
            yield f"{label} {at.size} numbers"
        elif not toleranced or spread is None or kind in _SPREADS:
            yield f"{label} {number(float(at), 4, unit)}"
        else:
            size = value_at(value(f"{field}.{spread}"), design.problem, design.vector)
            said = " (standard deviation)" if spread == "std" else ""
            yield f"{label} {number(float(at), 4)} ± {number(size, 3, unit)}{said}"


def _frequency(share: Share, target: float, who: str, compared: Mapping[str, Evidence]) -> str:
    """How often limits break, as counts of so many that the target is a whole number: `8 cars in 1000`."""
    base = 1000 if target >= 1e-3 else 10 ** int(np.ceil(3 - np.log10(target)))
    aimed = f"target {given(round(base * target, 6))}"
    others = [f"{_of(base, one.joint.estimate)} {said}" for said, one in compared.items()]
    against = f", against {words(others)}" if others else ""
    many, several = _of(base, share.estimate), count(base) if base > 9999 else base
    break_it = f"{who.removesuffix('s')} in {several} exceeds" if many == "1" else f"{who} in {several} exceed"
    at_most = f", at most {_of(base, share.upper)}" if share.upper > target >= share.estimate else ""
    return f"{many} {break_it} a limit{at_most} ({aimed}){against}."


def _of(base: int, share: float) -> str:
    scaled = base * share
    return number(scaled, 2) if 0 < scaled < 9.95 and round(scaled) != round(scaled, 1) else count(round(scaled))


def _broken(evidence: Evidence | None, share: Share | None, target: float, who: str) -> Iterator[str]:
    """Each limit with the share that breaks it, its interval, and the target."""
    if evidence is not None:
        yield from (f"{limit} {share_text(one)}" for limit, one in evidence.violations.items())
    if share is not None:
        yield f"any {share_text(share)} of {count(share.samples)} fresh {who}, target {given(100 * target)}\u202f%"


def _rougher(design: Solution, nominal: Solution, objective: str, change: tuple[str, str]) -> str:
    """What the design costs beside the nominal one: `Ride is 3.9 % rougher.`"""
    more, size = design.objective - nominal.objective, abs(nominal.objective)
    if abs(more) <= 5e-4 * size:
        return f"{objective.capitalize()} is the same."
    relative = f"{number(100 * abs(more) / size, 2)}\u202f% " if size else ""
    return f"{objective.capitalize()} is {relative}{change[more < 0]}."


def _open(design: Solution, evidence: Evidence | None) -> Iterator[str]:
    """What neither the certificate nor the evidence tells."""
    if evidence is None:
        yield "how often single systems break limits"
    else:
        compared = {one.text for one in evidence.compared}
        yield from (f"{limit} ({why})" for limit, why in evidence.uncounted.items() if limit not in compared)
    if design.effort.searched is None:
        yield "whether another design, far from this one, is better: it is the best of its neighbourhood"
