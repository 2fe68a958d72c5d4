"""`SweptStudy`: one design of another study, along one bound."""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, final

import numpy as np
from typing_extensions import override

from aleator._core.border import meant, one_of, real_array, refusal, whole
from aleator._core.errors import ProblemError
from aleator.design import Problem
from aleator.reporting import Section, Verdict, count, front_table, number, sections, words
from aleator.solution import Solution
from aleator.studies._study import AbstractStudy, Draft
from aleator.sweep import Front, pareto, point_name, workers


@contextmanager
def executor_of(processes: int | None) -> Iterator[Executor | None]:
    """So many processes within a block (`al.workers`); none where the work is this one's."""
    if processes is None:
        yield None
        return
    with workers(processes) as executor:
        yield executor


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
        name, problem = design_of(study, design)
        self.title, self.subtitle = f"{study.title}: {name} over {bound}", study.subtitle
        self._values = distinct("sweep: values", list(values))
        if not self._values.size or not np.isfinite(self._values).all():
            raise refusal("sweep: values", "one finite value of the bound at least", self._values.tolist())
        check_sweepable("sweep", problem, bound, self._values)
        self._workers = study.workers if workers is None else whole("sweep: workers", workers)
        self._name, self._problem, self._bound, self._solving = name, problem, bound, study.solving

    @property
    @override
    def problems(self) -> Mapping[str, Problem]:
        return {self._name: self._problem}

    @property
    @override
    def solving(self) -> Mapping[str, Any]:
        return self._solving

    @override
    def chapter(self, page: Draft) -> None:
        page.step(f"front over {self._bound}")
        with executor_of(self._workers) as executor:
            how = {"executor": executor, "progress": page.progress, **self._solving}
            front = pareto(self._problem, self._bound, self._values, **how)
        solved = {_place(front, i): one for i, one in enumerate(front.points) if isinstance(one, Solution) and one.ok}
        page.recommend(self._verdict(front, len(solved)))
        if front.points and not solved:
            page.unsolved.append(_nothing_solved(front))
        page.append(Section("Points", []))
        page.add(replace(front_table({"": front}), caption=f"{self._name} over {self._bound}"), printed=True)
        if front.interrupted:
            page.add(f"{len(front.values)} of {len(self._values)} points are available.")
        ends = {name: solved[name] for name in list(solved)[:: max(len(solved) - 1, 1)]}
        page.append(*sections(ends, {}, {self._name: front}))
        page.keep("fronts", {self._name: front})

    def _verdict(self, front: Front, solved: int) -> Verdict:
        if front.interrupted and not solved:
            return Verdict(
                "caution", "Interrupted", f"No point over {self._bound} was solved before the sweep stopped."
            )
        if not solved:
            return Verdict("bad", "Nothing solved", _nothing_solved(front))
        told = f"{count(solved)} of {count(len(self._values))} points over {self._bound} are solved"
        whole_front = solved == len(self._values)
        headline = f"{told}; {_range_of(front)}."
        return Verdict("good" if whole_front else "caution", "Swept" if whole_front else "Partly solved", headline)


def _nothing_solved(front: Front) -> str:
    return f"No point over {front.bound} is solved. The first: {front.points[0].why()}"


def problems_of(study: AbstractStudy) -> dict[str, Problem]:
    """The problems that a study declares. Raises `ProblemError` if there are none, or anything else."""
    what, problems = f"{type(study).__name__}.problems", study.problems
    if not isinstance(problems, Mapping):
        raise refusal(what, "problems by their names", problems)
    if not problems:
        raise ProblemError(
            f"The study '{study.title}' declares no problems: give its class the property `problems`, by their names."
        )
    return {name: one_of(f"{what}: '{name}'", one, Problem) for name, one in problems.items()}


def design_of(study: AbstractStudy, design: str | None) -> tuple[str, Problem]:
    """A design's name and problem; the last if none is named. Raises `ProblemError` if there is none of that name."""
    problems = problems_of(study)
    if design is None:
        design = list(problems)[-1]
    if design not in problems:
        known = f"expected one of {list(problems)}.{meant(design, problems)}"
        raise ProblemError(f"The study '{study.title}' has no design '{design}'; {known}")
    return design, problems[design]


def distinct(what: str, values: Any) -> np.ndarray:
    """Values of a bound, each once, in the order in which they are given. Raises `ProblemError` for other things."""
    return np.array(list(dict.fromkeys(np.ravel(real_array(what, values)).tolist())))


def check_sweepable(what: str, problem: Problem, bound: str, values: np.ndarray) -> None:
    """Refuse a bound that is not there, or that one number cannot set. Raises `ProblemError`."""
    limit = words([str(one) for one in problem.named(bound)])
    for value in values.tolist():
        try:
            problem.with_bound(bound, value)
        except ProblemError as error:
            raise ProblemError(
                f"{what}: {value:g} alone cannot be the bound of '{bound}', which is {limit}: sweep a limit of one "
                "side, or write each side in the study as a limit with a name of its own."
            ) from error


def _range_of(front: Front) -> str:
    """Objective and bound at both ends of what is solved."""
    solved = sorted((value, i) for i, value in enumerate(front.values.tolist()) if front.points[i].ok)
    ends = dict.fromkeys(i for _, i in (solved[0], solved[-1]))
    return f"the objective is {words([f'{number(front.objectives[i], 4)} at {_place(front, i)}' for i in ends])}"


def _place(front: Front, i: int) -> str:
    return point_name(front.bound, front.values[i])
