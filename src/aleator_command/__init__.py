"""The `aleator` command: its subcommands, their arguments and their help.

What they do is in `aleator.cli`, which is imported when it is needed: that takes a second or two. Until then nothing
here imports JAX, and signals end the process with a word.
"""

import json
import os
import signal
import sys
from types import FrameType

from aleator_command._commands import application as application


def main() -> None:
    """Entry point of the `aleator` command."""
    mind_signals()
    try:
        application()
    finally:
        # All is said and done: while Python takes itself apart, no signal shall change the exit code.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def mind_signals() -> None:
    """Have SIGINT and SIGTERM end the process with a word, not with a traceback."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def _end(number: int, frame: FrameType | None) -> None:
    """Before a run has begun there is nothing to keep."""
    del frame
    if "--json" in sys.argv[1:]:
        document = {"command": sys.argv[1], "exit_code": 128 + number, "errors": ["Interrupted."]}
        os.write(1, f"{json.dumps(document)}\n".encode())
    os.write(2, b"Interrupted.\n")
    os._exit(128 + number)
