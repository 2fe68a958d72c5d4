"""`kept`: work of one's own that takes long, done once for the same code and numbers."""

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from aleator._core.border import Progress
from aleator._core.errors import ProblemError
from aleator._core.journalled import journalled
from aleator._core.parallel import heeding

Result = TypeVar("Result")


def kept(
    name: str,
    function: Callable[..., Result],
    *arguments: Any,
    version: str | int = "",
    progress: Progress | None = None,
    **named: Any,
) -> Result:
    """What a function returns for some arguments; in a run's folder, what an earlier run has found by the same work.

        count = ext.kept("rejects of the given tolerances", count_rejects, tolerances, samples=1_000_000)

    A journal keeps designs, evidence and fronts by itself (see `al.journal`); with this it keeps any other work too:
    a count, an enumeration, an `al.expand`. The work is the same if the name, the arguments and the version are the
    same, and the function's code with the globals and closures that it names. What it asks of `al.solve` and the like
    is a part of this one result.

    - `name`: by which the journal lists the result, as `work` of this name;
    - `function`: gets all that it works with as arguments, and returns what Python can pickle;
    - `version`: say another one where the work is another although its own code is the same, because a file that it
      reads or a function that it calls by another name has changed;
    - `progress`: given to the function as its own `progress`, if any; the result does not follow from it.

    Work that another run could not recognise is done each time, with a `JournalWarning`: by a function that names what
    cannot be written out, such as a lock. So is work whose result no other process could read. Ctrl-C ends the work,
    whatever the function makes of it.

    Raises `TypeError` for arguments that the function does not take, and `ProblemError` if it returns None.
    """
    reported = {} if progress is None else {"progress": progress}
    bound = inspect.signature(function).bind(*arguments, **named, **reported).arguments
    given = {f"argument {one}": value for one, value in bound.items() if one not in reported}

    def computed() -> Result:
        with heeding() as heed:  # what it asks for may have ended early without saying so
            result = function(*arguments, **named, **reported)
            heed()
        if result is None:
            raise ProblemError(f"kept: '{name}': expected a function that returns what is kept; it returned None.")
        return result

    called = getattr(function, "__qualname__", type(function).__qualname__)
    identity = {"function": function, "called": called, "version": str(version)}
    return journalled(f"work {name}", identity | given, computed)
