"""What is refused as a number, a distribution, a decision or a dimension, and why: by one table for each subject."""

import numpy as np
import pytest

import aleator as al
from aleator._core.errors import ProblemError


def bell(x):
    return 7.0 * np.exp(-(x**2) / 2)


POSITIVE_NUMBERS = {
    "Uniform half_width": lambda s: al.Uniform(1.0, half_width=s),
    "Normal std": lambda s: al.Normal(1.0, s),
    "Beta std": lambda s: al.Beta(mean=0.3, std=s),
    "Beta alpha": lambda s: al.Beta(alpha=s, beta=2.0),
    "Beta beta": lambda s: al.Beta(alpha=2.0, beta=s),
    "Gamma scale": lambda s: al.Gamma(shape=2.0, scale=s),
    "Gamma shape": lambda s: al.Gamma(shape=s, scale=2.0),
    "Gamma std": lambda s: al.Gamma(mean=2.0, std=s),
    "Exponential rate": lambda s: al.Exponential(rate=s),
    "LogNormal mean": lambda s: al.LogNormal(mean=s, std=1.0),
    "LogNormal std": lambda s: al.LogNormal(mean=1.0, std=s),
    "LogNormal log_std": lambda s: al.LogNormal(log_mean=1.0, log_std=s),
    "Weibull scale": lambda s: al.Weibull(s, 1.0),
    "Weibull shape": lambda s: al.Weibull(1.0, s),
    "Weibull std": lambda s: al.Weibull(mean=1.0, std=s),
    "Gumbel scale": lambda s: al.Gumbel(0.0, s),
    "Triangular half_width": lambda s: al.Triangular(mean=0.0, half_width=s),
    "TruncatedNormal scale": lambda s: al.TruncatedNormal(1.0, s, lower=0.0),
    "Density scale": lambda s: al.Density(bell, -1.0, 1.0, scale=s),
    "Sample scale": lambda s: al.Sample([1.0, 2.0], scale=s),
}


def test_a_spread_or_shape_that_is_not_positive_and_finite_is_refused_by_name_and_value():
    for name, make in POSITIVE_NUMBERS.items():
        family, parameter = name.split()
        for bad in (0.0, -1.0, np.nan, np.inf):
            with pytest.raises(ProblemError, match=f"^{family} needs .*{parameter}={bad:g}"):
                make(bad)


IMPOSSIBLE = [
    (lambda: al.Uniform.bounds(1.0, 1.0), "lower=1, upper=1"),
    (lambda: al.Beta(mean=0.3, std=0.46), "std=0.46"),  # at most sqrt(mean (1 - mean)), here 0.458
    (lambda: al.Exponential(mean=1.0, lower=2.0), "finite mean above lower.*lower=2"),
    (lambda: al.Triangular(1.0, 0.5, 2.0), "mode=0.5"),
    (lambda: al.TruncatedNormal(0.0, 1.0, lower=40.0), "within 37 scales.*lower=40"),
    (lambda: al.Density(np.sin, 0.0, 7.0), "not negative.*received -"),
    (lambda: al.Density(lambda x: 1 / x, 0.0, 1.0), "converge towards its end 0"),
    (lambda: al.Density(lambda x: (1 - x) ** -0.5, 0.0, 1.0), "grows without bound towards its end 1.*location"),
    (lambda: al.Density(lambda x: 1 / (1 + x**2), -np.inf, np.inf), "moments"),
    (lambda: al.Normal(1.0, al.Decision(0.0, 0.0)), r"std=Decision\(0 in"),
    (lambda: al.Decision(1.0, lower=2.0, upper=0.0), "received 2.0 <= 1.0 <= 0.0"),
    (lambda: al.Toleranced(1.0, plus=0.1, minus=-0.1), "in order.*minus=-0.1"),
]


@pytest.mark.parametrize(("make", "received"), IMPOSSIBLE)
def test_numbers_that_cannot_be_are_refused_with_what_was_received(make, received):
    with pytest.raises(ProblemError, match=received):
        make()


NARROW, FINITE = "Narrow the bounds of its decisions", "Give the decision finite bounds"
INSIDE_OUT = {
    "gamma below its bound": (lambda: al.Gamma(mean=al.Decision(2, -3, 5), std=1), "mean=-3", NARROW),
    "normal of unbounded std": (lambda: al.Normal(1.0, al.Decision(0.1)), "std=-inf", FINITE),
    "beta crossing": (
        lambda: al.Beta(alpha=2, beta=2, lower=al.Decision(0, -1, 2), upper=al.Decision(1, 0, 3)),
        "lower=2, upper=0",
        NARROW,
    ),
    "beta wider than possible": (lambda: al.Beta(mean=al.Decision(0.5, 0.1, 0.9), std=0.4), "mean=0.1", NARROW),
}


@pytest.mark.parametrize(("make", "corner", "remedy"), INSIDE_OUT.values(), ids=INSIDE_OUT.keys())
def test_a_distribution_that_its_decisions_turn_inside_out_is_refused_with_the_corner_and_the_remedy(
    make, corner, remedy
):
    with pytest.raises(ProblemError, match=f"its decisions reach {corner}, where it is no distribution.*{remedy}"):
        make()


def test_a_spread_may_vanish_or_grow_without_bound_where_every_decision_in_between_makes_a_distribution():
    al.Normal(al.Decision(0), al.Decision(1, 0))
    al.Uniform.bounds(al.Decision(1, -np.inf, 2), al.Decision(3, 2, np.inf))
    al.Beta(alpha=2, beta=2, lower=al.Decision(0, 0, 1), upper=1)
    al.Gamma(shape=2, scale=al.Decision(1, 0), lower=al.Decision(0))
    al.Beta(mean=al.Decision(0.5, 0.2, 0.8), std=al.Decision(0.1, 0.01, 0.3))


def test_decisions_shared_under_one_name_reach_only_the_corners_that_they_share():
    k = al.Decision(2.0, 1.0, 5.0).shared("k")
    distribution = al.Beta(mean=k, std=0.1, lower=0.0, upper=al.Decision(9.0, 6.0, 10.0))
    assert len(list(distribution.corners())) == 4
    assert list(al.Gamma(mean=k, std=k).corners()) == [{"mean": 1.0, "std": 1.0}, {"mean": 5.0, "std": 5.0}]
