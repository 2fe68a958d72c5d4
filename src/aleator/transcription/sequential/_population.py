"""The values of a problem at many decisions in few calls, without derivatives: on all cores, or by an executor."""

import functools
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.compilation import Compiled, Use
from aleator._core.errors import ProblemError
from aleator._core.executors import Pack, each_of, packed
from aleator.design import Problem, functionals_of, refuse_other_code
from aleator.ensemble import Part, each, fill, parts
from aleator.expansion import Collocation
from aleator.nlp import NonlinearProgram
from aleator.statistics import Constants
from aleator.transcription._expansions import scope_of

# Systems simulated together: more are slower, because their histories leave the cache.
_SYSTEMS = 128
# Designs simulated together: of more, many would often be repetitions, and there would be no calls to share.
_DESIGNS = 16
# Calls by one thread before it waits for the others, which takes time.
_CALLS = 8
# Populations that a worker holds: as many problems as it may be asked about in turn.
_KEPT = 4


def _values(
    problem: Problem, collocation: Collocation, constants: Constants, several: Float[Array, "k n"]
) -> Float[Array, "k rows"]:
    functionals = functionals_of(problem.expressions)

    def one(decisions: Float[Array, " n"]) -> Float[Array, " rows"]:
        scope, samples = scope_of(problem, functionals, collocation, constants, decisions)
        values, _ = scope.evaluated(problem.expressions)
        finite = jnp.array([jnp.isfinite(one).all() for one in samples]).all()
        # A statistic may hide a failed simulation: the probability of a rare event is zero if that system gives NaN.
        return jnp.where(finite, jnp.concatenate(values), jnp.nan)

    return jax.vmap(one)(several)


VALUES = Compiled(_values, use=lambda problem, *_: Use.LOOPS if problem.is_integrated else Use.ROWS)


@final
class Population:
    """The objective and the rows of the constraints at any number of decisions.

    Compiled for one design and for as many as are worth one call. Digits depend on the size that a program is compiled
    for, and so on whether one design is asked for or several, but neither on how many these are nor on who evaluates
    which.
    """

    def __init__(self, traced: Problem, collocation: Collocation, constants: Constants):
        self.made_of = {"traced": traced, "collocation": collocation, "constants": constants}
        self._together = min(max(1, _SYSTEMS // len(collocation.points)), _DESIGNS)
        self._of_size = {size: VALUES.bound(traced, collocation, constants) for size in {1, self._together}}

    def __call__(self, decisions: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        """The objectives, shape (k,), and the rows of the constraints, shape (k, rows)."""
        size = self.size(len(decisions))
        self._prepare(decisions, size)

        def values(part: Part) -> Float[np.ndarray, "some rows"]:
            return np.concatenate([self._rows(one.points, size) for one in parts(part.points, size)])

        rows = np.concatenate([values for _, values in each(values, parts(decisions, size * _CALLS))])
        return rows[:, 0], rows[:, 1:]

    def size(self, count: int) -> int:
        """How many designs are evaluated in one call, of so many in all."""
        return self._together if count > 1 else 1

    def rows(self, some: Sequence[Float[np.ndarray, "few n"]], size: int) -> list[Float[np.ndarray, "few rows"]]:
        """The objective and the constraints at some designs, for each call: no more than `size` designs in one."""
        self._prepare(some[0], size)
        return [self._rows(one, size) for one in some]

    def _prepare(self, decisions: Float[np.ndarray, "k n"], size: int) -> None:
        # Traced here, because only the calling thread may run a user's code.
        self._of_size[size].prepare(fill(decisions[:size], size))

    def _rows(self, decisions: Float[np.ndarray, "few n"], size: int) -> Float[np.ndarray, "few rows"]:
        return np.asarray(self._of_size[size](fill(decisions, size)))[: len(decisions)]


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
    population, made_of = program.values, packed(executor, Population, program.values.made_of)

    def values(decisions: Float[np.ndarray, "k n"]) -> tuple[np.ndarray, np.ndarray]:
        """In calls of the same size as here, so that digits are the same."""
        size = population.size(len(decisions))
        calls = [one.points for one in parts(decisions, size)]
        results = each_of(executor, _rows_there, calls, {"made_of": made_of, "size": size}, where)
        rows = np.concatenate([some for _, some in results])
        return rows[:, 0], rows[:, 1:]

    return replace(program, values=values)


def _rows_there(
    items: Sequence[Float[np.ndarray, "few n"]], made_of: Pack, size: int
) -> list[Float[np.ndarray, "few rows"]]:
    return _population(made_of).rows(items, size)


@functools.lru_cache(_KEPT)
def _population(made_of: Pack) -> Population:
    """A population in this process, which is made and compiled once for all generations."""
    kind, parts_of_it = made_of.opened()
    refuse_other_code(parts_of_it["traced"])
    return kind(**parts_of_it)
