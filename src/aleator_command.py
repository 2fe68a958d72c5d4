"""The `aleator` command, which minds signals before it imports the package: that takes a second or two."""

import json
import os
import signal
import sys
from types import FrameType


def main() -> None:
    """Entry point of the `aleator` command."""
    mind_signals()
    from aleator.cli import main as run

    try:
        run()
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
        told = {"command": sys.argv[1], "exit_code": 128 + number, "errors": ["Interrupted."]}
        os.write(1, f"{json.dumps(told)}\n".encode())
    os.write(2, b"Interrupted.\n")
    os._exit(128 + number)


if __name__ == "__main__":
    main()
