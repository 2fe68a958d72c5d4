"""`Isolated`: a function each of whose calls has a process of its own, which can be ended."""

import multiprocessing
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, final

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.errors import SimulationError
from aleator._core.executors import ended_with, endings, exit_told, report
from aleator.foreign._runs import is_of_pickle, refuse_traced, unsendable


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
