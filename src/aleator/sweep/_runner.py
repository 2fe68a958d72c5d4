"""The steps of sweeps, until all are done or Ctrl-C ends them: one after the other, or at once by an executor.

Every step tells its progress, begins its warnings with its place, and is recalled from a journal that has it.
"""

import pickle
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, TypeVar, final

from aleator._core.border import Progress, check_progress
from aleator._core.errors import AleatorError, SimulationError, warned_of
from aleator._core.executors import check_executor, each_done, is_of_this_process
from aleator._core.journalled import NotKeptError, Place, calling, place_of
from aleator._core.parallel import heeding
from aleator.design import Problem, refuse_other_code
from aleator.nlp import Status
from aleator.solution import Solution
from aleator.solving import Call, solve
from aleator.validation import Evidence, validate, validated_from

Arguments: TypeAlias = Mapping[str, Any]
_Result = TypeVar("_Result")


@final
@dataclass(frozen=True)
class Work:
    """Work that sweeps repeat, with `problem` or `solution` among its arguments.

    - `name`: what a journal calls it; `follows_from`: all that a result follows from, by the same arguments;
    - `compute`: a function of a module, which workers find by its name. It opens the entry of a journal itself.
    """

    name: str
    follows_from: Callable[..., dict[str, Any]]
    compute: Callable[..., Any]


def _solved(**arguments: Any) -> Solution:
    return solve(**arguments, throw=False)


SOLVE = Work("solve", lambda **arguments: Call(**arguments).causes, _solved)
VALIDATE = Work("validate", validated_from, validate)


def finished(result: _Result) -> _Result:
    """A result. Raises `KeyboardInterrupt` for one that Ctrl-C has cut short."""
    if getattr(result, "status", None) is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return result


@contextmanager
def running(
    verb: str, has_results: Callable[[], object], progress: Progress, executor: Executor | None = None
) -> "Iterator[Runner]":
    """Run the steps of a verb, whose `progress` and `executor` are checked first, until they are done.

    Ctrl-C ends them early, if there is any result yet; else it raises `KeyboardInterrupt`.
    """
    check_progress(verb, progress)
    check_executor(verb, executor)
    with heeding() as heed:
        runner = Runner(verb, heed, progress, executor)
        try:
            yield runner
        except KeyboardInterrupt:
            if not has_results():
                raise
            runner.interrupted = True


@final
class Runner:
    """Runs the steps of a sweep. `interrupted`: whether Ctrl-C ended them early."""

    def __init__(self, verb: str, heed: Callable[[], None], progress: Progress, executor: Executor | None):
        self._verb, self._heed, self.progress, self.executor = verb, heed, progress, executor
        self.interrupted = False

    @contextmanager
    def step(self, task: str, done: int, total: int, place: str) -> Iterator[None]:
        """One step of a `task`, after those done, that follows from these; `place`: in words, for its warnings."""
        self._heed()
        self.progress(task, done, total)
        with _at(f"{self._verb}, {place}"):
            yield

    def each(
        self,
        work: Work,
        task: str,
        calls: Sequence[Arguments],
        places: Sequence[str],
        *,
        accepted: type[AleatorError] | tuple[()] = (),
    ) -> Iterator[tuple[int, Any]]:
        """The results of independent steps, each with its index, as soon as they are there.

        - `places`: each step in words; `accepted`: exceptions that are results, such as the refusal of a point; others
          are raised.

        What Ctrl-C has cut short is no result. What a journal has is not computed. Where the caller stops, what an
        executor has not begun is cancelled.

        Raises `ProblemError` for a model that cannot travel, and `SimulationError` if workers keep dying.
        """
        self.progress(task, 0, len(calls))
        places = [f"{self._verb}, {place}" for place in places]
        executor = self.executor
        results = _in_turn(work, calls, places) if executor is None else _at_once(work, calls, places, executor)
        for done, (i, result) in enumerate(results, 1):
            if isinstance(result, AleatorError) and not isinstance(result, accepted):
                raise result
            yield i, finished(result)
            self.progress(task, done, len(calls))
            self._heed()


@contextmanager
def _at(place: str) -> Iterator[None]:
    with warned_of(place), calling(place):
        yield


def _in_turn(work: Work, calls: Sequence[Arguments], places: Sequence[str]) -> Iterator[tuple[int, Any]]:
    absent = None
    for i, (call, place) in enumerate(zip(calls, places, strict=True)):
        try:
            with _at(place):
                result = work.compute(**call)
        except AleatorError as error:
            result = error
        except NotKeptError as error:  # the others may be there
            absent = error
            continue
        yield i, result
    if absent is not None:
        raise absent


def _at_once(
    work: Work, calls: Sequence[Arguments], places: Sequence[str], executor: Executor
) -> Iterator[tuple[int, Any]]:
    kept, absent = dict[int, Place](), None
    for i, (call, place) in enumerate(zip(calls, places, strict=True)):
        try:
            with calling(place):
                kept[i] = place_of(work.name, work.follows_from(**call))
        except NotKeptError as error:
            absent = error
    missing = {i: {"compute": work.compute, "call": calls[i]} for i, place in kept.items() if place.recalled is None}
    results = each_done(executor, _computed, missing, places)
    yield from ((i, place.recalled) for i, place in kept.items() if place.recalled is not None)
    if absent is not None:
        raise absent
    try:
        for i, result in results:
            del missing[i]
            if isinstance(result, AleatorError):
                kept[i].failed(result)
            else:
                result = result if is_of_this_process(executor) else _with_own_objects(result, calls[i])
                kept[i].keep(result)
            yield i, result
    except SimulationError as error:  # of lost workers
        for i in missing:
            kept[i].failed(error)
        raise


def _computed(compute: Callable[..., Any], call: Arguments) -> Any:
    """What a worker does."""
    refuse_other_code(call["problem"] if "problem" in call else call["solution"].problem)
    return compute(**call)


def _with_own_objects(result: Any, call: Arguments) -> Any:
    """A result that travelled, with the objects of this process in the place of their copies."""
    if isinstance(result, Evidence):
        return replace(result, solution=call["solution"])
    if isinstance(result, Solution):
        sent: Problem = call["problem"]
        return replace(result, problem=sent) if pickle.dumps(result.problem) == pickle.dumps(sent) else result
    return result
