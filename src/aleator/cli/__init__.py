"""What the command line does: `aleator run STUDY` and its fellow commands, which `aleator_command` declares, with their
exit codes and JSON documents.
"""

from typing import Any

from aleator.cli._results import check, compare, listed, report, validate
from aleator.cli._run import begin, resume
from aleator.cli._run import run_study as run_study
from aleator.cli._terminal import Terminal

_COMMANDS = {
    "check": check,
    "run": begin,
    "resume": resume,
    "sweep": begin,
    "validate": validate,
    "report": report,
    "compare": compare,
    "list": listed,
}


def execute(command: str, *, as_json: bool, **arguments: Any) -> int:
    """Do a command with its arguments by name, as `aleator_command` declares them, and return its exit code."""
    terminal = Terminal(command, as_json)
    return terminal.do(lambda: _COMMANDS[command](terminal, **arguments))
