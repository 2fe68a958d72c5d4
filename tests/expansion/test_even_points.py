"""Point sets in the unit cube against scipy's, closed forms and what they promise, in many variables too."""

import math

import numpy as np
import pytest
from scipy.stats import norm, qmc

import aleator as al
from aleator.expansion import (
    Basis,
    ChristoffelPoints,
    HaltonPoints,
    HammersleyPoints,
    LatinHypercubePoints,
    OptimalPoints,
    RandomPoints,
    SobolPoints,
    TotalDegree,
)
from aleator.uncertainty import HermiteGerm, LegendreGerm
from zoo import cases

EVEN = [HammersleyPoints(), HaltonPoints(), SobolPoints(), LatinHypercubePoints(), RandomPoints()]
SEEDED = [SobolPoints, LatinHypercubePoints, RandomPoints, ChristoffelPoints, OptimalPoints]


def test_the_halton_sequence_is_scipys_without_the_origin_and_the_hammersley_set_has_it_beside_an_even_column():
    halton = qmc.Halton(d=5, scramble=False).random(51)[1:]
    points = HammersleyPoints().levels(50, 6)
    assert points[:, 0] == pytest.approx((np.arange(50) + 0.5) / 50, rel=1e-15)
    assert points[:, 1:] == pytest.approx(halton, rel=1e-13)
    assert HaltonPoints().levels(50, 5) == pytest.approx(halton, rel=1e-13)


def test_scrambled_sobol_points_fill_every_elementary_interval():
    # 2^6 points of a (0, 6, 2)-net in base 2: one in each of 64 boxes, however 64 is split
    points = SobolPoints(seed=3).levels(64, 2)
    for split in ((64, 1), (1, 64), (2, 32), (8, 8), (16, 4)):
        boxes = np.floor(points * np.array(split)).astype(int)
        assert len(np.unique(boxes, axis=0)) == 64


def test_a_latin_hypercube_has_one_point_in_each_slice_of_each_variable():
    slices = np.floor(LatinHypercubePoints(seed=4).levels(37, 5) * 37).astype(int)
    assert all(sorted(column) == list(range(37)) for column in slices.T.tolist())


@pytest.mark.parametrize("points", EVEN)
def test_points_lie_strictly_inside_the_unit_cube_none_twice_and_are_the_germs_quantiles_of_equal_weight(points):
    levels = points.levels(64, 12)
    assert levels.shape == (64, 12)
    assert np.all((levels > 0) & (levels < 1))
    assert all(len(np.unique(column)) == 64 for column in levels.T)
    basis = Basis({"u": LegendreGerm(), "n": HermiteGerm()}, np.zeros((1, 2), dtype=int))
    nodes, levels = points.nodes(basis, 32), points.levels(32, 2)
    assert nodes.weights == pytest.approx(np.full(32, 1 / 32), rel=1e-15)
    np.testing.assert_allclose(
        nodes.points, np.stack([2 * levels[:, 0] - 1, norm.ppf(levels[:, 1])], axis=1), rtol=1e-11
    )
    if points.nested:
        assert np.array_equal(points.nodes(basis, 100).points[:32], nodes.points)


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


DISTRIBUTIONS = {"uniform": al.Uniform.bounds(1.0, 3.0), "normal": al.Normal(2.0, 0.5)}
STDS = {"uniform": 1 / math.sqrt(3), "normal": 0.5}


@pytest.mark.parametrize(
    ("kind", "variables", "order"),
    cases([("normal", 12, 2), ("uniform", 100, 1), ("uniform", 9, 2), ("normal", 30, 1)], 2),
)
def test_a_linear_function_of_many_variables_is_expanded_to_rounding_at_a_small_condition_number(
    kind, variables, order
):
    model = {f"x{i}": DISTRIBUTIONS[kind] for i in range(variables)}
    expanded = al.expand(lambda at: sum(at.values()), model, al.Expansion(order))
    assert float(expanded.mean) == pytest.approx(2.0 * variables, rel=1e-12)
    assert float(expanded.std) == pytest.approx(STDS[kind] * math.sqrt(variables), rel=1e-12)
    assert float(expanded.collocation.condition_number) < 6.0
