"""Where a design comes from that is sampled: from the folder, or from a solve of now, and why."""

from collections.abc import Callable
from typing import NamedTuple

from aleator.cli._differences import changed, design_of, in_brackets
from aleator.design import Problem
from aleator.journalling import Entry, Journal
from aleator.solution import Solution


class Origin(NamedTuple):
    """Where a design comes from.

    - `solved`: whether it was solved now; else it is in the folder;
    - `told`: that and why, as the end of a sentence;
    - `differs`: in which parts of what it follows from it differs from the design that the folder's run found; None
      where it is that, or where there is none;
    - `as_declared`: whether what was sampled is the run's design and that of the study as it is now.
    """

    solved: bool
    told: str
    differs: list[str] | None = None
    as_declared: bool = True


def with_origin(
    kept: Journal,
    name: str,
    one: Solution | Problem,
    declared: Problem | None,
    solve: Callable[[Problem], Solution],
) -> tuple[Solution, Origin]:
    """A design of a folder, solved where the folder does not have it; what is solved now is called `name` there.

    `declared`: what the study says of it now, if it says anything.
    """
    if isinstance(one, Solution):
        entry = kept.entry_of(one)
        as_declared = entry is None or declared is None or kept.is_about(entry, declared)
        return one, Origin(False, _TAKEN if as_declared else _OF_ANOTHER_FORM, as_declared=as_declared)
    earlier, begun = design_of(name, kept.entries), kept.begun
    design = solve(one)
    present, solved = kept.entry_of(design), kept.begun > begun
    if present is not None and not present.name:
        kept.call({name: design})
    return design, _origin(earlier, present, solved)


def _origin(earlier: Entry | None, present: Entry | None, solved: bool) -> Origin:
    if earlier is None or present is None:
        return Origin(solved, _NOT_THERE if solved else _TAKEN)
    if earlier.key == present.key:
        return Origin(solved, _LOST if solved else _TAKEN)
    parts = changed(earlier, present)
    told = "solved anew, because" if solved else "taken from the folder, where it was solved after"
    had = "has changed" if solved else "had changed"
    return Origin(
        solved,
        f"{told} what it follows from {had} since the folder's run{in_brackets(parts)}: it is not the design that the "
        "run found.",
        parts,
        as_declared=False,
    )


_TAKEN = "taken from the folder."
_OF_ANOTHER_FORM = (
    "taken from the folder, where the run found it. The study declares another problem of this name now: run it to "
    "have its design."
)
_NOT_THERE = "solved, because the folder does not have it."
_LOST = "solved again, because its file in the folder has gone or is damaged."
