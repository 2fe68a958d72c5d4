"""What the command line does: `aleator run STUDY` and its fellow commands, which `aleator_command` declares, with their
exit codes and JSON documents.
"""

from aleator.cli._commands import check as check
from aleator.cli._commands import list_results as list_results
from aleator.cli._commands import resume as resume
from aleator.cli._commands import run as run
from aleator.cli._commands import sweep as sweep
from aleator.cli._commands import validate as validate
from aleator.cli._course import run_study as run_study
from aleator.cli._results import compare as compare
from aleator.cli._results import report as report
from aleator_command import application as application
