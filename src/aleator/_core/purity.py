"""Refuse code that computes something different at each call: random numbers, clocks, counters."""

from collections.abc import Callable
from typing import Any, TypeVar

from aleator._core.arrays import Pytree
from aleator._core.code import read_code
from aleator._core.errors import ProblemError
from aleator._core.readings import Place, changed_places

_Traced = TypeVar("_Traced")


def steadily(
    name: str, code: Pytree, trace: Callable[[], _Traced], told: Callable[[_Traced], Any]
) -> tuple[_Traced, frozenset[Place]]:
    """The result of `trace`, and the places in the code that tracing changed; `told` gives a key of what is computed.

    Code that might compute something different at each call is traced twice. Raises `ProblemError` if it does, in the
    name of its owner.
    """
    before = read_code(code)
    found = trace()
    after = read_code(code)
    moved = changed_places(before, after)
    if (moved or after.doubts) and told(trace()) != told(found):
        suspects = ", ".join(dict.fromkeys(str(one) for one in [*moved, *after.doubts]))
        raise ProblemError(
            f"{name} computes something else each time it is called, so that no result holds. Check "
            f"{suspects}. Expected code that depends on its arguments and fields alone: put a distribution, such as "
            "al.Normal(0.0, 1.0), in the place of a random number."
        )
    return found, frozenset(moved)
