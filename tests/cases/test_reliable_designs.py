"""Two benchmarks of reliability-based design: a short column, and Golinski's speed reducer."""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from zoo import algebraic

pytestmark = pytest.mark.slow


# --- The short column (Kuschel and Rackwitz 1997; Dakota, dakota_rbdo_short_column) ----------------------------------


@algebraic
def section(b, h, strength, loads):
    """A rectangular section of some yield stress under a moment and a normal force."""
    bending = 4 * loads["M"] / (b * h**2 * strength)
    return {"g": 1 - bending - (loads["P"] / (b * h * strength)) ** 2, "area": b * h}


def column(b, h):
    loads = al.correlated({"P": al.Normal(500.0, 100.0), "M": al.Normal(2000.0, 400.0)}, {("P", "M"): 0.5})
    return section(b, h, al.LogNormal(mean=5.0, std=0.5), loads)


def margin(column):
    return column.outputs()["g"]


def test_the_margin_of_a_column_has_its_moments():
    for sides, moments in {(5.0, 15.0): (-2.3413565, 1.0704223), (8.668, 25.0): (0.4735263, 0.1511655)}.items():
        expanded = al.expand(margin, column(*sides))
        assert (expanded.mean, expanded.std) == pytest.approx(moments, rel=1e-3)


def test_the_lightest_column_that_fails_as_seldom_as_wanted():
    # Exact by Gauss-Hermite over the loads, given which the probability is that of one lognormal number.
    wanted = 0.0062096653
    problem = al.Problem(
        column(al.Decision(5.0, 5.0, 15.0), al.Decision(15.0, 15.0, 25.0)),
        minimize=al.output("area").mean,
        subject_to=[al.output("g").probability(below=0.0) <= wanted],
    )
    solution = al.solve(problem)
    assert solution.objective == pytest.approx(216.20456, rel=3e-3)
    assert solution.at_bounds == ("h",)
    sample = al.references.monte_carlo(margin, column(solution.decisions["b"], solution.decisions["h"]), 10**6)
    found = sample.probability(below=0.0)
    assert abs(found.value - wanted) < 3 * found.standard_error


# --- The speed reducer (Golinski 1970; Yin and Chen 2006) ------------------------------------------------------------


def weight(x1, x2, x3, x4, x5, x6, x7):
    gear = 0.7854 * x1 * x2**2 * (3.3333 * x3**2 + 14.9334 * x3 - 43.0934)
    holes = 1.508 * x1 * (x6**2 + x7**2)
    return gear - holes + 7.4777 * (x6**3 + x7**3) + 0.7854 * (x4 * x6**2 + x5 * x7**2)


NAMES = [f"x{i}" for i in range(1, 8)]


class Reducer(al.AlgebraicSystem):
    """Seven dimensions; `ratio` writes the eighth limit as a quotient, as it is published, or else as a difference."""

    x1: al.Number
    x2: al.Number
    x3: al.Number
    x4: al.Number
    x5: al.Number
    x6: al.Number
    x7: al.Number
    ratio: bool

    def outputs(self):
        x1, x2, x3, x4, x5, x6, x7 = (getattr(self, name) for name in NAMES)
        limits = [
            27 / (x1 * x2**2 * x3) - 1,
            397.5 / (x1 * x2**2 * x3**2) - 1,
            1.93 * x4**3 / (x2 * x3 * x6**4) - 1,
            1.93 * x5**3 / (x2 * x3 * x7**4) - 1,
            jnp.sqrt((745 * x4 / (x2 * x3)) ** 2 + 16.9e6) / (0.1 * x6**3) - 1100,
            jnp.sqrt((745 * x5 / (x2 * x3)) ** 2 + 157.5e6) / (0.1 * x7**3) - 850,
            x2 * x3 - 40,
            5 - x1 / x2 if self.ratio else 5 * x2 - x1,
            x1 / x2 - 12,
            (1.5 * x6 + 1.9) / x4 - 1,
            (1.1 * x7 + 1.9) / x5 - 1,
        ]
        return {f"g{i}": limit for i, limit in enumerate(limits, 1)} | {"weight": weight(x1, x2, x3, x4, x5, x6, x7)}


BOUNDS = [(2.6, 3.6), (0.7, 0.8), (17.0, 28.0), (7.3, 8.3), (7.3, 8.3), (2.9, 3.9), (5.0, 5.5)]


def dimensions(means):
    return {name: al.Normal(mean, 0.005) for name, mean in zip(NAMES, means, strict=True)}


def reducer_problem(*, ratio: bool = True) -> al.Problem:
    means = [al.Decision((low + high) / 2, low, high) for low, high in BOUNDS]
    return al.Problem(
        Reducer(**dimensions(means), ratio=ratio),
        minimize=al.expressions.function(weight, *(al.value(f"{name}.mean") for name in NAMES)),
        subject_to=[al.output(f"g{i}").at_most(0.0, sigmas=3.0) for i in range(1, 12)],
        expansion=al.Expansion(order=2),
    )


def test_the_lightest_speed_reducer_under_tolerances():
    # By Gauss rules of three nodes in each of seven variables, and SLSQP.
    solution = al.solve(reducer_problem())
    assert solution.objective == pytest.approx(3039.24145, rel=1e-4)
    found = [solution.decisions[f"{name}.mean"] for name in NAMES]
    assert found == pytest.approx([3.577957, 0.7, 17.0, 7.3, 7.754026, 3.365101, 5.301593], rel=1e-4)
    assert solution.at_bounds == ("x2.mean", "x3.mean", "x4.mean")
    assert {one.name for one in solution.constraints if np.any(one.active)} == {"g5", "g6", "g8", "g11"}
    expanded = al.expand(
        lambda one: one.outputs()["weight"], Reducer(**dimensions(found), ratio=True), al.Expansion(order=2)
    )
    assert (expanded.mean, expanded.std) == pytest.approx((3039.32893, 23.4495), rel=1e-4)


def test_the_form_of_a_limit_moves_the_lightest_speed_reducer_and_without_tolerances_it_is_the_published_one():
    problem = reducer_problem(ratio=False)
    solution = al.solve(problem)
    assert solution.objective == pytest.approx(3038.664, rel=1e-5)
    assert solution.decisions["x1.mean"] == pytest.approx(3.576485, rel=1e-5)
    assert al.solve(al.deterministic(problem)).objective == pytest.approx(2994.471066, rel=1e-4)
