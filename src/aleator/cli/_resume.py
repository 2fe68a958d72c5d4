"""`aleator resume`: go on with a run, from its folder alone."""

from dataclasses import replace

from aleator.cli._course import executed
from aleator.cli._options import AsJson, Folder, Workers
from aleator.cli._record import recorded
from aleator.cli._terminal import Terminal


def resume(folder: Folder, workers: Workers = None, as_json: AsJson = False) -> None:
    """Go on with the run of a folder, whatever ended it: the folder says which study it was, and with which options.

    What is finished is taken from the folder, down to the last bit. As many processes share the work as before, or
    --workers.
    """
    terminal = Terminal("resume", as_json)
    with terminal.refusing():
        record = recorded(folder)
        record = replace(record, workers=workers or record.workers)
    terminal.conclude(executed(terminal, record.made, folder, record=record))
