"""Point sets in the unit cube against scipy's, closed forms and what they promise."""

import numpy as np
import pytest
from scipy.stats import qmc

from aleator._core.errors import ProblemError
from aleator.expansion import (
    Basis,
    ChristoffelPoints,
    Expansion,
    HaltonPoints,
    HammersleyPoints,
    LatinHypercubePoints,
    OptimalPoints,
    RandomPoints,
    SobolPoints,
    TotalDegree,
    collocate,
)
from aleator.uncertainty import HermiteGerm, LegendreGerm

EVEN = [HammersleyPoints(), HaltonPoints(), SobolPoints(), LatinHypercubePoints(), RandomPoints()]
NESTED = [points for points in EVEN if points.nested]
SEEDED = [SobolPoints, LatinHypercubePoints, RandomPoints, ChristoffelPoints, OptimalPoints]


def test_the_hammersley_set_has_halton_columns_beside_an_even_one():
    halton = qmc.Halton(d=5, scramble=False).random(51)[1:]
    points = HammersleyPoints().levels(50, 6)
    assert points[:, 0] == pytest.approx((np.arange(50) + 0.5) / 50, rel=1e-15)
    assert points[:, 1:] == pytest.approx(halton, rel=1e-13)


def test_radical_inverses_mirror_the_digits():
    # 1 .. 6 in base 2: 1, 10, 11, 100, 101, 110; in base 3: 1, 2, 10, 11, 12, 20
    points = HaltonPoints().levels(6, 2)
    assert points[:, 0].tolist() == [1 / 2, 1 / 4, 3 / 4, 1 / 8, 5 / 8, 3 / 8]
    assert points[:, 1] == pytest.approx([1 / 3, 2 / 3, 1 / 9, 4 / 9, 7 / 9, 2 / 9], rel=1e-15)


def test_the_halton_sequence_is_scipys_without_the_origin():
    assert HaltonPoints().levels(99, 12) == pytest.approx(qmc.Halton(12, scramble=False).random(100)[1:], rel=1e-12)


@pytest.mark.parametrize("axes", [(0,), (1,), (0, 1)])
def test_scrambled_sobol_points_fill_every_elementary_interval(axes):
    # 2^6 points of a (0, 6, 2)-net in base 2: one in each of 64 boxes, however 64 is split
    points = SobolPoints(seed=3).levels(64, 2)
    splits = {(0,): [(64, 1)], (1,): [(1, 64)], (0, 1): [(2, 32), (8, 8), (16, 4)]}[axes]
    for split in splits:
        boxes = np.floor(points * np.array(split)).astype(int)
        assert len(np.unique(boxes, axis=0)) == 64


def test_a_latin_hypercube_has_one_point_in_each_slice_of_each_variable():
    slices = np.floor(LatinHypercubePoints(seed=4).levels(37, 5) * 37).astype(int)
    assert all(sorted(column) == list(range(37)) for column in slices.T.tolist())


@pytest.mark.parametrize("variables", [1, 2, 5, 12])
@pytest.mark.parametrize("count", [1, 2, 64, 243])
@pytest.mark.parametrize("points", EVEN)
def test_all_points_lie_strictly_inside_the_unit_cube(points, count, variables):
    levels = points.levels(count, variables)
    assert levels.shape == (count, variables)
    assert np.all((levels > 0) & (levels < 1))


@pytest.mark.parametrize("points", EVEN)
def test_no_point_comes_twice(points):
    for column in points.levels(500, 4).T:
        assert len(np.unique(column)) == 500


@pytest.mark.parametrize("points", NESTED)
def test_nested_sets_hold_all_their_smaller_ones(points):
    basis = Basis({"u": LegendreGerm(), "n": HermiteGerm()}, np.zeros((1, 2), dtype=int))
    large = points.nodes(basis, 100).points
    for count in (1, 7, 32, 65):
        assert np.array_equal(points.nodes(basis, count).points, large[:count])


def test_the_sets_that_are_nested_say_so():
    assert {type(points).__name__ for points in NESTED} == {"HaltonPoints", "SobolPoints", "RandomPoints"}


@pytest.mark.parametrize("points", [HammersleyPoints(), HaltonPoints(), SobolPoints()])
def test_low_discrepancy_sets_are_more_even_than_random_points(points):
    assert qmc.discrepancy(points.levels(256, 3)) < 0.2 * qmc.discrepancy(RandomPoints().levels(256, 3))


@pytest.mark.parametrize(("points", "slope"), [(RandomPoints, -0.5), (SobolPoints, -1.5)])
def test_means_converge_at_the_known_rates(points, slope):
    # Owen (1997): scrambled nets integrate smooth functions to n^-1.5, but for logarithms
    counts = 2 ** np.arange(4, 12)

    def error(count):
        means = [np.prod(1 + 0.5 * (points(seed=s).levels(count, 3) - 0.5), axis=1).mean() for s in range(20)]
        return np.sqrt(np.mean((np.array(means) - 1) ** 2))

    fitted = np.polyfit(np.log(counts), np.log([error(count) for count in counts]), 1)[0]
    assert fitted == pytest.approx(slope, abs=0.2)


@pytest.mark.parametrize("kind", SEEDED)
def test_a_seed_gives_the_same_points_again_and_another_one_others(kind):
    basis = Basis({"u": LegendreGerm(), "n": HermiteGerm()}, TotalDegree().indices(("u", "n"), 2))
    first, again, other = (kind(10, seed=seed).nodes(basis, 0).points for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.any(first == other)


@pytest.mark.parametrize("points", EVEN)
def test_weights_are_equal_and_points_the_germs_quantiles(points):
    basis = Basis({"u": LegendreGerm(), "n": HermiteGerm()}, np.zeros((1, 2), dtype=int))
    nodes = points.nodes(basis, 30)
    assert nodes.weights == pytest.approx(np.full(30, 1 / 30), rel=1e-15)
    assert np.array_equal(nodes.points[:, 0], 2 * points.levels(30, 2)[:, 0] - 1)


@pytest.mark.parametrize("points", [HaltonPoints(50), SobolPoints(50, seed=1), LatinHypercubePoints(50)])
def test_a_set_takes_the_number_of_points_it_was_given(points):
    germs = {"u": LegendreGerm(), "v": LegendreGerm()}
    assert collocate(germs, Expansion(2, points=points)).collocation.points.shape == (50, 2)


@pytest.mark.parametrize("count", [0, -3, True, 2.5])
def test_a_number_of_points_that_is_no_positive_whole_number_is_refused(count):
    with pytest.raises((ProblemError, TypeError), match="number of points is a whole number of at least 1"):
        SobolPoints(count)


@pytest.mark.parametrize("seed", [-1, 0.5, None, True])
@pytest.mark.parametrize("kind", SEEDED)
def test_a_seed_that_is_no_whole_number_is_refused(kind, seed):
    with pytest.raises((ProblemError, TypeError), match="seed"):
        kind(seed=seed)
