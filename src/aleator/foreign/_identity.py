"""What tells one black box from another, in any process."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

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
