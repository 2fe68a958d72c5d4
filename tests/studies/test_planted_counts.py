"""Linkages that are counted in batches are all drawn anew."""

import numpy as np
import pytest

from aleator.studies.four_bar import LENGTHS, WIDTHS, _counts


def test_every_batch_of_linkages_is_drawn_anew(monkeypatch: pytest.MonkeyPatch):
    drawn, draw = [], _counts.drawn_postures

    def noted(*given, **named):
        drawn.append(draw(*given, **named))
        return drawn[-1]

    monkeypatch.setattr(_counts, "AT_ONCE", 4)
    monkeypatch.setattr(_counts, "drawn_postures", noted)
    _counts.count_linkages(LENGTHS, WIDTHS, 10)
    heights = [one.tool[:, 0, 1] for one in drawn]
    assert [len(one) for one in heights] == [4, 4, 2]
    assert len(np.unique(np.concatenate(heights))) == 10
