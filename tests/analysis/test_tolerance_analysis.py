"""Tolerance analysis: stacks of plates with closed forms, the published clutch, and mistakes refused."""

import warnings
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import aleator as al
from zoo import algebraic


def stack(**distributions):
    """A gap between a housing and two plates: linear, so that everything is known."""
    return al.Assembly(dimensions=distributions, features={"gap": "housing - 2*plate"})


@pytest.fixture(scope="module")
def normal_stack():
    model = stack(housing=al.Toleranced(10.0, tolerance=0.3), plate=al.Toleranced(4.0, tolerance=0.2))
    return al.tolerance_analysis(model, "gap", lower=1.6, upper=2.5)


STD = np.hypot(0.1, 2 * 0.2 / 3)


def test_a_linear_stack_of_normal_parts_is_normal_with_the_capabilities_and_rejects_of_its_gap(normal_stack):
    assert normal_stack.nominal == pytest.approx(2.0, rel=1e-12)
    assert normal_stack.std == pytest.approx(STD, rel=1e-10)
    assert normal_stack.linear_std == pytest.approx(STD, rel=1e-12)
    assert normal_stack.skewness == pytest.approx(0.0, abs=1e-8)
    assert normal_stack.kurtosis == pytest.approx(3.0, rel=1e-8)
    assert normal_stack.cp == pytest.approx(0.9 / (6 * STD), rel=1e-10)
    assert normal_stack.cpk == pytest.approx(0.4 / (3 * STD), rel=1e-10)
    assert normal_stack.rejects_low == pytest.approx(1e6 * stats.norm.cdf(-0.4 / STD), rel=1e-5)
    assert normal_stack.rejects_high == pytest.approx(1e6 * stats.norm.sf(0.5 / STD), rel=1e-5)


def test_zones_add_up_and_contributions_are_all_of_the_variance(normal_stack):
    assert normal_stack.worst_case == pytest.approx((2 - 0.7, 2 + 0.7), rel=1e-9)
    assert normal_stack.rss == pytest.approx(np.hypot(0.3, 0.4), rel=1e-12)
    shares = {name: one.linear for name, one in normal_stack.contributions.items()}
    totals = {name: one.total for name, one in normal_stack.contributions.items()}
    assert shares["plate"] == pytest.approx(100 * (0.4 / 3) ** 2 / STD**2, rel=1e-9)
    assert sum(shares.values()) == pytest.approx(100, rel=1e-12)
    assert totals == pytest.approx(shares, rel=1e-8)
    assert normal_stack.contributions["plate"].sensitivity == pytest.approx(-2.0, rel=1e-12)


@algebraic
def curved(a, b, weights):
    """A rule of two dimensions: which one, is data."""
    rules = b * jnp.exp(3 * a), b * (1 - jnp.cos(a)), b + 0.4 * jnp.sin(8 * a), jnp.exp(a)
    return {"y": sum(weight * one for weight, one in zip(weights, rules, strict=True))}


def curved_assembly(rule, *zones):
    """An assembly by one of the rules, each dimension with its nominal value and its tolerance."""
    return curved(*(al.Toleranced(one, tolerance=width) for one, width in zones), np.eye(4)[rule].tolist())


@pytest.mark.parametrize(
    ("rule", "first", "second", "ends"),
    [
        # At corners, far from what a polynomial says there; inside of one zone, with four extremes.
        (0, (0.0, 0.6), (1.0, 0.1), (0.9 * np.exp(-1.8), 1.1 * np.exp(1.8))),
        (2, (0.1, 0.2), (1.0, 0.02), (0.98 + 0.4 * np.sin(-0.8), 1.42)),
    ],
)
def test_the_worst_case_is_the_range_of_the_assembly_itself(rule, first, second, ends):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", al.ExpansionWarning)
        analysis = al.tolerance_analysis(curved_assembly(rule, first, second), "y", lower=-1.0)
    assert analysis.worst_case == pytest.approx(ends, rel=1e-9, abs=1e-12)


@pytest.mark.slow
def test_zones_are_those_of_the_distributions_unless_given():
    model = stack(housing=al.Toleranced(10.0, plus=0.05, minus=0.02), plate=al.Uniform.bounds(3.9, 4.2))
    one = al.tolerance_analysis(model, "gap", lower=0.0)
    assert tuple(one.contributions["housing"].zone) == pytest.approx((9.98, 10.05))
    assert tuple(one.contributions["plate"].zone) == pytest.approx((3.9, 4.2))
    assert one.worst_case == pytest.approx((9.98 - 8.4, 10.05 - 7.8), rel=1e-9)
    assert one.rejects_high == 0
    given = al.tolerance_analysis(model, "gap", lower=0.0, tolerances={"housing": 0.5, "plate": (0.1, 0.2)})
    assert given.worst_case == pytest.approx((9.515 - 2 * 4.25, 10.515 - 2 * 3.95), rel=1e-9)
    # As much is in the zone as within three standard deviations of a normal distribution, on either side.
    worn = al.tolerance_analysis({"wear": al.Exponential(mean=2.0, lower=0.0)}, lambda at: -at["wear"], lower=-9.0)
    assert worn.worst_case == pytest.approx((2 * stats.norm.logcdf(-3.0), 2 * stats.norm.logcdf(3.0)), rel=1e-9)
    with pytest.raises(al.ProblemError, match="no uncertain dimension"):
        al.tolerance_analysis(model, "gap", lower=0.0, tolerances={"plat": 0.1})


def test_rejects_in_a_tail_that_the_expansion_misses_are_those_of_the_assembly():
    """A lognormal gap, whose expansion of order 3 has four times as many rejects below."""
    analysis = al.tolerance_analysis(curved_assembly(3, (0.0, 0.9), (1.0, 0.15)), "y", lower=0.3, upper=3.0)
    exact = 1e6 * np.array([stats.norm.cdf(np.log(0.3) / 0.3), stats.norm.sf(np.log(3.0) / 0.3)])
    found = np.array([analysis.rejects_low, analysis.rejects_high])
    assert np.abs(found - exact).max() < analysis.rejects_error
    assert analysis.rejects_error < 0.2 * exact.sum()


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4, 5, 8, 10])
def test_the_error_of_rejects_covers_that_of_the_integral_over_the_expansion(count):
    """Squares, which order 2 has exactly: around the smallest of their sums lines through the germ hardly tell."""
    parts = {f"d{i}": al.Normal(0.0, 1.0) for i in range(count)}
    least = float(stats.chi2(count).ppf(1e-3))
    squares = partial(sum_of, jnp.square)
    analysis = al.tolerance_analysis(parts, squares, lower=least, expansion=al.Expansion(order=2))
    assert abs(analysis.rejects - 1000.0) < analysis.rejects_error < 2000.0


def sum_of(function, parts):
    return sum(map(function, parts.values()))


@pytest.mark.filterwarnings("ignore::aleator.ExpansionWarning")  # a cone is no polynomial
def test_a_true_position_has_no_derivative_at_its_nominal_and_is_analysed_without():
    """The distance of two normal deviations is Rayleigh's."""
    sigma = 0.01
    hole = {"x": al.Normal(0.0, sigma), "y": al.Normal(0.0, sigma)}
    analysis = al.tolerance_analysis(
        hole, lambda at: jnp.sqrt(at["x"] ** 2 + at["y"] ** 2), upper=2.5 * sigma, expansion=al.Expansion(order=8)
    )
    assert analysis.mean == pytest.approx(sigma * np.sqrt(np.pi / 2), rel=0.02)
    assert analysis.std == pytest.approx(sigma * np.sqrt(2 - np.pi / 2), rel=0.05)
    assert analysis.rejects_high == pytest.approx(1e6 * np.exp(-(2.5**2) / 2), abs=2 * analysis.rejects_error)
    assert analysis.worst_case == pytest.approx((0.0, 3 * np.sqrt(2) * sigma))
    assert np.isnan(analysis.rss)
    assert "nan" not in f"{analysis}\n{analysis.contributions['x']}"
