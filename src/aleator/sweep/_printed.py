"""How results of sweeps are printed: a table, and what is said of it."""

from collections.abc import Iterable, Sequence

INTERRUPTED = "interrupted by the user"


def table(rows: Sequence[Sequence[str]], *said: str, interrupted: bool = False) -> str:
    """Rows of cells, the first of which is the heading, in columns; then what is said in further lines."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return listed([*lines, *said], interrupted=interrupted)


def listed(lines: Iterable[str], *, interrupted: bool = False) -> str:
    """Lines that are not empty, and that Ctrl-C has ended what they tell of."""
    return "\n".join([*filter(None, lines), *([INTERRUPTED] if interrupted else [])])
