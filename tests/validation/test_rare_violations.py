"""Violations that are too rare to be counted: estimated by weighted samples, against closed forms."""

import numpy as np
import pytest
from scipy import stats

import aleator as al
from aleator.validation import WeightedProportion
from aleator.validation._rare import adapted
from zoo import gain_problem

RARE = 1e-4
FAR = stats.norm.isf(RARE)


def plane(variables):
    """One limit, a plane in any direction."""
    direction = np.arange(1.0, variables + 1)
    direction /= np.linalg.norm(direction)
    return variables, lambda normals: (normals @ direction - FAR)[None], RARE


def test_weights_are_the_given_density_over_that_of_the_proposal():
    generator = np.random.default_rng(1)
    variables, scores, _ = plane(3)
    proposal = adapted(scores, variables, 3.7, 1000, generator)
    points = proposal.draw(200_000, generator)
    weights = proposal.weights(points)
    assert weights.max() <= 10.0 + 1e-9
    assert weights.mean() == pytest.approx(1.0, abs=5 * weights.std() / np.sqrt(len(weights)))
    densities = [
        share * stats.multivariate_normal(mean, factor @ factor.T).pdf(points[:50])
        for share, (mean, factor) in zip(proposal.shares, proposal.components, strict=True)
    ]
    given = stats.multivariate_normal(np.zeros(3)).pdf(points[:50])
    np.testing.assert_allclose(weights[:50], given / np.sum(densities, axis=0), rtol=1e-10)


@pytest.mark.parametrize(("count", "confidence"), [(1, 0.95), (7, 0.99), (300, 0.9)])
def test_of_equal_weights_the_interval_is_that_of_a_poisson_count(count, confidence):
    weights = np.where(np.arange(10_000) < count, 0.01, 0.0)
    share = WeightedProportion.of(weights)
    assert share.estimate == pytest.approx(count * 1e-6)
    assert share.effective == pytest.approx(count)
    share = WeightedProportion(share.estimate, share.variance, share.largest, share.samples, confidence)
    tail = (1 - confidence) / 2
    assert share.lower == pytest.approx(1e-6 * stats.gamma.ppf(tail, count), rel=1e-9)
    assert share.upper == pytest.approx(1e-6 * stats.gamma.ppf(1 - tail, count + 1), rel=1e-9)


def test_where_nothing_happened_nothing_is_known():
    share = WeightedProportion.of(np.zeros(10))
    assert (share.estimate, share.lower, share.upper, share.effective) == (0.0, 0.0, 1.0, 0.0)


def test_a_design_that_one_system_in_thirty_thousand_breaks_is_told_by_two_thousand():
    solution = al.solve(gain_problem(sigmas=4.0, theta=al.Normal(1.0, 0.2)))
    share = al.rare_violation(solution, "response", 2000)
    assert isinstance(share, WeightedProportion)
    assert share.lower <= stats.norm.sf(4.0) <= share.upper < 1.3 * share.lower
    assert al.rare_violation(solution, samples=2000) == share
    assert al.rare_violation(solution, samples=2000, seed=1) != share


def test_what_cannot_happen_is_counted_instead():
    solution = al.solve(gain_problem(sigmas=2.0))
    share = al.rare_violation(solution, samples=3000)
    assert share == al.results.Proportion(0, 3000)
