"""The command line: `aleator run STUDY` and its fellow commands, and what they share.

Exit codes: 0 success, 1 a solve, a simulation or writing failed, 2 wrong usage, 130 interrupted, 143 terminated.
Finished results are written in every case. With `--json` one JSON document is printed on stdout, and all else on
stderr; `docs/studies.md` has its keys.
"""

from aleator.cli._commands import application as application
from aleator.cli._commands import main as main
from aleator.cli._course import run_study as run_study
