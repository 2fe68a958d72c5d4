"""`aleator check`: what a study will do."""

from aleator import studies
from aleator._core.interruption import Interruptions
from aleator.cli._options import AsJson, StudyName
from aleator.cli._terminal import Terminal
from aleator.studies import Check


def check(study: StudyName, as_json: AsJson = False) -> None:
    """Print what a study will do, before anything is spent: sizes, points, derivatives, times."""
    terminal = Terminal("check", as_json)
    interruptions = Interruptions(lambda: terminal.ended_at_once("Interrupted.", interruptions.exit_code))
    with interruptions, terminal.refusing():
        looked = Check(studies.load(study))
    for one in looked.mathematics():
        terminal.title(one.heading)
        terminal.tell(one.text)
    if (numbers := looked.numbers()) is not None:
        terminal.table(numbers)
    terminal.table(looked.table())
    for one in looked.troubles:
        terminal.look_at(one)
    terminal.note(study=study, problems=looked.document(), look_at=looked.troubles)
    terminal.conclude(0)
