"""The exceptions and warnings of `aleator`.

Each message is one clear sentence (or two) that names the thing, what was expected, what was received and what to do.
Warnings are given at the line that the package was called from, each of many solves with its name.
"""

import contextlib
import importlib
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any


class AleatorError(Exception):
    """Base of every error that `aleator` raises on purpose."""


class ProblemError(AleatorError, ValueError):
    """The declared problem is invalid: found before anything is compiled or simulated."""


class SimulationError(AleatorError, ArithmeticError):
    """A simulation produced numbers that are not finite; the message names the realisation and the time."""


class SolveError(AleatorError, RuntimeError):
    """The nonlinear program was not solved. The unfinished solution is kept in `solution`."""

    def __init__(self, message: str, solution: object = None):
        super().__init__(message)
        self.solution = solution


class MissingExtraError(AleatorError, ImportError):
    """An optional library is not installed; the message names the command that installs it."""


def optional(library: str, who: str, install: str, instead: str = "") -> Any:
    """A library, imported late. Raises `MissingExtraError`, with what pip installs and what there is `instead`."""
    try:
        return importlib.import_module(library)
    except ImportError as error:
        name, further = library.partition(".")[0], f", or use {instead}" if instead else ""
        raise MissingExtraError(
            f"{who} needs the library {name}: install it with `pip install {install}`{further}."
        ) from error


class AleatorWarning(UserWarning):
    """Base of every warning that `aleator` issues."""


class ExpansionWarning(AleatorWarning):
    """The expansion does not resolve an output well enough for its statistics to be trusted."""


class CorrelationWarning(AleatorWarning):
    """Uncertain numbers of a design have other correlations than those given, for decisions set their shapes."""


class GridWarning(AleatorWarning):
    """The time grid is too coarse for the accuracy that is asked for."""


class SimulationWarning(AleatorWarning):
    """Outputs of a simulation are not finite, or samples of a black box were dropped; the message names the first."""


class CalibrationWarning(AleatorWarning):
    """A calibration ended without a design whose frequency of violation was confirmed to be low enough."""


class JournalWarning(AleatorWarning):
    """A result cannot be kept in a journal, or one that was kept cannot be used."""


# Files of this package, and of what runs the end of a context.
_INSIDE = (str(Path(__file__).parents[1]), contextlib.__file__)


@contextlib.contextmanager
def warned_of(where: str) -> Iterator[None]:
    """Have warnings of ours begin with `where` they arose, at the line that the package was called from.

    All others are passed on as they are, those before an error or an interruption too.
    """
    heard: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            yield
    finally:
        for one in heard:
            if issubclass(one.category, AleatorWarning):
                warnings.warn_explicit(f"{where}: {one.message}", one.category, *_caller())
            else:
                warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)


def warn_outside(message: str, category: type[AleatorWarning]) -> None:
    """Warn at the line outside of this package from which it was called, however deep within it this happens."""
    warnings.warn_explicit(message, category, *_caller())


def _caller() -> tuple[str, int]:
    """The file and line outside of this package from which it was called."""
    frame = sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_INSIDE):
        frame = frame.f_back
    return frame.f_code.co_filename, frame.f_lineno
