"""What tells one black box from another, in any process."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

from aleator._core.lasting import code_digest
from aleator.foreign._command import Command
from aleator.foreign._isolated import Isolated


def identity(function: Callable[..., Any]) -> str:
    """A digest of a function's code, or of a command and the contents of the files that it names."""
    if isinstance(function, Isolated):
        return identity(function.function)
    if not isinstance(function, Command):
        return code_digest(function)
    files = [hashlib.sha256(Path(one).read_bytes()).hexdigest() for one in function.arguments if Path(one).is_file()]
    told = [list(function.arguments), function.input_file, function.output_file, files]
    return hashlib.sha256(json.dumps(told).encode()).hexdigest()


def followed(function: Callable[..., Any]) -> Any:
    """What the outputs follow from, for the journal of a run: a function, which it reads; None for a command.

    A command may read what nobody sees.
    """
    if isinstance(function, Isolated):
        return followed(function.function)
    return None if isinstance(function, Command) else function


@final
class Watched:
    """The identity of a function from call to call of its box.

    What changes while it runs, such as a count of its calls, is its own doing: it returns the same for the same numbers
    all the same. What changes between two calls, such as a number that it reads, makes it another function.
    """

    def __init__(self, function: Callable[..., Any]):
        self._function = function
        self._now = self._left = identity(function)

    def begun(self) -> str:
        """The identity, as a call begins."""
        found = identity(self._function)
        if found != self._left:
            self._now = self._left = found
        return self._now

    def ended(self) -> None:
        """See how a call leaves the function."""
        self._left = identity(self._function)
