"""Which designs of a front are efficient."""

import numpy as np

from aleator.sweep._hypervolume import efficient


def test_a_design_that_is_equal_in_one_wish_and_worse_in_another_is_dominated():
    points = np.array([[0.0, 1.0], [0.0, 2.0], [1.0, 0.0], [1.0, 0.0 + 1e-4]])
    assert efficient(points, np.full(2, 1e-2)).tolist() == [True, False, True, True]
    assert efficient(points, np.full(2, 1e-5)).tolist() == [True, False, True, False]
