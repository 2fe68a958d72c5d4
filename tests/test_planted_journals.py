"""Journals recall what is the same, and finished."""

from pathlib import Path
from types import SimpleNamespace

import aleator as al
from aleator._core.journalled import journalled
from zoo import bar_problem


def test_another_order_of_the_expansion_is_another_result(tmp_path: Path):
    with al.journal(tmp_path):
        first, other, again = (
            al.solve(bar_problem(expansion=al.Expansion(order=order))).certificate.expansion.order
            for order in (2, 3, 2)
        )
    assert (first, other, again) == (2, 3, 2)
    assert len(al.load(tmp_path)) == 2


def test_what_was_interrupted_is_computed_again_and_what_is_finished_is_not(tmp_path: Path):
    ended = [True, False, False]

    def found() -> SimpleNamespace:
        with al.journal(tmp_path):
            return journalled("work", {"number": 1}, lambda: SimpleNamespace(interrupted=ended.pop(0)))

    assert [found().interrupted for _ in range(3)] == [True, False, False]
    assert ended == [False]  # the third was recalled
    assert len(al.load(tmp_path)) == 1
