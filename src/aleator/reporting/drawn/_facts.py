"""`Facts`: what a notebook shows of a result, as data; and the markup that shows it."""

import functools
import html
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from aleator.reporting._blocks import Table

# Rows of a table that are shown at most; all are in the printed text.
_MOST = 12
# No colours but translucent greys: text takes the colours of the notebook, light or dark.
_LINE = "1px solid rgba(128,128,128,0.45)"
_TABLE = "border-collapse:collapse;margin:0 0 0.8em 0"
_CAPTION = "text-align:left;white-space:nowrap"
_CELL = f"padding:0.2em 0.8em 0.2em 0;text-align:left;vertical-align:top;border-bottom:{_LINE}"


@dataclass(frozen=True)
class Facts:
    """A heading, a sentence that matters most, and small tables. All of it is plain text, escaped when it is shown."""

    heading: str
    sentence: str = ""
    tables: Sequence[Table] = ()


@functools.singledispatch
def facts_of(result: Any) -> Facts:
    """The facts of a result, by its type: by default its type alone, above what is printed of it."""
    return Facts(type(result).__name__)


def page_of(result: Any) -> str:
    """A result as markup for a notebook: its facts, then what `print` shows of it."""
    try:
        facts = facts_of(result)
    except Exception:
        # A notebook would show the trace of this in the place of the result, which can be printed all the same.
        facts = Facts(type(result).__name__)
    tables = "".join(map(_table, facts.tables))
    sentence = f"<p>{_escaped(facts.sentence)}</p>" if facts.sentence else ""
    printed = f'<pre style="overflow-x:auto;line-height:1.35">{_escaped(str(result))}</pre>'
    if facts.tables:
        printed = f"<details><summary>as printed</summary>{printed}</details>"
    inside = f"<p><b>{_escaped(facts.heading)}</b></p>{sentence}{tables}{printed}"
    # Notebooks set what is between dollar signs as mathematics, unless told not to.
    return f'<div class="aleator tex2jax_ignore mathjax_ignore">{inside}</div>'


def _table(table: Table) -> str:
    rows = [list(row) for row in table.rows[:_MOST]]
    caption = f'<caption style="{_CAPTION}">{_escaped(table.caption)}</caption>' if table.caption else ""
    head = _row(table.header, "th") if any(table.header) else ""
    left = len(table.rows) - _MOST
    note = f"and {left} more. {table.note}" if left > 0 else table.note
    below = f"<p>{_escaped(note)}</p>" if note else ""
    body = "".join(_row(row, "td") for row in rows)
    return f'<table style="{_TABLE}">{caption}{head}{body}</table>{below}'


def _row(cells: Sequence[str], kind: str) -> str:
    inside = "".join(f'<{kind} style="{_CELL}">{_escaped(cell)}</{kind}>' for cell in cells)
    return f"<tr>{inside}</tr>"


def _escaped(text: str) -> str:
    return html.escape(text)
