"""Memory mappings: Linux limits their number for each process, and compiled code takes hundreds.

Beyond the limit LLVM gets no memory and ends the process without a message.
"""

from pathlib import Path

_OWN, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")


def mappings() -> int:
    """How many memory mappings this process has; 0 if unknown."""
    try:
        with _OWN.open("rb") as lines:
            return sum(1 for _ in lines)
    except OSError:
        return 0


def most_mappings() -> float:
    """How many it may have; infinite if the system sets no limit."""
    try:
        return int(_MOST.read_text())
    except (OSError, ValueError):
        return float("inf")
