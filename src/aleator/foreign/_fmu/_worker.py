"""What a process of its own does with an FMU: it opens it, and answers requests until it is left alone."""

import os
import sys
import threading
import warnings
from collections.abc import Callable
from multiprocessing.connection import Client
from typing import Any

from aleator._core.errors import AleatorError
from aleator.foreign._fmu._opened import Opened
from aleator.foreign._fmu._served import Objects


def serve(address: str | tuple[str, int], key: bytes) -> None:
    """Connect to the process that started this one, and serve it.

    Its first message is what `Opened` takes, others are the numbers of objects to forget and a request. Answers are
    what is returned, what is raised (the name of its type and its text), and the texts of warnings; None is a sign of
    life.
    """
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with Client(address, authkey=key) as connection:
        objects: list[Objects] = []

        def opened(opening: tuple[Any, ...]) -> None:
            fmu = Opened(*opening)
            fmu.library.on_start = lambda: connection.send(None)
            objects.append(Objects(fmu))

        def answered(message: tuple[Any, ...]) -> Any:
            forgotten, request = message
            objects[0].forget(forgotten)
            return objects[0].answer(request)

        try:
            connection.send(_tried(opened, connection.recv()))
            while True:
                connection.send(_tried(answered, connection.recv()))
        except (EOFError, OSError):  # nobody asks any more
            pass
    # Without the clean-up of a library that may have been left in any state.
    os._exit(0)


def _tried(function: Callable[[tuple[Any, ...]], Any], message: tuple[Any, ...]) -> tuple[Any, Any, list[str]]:
    """What a function returns, what it raises, and of what it warns."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        returned, raised = None, None
        try:
            returned = function(message)
        except (EOFError, BrokenPipeError):
            raise
        except AleatorError as error:
            raised = (type(error).__name__, str(error))
        except Exception as error:
            raised = (type(error).__name__, " ".join(str(error).split()))
    return returned, raised, [str(one.message) for one in heard]


def _end_with_parent() -> None:
    """End when the process that started this one does, in the middle of a call of the library too."""
    sys.stdin.buffer.read()
    os._exit(1)
