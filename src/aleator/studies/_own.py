"""`Study`: a study of one's own, declared by its problems alone."""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any, final

from typing_extensions import override

from aleator._core.border import a_name, one_of, positive, refusal, whole
from aleator._core.errors import ProblemError
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver
from aleator.reporting import (
    TARGET,
    certificate_table,
    designs_table,
    evidence_sections,
    evidence_table,
    proposal,
    sections,
    trade_offs_section,
    violations_table,
)
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies._study import AbstractStudy, Draft
from aleator.studies._swept import check_sweepable, distinct, executor_of
from aleator.sweep import Front, TradeOff, pareto, trade_off, validate_all
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
        self._problems = _problems(designs)
        self.title = one_of("Study: title", title, str)
        self.subtitle = one_of("Study: subtitle", subtitle, str)
        self._samples, self._seed = whole("Study: samples", samples, least=2), whole("Study: seed", seed, least=0)
        self._target = positive("Study: target", target, below=1.0)
        if not isinstance(sweeps, Mapping | None):
            raise refusal("Study: sweeps", "values by the names of constraints", sweeps)
        swept = (sweeps or {}).items()
        self._sweeps = {name: distinct(f"Study: sweep over '{name}'", one) for name, one in swept}
        self._wishes = _checked_wishes(wishes)
        self._points = whole("Study: points", points, least=max(2, len(self._wishes)))
        self._solver = None if solver is None else one_of("Study: solver", solver, AbstractSolver, "al.solvers.Ipopt()")
        self._transcription = one_of("Study: transcription", transcription, AbstractTranscription, "al.Sequential()")
        self._workers = None if workers is None else whole("Study: workers", workers)
        self._is_quick = False
        for name, values in self._sweeps.items():
            check_sweepable("Study: sweeps", self._last, name, values)
        if quick:
            self._shrink()

    def quickened(self) -> "Study":
        """The same study, small enough for a first look."""
        quick = copy(self)
        quick._shrink()
        return quick

    def _shrink(self) -> None:
        self._is_quick, self._samples = True, max(self._samples // _QUICK_SAMPLES, 2)
        self._sweeps = {name: one[::_QUICK_POINTS] for name, one in self._sweeps.items()}
        self._points = max(self._points // _QUICK_POINTS, max(2, len(self._wishes)))

    @property
    @override
    def workers(self) -> int | None:
        return self._workers

    @override
    def with_workers(self, count: int) -> "Study":
        if not (self._sweeps or self._wishes):
            raise ProblemError(
                f"--workers {count}: the study '{self.title}' has nothing to share among processes: expected "
                "`sweeps` or `wishes`. A single solve takes all cores of the machine by itself."
            )
        shared = copy(self)
        shared._workers = whole("Study: workers", count)
        return shared

    @property
    @override
    def problems(self) -> Mapping[str, Problem]:
        return self._problems

    @property
    @override
    def solving(self) -> Mapping[str, Any]:
        return {"solver": self._solver, "transcription": self._transcription}

    @property
    def samples(self) -> int:
        """The fresh systems on which each design is validated."""
        return self._samples

    @property
    def solves(self) -> int:
        """How many designs are solved in all."""
        front = self._points if self._wishes else 0
        return len(self.problems) + sum(map(len, self._sweeps.values())) + front

    @property
    def _last(self) -> Problem:
        return list(self.problems.values())[-1]

    @property
    @override
    def left_out(self) -> str:
        return "all samples and all points of its fronts" if self._is_quick else ""

    @override
    def chapter(self, page: Draft) -> None:
        designs, evidence = dict[str, Solution](), dict[str, Evidence]()
        for name, problem in self.problems.items():
            page.step(f"design {name}")
            page.progress(f"design {name}", 0, 1)
            designs[name] = solve(problem, **self.solving, throw=False)
            page.progress(f"design {name}: {in_brief(designs[name])}", 1, 1)
            page.keep("designs", {name: designs[name]})
        page.unsolved += [f"'{name}' is not solved: {one.why()}" for name, one in designs.items() if not one.ok]
        first, *trust = sections(designs, {}, {})
        page.append(first)
        page.tables.append(designs_table(designs, {}))
        for name, design in designs.items():
            page.step(f"evidence on {name}")
            if design.ok:
                evidence[name] = validate(design, self._samples, seed=self._seed, progress=page.progress)
                page.keep("evidence", {name: evidence[name]})
        page.recommend(proposal(designs, evidence, self._target))
        page.append(*evidence_sections(evidence))
        if evidence:
            page.add(violations_table(evidence), printed=True)
            page.tables.append(evidence_table(evidence))
        page.tables.append(certificate_table(designs))
        for bound, values in self._sweeps.items():
            page.step(f"front over {bound}")
            with executor_of(self._workers) as executor:
                front = pareto(self._last, bound, values, executor=executor, progress=page.progress, **self.solving)
            self._show(page, designs, evidence, bound, front)
        if self._wishes:
            page.step("trade-off")
            front = trade_off(self._last, self._wishes, self._points, progress=page.progress, **self.solving)
            self._show(page, designs, evidence, " against ".join(self._wishes), front)
        page.append(*trust)

    def _show(
        self,
        page: Draft,
        designs: Mapping[str, Solution],
        evidence: Mapping[str, Evidence],
        name: str,
        front: Front | TradeOff,
    ) -> None:
        """Show a front, with evidence on the same systems at each point, so that a choice shows how often it fails."""
        kind, work = ("fronts", f"front over {name}") if isinstance(front, Front) else ("trade-offs", "trade-off")
        page.kept = {**page.kept, kind: {**page.kept.get(kind, {}), name: front}}
        sampled = None
        if not front.interrupted and any(one.ok for one in front.solutions):
            page.step(f"evidence along the {work}")
            with executor_of(self._workers) as executor:
                everyone = {"seed": self._seed, "executor": executor, "progress": page.progress}
                sampled = validate_all(front, self._samples, **everyone)
            page.kept = {**page.kept, "along": {**page.kept.get("along", {}), name: sampled.by_place}}
        known = [*evidence.values(), *(() if sampled is None else sampled.by_place.values())]
        page.append(trade_offs_section(designs, {name: front}, known))
        if front.interrupted or (sampled is not None and sampled.interrupted):
            page.add(f"{len(front.solutions)} points of the front over {name} are available.")
            raise KeyboardInterrupt


def _checked_wishes(wishes: Mapping[str, Expression] | None) -> dict[str, Expression]:
    if wishes is None:
        return {}
    if not isinstance(wishes, Mapping) or len(wishes) < 2:
        raise refusal("Study: wishes", "two expressions or more by name", wishes)
    for name, one in wishes.items():
        one_of(f"Study: wish '{a_name('Study: the name of a wish', name)}'", one, Expression)
    return dict(wishes)


def _problems(designs: Any) -> dict[str, Problem]:
    if isinstance(designs, Problem):
        return {"design": designs}
    if not isinstance(designs, Mapping) or not designs:
        raise refusal("Study: designs", "a problem, or several by name", designs)
    for name, one in designs.items():
        one_of(f"Study: design '{a_name('Study: the name of a design', name)}'", one, Problem)
    return dict(designs)


def study_of(owner: str, declared: Mapping[str, Any]) -> AbstractStudy:
    """The study that a file declares by its names: `study`, or a `Study` of its problems. Raises `ProblemError`."""
    study = declared.get("study")
    if study is not None:
        return one_of(f"{owner}: study", study, AbstractStudy, "al.Study(problem)")
    problems = {name: one for name, one in declared.items() if isinstance(one, Problem) and not name.startswith("_")}
    if not problems:
        raise ProblemError(
            f"{owner}: expected a study, such as `study = al.Study(problem)`, or problems, such as "
            "`problem = al.Problem(...)`; received neither."
        )
    return Study(problems, title=owner)
