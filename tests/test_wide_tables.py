"""Tables on a terminal: none of what they say is cut, however narrow it is."""

import io
import re

import pytest
from rich.console import Console

from aleator.cli._tables import fitted
from aleator.reporting import Table, number

NAMES = [f"design {i}" for i in range(8)]
NUMBERS = [[number(23339.0 + i + 0.001 * j, 7, "N/m") for i in range(8)] for j in range(3)]
WIDE = Table("Designs", ["", *NAMES], [[f"row {j}", *one] for j, one in enumerate(NUMBERS)], "A note on all of them.")


def printed(table: Table, width: int) -> str:
    written = io.StringIO()
    console = Console(file=written, width=width, markup=False, emoji=False, highlight=False)
    for one in fitted(table, width):
        console.print(one)
    return written.getvalue()


@pytest.mark.parametrize("width", [40, 60, 80, 100, 400])
def test_every_number_of_a_wide_table_stands_whole_in_one_line(width: int):
    text = printed(WIDE, width)
    assert "…" not in text
    for row in NUMBERS:
        for one in row:
            assert one in text
    for name in (*NAMES, "row 0", "row 1", "row 2"):
        assert name in text
    assert max(map(len, text.splitlines())) <= width
    assert text.count("Designs") == text.count("A note on all") == 1


def test_a_table_that_fits_stands_in_one_piece():
    assert printed(WIDE, 400).count("row 0") == 1


def test_long_texts_wrap_between_words_and_longer_words_are_broken_without_loss():
    reason = "no design: the width is at its bound and the stress is beyond its limit by 0.3 kN/mm"
    word = "a-name-without-any-space-" * 5
    text = printed(Table("Points", ["stress", "Result"], [["0.01", reason], ["0.02", word]]), 60)
    cells = [line.split("│")[2].strip() for line in text.splitlines() if line.startswith("│")]
    assert " ".join(cells[:2]) == reason
    assert "".join(cells[2:]) == word
    assert re.search(r"│ 0.02 ", text)
