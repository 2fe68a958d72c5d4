"""`aleator report`: the page of what is in a run's folder."""

from pathlib import Path
from typing import NoReturn

from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._designs import designs_and_evidence, documents_table, written_designs
from aleator.cli._folder import is_stale, stale, study_of
from aleator.cli._terminal import Terminal
from aleator.journalling import Recalled, recalling
from aleator.reporting import (
    PAGE,
    Code,
    Page,
    Section,
    Text,
    Verdict,
    by_place,
    proposal,
    sections,
    whole_page,
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


def report(folder: Path, out: Path | None, as_json: bool) -> NoReturn:
    """Write the page of what is in a run's folder, without computing anything, and say what is missing.

    A complete page is not replaced by one from which something is missing.
    """
    terminal, missing = Terminal("report", as_json), list[str]()
    terminal.note(folder=str(folder), files=[], missing=missing, verdict=None)
    with terminal.refusing(), terminal.warning():
        with recalling(folder) as run:
            page = _page(folder, run, missing)
        path = write_page(page, out or folder / (_SO_FAR if missing and (folder / PAGE).exists() else PAGE))
    for sentence in missing:
        terminal.look_at(sentence)
    if path.name == _SO_FAR:
        terminal.look_at(f"{folder / PAGE} stays as it is, because the page of now is without what is missing.")
    terminal.tell(f"wrote {path}")
    terminal.note(files=[str(path)], verdict=page.verdict.headline)
    terminal.conclude(0)


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
    return _page_of_designs(folder, run, study, missing)


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


def _page_of_designs(folder: Path, run: Recalled, study: AbstractStudy | None, missing: list[str]) -> Page:
    """A page of all designs and all evidence in a folder, whatever computed them; adds what is missing from it.

    Where no result can be read without the model's code, it shows the designs that the run has written down.
    """
    designs, evidence = designs_and_evidence(run.finished())
    missing += dict.fromkeys(run.missing)
    title = folder.resolve().name
    if designs:
        names, about = list(designs), proposal(designs, evidence)
        title = study.title if study is not None else title
        chapters = sections(designs, evidence, {})
    else:
        if not run.missing:
            raise ProblemError(f"report: nothing is finished yet in '{folder}': there is no design to show.")
        written = written_designs(folder)
        if not written:
            raise ProblemError(f"report: no design in '{folder}' can be read: {run.missing[0]}")
        missing.append(_WITHOUT_THE_MODEL)
        numbers = "The model's code cannot be read: these are the numbers of its run."
        names, about = list(written), Verdict("caution", "Numbers only", numbers)
        chapters = [
            Section(name, [documents_table(name, {"Value": one}), Code("The problem", "\n".join(one["problem"]))])
            for name, one in written.items()
        ]
    absent = [Section("Missing", [Text(missing)])] if missing else []
    return whole_page(title, f"Kept in {folder.resolve().name}: {words(names)}", about, [*chapters, *absent])
