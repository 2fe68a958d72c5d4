"""What tells one black box from another, in any process."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from aleator._core.identity import code_digest
from aleator.foreign._command import Command
from aleator.foreign._isolated import Isolated


def identity(function: Callable[..., Any], version: str) -> str:
    """A digest of a function's source and its version, or of a command with the contents of the files that it names."""
    if isinstance(function, Isolated):
        return identity(function.function, version)
    if not isinstance(function, Command):
        return code_digest(function, version)
    files = [hashlib.sha256(Path(one).read_bytes()).hexdigest() for one in function.arguments if Path(one).is_file()]
    told = [list(function.arguments), function.input_file, function.output_file, files, version]
    return hashlib.sha256(repr(told).encode()).hexdigest()


def followed(function: Callable[..., Any]) -> Any:
    """What the outputs follow from, for the journal of a run: a function, told by its source; None for a command.

    A command may read what nobody sees.
    """
    if isinstance(function, Isolated):
        return followed(function.function)
    return None if isinstance(function, Command) else function
