"""`aleator report`: the page of what is in a folder."""

from pathlib import Path
from typing import Annotated

import typer

from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._kept import sorted_by_kind
from aleator.cli._options import AsJson, Folder
from aleator.cli._record import RECORD, recorded
from aleator.cli._terminal import Terminal
from aleator.journalling import Recalled, recalling
from aleator.reporting import PAGE, Page, Section, Text, footer, sections, verdict, words, write_page
from aleator.studies import AbstractStudy


def report(
    folder: Folder,
    out: Annotated[
        Path | None, typer.Option(help="File for the page.", show_default=f"FOLDER/{PAGE}", metavar="FILE")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write the page of what is in a run's folder, without computing anything, and say what is missing.

    Another process may be running there.
    """
    terminal = Terminal("report", as_json)
    with terminal.refusing(), terminal.warning():
        with recalling(folder) as kept:
            page, missing = _page(folder, kept)
        path = write_page(page, out or folder / PAGE)
    for one in missing:
        terminal.look_at(one)
    terminal.tell(f"wrote {path}")
    terminal.note(folder=str(folder), files=[str(path)], missing=missing, verdict=page.verdict.headline)
    terminal.conclude(0)


def _page(folder: Path, kept: Recalled) -> tuple[Page, list[str]]:
    """The page, and what is missing from it, a sentence each."""
    study = recorded(folder).made() if (folder / RECORD).is_file() else None
    if study is not None and study.stages_are_journalled:
        missing = _recalled(study, kept)
        if any(study.results().values()):
            return study.page(), missing
    return _bare_page(folder, kept, study)


def _recalled(study: AbstractStudy, kept: Recalled) -> list[str]:
    """Let a study take all its results from a folder; what is not there, a sentence each."""
    missing = []
    for name in study.stages:
        try:
            study.run(name)
        except KeyboardInterrupt:
            missing.append(f"'{name}' is not finished: {words(list(dict.fromkeys(kept.missing)), 'some')} is missing.")
        except AleatorError as error:
            missing.append(f"'{name}' failed: {error}")
        kept.missing.clear()
    return missing


def _bare_page(folder: Path, kept: Recalled, study: AbstractStudy | None) -> tuple[Page, list[str]]:
    """A page of all designs and all evidence in a folder, whatever computed them."""
    designs, evidence = sorted_by_kind(kept.finished())
    if not designs:
        raise ProblemError(f"report: there is no finished design in '{folder}' yet.")
    told = [*kept.missing, *([_HARD_TO_SEE] if study is not None and not study.stages_are_journalled else [])]
    page = Page(
        title=study.title if study is not None else folder.resolve().name,
        subtitle=f"Kept in {folder.resolve().name}: {words(list(designs))}",
        verdict=verdict(designs, evidence),
        sections=[*sections(designs, evidence, {}), *([Section("Missing", [Text(told)])] if told else [])],
        footer=footer(),
    )
    return page, told


_HARD_TO_SEE = (
    "This page has the designs and the evidence that the journal keeps; the study's own chapters follow with "
    "`aleator resume`."
)
