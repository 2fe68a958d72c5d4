"""The case studies: each a short module that reads like its chapter. The command line finds them here, by name."""

from collections.abc import Callable
from importlib import import_module
from typing import NamedTuple

from aleator._core.errors import ProblemError
from aleator.studies._study import AbstractStudy as AbstractStudy


class Entry(NamedTuple):
    """A study as listed: what it is about, and where it is made. The module is imported only when it is run."""

    about: str
    module: str


STUDIES = {
    "suspension": Entry(
        "Quarter car: deterministic, robust and apportioned suspension (sections 6.4 and 7.4)",
        "aleator.studies.suspension._study",
    ),
    "clutch": Entry(
        "One-way clutch: tolerance analysis by every method, and the cheapest tolerances (section 7.2)",
        "aleator.studies.clutch._study",
    ),
    "pick-and-place-effort": Entry(
        "Two-link arm with an uncertain payload: least effort, least spread at the end (section 5.5.1)",
        "aleator.studies.pick_and_place_effort._study",
    ),
    "pick-and-place-time": Entry(
        "Two-link arm with an uncertain payload: least time, and the margin that it takes (section 5.5.2)",
        "aleator.studies.pick_and_place_time._study",
    ),
    "swing-up": Entry(
        "Double pendulum of uncertain mass, driven at one joint: swing-up of least energy (section 5.5.3)",
        "aleator.studies.swing_up._study",
    ),
}


def load(name: str, *, quick: bool = False) -> AbstractStudy:
    """A study ready to run; `quick` makes it small enough to try in a minute.

    Raises `ProblemError` for an unknown name.
    """
    if name not in STUDIES:
        raise ProblemError(f"There is no study '{name}'; expected one of {sorted(STUDIES)}. See `aleator list`.")
    make: Callable[[bool], AbstractStudy] = import_module(STUDIES[name].module).make
    return make(quick)
