"""A sampled statistic that is not a number meets no limit."""

import dataclasses

import numpy as np
import pytest

from aleator.validation._compared import Compared


@pytest.mark.parametrize(
    ("value", "beyond", "error", "meets"),
    [(0.5, -0.5, 0.01, True), (1.5, 0.5, 0.01, False), (1.01, 0.01, 0.01, None), (np.nan, np.nan, 0.01, False)],
)
def test_a_comparison_meets_its_limit_breaks_it_or_cannot_tell(value, beyond, error, meets):
    one = Compared("stress", "mean ≤ 1", value, error, None, 1.0, beyond, tolerance=1e-6, reach=4.0)
    assert one.meets is meets
    never = dataclasses.replace(one, beyond=np.nan, standard_error=np.nan)
    assert never.meets is False
