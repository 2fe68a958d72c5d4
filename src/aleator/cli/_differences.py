"""In what the designs of a folder differ by what they follow from."""

from collections.abc import Iterable

from aleator.journalling import Entry
from aleator.reporting import words

# Parts of a key, in words.
_PARTS = {
    "equations": "equations",
    "code": "the model's code",
    "versions": "versions of aleator or of libraries",
    "problem": "numbers of the problem",
    "solver": "the solver",
    "transcription": "the transcription",
    "warm_start": "the start",
    "start": "the start",
    "how": "settings of the solve",
}


def changed(first: Entry, other: Entry) -> list[str]:
    """In which parts of what they follow from two results differ, in words."""
    parts = [part for part in {**first.parts, **other.parts} if first.parts.get(part) != other.parts.get(part)]
    return list(dict.fromkeys(_PARTS.get(part, part) for part in parts))


def in_brackets(parts: list[str]) -> str:
    """Parts at the end of a sentence; nothing if none is known."""
    return f" ({words(parts)})" if parts else ""


def design_of(name: str, entries: Iterable[Entry]) -> Entry | None:
    """The entry of a folder's design: that of its run (`designs/robust`), or else one that was solved to be sampled."""
    found = [one for one in entries if _is_solved(one) and one.name.rpartition("/")[2] == name]
    return max(found, key=lambda one: "/" in one.name, default=None)


def pair_of(name: str, entries: Iterable[Entry]) -> tuple[Entry, Entry] | None:
    """The entry of a run's design, and a later one that was solved to be sampled; None if there is no such."""
    short = name.rpartition("/")[2]
    found = [one for one in entries if _is_solved(one) and one.name in (name, short)]
    return (found[0], found[1]) if [one.name for one in found] == [name, short] and name != short else None


def _is_solved(one: Entry) -> bool:
    return one.is_finished and one.what.startswith("solve ")
