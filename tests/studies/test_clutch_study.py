"""The clutch study: table 7.2, its analysis and its allocation, in small, from stage to page."""

import itertools

import numpy as np
import pytest

import aleator as al
from aleator import extending as ext
from aleator.studies import load
from aleator.studies.clutch import (
    EXACT,
    MEANS,
    SPECIFICATIONS,
    TOLERANCES,
    clutch,
    cost,
    exact_rejects,
    pressure_angle,
    tolerances_of,
    worst_case,
)
from aleator.studies.clutch._chapter import Method, local_method


@pytest.fixture(scope="module")
def page():
    """The page of a quick run."""
    made = ext.Draft(load("clutch", quick=True))
    made.fill()
    return made


@pytest.fixture(scope="module")
def methods(page):
    rows = page.kept["methods"]
    return {name: Method(*(rows[part].sel(row=name).item() for part in Method._fields)) for name in rows["row"].values}


def test_the_loop_closes_where_the_closed_form_says_and_its_quadrature_is_the_exact_value():
    nominal = al.references.linearise(lambda realised: al.simulate(realised)["chi"][0], clutch())
    assert float(nominal.mean) == pytest.approx(float(pressure_angle(*MEANS.values())), rel=1e-12)
    nodes, weights = np.polynomial.hermite_e.hermegauss(24)
    germs, weight = np.meshgrid(nodes, nodes, nodes), np.prod(np.meshgrid(weights, weights, weights), axis=0)
    parts = (MEANS[name] + TOLERANCES[name] / 3 * germ for name, germ in zip(MEANS, germs, strict=True))
    angle = pressure_angle(*parts)
    variance = np.average((angle - np.average(angle, weights=weight)) ** 2, weights=weight)
    assert pytest.approx(3 * np.sqrt(variance), rel=1e-12) == EXACT
    assert pytest.approx(0.6590101, abs=1e-7) == EXACT


def corners(tolerances):
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    return pressure_angle(*(np.array(list(MEANS.values())) + signs * np.array(list(tolerances.values()))).T)


def test_the_worst_case_is_the_extreme_of_all_corners_of_the_tolerances():
    """The angle is monotone in each dimension, so that no point of the box lies beyond its eight corners."""
    for tolerances in (TOLERANCES, {"a": 0.01, "c": 0.05, "e": 0.03}):
        every = corners(tolerances)
        assert worst_case(tolerances) == pytest.approx((every.min(), every.max()), rel=1e-14)
    assert worst_case(TOLERANCES) == pytest.approx(
        (5.957, 7.938), abs=1e-3
    )  # cos chi = 39.135 / 39.3475, 39.015 / 39.3925


def test_counted_rejects_are_those_of_the_exact_tails():
    wide, samples = {name: 1.5 * tolerance for name, tolerance in TOLERANCES.items()}, 2_000_000
    drawn = np.random.default_rng(2).standard_normal((len(MEANS), samples))
    angle = pressure_angle(*(MEANS[name] + wide[name] / 3 * row for name, row in zip(MEANS, drawn, strict=True)))
    for limits in SPECIFICATIONS.values():
        counts = np.sum(angle < limits[0]), np.sum(angle > limits[1])
        for count, exact in zip(counts, exact_rejects(wide, limits), strict=True):
            one = al.results.Proportion(int(count), samples)
            assert one.lower < exact < one.upper
    low, high = exact_rejects(TOLERANCES)  # one sum of normal parts a limit
    assert (low, high) == pytest.approx((8.2556e-6, 8.3914e-7), rel=1e-3)


@pytest.mark.slow
def test_table_7_2_is_reached_at_the_published_points(methods):
    published = {"DLM": (0.65788, 5e-6), "gPC, order 3": (0.65900, 1.5e-5), "gPC, order 5": (0.65901, 1.5e-5)}
    found = {**methods, "gPC, order 7": local_method("gPC, order 7", 1)}
    for name, (value, tolerance) in {**published, "gPC, order 7": (0.6590101, 1e-7)}.items():
        assert found[name].three_sigma == pytest.approx(value, abs=tolerance), name
    assert [methods[f"gPC, order {order}"].points for order in (2, 3, 5)] == [30, 60, 168]
    for name in ("Monte Carlo", "quasi-Monte Carlo"):
        sampled = methods[name]
        assert abs(sampled.three_sigma - EXACT) < 4.5 * sampled.standard_error
    # Monte Carlo needs a thousand times the effort of order three.
    expanded, sampled = methods["gPC, order 3"], methods["Monte Carlo"]
    calls = sampled.points * (sampled.standard_error / abs(expanded.three_sigma - EXACT)) ** 2
    assert calls > 1000 * expanded.points


@pytest.mark.slow
def test_the_allocation_follows_the_rule_of_the_linearised_problem(page):
    """Minimising the sum of 1/T at a given variance makes T proportional to |S|^(-2/3)."""
    design = page.kept["allocation"]
    assert design.ok
    analysis = al.tolerance_analysis(clutch(), "chi", lower=6.0, upper=8.0)
    chosen = tolerances_of(design)
    scaled = np.array([chosen[name] * abs(analysis.contributions[name].sensitivity) ** (2 / 3) for name in chosen])
    # The angle is slightly skewed, so the rule holds to a part in a hundred.
    np.testing.assert_allclose(scaled, scaled.mean(), rtol=0.01)
    assert design.objective == pytest.approx(cost(chosen), rel=1e-12)
    assert design.objective < 0.65 * cost(TOLERANCES)
