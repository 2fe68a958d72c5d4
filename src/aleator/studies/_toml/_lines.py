"""Lines of a TOML file by the place of what stands there, which parsers do not tell."""

import re
from collections.abc import Sequence

_HEADER = re.compile(r"\s*\[\[?(?P<path>[^\]]+)\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"\s*(?P<path>(?:\"[^\"]*\"|'[^']*'|[\w.\-])+)\s*=")
_PART = re.compile(r"\"([^\"]*)\"|'([^']*)'|([\w\-]+)")


def line_of(text: str, place: Sequence[str | int]) -> int:
    """The line on which a place begins, or the nearest table around it; 1 if it is nowhere."""
    wanted = [str(one) for one in place]
    best, longest, table = 1, 0, list[str]()
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            table = path = _parts(header["path"])
        elif key := _KEY.match(line):
            path = [*table, *_parts(key["path"])]
        else:
            continue
        shared = next(
            (i for i, (a, b) in enumerate(zip(path, wanted, strict=False)) if a != b), min(len(path), len(wanted))
        )
        if shared == len(path) and shared > longest:
            best, longest = number, shared
    return best


def _parts(path: str) -> list[str]:
    return [next(part for part in found if part) for found in _PART.findall(path)]
