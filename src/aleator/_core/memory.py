"""The machine's memory, and a check before allocation that refuses requests beyond it."""

import os
from functools import lru_cache
from pathlib import Path

from aleator._core.errors import ProblemError

NUMBER = 8
"""Bytes of a real number."""

# The part of the machine's memory that one array program may take: the rest of a solve, and the machine, need some.
_SHARE = 0.5

# Used if the machine's memory is unknown.
_ASSUMED = 8 * 2**30

# Larger numbers of bytes are not printed.
_BEYOND = 2**100

_GROUPS = Path("/sys/fs/cgroup")
_OWN_GROUP = Path("/proc/self/cgroup")


def refuse_beyond_memory(what: str, size: int, advice: str) -> None:
    """Raise `ProblemError` if `what`, a noun, needs more memory than is available: `size` in bytes.

    `advice`: a sentence with the remedy. Check counts before anything is enumerated.
    """
    there = memory()
    if size > _SHARE * there:
        raise ProblemError(
            f"{what} would need {_gibibytes(size)} of memory; this machine has {_gibibytes(there)}, of which half may "
            f"be used. {advice}"
        )


@lru_cache(maxsize=1)
def memory() -> int:
    """The memory of this machine in bytes, or the limit of a container."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        machine = 0
    return min([machine if machine > 0 else _ASSUMED, *_group_limits()])


def _group_limits() -> list[int]:
    """The limits of this process's control groups, of both versions; empty if there are none."""
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
