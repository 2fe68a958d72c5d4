"""Where the library of an FMU is loaded, and how it is asked there."""

import itertools
import weakref
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator.foreign._fmu._library import LOCK
from aleator.foreign._fmu._opened import Opened
from aleator.foreign._fmu._served import Objects, Request

_NUMBERS = itertools.count()


class AbstractDoor:
    """The way to the objects of an FMU (`_served.py`). One request at a time is answered."""

    def __init__(self) -> None:
        # Whatever runs when an object is collected must not send anything: it may be in the middle of a request.
        self._forgotten: deque[int] = deque()

    @abstractmethod
    def ask(self, request: Request, where: Callable[[], str]) -> Any:
        """The answer to a request; `where` says at which numbers it is asked, as ', with x=1'."""

    def forget(self, number: int) -> None:
        """Give up the object of a number, some time."""
        self._forgotten.append(number)

    def _taken(self) -> list[int]:
        """The numbers of objects that have not been given up yet."""
        return [self._forgotten.popleft() for _ in range(len(self._forgotten))]


@final
class Here(AbstractDoor):
    """An FMU in this process."""

    def __init__(self, name: str, folder: Path, kind: str, settings: Mapping[str, Any]):
        super().__init__()
        with LOCK:
            self._objects = Objects(Opened(name, folder, kind, settings))

    @override
    def ask(self, request: Request, where: Callable[[], str]) -> Any:
        with LOCK:
            self._objects.forget(self._taken())
            return self._objects.answer(request)


@final
class Served:
    """An object behind a door, made there by `maker` from `parts`; given up there when it is collected here."""

    def __init__(self, door: AbstractDoor, maker: str, *parts: Any):
        self._door, self._maker, self._parts = door, maker, parts
        self._number = next(_NUMBERS)
        weakref.finalize(self, door.forget, self._number).atexit = False

    def ask(self, method: str, *arguments: Any, where: Callable[[], str]) -> Any:
        """What a method of it returns."""
        return self._door.ask(Request(self._number, self._maker, self._parts, method, arguments), where)
