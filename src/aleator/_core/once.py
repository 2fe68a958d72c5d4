"""What follows from an object alone, found once for as long as the object lives."""

import functools
import threading
import weakref
from collections.abc import Callable
from typing import Any, TypeVar

_Object = TypeVar("_Object")
_Result = TypeVar("_Result")


def once_for_each(function: Callable[[_Object], _Result]) -> Callable[[_Object], _Result]:
    """A function of one object that never changes, told by its identity: called again only for another object.

    Its results outlive traces: they must hold no array that is being traced.
    """
    known: dict[int, tuple[Any, _Result]] = {}
    # An object may be collected, and so forgotten, while its own thread looks another one up.
    lock = threading.RLock()

    def forget(key: int, reference: Any) -> None:
        with lock:
            if key in known and known[key][0] is reference:
                del known[key]

    @functools.wraps(function)
    def found(it: _Object) -> _Result:
        with lock:
            reference, result = known.get(id(it), (None, None))
        if reference is not None and reference() is it:
            return result  # type: ignore[return-value]
        result = function(it)
        with lock:
            known[id(it)] = weakref.ref(it, functools.partial(forget, id(it))), result
        return result

    return found
