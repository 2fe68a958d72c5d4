"""`Study`: a study of one's own, declared by its problems alone."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar, final

from typing_extensions import override

from aleator._core.border import Progress, a_name, one_of, refusal, whole
from aleator._core.errors import ProblemError
from aleator.design import Expression, Problem
from aleator.nlp import AbstractSolver, Status
from aleator.reporting import Section, Table, Verdict, certificate_table, designs_table, evidence_table, sections
from aleator.reporting import verdict as verdict_on
from aleator.solution import Solution, in_brief
from aleator.solving import solve
from aleator.studies._study import AbstractStudy, Stage, stop_if_interrupted
from aleator.studies._swept import check_sweepable, distinct, executor_of, front_of
from aleator.sweep import EvidenceOfAll, Front, TradeOff, trade_off, validate_all
from aleator.transcription import DEFAULT, AbstractTranscription
from aleator.validation import Evidence, validate

Part = TypeVar("Part")

# A quick run takes these parts of the samples, and of the points of fronts.
_QUICK_SAMPLES, _QUICK_POINTS = 20, 3
# Relative durations of the stages: the first solve compiles.
_SOLVE, _EVIDENCE, _POINT, _EVIDENCE_ALONG = 3.0, 2.0, 1.0, 0.5


class _Found(NamedTuple):
    """What a study has found so far, each by the name of its design, bound or trade-off."""

    designs: dict[str, Solution]
    evidence: dict[str, Evidence]
    fronts: dict[str, Front]
    trade_offs: dict[str, TradeOff]
    along: dict[str, EvidenceOfAll]


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
      `seed`; the last is the one that is proposed, on which the verdict is, and the others stand beside it;
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
        if not isinstance(sweeps, Mapping | None):
            raise refusal("Study: sweeps", "values by the names of constraints", sweeps)
        swept = (sweeps or {}).items()
        self._sweeps = {name: distinct(f"Study: sweep over '{name}'", one) for name, one in swept}
        self._wishes = _checked_wishes(wishes)
        self._points = whole("Study: points", points, least=max(2, len(self._wishes)))
        self._solver = None if solver is None else one_of("Study: solver", solver, AbstractSolver, "al.solvers.Ipopt()")
        self._transcription = one_of("Study: transcription", transcription, AbstractTranscription, "al.Sequential()")
        self._workers = None if workers is None else whole("Study: workers", workers)
        self._is_quick = quick
        for name, values in self._sweeps.items():
            check_sweepable("Study: sweeps", self._last, name, values)
        self._found = _Found({}, {}, {}, {}, {})

    def quickened(self) -> "Study":
        """The same study, small enough for a first look."""
        return self._with(
            samples=max(self._samples // _QUICK_SAMPLES, 2),
            sweeps={name: one[::_QUICK_POINTS].tolist() for name, one in self._sweeps.items()},
            points=max(self._points // _QUICK_POINTS, max(2, len(self._wishes))),
            quick=True,
        )

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
        return self._with(workers=count)

    def _with(self, **changed: Any) -> "Study":
        """The same study with other settings."""
        settings: dict[str, Any] = {
            "title": self.title,
            "subtitle": self.subtitle,
            "samples": self._samples,
            "seed": self._seed,
            "sweeps": {name: one.tolist() for name, one in self._sweeps.items()},
            "wishes": self._wishes or None,
            "points": self._points,
            "solver": self._solver,
            "transcription": self._transcription,
            "workers": self._workers,
            "quick": self._is_quick,
        }
        return Study(self.problems, **{**settings, **changed})

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
    def _wished(self) -> str:
        return " against ".join(self._wishes)

    @property
    def _last(self) -> Problem:
        return list(self.problems.values())[-1]

    @property
    @override
    def stages(self) -> Mapping[str, Stage]:
        solved = {f"design {name}": Stage(partial(self._solve, name), _SOLVE) for name in self.problems}
        sampled = {f"evidence on {name}": Stage(partial(self._validate, name), _EVIDENCE) for name in self.problems}
        swept: dict[str, Stage] = {}
        for name, values in self._sweeps.items():
            swept[f"front over {name}"] = Stage(partial(self._sweep, name), _POINT * len(values))
            swept[f"evidence along the front over {name}"] = self._along(name, self._found.fronts, len(values))
        if self._wishes:
            swept["trade-off"] = Stage(self._trade_off, _POINT * self._points)
            swept["evidence along the trade-off"] = self._along(self._wished, self._found.trade_offs, self._points)
        return {**solved, **sampled, **swept}

    def _along(self, name: str, fronts: Mapping[str, Front | TradeOff], points: int) -> Stage:
        return Stage(partial(self._validate_along, name, fronts), _EVIDENCE_ALONG * points)

    @override
    def results(self) -> Mapping[str, Any]:
        found = self._found
        along = {name: one.by_place for name, one in found.along.items()}
        named = {"evidence": found.evidence, "fronts": found.fronts, "trade-offs": found.trade_offs, "along": along}
        return {"designs": found.designs, **{name: one for name, one in named.items() if one}}

    @override
    def verdict(self) -> Verdict:
        found = self._found
        if not found.designs:
            return Verdict("caution", "Interrupted", "No design was finished before the study stopped: run it again.")
        return verdict_on(found.designs, found.evidence)

    @override
    def sections(self) -> Sequence[Section]:
        found = self._found
        along = [each for one in found.along.values() for each in one.by_place.values()]
        return sections(found.designs, found.evidence, found.fronts, found.trade_offs, along)

    @override
    def tables(self) -> list[Table]:
        designs, evidence = self._found.designs, self._found.evidence
        if not designs:
            return []
        counted = [evidence_table(evidence)] if evidence else []
        return [designs_table(designs, evidence), *counted, certificate_table(designs)]

    @property
    @override
    def left_out(self) -> str:
        return "all samples and all points of its fronts" if self._is_quick else ""

    @property
    @override
    def unsolved(self) -> str:
        failed = {name: one for name, one in self._found.designs.items() if not one.ok}
        return "; ".join(f"'{name}' is not solved: {one.why()}" for name, one in failed.items())

    @override
    def cut_short(self) -> Iterator[str]:
        for name, one in self._found.fronts.items():
            if one.interrupted:
                yield f"{len(one.values)} of {len(self._sweeps[name])} points of the front over {name} are available."

    def _solve(self, name: str, progress: Progress) -> None:
        progress(f"design {name}", 0, 1)
        found = self._found.designs[name] = solve(self.problems[name], **self.solving, throw=False)
        progress(f"design {name}: {in_brief(found)}", 1, 1)
        if found.status is Status.INTERRUPTED:
            raise KeyboardInterrupt

    def _validate(self, name: str, progress: Progress) -> None:
        design = _there(self._found.designs, name)
        if design.ok:
            self._found.evidence[name] = validate(design, self._samples, seed=self._seed, progress=progress)

    def _sweep(self, bound: str, progress: Progress) -> None:
        values = self._sweeps[bound]
        front = front_of(self._last, bound, values, processes=self._workers, solving=self.solving, progress=progress)
        self._found.fronts[bound] = front
        stop_if_interrupted(self._found.fronts[bound])

    def _trade_off(self, progress: Progress) -> None:
        found = trade_off(self._last, self._wishes, self._points, progress=progress, **self.solving)
        self._found.trade_offs[self._wished] = found
        stop_if_interrupted(found)

    def _validate_along(self, name: str, fronts: Mapping[str, Front | TradeOff], progress: Progress) -> None:
        """Count on the same systems at each solved point, so that whoever chooses one sees how often it fails."""
        front = _there(fronts, name)
        if any(one.ok for one in front.solutions):
            with executor_of(self._workers) as executor:
                found = validate_all(front, self._samples, seed=self._seed, executor=executor, progress=progress)
            self._found.along[name] = found
            stop_if_interrupted(found)


def _there(found: Mapping[str, Part], name: str) -> Part:
    """What an earlier stage has found. Raises `KeyboardInterrupt` where that one was stopped before it had anything."""
    if name not in found:
        raise KeyboardInterrupt
    return found[name]


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
