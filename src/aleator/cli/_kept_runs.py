"""Commands on what a folder has, which compute nothing: `aleator report` writes its page, `aleator list` its results,
`aleator compare` sets the designs of several side by side.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from aleator._core.border import content_of, json_of
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._folder import RECORD, Record, staleness
from aleator.cli._terminal import Terminal
from aleator.journalling import examined, listing, numbered, recalling
from aleator.reporting import (
    PAGE,
    by_place,
    design_digest,
    documents_table,
    json_text,
    rows_of,
    solution_document,
    words,
    write_page,
)
from aleator.solution import Solution
from aleator.studies import Draft
from aleator.validation import Evidence

_SO_FAR = "report-so-far.html"


def listed(terminal: Terminal, folder: Path) -> int:
    """List the results in a run's folder."""
    entries, is_stale = examined(folder), staleness(folder)
    names = {entry.key: name for name, entry in numbered(entries.values()).items()}
    terminal.tell(listing(folder, entries))
    if is_stale:
        terminal.tell(f"look at: {is_stale}")
    told = ("name", "what", "state", "why", "file", "host", "process", "since")
    results = [
        {name: value for name, value in asdict(entry).items() if name in told}
        | {"load": names.get(key), "seconds": entry.seconds or None}
        for key, entry in entries.items()
    ]
    terminal.note(folder=str(folder), stale=bool(is_stale), results=results)
    return 0


def report(terminal: Terminal, folder: Path, out: Path | None) -> int:
    """Write the page of a study from what is in its run's folder, without computing anything; say what is missing.

    A complete page is not replaced by one from which something is missing.
    """
    missing = list(filter(None, [staleness(folder)]))
    terminal.note(folder=str(folder), files=[], missing=missing, verdict=None)
    draft = Draft(Record.of(folder).made())
    with recalling(folder) as results:
        try:
            draft.fill()
        except KeyboardInterrupt:  # what is not there ends the chapter
            absent = " ".join(dict.fromkeys(results.missing))
            missing.append(f"'{draft.present}' is not finished, nor what follows it: {absent}")
        except AleatorError as error:
            missing.append(f"'{draft.present}' failed: {error}")
    if not by_place(draft.kept):
        raise ProblemError(f"report: nothing is finished yet in '{folder}' that can be shown. {' '.join(missing)}")
    page = draft.page()
    path = write_page(page, out or folder / (_SO_FAR if missing and (folder / PAGE).exists() else PAGE))
    for sentence in missing:
        terminal.tell(f"look at: {sentence}")
    if path.name == _SO_FAR:
        terminal.tell(f"{folder / PAGE} stays as it is, because the page of now is without what is missing.")
    terminal.tell(f"wrote {path}")
    terminal.note(files=[str(path)], verdict=page.verdict.headline)
    return 0


def compare(terminal: Terminal, folders: list[Path]) -> int:
    """Print the designs of several runs side by side, and in what they differ."""
    if len(folders) < 2 or len({folder.resolve() for folder in folders}) < len(folders):
        received = words([str(folder) for folder in folders])
        raise ProblemError(f"compare: expected two folders or more, each once; received {received}.")
    first, *others = runs = {str(folder): _documents(folder) for folder in folders}
    rows: dict[tuple[str | None, ...], str] = {}  # the names of a design in all runs, and the first of these
    for name in (name for designs in runs.values() for name in designs):
        rows.setdefault(tuple(_name_in(designs, name, runs) for designs in runs.values()), name)
    compared, differences = dict[str, Any](), dict[str, dict[str, list[str] | None]]()
    for names, name in rows.items():
        own = dict(zip(runs, names, strict=True))
        row = compared[name] = {label: runs[label].get(own[label] or "") for label in runs}
        called = {f"{label}: {own[label]}" if own[label] not in (None, name) else label: row[label] for label in runs}
        terminal.table(documents_table(name, called))
        differences[name] = {other: _differing(row[first], row[other]) for other in others}
        for other, differing in differences[name].items():
            if differing is None:
                absent = [label for label in (first, other) if row[label] is None]
                terminal.tell(f"{name}: {words(absent)} {'names' if len(absent) == 1 else 'name'} no such design.")
            else:
                how = f"differ in {words(differing)}" if differing else "are equal"
                terminal.tell(f"{name}: {first} and {other} {how}.")
    terminal.note(folders=[*runs], designs=compared, differences=differences)
    return 0


def _documents(folder: Path) -> Mapping[str, Any]:
    """A run's designs as documents by name: as the run has written them, or as its journal has them."""
    path = folder / "designs.json"
    try:
        if path.exists():
            return json_of(content_of(path))
    except (OSError, ValueError) as error:
        raise ProblemError(f"'{path}' cannot be read as the designs of a run ({error}).") from error
    if (folder / RECORD).exists():
        Record.of(folder)  # so that its models' modules can be imported
    with recalling(folder) as journal:
        results = journal.finished()
    evidence = {design_digest(one.solution): one for one in results.values() if isinstance(one, Evidence)}
    designs = {name: one for name, one in results.items() if isinstance(one, Solution)}
    designs = {name: one for name, one in designs.items() if "/" in name} or designs  # those that a study names
    documents = {name: solution_document(one, evidence.get(design_digest(one))) for name, one in designs.items()}
    return json_of(json_text(documents))


def _name_in(designs: Mapping[str, Any], name: str, runs: Mapping[str, Mapping[str, Any]]) -> str | None:
    """What a run calls a design that some run calls `name`: the same, or else the name of the same problem."""
    if name in designs:
        return name
    problems = [run[name]["problem"] for run in runs.values() if name in run]
    return next((own for own, design in designs.items() if design["problem"] in problems), None)


def _differing(first: Mapping[str, Any] | None, other: Mapping[str, Any] | None) -> list[str] | None:
    """What differs between two designs, down to the last digit; None if one is missing."""
    if first is None or other is None:
        return None
    whole, another = (
        {row.label: (row.value, row.unit) for row in rows_of(one) if row.value is not None}
        | {"constraints": one["constraints"], "the problem": one["problem"]}
        for one in (first, other)
    )
    labels = [label for label in {**whole, **another} if whole.get(label) != another.get(label)]
    # The digest is of decisions, objective and equations together.
    return labels or ["the equations of the model"] * (first["digest"] != other["digest"])
