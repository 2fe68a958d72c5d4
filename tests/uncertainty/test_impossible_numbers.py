"""What is refused as a number, a distribution, a decision or a dimension, and why: by one table for each subject."""

import numpy as np
import pytest

from aleator._core.errors import ProblemError
from aleator.uncertainty import (
    Beta,
    Decision,
    Density,
    Exponential,
    Gamma,
    Gumbel,
    LogNormal,
    Normal,
    Sample,
    Toleranced,
    Triangular,
    TruncatedNormal,
    Uniform,
    Weibull,
    toleranced,
)


def bell(x):
    return 7.0 * np.exp(-(x**2) / 2)


POSITIVE_NUMBERS = {
    "Uniform half_width": lambda s: Uniform(1.0, half_width=s),
    "Uniform std": lambda s: Uniform(1.0, std=s),
    "Normal std": lambda s: Normal(1.0, s),
    "Beta std": lambda s: Beta(mean=0.3, std=s),
    "Beta alpha": lambda s: Beta(alpha=s, beta=2.0),
    "Beta beta": lambda s: Beta(alpha=2.0, beta=s),
    "Gamma scale": lambda s: Gamma(shape=2.0, scale=s),
    "Gamma shape": lambda s: Gamma(shape=s, scale=2.0),
    "Gamma std": lambda s: Gamma(mean=2.0, std=s),
    "Exponential mean": lambda s: Exponential(mean=s),
    "Exponential rate": lambda s: Exponential(rate=s),
    "LogNormal mean": lambda s: LogNormal(mean=s, std=1.0),
    "LogNormal std": lambda s: LogNormal(mean=1.0, std=s),
    "LogNormal median": lambda s: LogNormal(median=s, log_std=1.0),
    "LogNormal log_std": lambda s: LogNormal(log_mean=1.0, log_std=s),
    "Weibull scale": lambda s: Weibull(s, 1.0),
    "Weibull shape": lambda s: Weibull(1.0, s),
    "Weibull mean": lambda s: Weibull(mean=s, std=1.0),
    "Weibull std": lambda s: Weibull(mean=1.0, std=s),
    "Gumbel scale": lambda s: Gumbel(0.0, s),
    "Gumbel std": lambda s: Gumbel(mean=0.0, std=s),
    "Triangular half_width": lambda s: Triangular(mean=0.0, half_width=s),
    "TruncatedNormal scale": lambda s: TruncatedNormal(1.0, s, lower=0.0),
    "Density scale": lambda s: Density(bell, -1.0, 1.0, scale=s),
    "Sample scale": lambda s: Sample([1.0, 2.0], scale=s),
}


@pytest.mark.parametrize("name", POSITIVE_NUMBERS)
def test_a_spread_or_shape_that_is_not_positive_and_finite_is_refused_by_name_and_value(name):
    family, parameter = name.split()
    for bad in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ProblemError) as refusal:
            POSITIVE_NUMBERS[name](bad)
        assert str(refusal.value).startswith(f"{family} needs ")
        assert f"{parameter}={bad:g}" in str(refusal.value)


IMPOSSIBLE = [
    (lambda: Uniform.bounds(1.0, 1.0), "lower=1, upper=1"),
    (lambda: Uniform.bounds(0.0, float("inf")), "inf"),
    (lambda: Normal(float("nan"), 1.0), "nan"),
    (lambda: Beta(alpha=2.0, beta=2.0, lower=3.0, upper=1.0), "lower=3, upper=1"),
    (lambda: Beta(mean=1.0, std=0.1, lower=1.0, upper=1.0), "lower=1, upper=1"),
    (lambda: Beta(mean=0.3, std=0.46), "std=0.46"),  # at most sqrt(mean (1 - mean)), here 0.458
    (lambda: Beta(mean=0.0, std=0.1), "mean=0"),
    (lambda: Beta(mean=1.2, std=0.1), "mean=1.2"),
    (lambda: Gamma(mean=2.0, std=1.0, lower=3.0), "lower=3"),
    (lambda: Gamma(mean=1e200, std=1e-3), "mean=1e.200"),
    (lambda: Exponential(mean=1.0, lower=2.0), "finite mean above lower.*lower=2"),
    (lambda: LogNormal(mean=1.0, std=0.5, lower=1.0), "lower=1"),
    (lambda: Weibull(mean=1.0, std=0.5, lower=3.0), "lower=3"),
    (lambda: Triangular(1.0, 0.5, 2.0), "mode=0.5"),
    (lambda: Triangular(1.0, 2.5, 2.0), "mode=2.5"),
    (lambda: Triangular(2.0, 2.0, 2.0), "lower < upper"),
    (lambda: TruncatedNormal(0.0, 1.0, lower=2.0, upper=1.0), "lower < upper"),
    (lambda: TruncatedNormal(0.0, 1.0, lower=40.0), "within 37 scales.*lower=40"),
    (lambda: TruncatedNormal(0.0, 1.0, upper=-40.0), "within 37 scales.*upper=-40"),
    (lambda: Density(3.0, 0.0, 1.0), "takes a function"),
    (lambda: Density(bell, 1.0, 0.0), "lower < upper"),
    (lambda: Density(bell, Decision(0.0), 1.0), "lower"),
    (lambda: Density(np.sin, 0.0, 7.0), "not negative.*received -0"),
    (lambda: Density(lambda x: np.where(x > 0.5, np.nan, 1.0), 0.0, 1.0), "received nan"),
    (lambda: Density(lambda x: 0 * x, 0.0, 1.0), "no mass"),
    (lambda: Density(lambda x: np.exp(-(((x - 20) / 1e-3) ** 2)), -np.inf, np.inf), "no mass"),
    (lambda: Density(lambda x: 1 / x, 0.0, 1.0), "converge towards its end 0"),
    (lambda: Density(lambda x: 1 / x, 1.0, np.inf), "converge towards its end inf"),
    (lambda: Density(lambda x: (1 - x) ** -0.5, 0.0, 1.0), "grows without bound towards its end 1.*location"),
    (lambda: Density(lambda x: 1 / (1 + x**2), -np.inf, np.inf), "moments"),
    (lambda: Density(lambda x: 1.0, 0.0, 1.0), "one number for each"),
    (lambda: Sample([2.0, 2.0]), "differ"),
    (lambda: Sample([1.0, np.nan]), "non-finite"),
    (lambda: Sample([[1.0, 2.0]]), "shape"),
    (lambda: Sample([1.0, 2.0, 4.0]).germ().recurrence(3), "order 2; received order 3"),
    (lambda: Uniform(3.0, 4.0), "expected Uniform"),
    (lambda: Uniform(1.0), r"received \(mean\)"),
    (lambda: Uniform(1.0, half_width=0.1, std=0.1), "half_width, std"),
    (lambda: Uniform.bounds(1.0, None), r"received \(lower\)"),
    (lambda: Beta(alpha=2.0), "alpha, lower, upper"),
    (lambda: Gamma(shape=2.0, std=1.0), "shape, std, lower"),
    (lambda: LogNormal(median=1.0, std=0.5), "LogNormal takes"),
    (lambda: Exponential(), "Exponential takes"),
    (lambda: Normal(1.0, np.ones(2)), "std"),
    (lambda: Normal(1.0, Decision(np.ones(2))), "std"),
    (lambda: Normal(1.0, Normal(0.0, 1.0)), "std"),
    (lambda: Normal(1.0, Decision(0.0, 0.0)), r"std=Decision\(0 in"),
    (lambda: Decision(1.0, lower=2.0, upper=0.0), "lower=2.0, upper=0.0"),
    (lambda: Decision(3.0, 0.0, 2.0), "received 3.0"),
    (lambda: Decision(-1.0, 0.0, 2.0), "received -1.0"),
    (lambda: Decision(np.array([1.0, 5.0]), 0.0, 2.0), "between its bounds"),
    (lambda: Decision(np.ones(3), lower=np.zeros(2)), r"shape \(3,\)"),
    (lambda: Decision(np.ones((2, 3)), upper=np.ones(3)), r"shape \(2, 3\)"),
    (lambda: Decision(np.ones(2), lower=np.array([0.0, 3.0]), upper=2.0), "lower bound"),
    (lambda: Decision(np.array([1.0, np.nan])), "finite"),
    (lambda: Toleranced(1.0), r"received \(nominal, cp\)"),
    (lambda: Toleranced(1.0, tolerance=0.1, plus=0.1, minus=0.1), "Toleranced takes"),
    (lambda: Toleranced(1.0, tolerance=0.1, cp=1.0, sigmas=3.0), "Toleranced takes"),
    (lambda: Toleranced(1.0, tolerance=-0.1, cp=-1.0), "tolerance=-0.1"),
    (lambda: Toleranced(1.0, plus=0.1, minus=-0.1), "in order.*minus=-0.1"),
    (lambda: Toleranced(1.0, tolerance=0.1, cp=0.0), "cp=0"),
    (lambda: Toleranced(1.0, tolerance=0.1, sigmas=-3.0), "sigmas=-3"),
    (lambda: Toleranced(1.0, tolerance=0.1, cp=1.0, cpk=1.2), "cpk=1.2"),
    (lambda: Toleranced(1.0, tolerance=0.1, cpk=0.5, towards="left"), "upper.*lower"),
]


@pytest.mark.parametrize(("make", "received"), IMPOSSIBLE)
def test_numbers_that_cannot_be_are_refused_with_what_was_received(make, received):
    with pytest.raises(ProblemError, match=received):
        make()


def test_a_text_that_is_no_toleranced_dimension_is_refused_with_the_forms_that_are():
    for text in ("27.645", "27,645 ±0.05", "27.645 0.05", "200-0.02", "8 ±-0.1", "8 +0.1/0.1", "8 +0.1/-0.1/-0.2"):
        with pytest.raises(ProblemError, match=r"is no toleranced dimension: expected .*\+0\.05/-0\.02"):
            toleranced(text)


NARROW, FINITE = "Narrow the bounds of its decisions", "Give the decision finite bounds"
INSIDE_OUT = {
    "gamma below its bound": (lambda: Gamma(mean=Decision(2, -3, 5), std=1), "mean=-3", NARROW),
    "gamma above its mean": (lambda: Gamma(mean=2, std=1, lower=Decision(0, -1, 3)), "lower=3", NARROW),
    "gamma without spread": (lambda: Gamma(mean=2, std=Decision(1, 0, 2)), "std=0", NARROW),
    "gamma without shape": (lambda: Gamma(shape=Decision(1, 0, 2), scale=1), "shape=0", NARROW),
    "gamma of negative scale": (lambda: Gamma(shape=1, scale=Decision(1, -1, 2)), "scale=-1", NARROW),
    "gamma of unbounded shape": (lambda: Gamma(shape=Decision(1, 0.1), scale=1), "shape=inf", FINITE),
    "uniform crossing": (lambda: Uniform.bounds(Decision(1, 0, 5), Decision(2, 0, 5)), "lower=5, upper=0", NARROW),
    "uniform of negative half-width": (lambda: Uniform(0, half_width=Decision(1, -2, 5)), "half_width=-2", NARROW),
    "normal of negative std": (lambda: Normal(Decision(0, -1, 1), Decision(1, -2, 5)), "mean=-1, std=-2", NARROW),
    "normal of unbounded std": (lambda: Normal(1.0, Decision(0.1)), "std=-inf", FINITE),
    "beta crossing": (
        lambda: Beta(alpha=2, beta=2, lower=Decision(0, -1, 2), upper=Decision(1, 0, 3)),
        "lower=2, upper=0",
        NARROW,
    ),
    "beta of zero width by moments": (
        lambda: Beta(mean=0.5, std=0.1, lower=Decision(0, 0, 1), upper=1),
        "lower=1",
        NARROW,
    ),
    "beta beyond its upper end": (lambda: Beta(mean=Decision(0.5, 0.2, 1.5), std=0.1), "mean=1.5", NARROW),
    "beta wider than possible": (lambda: Beta(mean=Decision(0.5, 0.1, 0.9), std=0.4), "mean=0.1", NARROW),
    "beta of unbounded std": (lambda: Beta(mean=0.5, std=Decision(0.1, 0.01)), "std=inf", FINITE),
    "beta without shape": (lambda: Beta(alpha=Decision(1, 0, 2), beta=2), "alpha=0", NARROW),
    "triangular": (lambda: Triangular(1.0, Decision(2.0, 0.0, 3.0), 4.0), "mode=0", NARROW),
    "weibull": (lambda: Weibull(1.0, Decision(2.0, 0.0, 3.0)), "shape=0", NARROW),
    "weibull by moments": (lambda: Weibull(mean=2.0, std=Decision(1.0, 0.0, 3.0)), "std=0", NARROW),
    "lognormal": (lambda: LogNormal(mean=2.0, std=Decision(1.0, -1.0, 2.0)), "std=-1", NARROW),
    "truncated normal": (lambda: TruncatedNormal(Decision(0.0), 1.0, lower=0.0), "location=-inf", FINITE),
    "exponential": (lambda: Exponential(rate=Decision(1.0, 0.0, 2.0)), "rate=0", NARROW),
    "tolerance": (lambda: Toleranced(1.0, tolerance=Decision(0.1, -0.1, 0.2)), "tolerance=-0.1", NARROW),
    "capability": (lambda: Toleranced(1.0, tolerance=0.1, cp=1.0, cpk=Decision(0.8, 0.5, 1.5)), "cpk=1.5", NARROW),
}


@pytest.mark.parametrize(("make", "corner", "remedy"), INSIDE_OUT.values(), ids=INSIDE_OUT.keys())
def test_a_distribution_that_its_decisions_turn_inside_out_is_refused_with_the_corner_and_the_remedy(
    make, corner, remedy
):
    with pytest.raises(ProblemError, match=f"its decisions reach {corner}, where it is no distribution.*{remedy}"):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Normal(Decision(0), Decision(1, 0)),
        lambda: Uniform(Decision(0), half_width=Decision(1, 0)),
        lambda: Uniform(Decision(0), std=Decision(1, 0)),
        lambda: Uniform.bounds(Decision(1, -np.inf, 2), Decision(3, 2, np.inf)),
        lambda: Beta(alpha=2, beta=2, lower=Decision(0, 0, 1), upper=1),
        lambda: Gamma(shape=2, scale=Decision(1, 0), lower=Decision(0)),
        lambda: Gamma(mean=Decision(2, 1, 5), std=Decision(1, 0.1, 2)),
        lambda: Beta(mean=Decision(0.5, 0.2, 0.8), std=Decision(0.1, 0.01, 0.3)),
    ],
)
def test_a_spread_may_vanish_or_grow_without_bound_where_every_decision_in_between_makes_a_distribution(make):
    make()


def test_decisions_shared_under_one_name_reach_only_the_corners_that_they_share():
    k = Decision(2.0, 1.0, 5.0).shared("k")
    distribution = Beta(mean=k, std=0.1, lower=0.0, upper=Decision(9.0, 6.0, 10.0))
    assert len(list(distribution.corners())) == 4
    assert list(Gamma(mean=k, std=k).corners()) == [{"mean": 1.0, "std": 1.0}, {"mean": 5.0, "std": 5.0}]


def test_a_decided_distribution_is_a_distribution_everywhere_between_its_bounds():
    distribution = Beta(
        mean=Decision(3.0, 2.5, 4.0),
        std=Decision(0.7, 0.1, 1.0),
        lower=Decision(1.0, 0.5, 1.2),
        upper=Decision(6.0, 5.5, 7.0),
    )
    generator = np.random.default_rng(1)
    for _ in range(200):
        somewhere = distribution.decided(lambda name, decision: generator.uniform(decision.lower, decision.upper))
        Beta(**somewhere.parameters)
