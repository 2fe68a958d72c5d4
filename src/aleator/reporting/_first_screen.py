"""`recommendation`: the first screen of a page, of a proposed design, its evidence and a nominal one."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from aleator._core.border import meant
from aleator._core.errors import ProblemError
from aleator.design import value, value_at
from aleator.reporting._blocks import Verdict
from aleator.reporting._numbers import (
    count,
    given,
    interval,
    number,
    percent,
    unit_of_decision,
    unit_of_objective,
    words,
)
from aleator.reporting._tables import unresolved
from aleator.solution import Solution
from aleator.uncertainty import fields_of
from aleator.validation import Evidence, Share

_SPREADS = ("half_width", "tolerance", "std")


def recommendation(
    design: Solution,
    evidence: Evidence | None,
    *,
    labels: Mapping[str, str],
    nominal: Solution | None = None,
    compared: Mapping[str, Evidence] | None = None,
    confirmation: Share | None = None,
    target: float = 0.05,
    who: str = "systems",
    objective: str = "the objective",
    change: tuple[str, str] = ("higher", "lower"),
    not_verified: Sequence[str] = (),
    sentences: Sequence[str] = (),
) -> Verdict:
    """What to build, what it achieves, how often its limits break, what it costs, and what nobody has verified.

    - `design`, `evidence`: the proposed one, sampled; `labels`: what its decisions are called, of those to be named;
    - `nominal`: a design of the same objective, called `objective` in a sentence, in which it is `change[0]` where the
      number is larger; `compared`: evidence on other designs, by what is said of them (`with the printed margin`);
    - `confirmation`: the share that breaks any limit, if it is not that of `evidence`: of a calibration;
    - `target`: the largest share of `who` that may break a limit; `not_verified`: what the study leaves open.

    Raises `ProblemError` for labels of what is no decision.
    """
    for name in labels:
        if name not in design.decisions:
            known = list(design.decisions)
            raise ProblemError(f"recommendation: there is no decision '{name}'.{meant(name, known)} Expected {known}.")
    built = [f"{label} {text}" for label, text in _decided(design, labels)]
    share = confirmation if confirmation is not None or evidence is None or not evidence.violations else evidence.joint
    open_ = [*_open(design, evidence), *not_verified]
    rows = [
        ("Build", "; ".join(f"{label} {text}" for label, text in _toleranced(design, labels))),
        ("Achieves", f"{objective} {number(design.objective, 4, unit_of_objective(design.problem))}"),
        ("Limits broken", "; ".join(_broken(evidence, share, target, who))),
        ("Cost", "" if nominal is None else _price(design, nominal, objective)),
        ("Not verified", "; ".join(open_)),
    ]
    told = {"sentences": sentences, "rows": [(name, text) for name, text in rows if text]}
    if not design.ok:
        return Verdict("bad", "Not solved", f"No design to build: {design.why()}", sentences)
    if coarse := unresolved({"design": design}):
        ((text, error),) = coarse.values()
        said = f"Do not build yet: means and spreads of {text} are off by {percent(error)} of the spread."
        return Verdict("bad", "Not resolved", said, **told)
    if evidence is not None and not evidence.agrees:
        return Verdict("bad", "Contradicted", f"Do not build: {evidence.alarm()}", **told)
    frequency = "" if share is None else _frequency(share, target, who, compared or {})
    price = "" if nominal is None else f" {_rougher(design, nominal, objective, change)}"
    if evidence is None and share is None:
        said = f"Do not build yet: nobody has counted how often {who} exceed a limit."
        return Verdict("caution", "Not checked", said, **told)
    if share is not None and share.upper > target:
        return Verdict("caution", "Do not build yet", f"{frequency}{price}", **told)
    return Verdict("good", "Build", f"Build {', '.join(built)}. {frequency}{price}".strip(), **told)


def _decided(design: Solution, labels: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """The decisions with labels, each with its number and unit."""
    for name, label in labels.items():
        value, unit = np.asarray(design.decisions[name], float), unit_of_decision(name, design.problem)
        yield label, number(float(value), 4, unit) if value.ndim == 0 else f"{value.size} numbers"


def _toleranced(design: Solution, labels: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """The same with the tolerances that are assumed, or chosen: `1643 ± 250 N s/m`."""
    parameters = {place: getattr(one, "parameters", {}) for place, _, one in fields_of(design.problem.system)}
    for (name, label), (_, text) in zip(labels.items(), _decided(design, labels), strict=True):
        field, _, kind = name.rpartition(".")
        spread = next((one for one in _SPREADS if one in parameters.get(field, {}) and one != kind), None)
        if spread is None or kind in _SPREADS:
            yield label, text
            continue
        number_at, unit = float(design.decisions[name]), unit_of_decision(name, design.problem)
        size = value_at(value(f"{field}.{spread}"), design.problem, design.vector)
        said = " (standard deviation)" if spread == "std" else ""
        yield label, f"{number(number_at, 4)} ± {number(size, 3, unit)}{said}"


def _frequency(share: Share, target: float, who: str, compared: Mapping[str, Evidence]) -> str:
    """How often limits break, as counts of so many that the target is a whole number: `8 cars in 1000`."""
    base = 1000 if target >= 1e-3 else 10 ** int(np.ceil(3 - np.log10(target)))
    aimed = f"target {given(round(base * target, 6))}"
    others = [f"{_of(base, one.joint.estimate)} {said}" for said, one in compared.items()]
    against = f", against {words(others)}" if others else ""
    many = f"{_of(base, share.estimate)} {who} in {count(base) if base > 9999 else base}"
    return f"{many} exceed a limit ({aimed}){against}."


def _of(base: int, share: float) -> str:
    scaled = base * share
    return number(scaled, 2) if 0 < scaled < 9.95 and round(scaled) != round(scaled, 1) else count(round(scaled))


def _broken(evidence: Evidence | None, share: Share | None, target: float, who: str) -> Iterator[str]:
    """Each limit with the share that breaks it, its interval, and the target."""
    aimed = f"{given(100 * target)}\u202f%"
    if evidence is not None:
        for limit, one in evidence.violations.items():
            yield f"{limit} {percent(one.estimate)} [{interval(one)}]"
    if share is not None:
        fresh = f"of {count(share.samples)} fresh {who}"
        yield f"any {percent(share.estimate)} [{interval(share)}] {fresh}, target {aimed}"


def _price(design: Solution, nominal: Solution, objective: str) -> str:
    unit = unit_of_objective(design.problem)
    return f"{objective} {number(design.objective, 4, unit)} instead of {number(nominal.objective, 4, unit)}"


def _rougher(design: Solution, nominal: Solution, objective: str, change: tuple[str, str]) -> str:
    """What the design costs beside the nominal one: `Ride is 3.9 % rougher.`"""
    relative = design.objective / nominal.objective - 1
    if abs(relative) < 5e-4:
        return f"{objective.capitalize()} is the same."
    return f"{objective.capitalize()} is {number(100 * abs(relative), 2)}\u202f% {change[relative < 0]}."


def _open(design: Solution, evidence: Evidence | None) -> Iterator[str]:
    """What neither the certificate nor the evidence tells."""
    if evidence is None:
        yield "how often single systems break limits"
    else:
        yield from (f"{limit} ({why})" for limit, why in evidence.uncounted.items())
    if design.effort.searched is None:
        yield "whether another design, far from this one, is better: it is the best of its neighbourhood"
