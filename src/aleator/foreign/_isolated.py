"""`Isolated`: a function each of whose calls has a process of its own."""

import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass
from pickle import PicklingError
from typing import Any, final

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.executors import ended_with, endings, exit_told, report
from aleator._core.leaves import is_traced
from aleator.ensemble import name_of


def refuse_traced(function: Callable[[Pytree], Pytree], realised: Pytree) -> None:
    """Raise `ProblemError` for a function that leaves this process if JAX traces it."""
    if is_traced(realised):
        kind = type(function).__name__
        raise ProblemError(f"{name_of(function)} cannot be traced by JAX: wrap it, al.foreign.BlackBox({kind}(...)).")


def refuse_unsendable(who: str, error: BaseException | None) -> None:
    """Raise `ProblemError` if an error says that something cannot be sent to a process.

    Before Python 3.14 the types of these errors are no help.
    """
    said = str(error).splitlines()[0].rstrip(".") if str(error) else ""
    is_told = "pickle" in said.lower() or "local object" in said.lower()
    if isinstance(error, PicklingError) or (isinstance(error, AttributeError | TypeError) and is_told):
        raise ProblemError(
            f"{who}: expected a function and results that can be sent to another process, such as a function at the "
            f"top level of a module; received: {said}."
        ) from error


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
            refuse_unsendable("Isolated", error)
            raise
        sender.close()
        try:
            with receiver, ended_with(process.pid or 0, lambda: not process.is_alive(), before):
                if not receiver.poll(self.time_limit):
                    raise SimulationError(f"it was ended after its time limit of {self.time_limit:g} s")
                returned, raised = receiver.recv()
        except EOFError as error:
            process.join()
            raise SimulationError(f"its process ended by itself, by {exit_told(process.exitcode)}") from error
        finally:
            process.kill()  # It may not have begun to lead a group.
            process.join()
        if raised is not None:
            raise SimulationError(f"it raised {raised}")
        return returned
