"""Runs of a function at many models: in this process, by an executor, or each in a process of its own."""

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pickle import PicklingError
from typing import Any, NamedTuple, final

import jax
import numpy as np
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.executors import ended_with, endings, exit_told, report
from aleator._core.leaves import is_traced
from aleator.ensemble import name_of

# Runs that an executor is given at a time: enough for all its workers, and few to cancel.
_IN_FLIGHT = 256


class Ended(NamedTuple):
    """A run that has ended: the place of its sample among all, and what it returned or the exception that it raised."""

    place: int
    returned: Any
    error: BaseException | None


@final
class Runs:
    """Runs that have yet to end; iterating gives the runs that have ended, several at a time, until none is left.

    Raises `ProblemError` if the executor is shut down or cannot be sent the function, and `SimulationError` if it is
    broken; all that ended before has been given then. `cancel` before `close`.
    """

    def __init__(self, function: Callable[[Pytree], Pytree], models: dict[int, Pytree], executor: Executor | None):
        self._function, self._models = function, models
        self._executor, self._width = (_Here(), 1) if executor is None else (executor, _IN_FLIGHT)
        self._queue = deque(models)
        self._flying: dict[Future, int] = {}

    def __iter__(self) -> Iterator[list[Ended]]:
        while self._queue or self._flying:
            refused = self._submit()
            done = wait(self._flying, return_when=FIRST_COMPLETED).done if self._flying else set()
            ended = [Ended(self._flying.pop(future), *_outcome(future)) for future in list(done)]
            broken = [run for run in ended if isinstance(run.error, BrokenExecutor)]
            yield [run for run in ended if not isinstance(run.error, BrokenExecutor)]
            if broken or refused:
                raise refused or _broken(broken[0].error)

    def again(self, index: int) -> None:
        """Run a sample once more, next."""
        self._queue.appendleft(index)

    def cancel(self) -> None:
        """Cancel the runs that have not begun."""
        for future in self._flying:
            future.cancel()

    def close(self) -> list[Ended]:
        """End, after `cancel`; returns the runs that ended meanwhile, which nothing else would see."""
        done = {future: i for future, i in self._flying.items() if future.done() and not future.cancelled()}
        self._flying, self._queue = {}, deque()
        return [Ended(index, *_outcome(future)) for future, index in done.items()]

    def _submit(self) -> Exception | None:
        """Fill the executor; returns the error by which it refuses more."""
        while self._queue and len(self._flying) < self._width:
            index = self._queue.popleft()
            try:
                self._flying[self._executor.submit(self._function, _fresh(self._models[index]))] = index
            except BrokenExecutor as error:
                return _broken(error)
            except RuntimeError as error:
                return ProblemError(f"BlackBox: expected an executor that takes work; it says: {error}.")
        return None


@final
class _Here(Executor):
    """Runs everything at once, in the calling thread."""

    @override
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future:
        future: Future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except (Exception, SystemExit) as error:
            future.set_exception(error)
        return future


def refuse_traced(function: Callable[[Pytree], Pytree], realised: Pytree) -> None:
    """Raise `ProblemError` for a function that leaves this process if JAX traces it."""
    if is_traced(realised):
        kind = type(function).__name__
        raise ProblemError(f"{name_of(function)} cannot be traced by JAX: wrap it, al.foreign.BlackBox({kind}(...)).")


def _fresh(model: Pytree) -> Pytree:
    """A model with containers and arrays of its own, which a function may change."""
    return jax.tree.map(lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, model)


def _outcome(future: Future) -> tuple[Any, BaseException | None]:
    if future.cancelled():
        return None, BrokenExecutor("it cancelled its work")
    error = future.exception()
    if error is None:
        return future.result(), None
    if isinstance(error, SystemExit):
        # A model that ends its own process has failed; it does not end this one.
        return None, SimulationError(f"it ended itself by sys.exit({'' if error.code is None else error.code!r})")
    return None, unsendable("BlackBox", error) if is_of_pickle(error) else error


def is_of_pickle(error: BaseException) -> bool:
    """Whether something could not be sent to a process. Before Python 3.14 the types of these errors are no help."""
    said = str(error).lower()
    return isinstance(error, PicklingError) or (
        isinstance(error, AttributeError | TypeError) and ("pickle" in said or "local object" in said)
    )


def unsendable(who: str, error: BaseException) -> ProblemError:
    """The error that says that something cannot be sent to a process."""
    said = next(iter(str(error).splitlines()), "").rstrip(".")
    return ProblemError(
        f"{who}: expected a function and results that can be sent to another process, such as a function at the top "
        f"level of a module; received: {said}."
    )


def _broken(error: BaseException | None) -> SimulationError:
    said = next(iter(str(error).splitlines()), "").rstrip(".")
    return SimulationError(
        f"BlackBox: its executor is broken ({said}). If a sample ends its process, let it run in one of its own by "
        'al.foreign.Isolated; a script that starts processes needs `if __name__ == "__main__":`'
    )


@final
@dataclass(frozen=True)
class Isolated:
    """A function each of whose calls has a Python process of its own: for functions that may hang or crash.

    A function that hangs in a thread or in the process of an executor cannot be ended without ending the others there.
    Here it can: `BlackBox(al.foreign.Isolated(simulate, time_limit=60.0), executor=ThreadPoolExecutor(4))`. The price
    is the start of a process for each call, which takes a second or more: Python, JAX and the function's own imports.

    - `function`: stands at the top level of a module, so that the process finds it. In a script, whatever is not a
      definition belongs under `if __name__ == "__main__":`;
    - `time_limit`: seconds from the start of the process, after which it is ended, with all processes that it started.

    A call raises `SimulationError` if the process exceeds its time or ends by itself, or if the function raises, and
    `ProblemError` if the function cannot be sent to a process.
    """

    function: Callable[[Any], Pytree]
    time_limit: float | None = None

    def __post_init__(self) -> None:
        if not callable(self.function):
            raise border.refusal("Isolated", "a function", self.function)
        if self.time_limit is not None:
            object.__setattr__(self, "time_limit", border.positive("Isolated: time_limit", self.time_limit))

    @property
    def __name__(self) -> str:
        """The name of the function, for messages."""
        return getattr(self.function, "__name__", type(self.function).__name__)

    def __call__(self, realised: Pytree) -> Pytree:
        """The outputs of the function at one realisation."""
        refuse_traced(self, realised)
        before, context = endings(), multiprocessing.get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=report, args=(sender, self.function, realised))
        try:
            process.start()
        except Exception as error:
            if is_of_pickle(error):
                raise unsendable("Isolated", error) from error
            raise
        sender.close()
        try:
            with receiver, ended_with(process.pid or 0, lambda: not process.is_alive(), before):
                returned, raised = self._received(receiver, process)
        finally:
            process.kill()  # It may not have begun to lead a group.
            process.join()
        if raised is not None:
            raise SimulationError(f"it raised {raised}")
        return returned

    def _received(self, receiver: Connection, process: BaseProcess) -> tuple[Pytree, str | None]:
        if not receiver.poll(self.time_limit):
            raise SimulationError(f"it was ended after its time limit of {self.time_limit:g} s")
        try:
            return receiver.recv()
        except EOFError as error:
            process.join()
            raise SimulationError(f"its process ended by itself, by {exit_told(process.exitcode)}") from error
