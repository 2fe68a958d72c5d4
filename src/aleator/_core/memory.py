"""How much memory there is, and a refusal of what would need more: before it is asked for, in one sentence."""

import os
from functools import lru_cache
from pathlib import Path

from aleator._core.errors import ProblemError

NUMBER = 8
"""Bytes of a real number."""

# What one array program may take of the machine's memory: the rest of a solve, and the machine, need theirs.
_SHARE = 0.5

# Where the machine does not say how much it has.
_ASSUMED = 8 * 2**30

# Beyond this many bytes, it does not matter how many there are.
_BEYOND = 2**100

_GROUPS = Path("/sys/fs/cgroup")
_OWN_GROUP = Path("/proc/self/cgroup")


def refuse_beyond_memory(what: str, size: int, advice: str) -> None:
    """Raise `ProblemError` if `what`, a noun, needs more memory than there is for it: `size` in bytes, of any number.

    `advice` is a sentence that says what to do. Counts are to be checked before anything is enumerated.
    """
    there = memory()
    if size > _SHARE * there:
        raise ProblemError(
            f"{what} would need {_gibibytes(size)} of memory; this machine has {_gibibytes(there)}, of which half may "
            f"be used. {advice}"
        )


@lru_cache(maxsize=1)
def memory() -> int:
    """The memory of this machine in bytes, or what a container leaves of it."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        machine = 0
    return min([machine if machine > 0 else _ASSUMED, *_group_limits()])


def _group_limits() -> list[int]:
    """The limits of the control groups that this process is in, of both versions; none where there are no groups."""
    limits = []
    for line in _read(_OWN_GROUP).splitlines():
        _, _, own = line.partition("::")
        places = [_GROUPS / own.strip("/"), *(_GROUPS / own.strip("/")).parents] if own else []
        limits += [place / "memory.max" for place in places if place.is_relative_to(_GROUPS)]
    texts = [_read(one).strip() for one in [*limits, _GROUPS / "memory" / "memory.limit_in_bytes"]]
    return [int(text) for text in texts if text.isdecimal() and int(text) > 0]


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ""


def _gibibytes(size: int) -> str:
    return f"{size / 2**30:.3g} GiB" if size < _BEYOND else f"more than {_BEYOND / 2**30:.0e} GiB"
