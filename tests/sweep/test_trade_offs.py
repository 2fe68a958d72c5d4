"""Fronts of several wishes against their closed forms, and against linear programs."""

import signal
import sys

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from scipy.optimize import linprog

import aleator as al
from aleator.extending import save
from aleator.sweep._hypervolume import efficient, hypervolume

X, Y, Z = (al.output(name) for name in "xyz")


class Plane(al.AlgebraicSystem):
    """Three decisions, disturbed; and a wave of the first."""

    a: al.Number
    b: al.Number
    c: al.Number
    off: al.Number

    def outputs(self):
        x = self.a + self.off
        wave = 1.0 - jnp.sqrt(self.a) - self.a * jnp.sin(10 * jnp.pi * self.a) + self.b**2
        return {"x": x, "y": self.b + self.off, "z": self.c + self.off, "wave": wave * (1.0 + self.off)}


def plane(*limits, lower=-4.0, upper=4.0, start=0.5, spread=0.1):
    decisions = (al.Decision(start, lower, upper) for _ in "abc")
    return al.Problem(Plane(*decisions, al.Uniform(0.0, half_width=spread)), minimize=X.mean, subject_to=limits)


def near(*place):
    """The mean square of the distance from a place: `|p - place|²` and the variance of the disturbance."""
    means = [one.mean for one in (X, Y, Z)]
    spread = X.variance + Y.variance + Z.variance
    return sum(((mean - at) ** 2 for mean, at in zip(means, place, strict=True)), start=spread)


VARIANCE = 3 * 0.1**2 / 3


def area(first, second):
    """The volume that a densely known front dominates, up to its own ends."""
    order = np.argsort(first)
    first, second = first[order], second[order]
    return float(np.sum(np.diff(first) * (second[0] - (second[1:] + second[:-1]) / 2)))


@pytest.mark.parametrize("method", ["boundary", "limits", "weights"])
def test_a_convex_front_is_that_of_the_closed_form(method):
    # Best between (1, 0, 0) and (0, 2, 0): on the line, where the roots of both add up to its length.
    found = al.trade_off(plane(), {"here": near(1, 0, 0), "there": near(0, 2, 0)}, 9, method=method)
    assert len(found.values) == 9
    roots = np.sqrt(np.maximum(found.values - VARIANCE, 0.0))  # rounding may leave less than nothing
    np.testing.assert_allclose(roots.sum(axis=1), np.sqrt(5), rtol=1e-5, atol=2e-3)
    np.testing.assert_allclose(found.best, VARIANCE, atol=1e-5)
    np.testing.assert_allclose(found.worst, 5 + VARIANCE, rtol=1e-3)
    assert all(one.ok for one in found.solutions)
    assert "9 designs, each solved" in str(found)


@pytest.mark.parametrize("method", ["boundary", "limits"])
def test_weights_are_the_slopes_of_the_front(method):
    found = al.trade_off(plane(), {"here": near(1, 0, 0), "there": near(0, 2, 0)}, 9, method=method)
    for (first, second), (one, other) in zip(found.values[1:-1], found.weights[1:-1], strict=True):
        # √f + √g = √5, hence dg/df = -√(g/f).
        assert one / other == pytest.approx(np.sqrt((second - VARIANCE) / (first - VARIANCE)), rel=5e-3)


def test_a_concave_front_is_found_and_weights_cannot():
    # Fonseca and Fleming 1995: 1 - exp(-|x ∓ 1/√3|²), best on the diagonal.
    def bell(sign):
        place = sign / np.sqrt(3)
        square = sum(((one.mean - place) ** 2 for one in (X, Y, Z)), start=0.0)
        return al.expressions.function(lambda s: 1.0 - jnp.exp(-s), square)

    wishes = {"plus": bell(1.0), "minus": bell(-1.0)}
    t = np.linspace(-1.0, 1.0, 20001)
    plus, minus = 1 - np.exp(-((t - 1) ** 2)), 1 - np.exp(-((t + 1) ** 2))
    exact = area(plus, minus)
    found = al.trade_off(plane(), wishes, 60)
    np.testing.assert_allclose(
        np.interp(found.values[::-1, 0], plus[::-1], minus[::-1]), found.values[::-1, 1], atol=1e-4
    )
    assert found.hypervolume([plus.max(), minus.max()]) == pytest.approx(exact, rel=0.03)
    assert np.abs(np.diff(found.values, axis=0)).max() < 0.1
    weighted = al.trade_off(plane(), wishes, 15, method="weights")
    assert np.abs(np.diff(weighted.values, axis=0)).max() > 0.5


@pytest.mark.parametrize("way", [{"starts": 12}, {"method": "population", "seed": 1}], ids=["starts", "population"])
def test_a_front_with_holes_is_found_on_all_its_parts(way):
    # Zitzler, Deb and Thiele's third function (2000): five parts.
    problem = plane(lower=1e-3, upper=1.0, start=0.4)
    found = al.trade_off(problem, {"a": al.value("a"), "wave": al.output("wave").mean}, 40, **way)
    a = np.linspace(1e-3, 1.0, 200001)
    wave = 1 - np.sqrt(a) - a * np.sin(10 * np.pi * a) + 1e-6
    points = np.stack([a, wave], axis=1)
    best = np.minimum.accumulate(wave)
    front = points[wave <= best]
    on_front = [np.abs(front - one).max(axis=1).min() for one in found.values]
    assert np.mean(np.array(on_front) < 2e-3) > 0.9
    holes = np.flatnonzero(np.diff(front[:, 0]) > 0.01)
    parts = np.split(front[:, 0], holes + 1)
    assert len(parts) == 5
    for part in parts:
        assert ((found.values[:, 0] >= part[0] - 1e-3) & (found.values[:, 0] <= part[-1] + 1e-3)).any()


def test_three_wishes_fill_a_surface():
    wishes = {"first": near(1, 0, 0), "second": near(0, 1, 0), "third": near(0, 0, 1)}
    found = al.trade_off(plane(), wishes, 24)
    assert len(found.values) >= 18
    # Best on the triangle between the places, of which each point is its own.
    roots = found.values - VARIANCE
    for one, solution in zip(roots, found.solutions, strict=True):
        place = np.array([solution.decisions[name] for name in "abc"])
        assert place.sum() == pytest.approx(1.0, abs=2e-3)
        assert place.min() > -2e-3
        np.testing.assert_allclose(one, ((place - np.eye(3)) ** 2).sum(axis=1), atol=1e-5)


def polygon(seed):
    """Random limits on two wishes, x and y, which some designs meet; one of them is parallel to an axis."""
    generator = np.random.default_rng(seed)
    while True:
        slopes, bounds = -generator.uniform(0.1, 1.0, (3, 2)), -generator.uniform(0.5, 2.0, 3)
        slopes[generator.integers(3)] = [[-1.0, 0.0], [0.0, -1.0]][generator.integers(2)]
        if (slopes.sum(axis=1) * 4.0 < bounds).all():
            return slopes, bounds


def improvable(slopes, bounds, point):
    """By how much a linear program lowers the sum of both wishes, none being worse than at a point."""
    found = linprog([1.0, 1.0], A_ub=slopes, b_ub=bounds, bounds=[(-4, point[0] + 1e-9), (-4, point[1] + 1e-9)])
    return point.sum() - found.fun if found.status == 0 else 0.0


def check_efficiency(seed):
    slopes, bounds = polygon(seed)
    limits = [
        (float(one[0]) * X.mean + float(one[1]) * Y.mean <= float(bound)).named(f"limit {i}")
        for i, (one, bound) in enumerate(zip(slopes, bounds, strict=True))
    ]
    for method in ("boundary", "limits"):
        found = al.trade_off(plane(*limits), {"x": X.mean, "y": Y.mean}, 6, method=method)
        assert len(found.values) >= 1
        for point in found.values:
            assert improvable(slopes, bounds, point) < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_no_point_is_weakly_efficient(seed):
    check_efficiency(seed)


@pytest.mark.slow
def test_no_point_of_twenty_random_fronts_is_weakly_efficient():
    for seed in range(4, 24):
        check_efficiency(seed)


def test_wishes_that_do_not_conflict_have_one_best_design():
    found = al.trade_off(plane(), {"here": near(1, 0, 0), "twice": 2.0 * near(1, 0, 0)}, 9)
    assert len(found.values) == 1
    assert "do not conflict" in str(found)


def test_wishes_of_any_size_and_name_have_the_same_front():
    plain = al.trade_off(plane(), {"here": near(1, 0, 0), "there": near(0, 2, 0)}, 5)
    scaled = al.trade_off(plane(), {"level": 1e9 * near(1, 0, 0), "weighted": 1e-9 * near(0, 2, 0)}, 5)
    np.testing.assert_allclose(scaled.values * [1e-9, 1e9], plain.values, rtol=1e-3, atol=1e-4)
    assert scaled.dominated == 0


def test_a_front_respects_the_limits_of_the_problem():
    found = al.trade_off(plane((Y.mean <= 0.5).named("low")), {"here": near(1, 0, 0), "there": near(0, 2, 0)}, 6)
    assert max(one.decisions["b"] for one in found.solutions) <= 0.5 + 1e-6


def test_a_population_respects_limits_and_is_the_same_for_the_same_seed():
    problem = plane((al.output("x").mean >= 0.1).named("limit"))
    wishes = {"first": near(1, 0, 0), "second": near(0, 1, 0)}
    both = [al.trade_off(problem, wishes, 6, method="population", evaluations=400, seed=3) for _ in range(2)]
    np.testing.assert_array_equal(both[0].values, both[1].values)
    for one in both[0].solutions:
        assert one.ok
        assert one.decisions["a"] >= 0.1 - 1e-6


def test_a_population_needs_bounds_and_its_library(monkeypatch):
    with pytest.raises(al.ProblemError, match=r"of which \['a', 'b', 'c'\] have none"):
        al.trade_off(plane(lower=-np.inf), {"one": near(1, 0, 0), "two": near(0, 1, 0)}, method="population")
    monkeypatch.setitem(sys.modules, "pymoo.algorithms.moo.nsga2", None)
    with pytest.raises(al.MissingExtraError, match=r"aleator\[fronts\]"):
        al.trade_off(plane(), {"one": near(1, 0, 0), "two": near(0, 1, 0)}, method="population")


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_keeps_the_points_found():
    def stop(task, done, total):
        if task == "trade-off" and done == 2:
            signal.raise_signal(signal.SIGINT)

    found = al.trade_off(plane(), {"here": near(1, 0, 0), "there": near(0, 2, 0)}, 30, progress=stop)
    assert found.interrupted
    assert 2 <= len(found.values) < 10
    assert "interrupted" in str(found)


def test_a_front_is_saved_and_drawn(tmp_path):
    wishes = {"first": near(1, 0, 0), "second": near(0, 1, 0), "third/all": near(0, 0, 1)}
    found = al.trade_off(plane(), wishes, 9)
    save(tmp_path, front=found)
    with xarray.open_dataset(tmp_path / "results.nc", group="front", engine="h5netcdf") as kept:
        np.testing.assert_array_equal(kept["wish first"], found.values[:, 0])
        assert kept["wish second"].attrs["long_name"] == str(wishes["second"])
        np.testing.assert_array_equal(kept["decision a"], [one.decisions["a"] for one in found.solutions])
    figures = al.reporting.trade_off_figure(found)
    assert len(figures) == 3
    np.testing.assert_array_equal(figures[0].data[0].x, found.values[:, 0])
    assert figures[2].layout.yaxis.title.text == "third/all"


def test_the_hypervolume_of_boxes_is_their_union():
    points = np.array([[0.0, 2.0, 1.0], [1.0, 0.0, 2.0], [2.0, 1.0, 0.0], [5.0, 5.0, 5.0]])
    generator = np.random.default_rng(0)
    drawn = generator.uniform(0.0, 3.0, (400_000, 3))
    share = np.mean((drawn[:, None] >= points).all(axis=2).any(axis=1))
    assert hypervolume(points, np.full(3, 3.0)) == pytest.approx(27 * share, rel=0.01)
    assert hypervolume(points, np.zeros(3)) == 0.0
    np.testing.assert_array_equal(efficient(points, np.full(3, 1e-9)), [True, True, True, False])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda: al.trade_off(plane(), {"one": X.mean}), "wishes: expected two expressions or more by name"),
        (lambda: al.trade_off(plane(), {"one": X.mean, "two": X}), "wish 'two': expected Expression"),
        (lambda: al.trade_off(plane(), {"one": X.mean, "two": Y.mean}, 1), "points is a whole number of at least 2"),
        (
            lambda: al.trade_off(plane(), {"one": X.mean, "two": Y.mean}, method="best"),
            '"weights" or "population"',
        ),
        (
            lambda: al.trade_off(plane((X.mean + Y.mean >= 20.0).named("much")), {"one": X.mean, "two": Y.mean}),
            "much",
        ),
        (
            lambda: al.trade_off(plane(), {"one": X.mean, "two": Y.mean}).hypervolume([1.0]),
            "2 finite numbers, one a wish",
        ),
    ],
)
def test_what_is_no_trade_off_is_refused(wrong, words):
    with pytest.raises(al.ProblemError, match=words):
        wrong()


class Decay(al.System):
    """A decay towards zero, whose speed has its price."""

    states = ("x",)

    rate: al.Number

    def initial(self):
        return {"x": 1.0}

    def rhs(self, t, z):
        return (-self.rate * z.x,)

    def outputs(self, t, z):
        return {"x": z.x, "effort": self.rate**2 * z.x}


def test_a_front_of_a_dynamical_system_is_that_of_limits_one_by_one():
    rest, effort = al.terminal("x").mean, al.integral("effort").mean
    problem = al.Problem(
        Decay(al.Uniform(al.Decision(1.0, 0.1, 3.0), half_width=0.05)), grid=al.Grid(1.0, 40), minimize=rest
    )
    found = al.trade_off(problem, {"rest": rest, "effort": effort}, 7)
    limited = al.Problem(problem.system, grid=problem.grid, minimize=rest, subject_to=[(effort <= 1.0).named("effort")])
    front = al.pareto(limited, "effort", found.values[:, 1])
    by_limit = dict(zip(front.values, front.objectives, strict=True))
    np.testing.assert_allclose([by_limit[one] for one in found.values[:, 1]], found.values[:, 0], atol=1e-5)
    inner = found.weights[1:-1]
    prices = dict(zip(front.values, front.shadow_prices, strict=True))
    for values, weights in zip(found.values[1:-1], inner, strict=True):
        assert weights[1] / weights[0] == pytest.approx(prices[values[1]], rel=1e-2)
