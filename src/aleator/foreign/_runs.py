"""Runs of a function at many models: one after the other, or by an executor."""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from pickle import PicklingError
from typing import Any, NamedTuple, final

import jax
import numpy as np
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError, SimulationError
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
            broken = [one for one in ended if isinstance(one.error, BrokenExecutor)]
            yield [one for one in ended if not isinstance(one.error, BrokenExecutor)]
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
