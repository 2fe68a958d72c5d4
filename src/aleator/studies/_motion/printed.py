"""Comparison of computed with published values in sign, order and size, from the numbers alone."""

from collections.abc import Mapping, Sequence

import numpy as np

from aleator.reporting import words
from aleator.studies._shared import signed

SAME_SIZE = 0.1
"""Changes agree in size if they differ by at most this fraction of the published one."""


def compared(printed: Mapping[str, float], ours: Mapping[str, float], what: str) -> str:
    """Whether `what` agrees between plans of the same names, in a sentence; others are relative to the first plan.

    Signs agree if every plan changes the first one's value in the same direction, orders if they are the same from
    smallest to largest, sizes if the relative changes differ by at most a tenth of the published ones.
    """
    names = [name for name in printed if name in ours and np.isfinite(ours[name])]
    if len(names) < 2:
        return ""
    theirs, found = (_changes([values[name] for name in names]) for values in (printed, ours))
    said = {
        "signs": bool(np.all(np.sign(theirs) == np.sign(found))),
        "order": _order(printed, names) == _order(ours, names),
        "sizes": bool(np.all(np.abs(found - theirs) <= SAME_SIZE * np.abs(theirs))),
    }
    yes, no = ([one for one in said if said[one] is told] for told in (True, False))
    parts = [f"{words(yes)} agree"] * bool(yes) + [f"{words(no)} do not{'' if yes else ' agree'}"] * bool(no)
    changes = [
        f"{name} {signed(one)} (published {signed(other)})"
        for name, one, other in zip(names[1:], found, theirs, strict=True)
    ]
    return f"Of {what}, {', '.join(parts)}: relative to {names[0]}, {words(changes)}."


def _changes(values: Sequence[float]) -> np.ndarray:
    return np.array(values[1:]) / values[0] - 1


def _order(values: Mapping[str, float], names: Sequence[str]) -> list[str]:
    return sorted(names, key=lambda name: values[name])
