"""`aleator report`: the page of what is in a folder."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._kept import sorted_by_kind
from aleator.cli._options import AsJson, Folder
from aleator.cli._record import study_of
from aleator.cli._terminal import Terminal
from aleator.cli._written import written_designs, written_section
from aleator.journalling import Recalled, recalling
from aleator.reporting import PAGE, Page, Section, Text, Verdict, by_place, footer, sections, verdict, words, write_page
from aleator.studies import AbstractStudy

SO_FAR = "report-so-far.html"


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
        with recalling(folder) as kept:
            page = _page(folder, kept, missing)
        path = write_page(page, out or _place(folder, missing))
    for one in missing:
        terminal.look_at(one)
    if path.name == SO_FAR:
        terminal.look_at(f"{folder / PAGE} stays as it is, because the page of now is without what is missing.")
    terminal.tell(f"wrote {path}")
    terminal.note(files=[str(path)], verdict=page.verdict.headline)
    terminal.conclude(0)


def _place(folder: Path, missing: Sequence[str]) -> Path:
    """Where the page goes: never over another one if something is missing from it."""
    return folder / (SO_FAR if missing and (folder / PAGE).exists() else PAGE)


def _page(folder: Path, kept: Recalled, missing: list[str]) -> Page:
    """The page; what is missing from it is added, a sentence each."""
    study, why = study_of(folder)
    if why:
        missing.append(f"{why} {_WITHOUT_THE_STUDY}")
    if study is not None:
        missing += _recalled(study, kept)
        if any(one is not None for one in by_place(study.results()).values()):
            return study.page()
    return _bare_page(folder, kept, study, missing)


def _recalled(study: AbstractStudy, kept: Recalled) -> list[str]:
    """Let a study take all its results from a folder; what is not there, a sentence each."""
    missing = []
    for name in study.stages:
        try:
            study.run(name)
        except KeyboardInterrupt:
            absent = " ".join(dict.fromkeys(kept.missing)) or _FOLLOWS_FROM
            missing.append(f"'{name}' is not finished: {absent}")
        except AleatorError as error:
            missing.append(f"'{name}' failed: {error}")
        except Exception:  # of whatever kind, where a stage works with what an earlier one would have found
            if not missing:
                raise
            study.failed_parts = ()
            missing.append(f"'{name}' is not finished: {_FOLLOWS_FROM}")
        kept.missing.clear()
    return missing


def _bare_page(folder: Path, kept: Recalled, study: AbstractStudy | None, missing: list[str]) -> Page:
    """A page of all designs and all evidence in a folder, whatever computed them; adds what is missing from it."""
    designs, evidence = sorted_by_kind(kept.finished())
    missing += dict.fromkeys(kept.missing)
    if not designs:
        return _written_page(folder, kept.missing, missing)
    if study is not None:
        missing.append(_OF_ANOTHER_FORM)
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
    return Page(
        title=folder.resolve().name,
        subtitle=f"Written in {folder.resolve().name}: {words(list(written))}",
        verdict=Verdict(
            "caution", "Numbers only", "The model's code cannot be read: these are the numbers of its run."
        ),
        sections=[*(written_section(name, one) for name, one in written.items()), Section("Missing", [Text(missing)])],
        footer=footer(),
    )


_FOLLOWS_FROM = "what it follows from is missing."
_WITHOUT_THE_STUDY = (
    "So the study's title, chapters, fronts and tables are missing; the page shows the designs and the evidence that "
    "the folder keeps."
)
_WITHOUT_THE_MODEL = (
    "Without the model's code there are no figures and certificates: the page shows what designs.json says. Histories "
    "are in results.nc."
)
_OF_ANOTHER_FORM = (
    "These are designs of an earlier form of the study, or of its fronts: the study as it is now has no result here "
    "yet; `aleator resume` computes them."
)
