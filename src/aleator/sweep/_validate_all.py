"""`validate_all`: evidence at every design of a front, with its intervals."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any, TypeAlias, final

from aleator._core.border import Progress, members, silent, whole
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.leaves import Drawn
from aleator.solution import Solution
from aleator.sweep._front import Front, point_name
from aleator.sweep._portfolio import Starts
from aleator.sweep._printed import table
from aleator.sweep._runner import VALIDATE, running
from aleator.sweep._trade_off import TradeOff
from aleator.validation import Evidence

Designs: TypeAlias = Front | TradeOff | Starts | Sequence[Solution]


@final
@dataclass(frozen=True)
class EvidenceOfAll(Drawn):
    """Evidence on several designs. `print(evidence)` lists the share of systems that break each limit, with intervals.

    - `designs`: those that were validated, in order; `places`: each on its front, in words;
    - `evidence`: on each; None where `refused` tells why by its index;
    - `interrupted`: whether Ctrl-C ended it; what was validated by then is included.
    """

    designs: tuple[Solution, ...]
    places: tuple[str, ...]
    evidence: tuple[Evidence | None, ...]
    refused: dict[int, str]
    interrupted: bool = False

    @property
    def by_place(self) -> dict[str, Evidence]:
        """The evidence by the places of its designs, without those that could not be simulated."""
        return {place: one for place, one in zip(self.places, self.evidence, strict=True) if one is not None}

    @property
    def agrees(self) -> bool:
        """Whether samples contradict none of the designs."""
        return not self.refused and all(one is not None and one.agrees for one in self.evidence)

    def __str__(self) -> str:
        names = list(dict.fromkeys(name for one in self.evidence if one for name in one.violations))
        rows = [["share that breaks (95 % interval)", *names]]
        for place, one in zip(self.places, self.evidence, strict=True):
            shares = one.violations if one else {}
            rows.append([place, *(str(shares.get(name, "")) for name in names)])
        alarms = [f"{place}: {one.alarm()}" for place, one in self.by_place.items() if not one.agrees]
        refused = [f"{self.places[i]}: {why}" for i, why in self.refused.items()]
        return table(rows, *alarms, *refused, interrupted=self.interrupted)


def validate_all(
    designs: Designs,
    samples: int = 20_000,
    *,
    seed: int = 0,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EvidenceOfAll:
    """Simulate fresh random systems at every solved design of a front (`al.validate` at each).

    - `designs`: of `al.pareto`, `al.trade_off` or `al.multistart`, or solutions; those without a design are left out;
    - `samples`, `seed`: of `al.validate`, the same systems for each design, so that designs can be compared;
    - `executor`: validates several designs at once (see `al.pareto`), with the same results.

    A design whose systems cannot be simulated is kept with the reason. Ctrl-C returns the evidence found so far. Raises
    `ProblemError` if there is no solved design.
    """
    samples, seed = whole("validate_all: samples", samples, least=2), whole("validate_all: seed", seed, least=0)
    solved = [(place, one) for place, one in _placed(designs) if one.ok]
    if not solved:
        raise ProblemError("validate_all: expected at least one solved design; received none.")
    calls = [{"solution": one, "samples": samples, "seed": seed} for _, one in solved]
    where = [f"design {i}" for i in range(len(calls))]
    found: dict[int, Evidence | AleatorError] = {}
    with running("validate_all", lambda: found, progress, executor) as run:
        found.update(run.each(VALIDATE, "evidence", calls, where, accepted=AleatorError))
    places, solutions = zip(*(solved[i] for i in sorted(found)), strict=True)
    results = [found[i] for i in sorted(found)]
    return EvidenceOfAll(
        solutions,
        places,
        tuple(one if isinstance(one, Evidence) else None for one in results),
        {i: str(one) for i, one in enumerate(results) if isinstance(one, AleatorError)},
        run.interrupted,
    )


def _placed(designs: Any) -> list[tuple[str, Solution]]:
    """The solutions, each with its place on the front in words."""
    if isinstance(designs, Front):
        pairs = zip(designs.values, designs.points, strict=True)
        return [(point_name(designs.bound, value), one) for value, one in pairs if isinstance(one, Solution)]
    if isinstance(designs, TradeOff):
        rows = (zip(designs.names, row, strict=True) for row in designs.values)
        told = [", ".join(f"{name} = {one:.6g}" for name, one in row) for row in rows]
        return list(zip(told, designs.solutions, strict=True))
    if isinstance(designs, Starts):
        return [(f"start {i}", one) for i, one in enumerate(designs.solutions)]
    what = "validate_all: designs, unless of al.pareto, al.trade_off or al.multistart"
    return [(f"{i}", one) for i, one in enumerate(members(what, designs, Solution))]
