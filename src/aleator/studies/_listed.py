"""The case studies by name, and how a study is loaded: by its name, its Python file, its TOML file or its module."""

from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from aleator._core.errors import ProblemError
from aleator.studies._files import load_file, load_module
from aleator.studies._own import Study
from aleator.studies._study import AbstractStudy
from aleator.studies._toml import load_toml


class Entry(NamedTuple):
    """A study as listed: what it is about, and its class as `module:name`, imported only when it is run."""

    about: str
    place: str


STUDIES = {
    "suspension": Entry(
        "Quarter car: deterministic, robust and apportioned suspension (sections 6.4 and 7.4)",
        "aleator.studies.suspension._study:SuspensionStudy",
    ),
    "clutch": Entry(
        "One-way clutch: tolerance analysis by every method, and the cheapest tolerances (section 7.2)",
        "aleator.studies.clutch._study:ClutchStudy",
    ),
    "pick-and-place-effort": Entry(
        "Two-link arm with an uncertain payload: least effort, least spread at the end (section 5.5.1)",
        "aleator.studies.pick_and_place_effort._study:PickAndPlaceEffort",
    ),
    "pick-and-place-time": Entry(
        "Two-link arm with an uncertain payload: least time, and the margin that it takes (section 5.5.2)",
        "aleator.studies.pick_and_place_time._study:PickAndPlaceTime",
    ),
    "swing-up": Entry(
        "Double pendulum of uncertain mass, driven at one joint: swing-up of least energy (section 5.5.3)",
        "aleator.studies.swing_up._study:SwingUp",
    ),
    "four-bar": Entry(
        "Straight-line linkage, a closed loop driven by its crank: robust lengths, and the cheapest tolerances",
        "aleator.studies.four_bar._study:FourBarStudy",
    ),
}


def load(name: str, *, quick: bool = False) -> AbstractStudy:
    """A study ready to run, by its name, its Python file or its module; `quick` makes it small enough for a first look.

    Raises `ProblemError` for an unknown name, and for a file that declares no study, or no quick one if that is asked.
    """
    if name.endswith(".toml"):
        own = load_toml(Path(name), load_module)
        return own.quickened() if quick else own
    if name.endswith(".py") or "." in name or ":" in name:
        own = load_file(Path(name)) if name.endswith(".py") else load_module(name)
        return _quick(own, name) if quick else own
    if name not in STUDIES:
        raise ProblemError(
            f"There is no study '{name}'; expected one of {sorted(STUDIES)} (see `aleator list`), or a file of "
            f"your own, such as {name}.py (`aleator new {name}.py` begins one)."
        )
    module, _, kind = STUDIES[name].place.partition(":")
    study: Any = getattr(import_module(module), kind)
    return study(study.quick if quick else study.full)


def _quick(study: AbstractStudy, name: str) -> AbstractStudy:
    if not isinstance(study, Study):
        raise ProblemError(f"{name}: its study is a {type(study).__name__}, which has no quick form: run it in full.")
    return study.quickened()
