"""What reads runs: `aleator report` writes the page of a folder, `aleator compare` sets runs side by side."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._folder import designs_and_evidence, is_stale, stale, study_of, value_text, written_designs
from aleator.cli._terminal import AsJson, Folder, Terminal
from aleator.journalling import FILE, Recalled, recalling
from aleator.reporting import (
    PAGE,
    Code,
    Page,
    Section,
    Table,
    Text,
    Verdict,
    by_place,
    footer,
    json_text,
    percent,
    sections,
    solution_document,
    verdict,
    words,
    write_page,
)
from aleator.studies import AbstractStudy, Draft

_SO_FAR = "report-so-far.html"
_FOLLOWS_FROM = "what it follows from is missing."
_WITHOUT_THE_STUDY = (
    "So the study's title, chapters, fronts and tables are missing; the page shows the designs and the evidence that "
    "the folder keeps."
)
_WITHOUT_THE_MODEL = (
    "Without the model's code there are no figures and certificates: the page shows what designs.json says. Histories "
    "are in results.nc."
)


def report(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="File for the page.", show_default=f"FOLDER/{PAGE}", metavar="FILE")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the page of what is in a run's folder, without computing anything, and say what is missing.

    Where the study's file has gone, or cannot be read any more, the page shows the designs that the folder keeps.

    Another process may be running there. A page that is there is not replaced by one from which something is missing:
    this one is written beside it, as report-so-far.html.
    """
    terminal = Terminal("report", as_json)
    missing = list[str]()
    terminal.note(folder=str(folder), files=[], missing=missing, verdict=None)
    with terminal.refusing(), terminal.warning():
        with recalling(folder) as run:
            page = _page(folder, run, missing)
        path = write_page(page, out or _place(folder, missing))
    for sentence in missing:
        terminal.look_at(sentence)
    if path.name == _SO_FAR:
        terminal.look_at(f"{folder / PAGE} stays as it is, because the page of now is without what is missing.")
    terminal.tell(f"wrote {path}")
    terminal.note(files=[str(path)], verdict=page.verdict.headline)
    terminal.conclude(0)


def _place(folder: Path, missing: Sequence[str]) -> Path:
    """Where the page goes: never over another one if something is missing from it."""
    return folder / (_SO_FAR if missing and (folder / PAGE).exists() else PAGE)


def _page(folder: Path, run: Recalled, missing: list[str]) -> Page:
    """The page; what is missing from it is added, a sentence each."""
    study, why = study_of(folder)
    if why:
        missing.append(f"{why} {_WITHOUT_THE_STUDY}")
    elif is_stale(folder):
        missing.append(stale(folder))
    if study is not None:
        page = Draft(study)
        missing += _recalled(page, run)
        if by_place(page.kept):
            return page.page()
    return _bare_page(folder, run, study, missing)


def _recalled(page: Draft, run: Recalled) -> list[str]:
    """Let a study take its results from a folder; what is not there, a sentence."""
    try:
        page.fill()
    except KeyboardInterrupt:
        absent = " ".join(dict.fromkeys(run.missing)) or _FOLLOWS_FROM
        return [f"'{page.present}' is not finished, nor what follows it: {absent}"]
    except AleatorError as error:
        return [f"'{page.present}' failed: {error}"]
    finally:
        run.missing.clear()
    return []


def _bare_page(folder: Path, run: Recalled, study: AbstractStudy | None, missing: list[str]) -> Page:
    """A page of all designs and all evidence in a folder, whatever computed them; adds what is missing from it."""
    designs, evidence = designs_and_evidence(run.finished())
    missing += dict.fromkeys(run.missing)
    if not designs:
        return _written_page(folder, run.missing, missing)
    return Page(
        title=study.title if study is not None else folder.resolve().name,
        subtitle=f"Kept in {folder.resolve().name}: {words(list(designs))}",
        verdict=verdict(designs, evidence),
        sections=[*sections(designs, evidence, {}), *([Section("Missing", [Text(missing)])] if missing else [])],
        footer=footer(),
    )


def _written_page(folder: Path, unread: Sequence[str], missing: list[str]) -> Page:
    """A page of the designs that a run has written down, where no result can be read without the model's code."""
    if not unread:
        raise ProblemError(f"report: nothing is finished yet in '{folder}': there is no design to show.")
    written = written_designs(folder)
    if not written:
        raise ProblemError(f"report: no design in '{folder}' can be read: {unread[0]}")
    missing.append(_WITHOUT_THE_MODEL)
    chapters = [_written_section(name, design) for name, design in written.items()]
    return Page(
        title=folder.resolve().name,
        subtitle=f"Written in {folder.resolve().name}: {words(list(written))}",
        verdict=Verdict(
            "caution", "Numbers only", "The model's code cannot be read: these are the numbers of its run."
        ),
        sections=[*chapters, Section("Missing", [Text(missing)])],
        footer=footer(),
    )


def _written_section(name: str, design: Mapping[str, Any]) -> Section:
    """A design on a page: decisions, objective, how often limits are broken, and the problem as mathematics."""
    rows = [["Status", design["status"]], ["Objective", value_text(design["objective"])]]
    rows += [[decision, value_text(number)] for decision, number in design["decisions"].items()]
    shares = design.get("evidence", {}).get("violations", {})
    rows += [[f"Systems that violate {_violated(limit)}", _interval_text(share)] for limit, share in shares.items()]
    return Section(name, [Table(name, ["", "Value"], rows), Code("The problem", "\n".join(design["problem"]))])


def compare(
    folders: Annotated[
        list[Path], typer.Argument(help="Runs' folders, two or more.", metavar="FOLDER FOLDER...", show_default=False)
    ],
    as_json: AsJson = False,
) -> None:
    """Print the designs of several runs side by side, and in which numbers the runs differ.

    Decisions, objective, and the evidence with its intervals; also constraints and the problem are compared, exactly.
    """
    terminal = Terminal("compare", as_json)
    with terminal.refusing():
        if len(folders) < 2:
            raise ProblemError("compare: expected two folders or more; received one.")
        runs = {label: _designs(folder) for label, folder in zip(_labels(folders), folders, strict=True)}
    rows: dict[tuple[str | None, ...], str] = {}  # the names of a design in all runs, and the first of these
    for name in (name for designs in runs.values() for name in designs):
        rows.setdefault(tuple(_name_in(designs, name, runs.values()) for designs in runs.values()), name)
    compared, differences = dict[str, Any](), dict[str, Any]()
    for names, name in rows.items():
        row = {label: runs[label].get(own or "") for label, own in zip(runs, names, strict=True)}
        terminal.table(_table(name, names, row))
        (reference, first), *others = row.items()
        compared[name] = row
        differences[name] = {label: first and other and _differing(first, other) for label, other in others}
        for label, differing in differences[name].items():
            terminal.tell(f"{name}: {_sentence(reference, label, differing)}")
    terminal.note(folders=[str(folder) for folder in folders], designs=compared, differences=differences)
    terminal.conclude(0)


def _labels(folders: Sequence[Path]) -> list[str]:
    """The last parts of the folders' names where these differ, the whole names elsewhere."""
    short = [folder.resolve().name for folder in folders]
    return short if len(set(short)) == len(short) else [str(folder) for folder in folders]


def _designs(folder: Path) -> Mapping[str, Any]:
    """A run's designs as documents by name: as the run has written them, or as its journal has them."""
    if written := written_designs(folder):
        return written
    if not (folder / FILE).is_file():
        raise ProblemError(
            f"compare: there are no results in '{folder}': expected a folder in which `aleator run` or a script within "
            "`al.journal(folder)` has kept results."
        )
    study_of(folder)  # so that its models' modules are there, if they are
    designs, evidence = designs_and_evidence(Recalled(folder).finished())
    return json.loads(
        json_text({name: solution_document(design, evidence.get(name)) for name, design in designs.items()})
    )


def _name_in(designs: Mapping[str, Any], name: str, runs: Iterable[Mapping[str, Any]]) -> str | None:
    """What a run calls a design that some run calls `name`: the same, or else the name of the same problem."""
    if name in designs:
        return name
    problems = [run[name]["problem"] for run in runs if name in run]
    return next((own for own, design in designs.items() if design["problem"] in problems), None)


def _numbers(design: Mapping[str, Any] | None) -> list[dict[str, tuple[Any, str]]]:
    """The rows of a design in groups: status, decisions, objective, evidence; each number exactly and as text."""
    if design is None:
        return [{}, {}, {}, {}]
    shares = design.get("evidence", {}).get("violations", {})
    return [
        {"Status": (design["status"], design["status"].partition(":")[0])},
        {name: (_with_unit(number), value_text(number)) for name, number in design["decisions"].items()},
        {"Objective": (_with_unit(design["objective"]), value_text(design["objective"]))},
        {f"Systems that violate {_violated(limit)}": (share, _interval_text(share)) for limit, share in shares.items()},
    ]


def _table(name: str, names: Sequence[str | None], designs: Mapping[str, Any]) -> Table:
    """One design in every run."""
    rows = [["There as", *(own or "–" for own in names)]] if set(names) - {None, name} else []
    for groups in zip(*map(_numbers, designs.values()), strict=True):
        labels = dict.fromkeys(label for group in groups for label in group)
        rows += [[label, *(group[label][1] if label in group else "–" for group in groups)] for label in labels]
    return Table(name, ["", *designs], rows, "")


def _differing(first: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """What differs between two designs, down to the last digit."""
    whole = [
        {label: number for group in _numbers(design) for label, (number, _) in group.items()}
        | {"constraints": design["constraints"], "the problem": design["problem"]}
        for design in (first, other)
    ]
    return [label for label in {**whole[0], **whole[1]} if whole[0].get(label) != whole[1].get(label)]


def _sentence(first: str, other: str, differing: list[str] | None) -> str:
    if differing is None:
        return f"one of {first} and {other} does not have it."
    return f"{first} and {other} differ in {words(differing)}." if differing else f"{first} and {other} are equal."


def _with_unit(number: Mapping[str, Any]) -> tuple[Any, str]:
    return number["value"], number["unit"]


def _interval_text(share: Mapping[str, Any]) -> str:
    """The share of systems that break a limit, with its interval."""
    return f"{percent(share['estimate'])} [{percent(share['lower'])} to {percent(share['upper'])}]"


def _violated(limit: str) -> str:
    """A limit of evidence in a sentence."""
    return "any limit" if limit == "any" else limit
