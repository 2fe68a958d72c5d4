"""`aleator validate`: fresh evidence on the designs of a study or of a folder."""

import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NoReturn, final

from aleator import studies
from aleator._core.border import meant
from aleator._core.errors import AleatorError, ProblemError
from aleator.cli._designs import designs_and_evidence, documents_table
from aleator.cli._folder import Record, folder_of, is_stale, stale, study_of
from aleator.cli._interruption import Interruptions
from aleator.cli._progress import shown
from aleator.cli._terminal import FAILED, Terminal
from aleator.design import Problem
from aleator.journalling import Journal, journal
from aleator.reporting import evidence_document, evidence_table, solution_document, violations_table
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies import AbstractStudy, executor_of, problems_of
from aleator.validation import Evidence
from aleator.validation import validate as validated

_NAME_IT = "Name the study to solve it first."
_KEPT = "Interrupted: finished evidence is kept."


def validate(place: str, samples: int, seed: int, design: str | None, workers: int | None, as_json: bool) -> NoReturn:
    """Count on fresh random systems how often the designs of a study or a folder break their limits."""
    terminal = Terminal("validate", as_json)
    with ExitStack() as held:
        sampling = _Sampling(terminal, samples, seed, held.enter_context(executor_of(workers)))
        held.enter_context(sampling.interruptions)
        held.enter_context(terminal.warning())
        with terminal.refusing():
            study, folder, why = _study_and_folder(place)
            run = held.enter_context(journal(folder))
            designs = _selected(study, why, run, design)
        code = sampling.of(designs, run, {} if study is None else study.solving)
    terminal.note(folder=str(folder), samples=samples, seed=seed, designs=sampling.documents)
    if sampling.evidence:
        designs = {name: solution_document(one.solution) for name, one in sampling.evidence.items()}
        terminal.table(documents_table("Designs", designs))
        terminal.table(violations_table(sampling.evidence))
        terminal.table(evidence_table(sampling.evidence))
    terminal.conclude(code)


def _study_and_folder(place: str) -> tuple[AbstractStudy | None, Path, str]:
    """The study and the folder of a name, and why a folder's study cannot be loaded, if so."""
    folder = Path(place)
    if folder.is_dir():
        study, why = study_of(folder)
    else:
        study, folder, why = studies.load(place), folder_of(place), ""
        Record(place).check_owns(folder)
    if is_stale(folder):
        raise ProblemError(f"validate: {stale(folder)}")
    return study, folder, why


def _selected(
    study: AbstractStudy | None, why: str, run: Journal, design: str | None
) -> Mapping[str, Solution | Problem]:
    """Designs of a folder, and problems that are to be solved first, by name."""
    # A solution without a name in the folder of a study is no design of its run.
    designs: dict[str, Solution | Problem] = {
        name: solution
        for name, solution in designs_and_evidence(run.finished())[0].items()
        if solution.ok and (study is None or not name.startswith("solve "))
    }
    if study is not None and (not designs or (design is not None and design not in designs)):
        designs = {**problems_of(study), **designs}
    if design is not None and design not in designs:
        known = f"expected one of {list(designs)}.{meant(design, designs)}"
        raise ProblemError(f"validate: there is no design '{design}' in '{run.folder}'; {known}")
    if not designs:
        raise ProblemError(
            f"validate: there is no finished design in '{run.folder}' that can be read. {why or _NAME_IT}"
        )
    return designs if design is None else {design: designs[design]}


@final
class _Sampling:
    """Designs that are solved where needed, and sampled in order; `evidence` and `documents` of what there is so far.

    A document says whether the design is solved (`status`, and `why` there is no evidence if it is not), whether it was
    solved just now (`solved_anew`), and how often its limits break (`violations`).
    """

    def __init__(self, terminal: Terminal, samples: int, seed: int, executor: Executor | None):
        self._terminal, self._samples, self._seed, self._executor = terminal, samples, seed, executor
        self.interruptions = Interruptions(lambda: terminal.ended_at_once(_KEPT, self.interruptions.exit_code))
        self.evidence: dict[str, Evidence] = {}
        self.documents: dict[str, dict[str, Any]] = {}
        self._is_refused = False

    def of(self, designs: Mapping[str, Solution | Problem], run: Journal, solving: Mapping[str, Any]) -> int:
        """Sample designs, problems solved first (as `solving` says); returns the exit code."""
        try:
            with shown(self._terminal.console, len(designs)) as progress, self.interruptions.work():
                for name, design in designs.items():
                    started, part = time.perf_counter(), f"evidence on {name}"
                    progress.begin(part)
                    with self._refusing(name):
                        solution = self._solution(name, design, run, solving)
                        progress.show(f"{name}: {in_brief(solution)}", 0, self._samples)
                        if not solution.ok:
                            raise ProblemError(solution.why())
                        self.evidence[name] = sampled = validated(
                            solution, self._samples, seed=self._seed, executor=self._executor, progress=progress.show
                        )
                        self.documents[name] |= evidence_document(sampled)
                    progress.end(part, f"{time.perf_counter() - started:.1f} s")
        except KeyboardInterrupt:
            self.interruptions.conclude()
            self._terminal.last_words(_KEPT)
            return self.interruptions.exit_code
        self.interruptions.rest()
        return FAILED if self._is_refused else 0

    def _solution(self, name: str, design: Solution | Problem, run: Journal, solving: Mapping[str, Any]) -> Solution:
        """A design of the folder, or of a solve of now, which has this name in the folder from now on."""
        begun = run.begun
        solution = design if isinstance(design, Solution) else solve(design, **solving, throw=False)
        is_new, document = run.begun > begun, solution_document(solution)
        if is_new:
            run.call({name: solution})
        facts = {key: document[key] for key in ("status", "decisions", "objective")}
        self.documents[name] = {"solved_anew": is_new, **facts}
        origin = "solved, because the folder does not have it" if is_new else "taken from the folder"
        self._terminal.tell(f"design {name}: {origin}.")
        return solution

    @contextmanager
    def _refusing(self, name: str) -> Iterator[None]:
        """Note why there is no evidence on a design, and go on."""
        try:
            yield
        except AleatorError as error:
            self._is_refused = True
            self.documents.setdefault(name, {})["why"] = f"{error}"
            self._terminal.complain(f"error with '{name}'", error)
