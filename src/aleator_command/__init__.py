"""The `aleator` command: its subcommands, their arguments and their help.

Exit codes: 0 success, 1 a solve, a simulation or writing failed, 2 wrong usage, 130 interrupted, 143 terminated.
Finished results are written in every case. With `--json` one JSON document is printed on stdout, and all else on
stderr. Numbers are finite or `null`. Every document has `command`, `exit_code` and `errors` (sentences); further:

- `run`, `resume`, `sweep`: `folder`, `finished`, `files`, `title`, `verdict`, `designs`, `fronts`, `recalled` (results
  of an earlier run); of one that had to end at once, `folder` alone;
- `check`: `study`, `look_at`, and `problems` by name: `decisions`, `uncertain`, `instants`, `order`, `terms`, `points`,
  `condition_number`, `rows`, `derivatives_agree`, `seconds_to_compile`, `seconds_of_evaluation`, `samples`,
  `simulations`, `bytes_of_derivatives`, `numbers` (`unit`, and `value`, a text for a distribution or decision);
- `validate`: `folder`, `samples`, `seed`, and `designs` by name: `status`, `decisions`, `objective`, `solved_anew`
  (`false` for a design of the folder), and evidence, or `why` there is none;
- `report`: `folder`, `files`, `missing`, `verdict` (`null` while nothing is finished);
- `compare`: `folders`, `designs` and `differences` by name and run;
- `list`: `studies` (`name`, `about`); of a folder: `folder`, `stale`, `results` (`name`, `load`, `what`, `state`,
  `why`, `file`, `host`, `process`, `since`, `seconds`), whose state is running, interrupted, done, infeasible, failed,
  stale or lost.

Designs have `status`, `decisions`, `objective` (`value`, `unit`), `constraints`, `certificate` and `evidence`. Evidence
has `samples`, `seed`, `agrees`, and `violations` by limit (`estimate`, `lower`, `upper`, `confidence`, `count`), with
`any` for all together. A front has `bound`, `interrupted` and `points` (`value`, `status`, `objective`, `shadow_price`,
`violation`, `decisions`, `why`).
"""
# What commands do is in `aleator.cli`, which is imported when it is needed: that takes a second or two. Until then
# nothing here imports JAX, and signals end the process with a word.

import json
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from types import FrameType
from typing import Any, NoReturn

from aleator_command._commands import UsageError, parsed
from aleator_command._studies import STUDIES
from aleator_command._template import begin_file

_USAGE = 2


def main() -> NoReturn:
    """Entry point of the `aleator` command."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)
    code = 1
    try:
        code = execute(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read it has gone; Python would flush once more
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    finally:
        # All is said and done: while Python takes itself apart, no signal shall change the exit code.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


def execute(words: Sequence[str]) -> int:
    """Do the command that some words ask for, and return its exit code."""
    try:
        arguments = parsed(words)
        return _executed(arguments.pop("command"), arguments)
    except UsageError as error:
        print(f"{error.usage}error: {error}", file=sys.stderr)
        if "--json" in words:
            print(json.dumps({"command": words[0], "exit_code": _USAGE, "errors": [f"{error}"]}))
        return _USAGE


def _executed(command: str, arguments: Mapping[str, Any]) -> int:
    if command == "new":
        written = begin_file(arguments["file"])
        print(f"wrote {written}\nnext: aleator check {written}, then aleator run {written}")
    elif command == "list" and arguments["folder"] is None:
        if arguments["as_json"]:
            studies = [{"name": name, "about": about} for name, about in STUDIES.items()]
            print(json.dumps({"command": "list", "studies": studies, "exit_code": 0, "errors": []}, indent=2))
        else:
            print("\n".join(f"{name:<{max(map(len, STUDIES))}}  {about}" for name, about in STUDIES.items()))
    elif command == "schema":
        from aleator.studies import schema

        print(json.dumps(schema(), indent=2, ensure_ascii=False))
    else:
        from aleator import cli

        return cli.execute(command, **arguments)
    return 0


def _end(number: int, frame: FrameType | None) -> None:
    """End with a word, not with a traceback: what is finished is in its folder."""
    del frame
    if "--json" in sys.argv[1:]:
        document = {"command": sys.argv[1], "exit_code": 128 + number, "errors": ["Interrupted."]}
        os.write(1, f"{json.dumps(document)}\n".encode())
    os.write(2, b"Interrupted.\n")
    os._exit(128 + number)
