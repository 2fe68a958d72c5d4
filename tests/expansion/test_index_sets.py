"""Index sets against their definitions, enumerated in full, closed forms."""

import math

import numpy as np
import pytest

import aleator as al

NAMES = tuple("abcdefghijklmnopqrst")
SETS = [
    (al.index_sets.TotalDegree(), lambda rows, order: rows.sum(axis=1) <= order),
    (al.index_sets.TensorProduct(), lambda rows, order: rows.max(axis=1) <= order),
    (al.index_sets.HyperbolicCross(0.5), lambda rows, order: np.sqrt(rows).sum(axis=1) ** 2 <= order + 1e-6),
    (al.index_sets.HyperbolicCross(0.75), lambda rows, order: (rows**0.75).sum(axis=1) ** (4 / 3) <= order + 1e-6),
    (al.index_sets.Anisotropic([1.0, 2.0, 1.5]), lambda rows, order: rows @ [1.0, 2.0, 1.5] <= order + 1e-6),
    (al.index_sets.Anisotropic({"b": 0.7}), lambda rows, order: rows @ [1.0, 0.7, 1.0] <= order + 1e-6),
]


@pytest.mark.parametrize("order", [1, 7])
@pytest.mark.parametrize(("index_set", "keeps"), SETS)
def test_a_set_holds_what_its_definition_keeps_of_all_multi_indices_once_in_order(index_set, keeps, order):
    everything = np.indices((2 * order + 1,) * 3).reshape(3, -1).T
    expected = {tuple(row) for row in everything[keeps(everything, order)].tolist()}
    rows = [tuple(row) for row in index_set.indices(("a", "b", "c"), order).tolist()]
    # Sorted by degree, then by the degrees of the first variables.
    assert rows == sorted(expected, key=lambda row: (sum(row), [-degree for degree in row]))


def test_many_variables_and_high_orders_need_no_enumeration_of_the_full_tensor():
    # 4^20 and 15^8 multi-indices would not fit into any memory
    assert len(al.index_sets.TotalDegree().indices(NAMES, 3)) == math.comb(23, 3)
    cross = al.index_sets.HyperbolicCross(0.5).indices(NAMES[:8], 14)
    assert cross.max(axis=0).tolist() == [14] * 8
    assert (cross > 0).sum(axis=1).max() == 3  # four factors of degree one have the q-norm 16


def test_weights_of_the_wrong_number_and_sets_too_large_for_memory_are_refused():
    with pytest.raises(al.ProblemError, match=r"one weight for each of the 3 germ variables.*received 2"):
        al.index_sets.Anisotropic([1, 2]).indices(NAMES[:3], 2)
    with pytest.raises(al.ProblemError, match=r"more than 200000 terms in 20 variables.*HyperbolicCross"):
        al.index_sets.TensorProduct().indices(NAMES, 3)
