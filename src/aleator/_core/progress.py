"""Progress of long work: a function called with the task, the steps done and their total."""

import inspect
from collections.abc import Callable
from typing import Any, TypeAlias

from aleator._core.given import refusal

Progress: TypeAlias = Callable[[str, int, int], None]


def silent(task: str, done: int, total: int) -> None:
    """Report nothing."""
    del task, done, total


def check_progress(who: str, progress: Any) -> None:
    """Refuse what cannot be called with the task, the steps done and their total."""
    expected = "a function of three arguments, the task, the steps done and their total"
    if not callable(progress):
        raise refusal(f"{who}: progress", expected, progress)
    try:
        inspect.signature(progress).bind("", 0, 1)
    except TypeError:
        raise refusal(f"{who}: progress", expected, progress) from None
    except ValueError:  # what is not written in Python need not have a signature
        return
