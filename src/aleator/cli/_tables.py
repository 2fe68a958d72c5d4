"""Tables of reports for a terminal of any width: wrapped between words, in blocks of columns, with no number cut."""

import re
import textwrap
from collections.abc import Iterator, Sequence
from itertools import cycle

from rich.cells import cell_len
from rich.table import Table as RichTable

from aleator.reporting import Table

# What rich draws around the cells of each column, and at the end of a row.
_AROUND, _END = 3, 1
# Narrower than this no column is wrapped for the sake of its neighbours.
_COMFORT = 16
# Ordinary spaces: not those between the digits of a number, or before its unit.
_WORDS = re.compile(r"[ \n]+")


def fitted(table: Table, width: int) -> Iterator[RichTable]:
    """A table of a report as tables that fit a width: the first column is repeated where the others need several.

    The caption stands above the first block, the note below the last.
    """
    columns = [list(one) for one in zip(table.header, *(map(str, row) for row in table.rows), strict=True)]
    blocks = list(_blocks(columns, width))
    for i, block in enumerate(blocks):
        title, note = table.caption if i == 0 else None, table.note if i == len(blocks) - 1 else None
        yield _drawn([columns[j] for j in block], width, title, note)


def _blocks(columns: Sequence[Sequence[str]], width: int) -> Iterator[list[int]]:
    """The columns of each block, by their numbers: as many as fit without a word cut, one beside the first at least."""
    needs = [_needed(one) + _AROUND for one in columns]
    block = [0][: len(columns)]
    for j in range(1, len(columns)):
        if len(block) > 1 and sum(needs[k] for k in (*block, j)) + _END > width:
            yield block
            block = [0]
        block.append(j)
    yield block


def _natural(column: Sequence[str]) -> int:
    return max(cell_len(line) for text in column for line in text.split("\n"))


def _needed(column: Sequence[str]) -> int:
    """The least width: that of the longest word. Numbers and units are joined by a space that is not broken."""
    longest = max((cell_len(word) for text in column for word in _WORDS.split(text)), default=0)
    return max(longest, min(_natural(column), _COMFORT))


def _drawn(columns: Sequence[list[str]], width: int, title: str | None, note: str | None) -> RichTable:
    widths = _widths(columns, width - _AROUND * len(columns) - _END)
    wrapped = [["\n".join(_lines(text, room)) for text in one] for one, room in zip(columns, widths, strict=True)]
    drawn = RichTable(title=title, caption=note, caption_justify="left")
    for header, *_ in wrapped:
        drawn.add_column(header, overflow="fold")
    for row in zip(*(one[1:] for one in wrapped), strict=True):
        drawn.add_row(*row)
    return drawn


def _widths(columns: Sequence[Sequence[str]], room: int) -> list[int]:
    """A width for each column: all that it asks for if there is room, or else what it needs, and a part of the rest."""
    natural = [_natural(one) for one in columns]
    widths = [min(_needed(one), wish) for one, wish in zip(columns, natural, strict=True)]
    if len(columns) > 1 and sum(widths) > room:  # two columns of long words: the first is that of labels
        widths[0] = max(min(widths[0], max(room - widths[1], room // 3)), 1)
        widths[1] = max(min(widths[1], room - widths[0]), 1)
    for j in cycle(range(len(columns))):
        if sum(widths) >= room or all(one >= wish for one, wish in zip(widths, natural, strict=True)):
            return widths
        widths[j] += widths[j] < natural[j]
    return widths


def _lines(text: str, room: int) -> list[str]:
    """The lines of a cell; a word is broken only where it is longer than its column."""
    return [part for line in text.split("\n") for part in (textwrap.wrap(line, room, break_on_hyphens=False) or [""])]
