"""Warnings at the line that the package was called from, each of many solves with the name of the one it speaks of."""

import contextlib
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

from aleator._core.errors import AleatorWarning

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
