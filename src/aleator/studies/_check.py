"""What a study will do, before anything is spent: sizes, quality of the points, derivatives, time."""

import time
from typing import final

import numpy as np

from aleator._core.errors import SimulationError
from aleator._core.memory import NUMBER
from aleator.design import Problem, problem_text
from aleator.dynamics import Grid
from aleator.examining import examine
from aleator.reporting import Code, Table, number
from aleator.studies._own import Study
from aleator.transcription import DEFAULT, AbstractTranscribed, transcribe

# Evaluations of a typical solve by derivatives, for predictions.
_EVALUATIONS = 30
_SECONDS = "{:.2g} s"


@final
class Check:
    """The problems of a study as tables: what each is, how well it is posed, and what it will take."""

    def __init__(self, study: Study):
        self._study = study

    def mathematics(self) -> list[Code]:
        """Each problem as mathematics."""
        return [Code(name, problem_text(one, ""), True) for name, one in self._study.problems.items()]

    def table(self) -> tuple[Table, list[str]]:
        """A column for each problem; and what was found that may stop a solver, a sentence each."""
        columns, troubles = [], []
        for name, problem in self._study.problems.items():
            rows, found = _column(problem, self._study.samples)
            columns.append(rows)
            troubles += [f"{name}: {one}" for one in found]
        names = list(columns[0])
        rows = [[row, *(one.get(row, "–") for one in columns)] for row in names]
        note = (
            f"Times on this machine, at the start: {_EVALUATIONS} evaluations for a solve, and {self._study.solves} "
            "solves in all."
        )
        return Table("What will be done", ["", *self._study.problems], rows, note), troubles


def _column(problem: Problem, samples: int) -> tuple[dict[str, str], list[str]]:
    began = time.perf_counter()
    transcribed = transcribe(problem, DEFAULT)
    compiled = time.perf_counter() - began
    each = _seconds(transcribed)
    derivatives, troubles = _examined(problem)
    points, decisions = len(transcribed.collocation.points), problem.placements.size
    grid = problem.grid
    uncertain = transcribed.basis.variables
    instants = grid.steps + 1 if isinstance(grid, Grid) else 1
    simulated = _EVALUATIONS * points + (samples if uncertain else 1)
    rows = {
        "decisions": f"{decisions}",
        "uncertain numbers": f"{uncertain}",
        "instants": f"{instants}" if isinstance(grid, Grid) else "no time",
        "expansion": f"order {transcribed.basis.order}, {transcribed.basis.terms} terms" if uncertain else "none",
        "collocation points": f"{points}",
        "condition number": number(float(transcribed.collocation.condition_number), 3),
        "rows of limits": f"{len(transcribed.program.constraint_lower)}",
        "derivatives": derivatives,
        "compilation": _SECONDS.format(compiled),
        "one evaluation": _SECONDS.format(each),
        "one solve": f"about {_SECONDS.format(_EVALUATIONS * each)}",
        "samples": f"{samples}" if uncertain else "one system, on a finer grid",
        "simulations": f"about {simulated}",
        "memory of derivatives": _bytes(NUMBER * len(transcribed.program.constraint_lower) * (1 + decisions)),
    }
    return rows, troubles


def _examined(problem: Problem) -> tuple[str, list[str]]:
    """What is said of the derivatives at the start, and what may stop a solver there."""
    try:
        found = examine(problem)
    except SimulationError as error:
        return "see below", [str(error)]
    troubles = [*found.kinks, *found.jumps, *found.wrong, *found.endless, *found.unfit]
    return "agree with differences" if found.ok else "see below", troubles


def _bytes(size: int) -> str:
    return f"{size / 2**20:.2g} MiB" if size < 2**30 else f"{size / 2**30:.2g} GiB"


def _seconds(transcribed: AbstractTranscribed) -> float:
    """The time of one evaluation with derivatives, at a point that is not remembered."""
    program = transcribed.program
    moved = np.clip(program.start + 1e-6 * program.variable_scale, program.lower, program.upper)
    began = time.perf_counter()
    program.evaluate(moved)
    return time.perf_counter() - began
