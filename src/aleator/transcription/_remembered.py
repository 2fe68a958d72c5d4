"""`Remembered`: what a function gives at the points it was asked for last."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar, final

import numpy as np
from jaxtyping import Float

# The start of a search or its latest point, and the one before.
_KEPT = 2

_Result = TypeVar("_Result")


@final
class Remembered(Generic[_Result]):
    """A function of a point that remembers the latest: neither a start nor an answer is computed twice."""

    def __init__(self, function: Callable[[Float[np.ndarray, " n"]], _Result]):
        self._function = function
        self._memory: dict[bytes, _Result] = {}
        self._lock = threading.Lock()

    def __call__(self, point: Float[np.ndarray, " n"]) -> _Result:
        key = point.tobytes()
        with self._lock:
            if key in self._memory:
                return self._memory[key]
        found = self._function(point)
        with self._lock:
            while len(self._memory) >= _KEPT:
                del self._memory[next(iter(self._memory))]
            self._memory[key] = found
        return found
