"""A population whose designs are shared among the workers of an executor."""

import functools
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import ProblemError
from aleator._core.executors import AbstractPack, each_of, packed
from aleator.design import refuse_other_code
from aleator.ensemble import parts
from aleator.nlp import NonlinearProgram
from aleator.transcription.sequential._population import Population

# Populations that a worker holds: as many problems as it may be asked about in turn.
_KEPT = 4


def valued_by(executor: Executor | None, program: NonlinearProgram, where: str) -> NonlinearProgram:
    """A program whose values at several points an executor finds; without one the same program.

    - `where`: the words with which warnings and errors begin.

    Raises `ProblemError` for a program whose values are not those of a simulated problem.
    """
    if executor is None:
        return program
    if not isinstance(program.values, Population):
        raise ProblemError(
            f"{where}: executor: expected transcription=al.Sequential(), whose designs other processes can simulate; "
            "received a transcription of another kind."
        )
    return replace(program, values=_Elsewhere(program.values, executor, where))


@final
class _Elsewhere:
    """A population by an executor, in calls of the same size as here, so that digits are the same."""

    def __init__(self, population: Population, executor: Executor, where: str):
        self._population, self._executor, self._where = population, executor, where
        self._given = {"made_of": packed(executor, Population, population.made_of)}

    def __call__(self, decisions: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        size = self._population.size(len(decisions))
        calls = [one.points for one in parts(decisions, size)]
        found = each_of(self._executor, _rows_there, calls, {**self._given, "size": size}, self._where)
        rows = np.concatenate([some for _, some in found])
        return rows[:, 0], rows[:, 1:]


def _rows_there(
    items: Sequence[Float[np.ndarray, "few n"]], made_of: AbstractPack, size: int
) -> list[Float[np.ndarray, "few rows"]]:
    return _population(made_of).rows(items, size)


@functools.lru_cache(_KEPT)
def _population(made_of: AbstractPack) -> Population:
    """A population in this process, which is made and compiled once for all generations."""
    kind, given = made_of.opened()
    refuse_other_code(given["traced"])
    return kind(**given)
