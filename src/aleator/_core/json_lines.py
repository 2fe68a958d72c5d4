"""Files of JSON lines that only grow: read once, whatever a killed process left at their end."""

import json
from pathlib import Path
from typing import Any, NamedTuple


class Line(NamedTuple):
    """A line that was written whole: its number from 1, its text, and what it says; None if it is no JSON."""

    number: int
    text: bytes
    value: Any


class Lines(NamedTuple):
    """The whole lines of a file, their size in bytes, and what stands after them: a last line that was cut off."""

    lines: tuple[Line, ...]
    size: int
    cut: bytes


def read_lines(path: Path) -> Lines:
    """The whole lines of a file; none if there is no file. A last line without its end was cut off by a crash.

    Raises `OSError` if it cannot be read.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return Lines((), 0, b"")
    *whole, cut = content.split(b"\n")
    lines = [Line(number, text, _value(text)) for number, text in enumerate(whole, 1) if text.strip()]
    return Lines(tuple(lines), len(content) - len(cut), cut)


def _value(text: bytes) -> Any:
    try:
        return json.loads(text)
    except ValueError:  # UnicodeDecodeError is one
        return None
