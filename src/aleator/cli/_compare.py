"""`aleator compare`: runs side by side."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from aleator._core.errors import ProblemError
from aleator.cli._differences import changed, in_brackets, pair_of
from aleator.cli._kept import evidence_on, sorted_by_kind
from aleator.cli._options import AsJson
from aleator.cli._record import study_of
from aleator.cli._terminal import Terminal
from aleator.cli._written import interval_text, value_text, violated, written_designs
from aleator.journalling import FILE, Entry, Recalled, entries_in, load, named
from aleator.reporting import Table, solution_document, words


class _Run(NamedTuple):
    """A run.

    - `label`, `folder`; `designs` as documents by name; `entries`: the journal's of all that was solved, by name;
    - `later`: the designs that `aleator validate` has solved anew since, and the parts in which these differ.
    """

    label: str
    folder: Path
    designs: Mapping[str, Any]
    entries: Mapping[str, Entry]
    later: Mapping[str, list[str]]

    def name_of(self, name: str, others: Sequence["_Run"]) -> str | None:
        """What it calls a design that some run calls `name`: if nothing is called so here, what is the same problem."""
        if name in self.designs or name in self.entries:
            return name
        for sought in (one.entries[name] for one in others if name in one.entries):
            same = {here: one for here, one in self.entries.items() if _problem(one) == _problem(sought)}
            if same:
                return next((here for here, one in same.items() if one.key == sought.key), list(same)[-1])
        return None


def _problem(entry: Entry) -> tuple[str, str | None]:
    """What an entry solves, however it came there."""
    return entry.what, entry.parts.get("problem")


def compare(
    folders: Annotated[
        list[Path], typer.Argument(help="Runs' folders, two or more.", metavar="FOLDER FOLDER...", show_default=False)
    ],
    as_json: AsJson = False,
) -> None:
    """Print the designs of several runs side by side, and what differs between the runs.

    Decisions, objective, the evidence with its intervals; and which parts of what the designs follow from: equations,
    code, numbers, versions.
    """
    terminal = Terminal("compare", as_json)
    with terminal.refusing():
        if len(folders) < 2:
            raise ProblemError("compare: expected two folders or more; received one.")
        labels = _labels(folders)
        runs = [_run(label, folder) for label, folder in zip(labels, folders, strict=True)]
    rows: dict[tuple[str | None, ...], str] = {}  # what each run calls a design, whose first name is told
    for name in (name for one in runs for name in one.designs):
        rows.setdefault(tuple(one.name_of(name, runs) for one in runs), name)
    designs, differences = dict[str, Any](), dict[str, Any]()
    for called, name in rows.items():
        found = [one and _document(run, one) for run, one in zip(runs, called, strict=True)]
        terminal.table(_table(name, runs, called, found))
        designs[name] = {run.label: one for run, one in zip(runs, found, strict=True)}
        differences[name] = _differences(runs, called)
        for label, parts in differences[name].items():
            terminal.tell(f"{name}: {_sentence(runs[0].label, label, parts)}")
    later = {one.label: one.later for one in runs}
    for label, name, parts in ((label, *one) for label, found in later.items() for one in found.items()):
        terminal.look_at(
            f"{name}: {label} has a later design of this name, which `aleator validate` has solved after what it "
            f"follows from had changed{in_brackets(parts)}. The table shows that of designs.json."
        )
    terminal.note(folders=[str(one) for one in folders], designs=designs, differences=differences, later=later)
    terminal.conclude(0)


def _labels(folders: Sequence[Path]) -> list[str]:
    """The last parts of the folders' names where these differ, the whole names elsewhere."""
    short = [one.resolve().name for one in folders]
    return short if len(set(short)) == len(short) else [str(one) for one in folders]


def _run(label: str, folder: Path) -> _Run:
    """A run's designs, as the run has written them, or as its journal keeps them."""
    entries = entries_in(folder) if (folder / FILE).is_file() else ()
    known = {one.name or name: one for name, one in named(entries).items() if one.what.startswith("solve ")}
    if written := written_designs(folder):
        return _Run(label, folder, written, known, _later(written, entries))
    if not entries:
        raise ProblemError(
            f"compare: there are no results in '{folder}': expected a folder in which `aleator run` or a script within "
            "`al.journal(folder)` has kept results."
        )
    designs, evidence = sorted_by_kind(_finished(folder))
    documents = {name: solution_document(one, evidence.get(name)) for name, one in designs.items()}
    return _Run(label, folder, documents, {name.rpartition("/")[2]: one for name, one in known.items()}, {})


def _finished(folder: Path) -> Mapping[str, Any]:
    study_of(folder)  # so that its models' modules are there, if they are
    return Recalled(folder).finished()


def _later(written: Iterable[str], entries: Sequence[Entry]) -> dict[str, list[str]]:
    found = {name: pair_of(name, entries) for name in written}
    return {name: changed(*pair) for name, pair in found.items() if pair is not None}


def _document(run: _Run, name: str) -> Any:
    """A design of a run; None if only its journal has it, and it cannot be read any more."""
    if name in run.designs:
        return run.designs[name]
    try:
        finished, kept = _finished(run.folder), load(run.folder)
        place = next(there for there, one in named(kept.entries).items() if one.key == run.entries[name].key)
        return solution_document(kept[place], evidence_on(kept[place], finished))
    except ProblemError:
        return None


def _table(name: str, runs: Sequence[_Run], called: Sequence[str | None], found: Sequence[Any]) -> Table:
    """One design in every run."""
    rows = [["Status", *("–" if one is None else one["status"].partition(":")[0] for one in found)]]
    if any(one not in (None, name) for one in called):
        rows = [["There as", *(one or "–" for one in called)], *rows]
    for decision in _union([one["decisions"] for one in found if one]):
        rows.append([decision, *(value_text(one and one["decisions"].get(decision)) for one in found)])
    rows.append(["Objective", *(value_text(one and one["objective"]) for one in found)])
    shares = [(one or {}).get("evidence", {}).get("violations", {}) for one in found]
    for limit in _union(shares):
        rows.append([f"Systems that violate {violated(limit)}", *(interval_text(one.get(limit)) for one in shares)])
    return Table(name, ["", *(one.label for one in runs)], rows, "")


def _union(groups: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(dict.fromkeys(name for group in groups for name in group))


def _differences(runs: Sequence[_Run], called: Sequence[str | None]) -> dict[str, list[str] | None]:
    """What each further run's design follows from that differs from the first one's; None where that is not known."""
    first, *others = [run.entries.get(name or "") for run, name in zip(runs, called, strict=True)]
    return {
        run.label: None if first is None or one is None else changed(first, one)
        for run, one in zip(runs[1:], others, strict=True)
    }


def _sentence(first: str, other: str, parts: list[str] | None) -> str:
    if parts is None:
        return f"what {first} and {other} follow from is not known: one of them does not have it."
    if not parts:
        return f"{first} and {other} follow from the same equations, code, numbers and versions."
    return f"{first} and {other} differ in {words(parts)}."
