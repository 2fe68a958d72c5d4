"""`aleator validate`: fresh evidence on the designs of a study or of a folder."""

import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, Any, final

import typer

from aleator import studies
from aleator._core.errors import AleatorError, ProblemError
from aleator._core.given import meant
from aleator._core.interruption import Interruptions
from aleator._core.progress import Progress
from aleator.cli._kept import sorted_by_kind
from aleator.cli._options import AsJson, Design, StudyOrFolder, folder_of
from aleator.cli._origin import Origin, with_origin
from aleator.cli._progress import shown
from aleator.cli._record import Record, study_of
from aleator.cli._terminal import FAILED, Terminal
from aleator.cli._written import value_text
from aleator.design import Problem
from aleator.journalling import Journal, journal
from aleator.reporting import Table, evidence_document, evidence_table, share_text, solution_document
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies import AbstractStudy, Study, SweptStudy, executor_of, problems_of
from aleator.validation import Evidence
from aleator.validation import validate as validated

_NAME_IT = "Name the study to solve it first."
_KEPT = "Interrupted: finished evidence is kept."


def validate(
    place: StudyOrFolder,
    samples: Annotated[int, typer.Option(min=2, help="Fresh random systems for each design.")] = 20_000,
    seed: Annotated[int, typer.Option(min=0, help="Of the random systems.")] = 0,
    design: Design = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes that simulate the systems.", show_default="this one")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Count on fresh random systems how often designs break their limits, with 95 % intervals.

    Designs are taken from the folder (of a study: results/STUDY), and solved first where they are not there, or where
    an `al.Study` has changed since: which of these is told of each. The evidence is kept there too; the study's page
    stays as it is.
    """
    terminal = Terminal("validate", as_json)
    with ExitStack() as held:
        sampling = _Sampling(terminal, samples, seed, held.enter_context(executor_of(workers)))
        held.enter_context(sampling.interruptions)
        held.enter_context(terminal.warning())
        with terminal.refusing():
            study, folder, why = _meant(place)
            kept = held.enter_context(journal(folder))
            designs = _wanted(study, why, kept, folder, design)
            declared, solving = _declared(study), {} if study is None else study.solving
        code = sampling.of(designs, kept, declared, solving)
    terminal.note(folder=str(folder), samples=samples, seed=seed, designs=sampling.document())
    if sampling.found:
        terminal.table(_decisions(sampling.found))
        terminal.table(_shares(sampling.found))
        terminal.table(evidence_table(sampling.found))
    terminal.conclude(code)


def _meant(place: str) -> tuple[AbstractStudy | None, Path, str]:
    """The study and the folder of a name: a folder's study, or why it cannot be had; a study's folder."""
    folder = Path(place)
    if not folder.is_dir():
        study, folder = studies.load(place), folder_of(place)
        Record(place).check_owns(folder)
        return study, folder, ""
    study, why = study_of(folder)
    return study, folder, why


def _wanted(
    study: AbstractStudy | None, why: str, kept: Journal, folder: Path, design: str | None
) -> Mapping[str, Solution | Problem]:
    """Designs of a folder, and problems that are to be solved first, by name."""
    found: dict[str, Solution | Problem] = {}
    if not isinstance(study, Study):  # whose designs the journal knows by all that they follow from
        designs = sorted_by_kind(kept.finished())[0]
        # What a study does not call by a name is of an earlier form of it.
        of_now = {name: one for name, one in designs.items() if study is not None and not name.startswith("solve ")}
        found.update({name: one for name, one in (of_now or designs).items() if one.ok})
    if study is not None and (not found or (design is not None and design not in found)):
        found = {**problems_of(study), **found}
    if design is not None and design not in found:
        known = f"expected one of {list(found)}.{meant(design, found)}"
        raise ProblemError(f"validate: there is no design '{design}' in '{folder}'; {known}")
    if not found:
        raise ProblemError(f"validate: there is no finished design in '{folder}' that can be read. {why or _NAME_IT}")
    return found if design is None else {design: found[design]}


def _declared(study: AbstractStudy | None) -> Mapping[str, Problem]:
    """What a sweep says now of its points, by name. What a study of one's own solves need not be what it declares."""
    return study.points if isinstance(study, SweptStudy) else {}


def _decisions(found: Mapping[str, Evidence]) -> Table:
    """What was sampled, a column for each design."""
    told = [solution_document(one.solution) for one in found.values()]
    names = list(dict.fromkeys(name for one in told for name in one["decisions"]))
    rows = [[name, *(value_text(one["decisions"].get(name)) for one in told)] for name in names]
    rows.append(["Objective", *(value_text(one["objective"]) for one in told)])
    return Table("Designs", ["", *found], rows, "")


def _shares(found: Mapping[str, Evidence]) -> Table:
    """How many systems break each limit, a column for each design."""
    limits = list(dict.fromkeys(name for one in found.values() for name in one.violations))
    rows = [[name, *(share_text(one.violations.get(name)) for one in found.values())] for name in limits]
    rows.append(["any limit", *(share_text(one.joint if one.violations else None) for one in found.values())])
    return Table("Systems that violate limits", ["", *found], rows, "In brackets: 95 % confidence.")


@final
class _Sampling:
    """Designs that are solved where needed, and sampled one after another; `found` is the evidence so far."""

    def __init__(self, terminal: Terminal, samples: int, seed: int, executor: Executor | None):
        self._terminal, self._samples, self._seed, self._executor = terminal, samples, seed, executor
        self.interruptions = Interruptions(lambda: terminal.ended_at_once(_KEPT, self.interruptions.exit_code))
        self.found: dict[str, Evidence] = {}
        self._refused: dict[str, str] = {}
        self._origins: dict[str, Origin] = {}

    def of(
        self,
        designs: Mapping[str, Solution | Problem],
        kept: Journal,
        declared: Mapping[str, Problem],
        solving: Mapping[str, Any],
    ) -> int:
        """Sample designs, those not kept solved first; returns the exit code.

        `declared`: what the study says of them now, by name, if it does; `solving`: how it solves them.
        """
        try:
            with shown(self._terminal.console, len(designs)) as progress, self.interruptions.work():
                for name, one in designs.items():
                    begun = time.perf_counter()
                    progress.begin(f"evidence on {name}")
                    with self._telling(name):
                        design, origin = with_origin(
                            kept, name, one, declared.get(name), partial(solve, **solving, throw=False)
                        )
                        self._sample(name, design, origin, progress.show)
                    progress.end(f"evidence on {name}", 1.0, f"{time.perf_counter() - begun:.1f} s")
        except KeyboardInterrupt:
            self.interruptions.conclude()
            self._terminal.last_words(_KEPT)
            return self.interruptions.exit_code
        self.interruptions.rest()
        return FAILED if self._refused else 0

    def document(self) -> Mapping[str, Any]:
        """What was found, by the names of the designs."""
        told = {name: {**self._told(name, one.solution), **evidence_document(one)} for name, one in self.found.items()}
        return {**told, **{name: {"why": why} for name, why in self._refused.items()}}

    def _told(self, name: str, design: Solution) -> dict[str, Any]:
        origin, document = self._origins[name], solution_document(design)
        told = {"solved": origin.solved, "origin": origin.told, "differs": origin.differs}
        return {**told, "decisions": document["decisions"], "objective": document["objective"]}

    def _sample(self, name: str, design: Solution, origin: Origin, progress: Progress) -> None:
        self._origins[name] = origin
        say = self._terminal.tell if origin.as_declared else self._terminal.look_at
        say(f"design {name}: {origin.told}")
        progress(f"{name}: {in_brief(design)}", 0, self._samples)
        if not design.ok:
            raise ProblemError(design.why())
        self.found[name] = validated(design, self._samples, seed=self._seed, executor=self._executor, progress=progress)

    @contextmanager
    def _telling(self, name: str) -> Iterator[None]:
        """Note why there is no evidence on a design, and go on."""
        try:
            yield
        except AleatorError as error:
            self._refused[name] = f"{error}"
            self._terminal.complain(f"error with '{name}'", error)
