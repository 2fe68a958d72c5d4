"""Checks of a study's declaration, made where members are used; refusals name the study's class and the member.

`what` begins the sentence: "Filling.stages".
"""

import inspect
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from aleator._core.errors import AleatorError, ProblemError
from aleator._core.given import members, one_of, positive, refusal
from aleator._core.progress import Progress, silent
from aleator.reporting import Section, Table, Verdict

Member = TypeVar("Member")


class Stage(NamedTuple):
    """A part of a study: its work, and its approximate duration relative to the other stages."""

    work: Callable[[Progress], None]
    share: float


class PartlySavedError(ProblemError):
    """Some results could not be saved; all others are in `paths`."""

    def __init__(self, message: str, paths: list[Path]):
        super().__init__(message)
        self.paths = paths


class Failure(NamedTuple):
    """The part of a study that failed, and why."""

    where: str
    why: str

    @classmethod
    def of(cls, where: str, error: Exception) -> "Failure":
        """A failure from its exception; the messages of our own exceptions suffice."""
        kind = "" if isinstance(error, AleatorError) else f"{type(error).__name__}: "
        return cls(where, f"{kind}{error}")

    def sentence(self) -> str:
        """The failure as a sentence for the page."""
        return f"In {self.where}: {self.why}"


def stages(what: str, value: Any) -> Mapping[str, Stage]:
    """Stages by name, in order."""
    expected = "a mapping of names to Stages, as a property"
    if not isinstance(value, Mapping) or not value:
        raise refusal(what, expected, value)
    for name, stage in value.items():
        one_of(f"{what}: the name of a stage", name, str)
        place = f"{what}: '{name}'"
        one_of(place, stage, Stage, "Stage(self.find, 1.0)")
        positive(f"{place}: share", stage.share)
        _takes_progress(f"{place}: work", stage.work)
    return value


def _takes_progress(what: str, work: Any) -> None:
    """Refuse work that cannot be called with its progress."""
    expected = "a function of one argument, the progress"
    if not callable(work):
        raise refusal(what, expected, work)
    try:
        inspect.signature(work).bind(silent)
    except TypeError as error:
        raise refusal(what, f"{expected} ({error})", work) from None
    except ValueError:  # what is not written in Python need not have a signature
        return


def asked(study: object, member: str) -> tuple[str, Any]:
    """The result of a study's method, and its place in words.

    Exceptions in a study's own code pass through; our refusals are extended by the place.
    """
    what, method = f"{type(study).__name__}.{member}", getattr(study, member)
    if not callable(method):
        raise refusal(what, "a method", method)
    try:
        return what, method()
    except ProblemError as error:
        raise ProblemError(f"{what}: {error}") from error


def verdict_of(study: object) -> Verdict:
    """A study's verdict."""
    what, value = asked(study, "verdict")
    return one_of(what, value, Verdict)


def sections_of(study: object) -> Sequence[Section]:
    """A study's sections."""
    what, value = asked(study, "sections")
    return members(what, value, Section)


def tables_of(study: object) -> Sequence[Table]:
    """A study's tables."""
    what, value = asked(study, "tables")
    return members(what, value, Table)


def cut_short(study: object) -> list[str]:
    """A study's sentences on interrupted parts."""
    what, value = asked(study, "cut_short")
    try:
        return list(members(what, list(value), str))
    except TypeError:
        raise refusal(what, "texts", value) from None
