"""`Study`: a study of one's own, declared by its problems alone; `SweptStudy`: a design along a bound."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from copy import copy
from dataclasses import replace
from typing import Any, final

import numpy as np
from typing_extensions import override

from aleator import reporting
from aleator._core.border import a_name, meant, one_of, positive, real_array, refusal, whole
from aleator._core.errors import ProblemError
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver
from aleator.reporting import TARGET, Section, Verdict
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies._study import AbstractStudy, Draft
from aleator.sweep import Front, TradeOff, pareto, trade_off, validate_all, workers
from aleator.transcription import DEFAULT, AbstractTranscription
from aleator.validation import Evidence, validate

# A quick run takes these parts of the samples, and of the points of fronts.
_QUICK_SAMPLES, _QUICK_POINTS = 20, 3


@final
class Study(AbstractStudy):
    """A study of your own: problems that are solved, sampled, swept and reported.

        study = al.Study(
            {"nominal": al.deterministic(problem), "robust": problem},
            title="Bracket",
            sweeps={"mass": [1.0, 1.2, 1.4]},
            wishes={"mass": al.output("mass").mean, "stress": al.output("stress").std},
        )

    A file with this as `study`, or with problems alone, is run by `aleator run FILE.py`.

    - `designs`: a problem, or several by name: each is solved, and validated on `samples` fresh systems drawn with
      `seed`; the last is the one that is proposed, and the others stand beside it;
    - `target`: the largest share of systems that may break a limit of the proposed design;
    - `sweeps`: values of bounds by the names of constraints, along which the last design is solved again
      (`al.pareto`); `wishes`: what is traded off in the last design (`al.trade_off`), at `points` places; each solved
      point is validated on as many systems as a design;
    - `title`, `subtitle`: of the page; `solver`, `transcription`: see `al.solve`;
    - `workers`: processes that solve the points of `sweeps`, and count the evidence along these and trade-offs
      (`al.workers`); this one does if it is left out;
    - `quick`: for a first look: a twentieth of the samples, and every third point of fronts.

    Raises `ProblemError` for anything else, and for sweeps over bounds that the last design does not have.
    """

    def __init__(
        self,
        designs: Problem | Mapping[str, Problem],
        *,
        title: str = "Design under uncertainty",
        subtitle: str = "",
        samples: int = 20_000,
        seed: int = 0,
        target: float = TARGET,
        sweeps: Mapping[str, Sequence[float]] | None = None,
        wishes: Mapping[str, Expression] | None = None,
        points: int = 12,
        solver: AbstractSolver | None = None,
        transcription: AbstractTranscription = DEFAULT,
        workers: int | None = None,
        quick: bool = False,
    ):
        designs = {"design": designs} if isinstance(designs, Problem) else designs
        self.problems = _by_name("Study: designs", "a problem, or several by name", designs, Problem)
        self.title = one_of("Study: title", title, str)
        self.subtitle = one_of("Study: subtitle", subtitle, str)
        self.samples, self._seed = whole("Study: samples", samples, least=2), whole("Study: seed", seed, least=0)
        self._target = positive("Study: target", target, below=1.0)
        swept = _by_name("Study: sweeps", "values by the names of constraints", sweeps or {}, object, 0)
        self._sweeps = {name: _bounds("Study: sweeps", self._last, name, values) for name, values in swept.items()}
        expected = "two expressions or more by name"
        self._wishes = {} if wishes is None else _by_name("Study: wishes", expected, wishes, Expression, 2)
        self._points = whole("Study: points", points, least=max(2, len(self._wishes)))
        self.solving = {
            "solver": None if solver is None else one_of("Study: solver", solver, AbstractSolver, "al.solvers.Ipopt()"),
            "transcription": one_of("Study: transcription", transcription, AbstractTranscription, "al.Sequential()"),
        }
        self.workers = None if workers is None else whole("Study: workers", workers)
        if quick:
            self._shrink()

    def quickened(self) -> "Study":
        """The same study, small enough for a first look."""
        quick = copy(self)
        quick._shrink()
        return quick

    def _shrink(self) -> None:
        self.left_out, self.samples = "all samples and all points of its fronts", max(self.samples // _QUICK_SAMPLES, 2)
        self._sweeps = {name: values[::_QUICK_POINTS] for name, values in self._sweeps.items()}
        self._points = max(self._points // _QUICK_POINTS, max(2, len(self._wishes)))

    @override
    def with_workers(self, count: int) -> "Study":
        if not (self._sweeps or self._wishes):
            super().with_workers(count)
        shared = copy(self)
        shared.workers = whole("Study: workers", count)
        return shared

    @property
    def solves(self) -> int:
        """How many designs are solved in all."""
        front = self._points if self._wishes else 0
        return len(self.problems) + sum(map(len, self._sweeps.values())) + front

    @property
    def _last(self) -> Problem:
        return list(self.problems.values())[-1]

    @override
    def chapter(self, page: Draft) -> None:
        designs, evidence = dict[str, Solution](), dict[str, Evidence]()
        fronts, along = dict[str, Front | TradeOff](), list[Evidence]()
        try:
            for name, problem in self.problems.items():
                page.step(f"design {name}")
                page.progress(f"design {name}", 0, 1)
                designs[name] = solve(problem, **self.solving, throw=False)
                page.progress(f"design {name}: {in_brief(designs[name])}", 1, 1)
                page.keep("designs", {name: designs[name]})
            page.unsolved += [f"'{name}' is not solved: {one.why()}" for name, one in designs.items() if not one.ok]
            for name, design in designs.items():
                page.step(f"evidence on {name}")
                if design.ok:
                    evidence[name] = validate(design, self.samples, seed=self._seed, progress=page.progress)
                    page.keep("evidence", {name: evidence[name]})
            page.recommend(reporting.proposal(designs, evidence, self._target))
            for bound, values in self._sweeps.items():
                page.step(f"front over {bound}")
                with executor_of(self.workers) as executor:
                    how = {"executor": executor, "progress": page.progress, **self.solving}
                    fronts[bound] = pareto(self._last, bound, values, **how)
                page.keep("fronts", {bound: fronts[bound]})
                self._sample_along(page, bound, fronts[bound], along)
            if self._wishes:
                page.step("trade-off")
                name, how = " against ".join(self._wishes), {"progress": page.progress, **self.solving}
                fronts[name] = trade_off(self._last, self._wishes, self._points, **how)
                page.keep("trade-offs", {name: fronts[name]})
                self._sample_along(page, name, fronts[name], along)
        finally:  # what was found stands on the page, whatever ends the chapter
            page.append(*reporting.sections(designs, evidence, fronts, along))
            if designs:
                page.tables += [reporting.designs_table(designs, evidence), reporting.certificate_table(designs)]
            if evidence:
                page.tables.append(reporting.evidence_table(evidence))

    def _sample_along(self, page: Draft, name: str, front: Front | TradeOff, along: list[Evidence]) -> None:
        """Evidence on the same systems at each point of a front, so that a choice shows how often it fails."""
        if any(one.ok for one in front.solutions):
            page.step(f"evidence along the front over {name}")
            with executor_of(self.workers) as executor:
                sampled = validate_all(front, self.samples, seed=self._seed, executor=executor, progress=page.progress)
            page.keep("along", {name: sampled.by_place})
            along += sampled.by_place.values()
            if sampled.interrupted:
                raise KeyboardInterrupt


@final
class SweptStudy(AbstractStudy):
    """One design of a study, solved again for each value of a bound.

    - `study`: any with `problems`; `design`: one of them by name, the last if it is left out;
    - `bound`, `values`: as for `al.pareto`; `workers`: processes that solve points (`al.workers`), as many as the
      study says if it is left out.

    Raises `ProblemError` for a design or a bound that is not there, and for values that are no numbers.
    """

    def __init__(
        self,
        study: AbstractStudy,
        bound: str,
        values: Sequence[float],
        *,
        design: str | None = None,
        workers: int | None = None,
    ):
        problems = problems_of(study)
        self._name, self._bound = design or list(problems)[-1], bound
        if self._name not in problems:
            known = f"expected one of {list(problems)}.{meant(self._name, problems)}"
            raise ProblemError(f"The study '{study.title}' has no design '{self._name}'; {known}")
        self.title, self.subtitle = f"{study.title}: {self._name} over {bound}", study.subtitle
        self._values = _bounds("sweep: values", problems[self._name], bound, values)
        self.workers = study.workers if workers is None else whole("sweep: workers", workers)
        self.problems, self.solving = {self._name: problems[self._name]}, study.solving

    @override
    def chapter(self, page: Draft) -> None:
        page.step(f"front over {self._bound}")
        with executor_of(self.workers) as executor:
            how = {"executor": executor, "progress": page.progress, **self.solving}
            front = pareto(self.problems[self._name], self._bound, self._values, **how)
        solved, asked = int(front.solved.sum()), len(self._values)
        said = f"{solved} of {asked} points over {self._bound} are solved."
        if not solved and front.points:
            said += f" The first: {front.points[0].why()}"
            page.unsolved.append(said)
        word = "Swept" if solved == asked else "Partly solved" if solved else "Nothing solved"
        page.recommend(Verdict("good" if solved == asked else "caution" if solved else "bad", word, said))
        page.append(Section("Points", reporting.front_blocks({self._name: front}) if front.points else []))
        if front.points:
            page.tables.append(replace(reporting.front_table({"": front}), caption=f"{self._name} over {self._bound}"))
        if front.interrupted:
            page.add(f"{len(front.values)} of {len(self._values)} points are available.")
        page.keep("fronts", {self._name: front})


def executor_of(processes: int | None) -> AbstractContextManager[Executor | None]:
    """So many processes within a block (`al.workers`); none where the work is this one's."""
    return nullcontext() if processes is None else workers(processes)


def problems_of(study: AbstractStudy) -> dict[str, Problem]:
    """The problems that a study declares. Raises `ProblemError` if there are none, or anything else."""
    what = f"{type(study).__name__}.problems"
    return _by_name(what, "at least one problem, by its name", study.problems, Problem)


def _by_name(what: str, expected: str, given: Any, kind: type[Any], least: int = 1) -> dict[str, Any]:
    """Things of a kind by their names, so many at least. Raises `ProblemError` for anything else."""
    if not isinstance(given, Mapping) or len(given) < least:
        raise refusal(what, expected, given)
    return {a_name(f"{what}: a key", name): one_of(f"{what}: '{name}'", one, kind) for name, one in given.items()}


def _bounds(what: str, problem: Problem, name: str, values: Any) -> np.ndarray:
    """Values of a bound, each once, in the order given. Raises `ProblemError` for others than the bound can have."""
    array = real_array(f"{what}: '{name}'", values)
    if not array.size:
        raise refusal(f"{what}: '{name}'", "one value at least", values)
    distinct = list(dict.fromkeys(np.ravel(array).tolist()))
    for value in distinct:
        problem.with_bound(name, value)
    return np.array(distinct)
