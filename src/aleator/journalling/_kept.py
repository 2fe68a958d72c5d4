"""`kept`: work of one's own that takes long, done once for the same code and numbers."""

import inspect
from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeVar

from aleator._core.errors import ProblemError
from aleator._core.given import a_name, refusal
from aleator._core.heard import heeding
from aleator._core.journalled import journalled
from aleator._core.progress import Progress, check_progress

Result = TypeVar("Result")


def kept(
    name: str, function: Callable[..., Result], *arguments: Any, progress: Progress | None = None, **named: Any
) -> Result:
    """What a function returns for some arguments; in a run's folder, what an earlier run has found by the same work.

        count = ext.kept("rejects of the given tolerances", count_rejects, tolerances, samples=1_000_000)

    A journal keeps designs, evidence and fronts by itself (see `al.journal`); with this it keeps any other work too:
    a count, an enumeration, an `al.expand`. The work is the same if the name, the arguments, and the function's code
    with all that this reads are the same. What it asks of `al.solve` and the like is a part of this one result.

    - `name`: by which the journal lists the result, as `work` of this name;
    - `function`: gets all that it works with as arguments, and returns what Python can pickle;
    - `progress`: given to the function as its own `progress`, if any; the result does not follow from it.

    Work that another run could not recognise is done each time, with a `JournalWarning`: by a function that draws
    random numbers, reads a clock or a file (let it take the numbers as arguments), say. So is work whose result no
    other process could read. Ctrl-C ends the work, whatever the function makes of it.

    Raises `ProblemError` for arguments that the function does not take, and if it returns None.
    """
    a_name("kept: the name", name)
    if not isinstance(function, FunctionType):
        raise refusal("kept: the function", "a function that takes all it works with as arguments", function)
    reported = {}
    if progress is not None:
        check_progress("kept", progress)
        reported = {"progress": progress}
    try:
        bound = inspect.signature(function).bind(*arguments, **named, **reported).arguments
    except TypeError as error:
        raise ProblemError(f"kept: expected the arguments of {function.__name__}; received others: {error}.") from None
    given = {f"argument {one}": value for one, value in bound.items() if one not in reported}

    def found() -> Result:
        with heeding() as heed:  # what it asks for may have ended early without saying so
            result = function(*arguments, **named, **reported)
            heed()
        if result is None:
            raise ProblemError(f"kept: '{name}': expected a function that returns what is kept; it returned None.")
        return result

    return journalled(f"work {name}", {"function": _identified(function), **given}, found)


def _identified(function: FunctionType) -> Any:
    """A function that is read with its code; of this package by name, since all its code is among the versions."""
    its_own = function.__module__.startswith("aleator.") and "<" not in function.__qualname__
    return f"{function.__module__}.{function.__qualname__}" if its_own else function
