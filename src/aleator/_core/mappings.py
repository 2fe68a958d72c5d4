"""Room in the address space: Linux lets a process have so many memory mappings, and compiled code takes hundreds.

Beyond that, memory is refused to LLVM, which ends the process without a word.
"""

from pathlib import Path

_OWN, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")


def mappings() -> int:
    """How many memory mappings this process has; 0 where the system does not say."""
    try:
        with _OWN.open("rb") as lines:
            return sum(1 for _ in lines)
    except OSError:
        return 0


def most_mappings() -> float:
    """How many it may have; infinite where the system sets no limit."""
    try:
        return int(_MOST.read_text())
    except (OSError, ValueError):
        return float("inf")
