"""Fronts of several wishes against their closed forms, and against linear programs."""

import jax.numpy as jnp
import numpy as np
import pytest
import xarray

import aleator as al
from aleator.extending import save
from aleator.sweep._trade_off import efficient, hypervolume
from executors import pressed
from zoo import cases

HERE, THERE, ELSEWHERE = (1.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, 1.0)
VARIANCE = 3 * 0.1**2 / 3
IDLE = ((0.0, 0.0, 0.0), -1.0)


class Near(al.AlgebraicSystem):
    """A place in space, disturbed, and the squares of its distances from others, each times a factor."""

    place: al.Number
    others: al.Number
    factors: al.Number
    slopes: al.Number
    off: al.Number

    def outputs(self):
        named = {
            f"near{i}": factor * jnp.sum((self.place + self.off - one) ** 2)
            for i, (factor, one) in enumerate(zip(self.factors, self.others, strict=True))
        }
        return {**named, "row": self.slopes @ self.place, "x": self.place[0] + self.off}


def near(*others, factors=(1.0, 1.0, 1.0), row=IDLE):
    """Three places that one would like to be at, and a limit `slopes @ place >= bound`."""
    place, others = al.Decision(np.full(3, 0.4), -4.0, 4.0), np.array([*others, ELSEWHERE][:3])
    model = Near(place, others, np.array(factors), np.array(row[0]), al.Uniform(0.0, half_width=0.1))
    limit = (al.output("row").mean >= row[1]).named("row")
    return al.Problem(model, minimize=al.output("x").mean, subject_to=[limit])


WISHES = {"here": al.output("near0").mean, "there": al.output("near1").mean}
THREE = {**WISHES, "third/all": al.output("near2").mean}
POPULATION = {"method": "population", "evaluations": 400, "seed": 3}


def roots(values):
    """Distances from two places, from their mean squares; rounding may leave less than nothing."""
    return np.sqrt(np.maximum(values - VARIANCE, 0.0))


class Size(al.AlgebraicSystem):
    x: al.Number

    def outputs(self):
        return {"square": self.x**2, "reciprocal": 1 / self.x}


def test_a_convex_front_is_that_of_the_closed_form_and_weights_are_its_slopes():
    # Best between (1, 0, 0) and (0, 2, 0): on the line, where both distances add up to its length.
    found = al.trade_off(near(HERE, THERE), WISHES, 5)
    assert len(found.values) == 5
    np.testing.assert_allclose(roots(found.values).sum(axis=1), np.sqrt(5), rtol=1e-5, atol=2e-3)
    np.testing.assert_allclose(found.best, VARIANCE, atol=1e-5)
    np.testing.assert_allclose(found.worst, 5 + VARIANCE, rtol=1e-3)
    assert all(one.ok for one in found.solutions)
    assert "5 designs, each solved" in str(found)
    # √f + √g = √5, hence dg/df = -√(g/f); at the ends, where a front gets ever steeper, it is not known.
    first, second = roots(found.values[1:-1]).T
    np.testing.assert_allclose(found.weights[1:-1, 0] / found.weights[1:-1, 1], second / first, rtol=5e-3)
    assert np.isnan(found.weights[[0, -1]]).all()


@pytest.mark.slow
def test_three_wishes_fill_a_surface_that_is_saved_and_drawn(tmp_path):
    found = al.trade_off(near(np.eye(3)[0], np.eye(3)[1]), THREE, 10)
    assert len(found.values) >= 8
    # Best on the triangle between the places, of which each point is its own.
    places = np.array([one.decisions["place"] for one in found.solutions])
    np.testing.assert_allclose(places.sum(axis=1), 1.0, atol=2e-3)
    assert places.min() > -2e-3
    exact = ((places[:, None] - np.eye(3)) ** 2).sum(axis=2)
    np.testing.assert_allclose(found.values - VARIANCE, exact, atol=1e-5)
    save(tmp_path, front=found)
    with xarray.open_dataset(tmp_path / "results.nc", group="front", engine="h5netcdf") as kept:
        np.testing.assert_array_equal(kept["wish here"], found.values[:, 0])
        assert kept["wish there"].attrs["long_name"] == str(WISHES["there"])
    figure = al.reporting.pair_figure(found, 0, 2)
    np.testing.assert_array_equal([figure.data[0].x, figure.data[0].y], found.values[:, [0, 2]].T)


def test_designs_are_told_in_the_problem_that_was_given_and_keep_its_limits():
    found = al.trade_off(near(HERE, (-1.0, 0.0, 0.0), row=((0.0, 1.0, 0.0), 0.25)), WISHES, 3)
    middle = found.solutions[1]
    assert set(middle.decisions) == {"place"}
    np.testing.assert_allclose(middle.decisions["place"], [0.0, 0.25, 0.0], atol=1e-4)
    assert [one.name for one in middle.constraints] == ["row"]
    assert "trade-off" not in str(middle)
    assert middle.objective == pytest.approx(float(found.weights[1] @ found.values[1]))
    # Both wishes' slopes by the second coordinate are 1/2; their weights times it are the limit's price.
    assert middle.multiplier("row") == pytest.approx(0.5 * found.weights[1].sum(), rel=1e-5)


class Curve(al.AlgebraicSystem):
    """A front of two wishes, best at `b = 0`: `q = 1 + slope a + factor a**power + wave sin(4 π a)`, with `p = a`."""

    a: al.Number
    b: al.Number
    numbers: al.Number

    def outputs(self):
        slope, factor, power, wave = self.numbers
        q = 1.0 + slope * self.a + factor * self.a**power + wave * jnp.sin(4.0 * jnp.pi * self.a)
        return {"p": self.a, "q": q + self.b}


P, Q = al.output("p").mean, al.output("q").mean


def curve(points, slope=0.0, factor=0.0, power=1.0, wave=0.0, upper=1.0, **options):
    decisions = al.Decision(0.5 * upper, 0.0, upper), al.Decision(0.5, 0.0, 1.0)
    problem = al.Problem(Curve(*decisions, np.array([slope, factor, power, wave])), minimize=P)
    return al.trade_off(problem, {"p": P, "q": Q}, points, **options)


def test_a_concave_front_is_whole_although_a_slope_vanishes_at_its_end():
    # At p = 0 nothing tells that q falls with p.
    found = curve(7, factor=-1.0, power=2.0)
    assert len(found.values) == 7
    np.testing.assert_allclose(found.values[:, 1], 1.0 - found.values[:, 0] ** 2, atol=1e-4)
    assert np.diff(found.values[:, 0]).max() < 0.4
    inner = found.weights[1:-1]
    np.testing.assert_allclose(inner[:, 0] / inner[:, 1], 2.0 * found.values[1:-1, 0], rtol=1e-3, atol=1e-3)
    assert not found.holes


def test_no_end_of_a_front_is_dominated_where_a_slope_is_infinite():
    found = curve(5, factor=-1.0, power=0.5)
    np.testing.assert_allclose(found.values[:, 1], 1.0 - np.sqrt(np.maximum(found.values[:, 0], 0.0)), atol=1e-4)
    np.testing.assert_allclose(found.worst, 1.0, atol=1e-3)
    np.testing.assert_allclose(found.best, 0.0, atol=1e-6)
    # Weights at the ends of a line are those beside them.
    found = curve(3, slope=-0.5)
    np.testing.assert_allclose(found.weights[:, 0] / found.weights[:, 1], 0.5, rtol=1e-4)
    np.testing.assert_allclose(found.values[[0, -1]], [[0.0, 1.0], [1.0, 0.5]], atol=1e-5)


WAYS = {"boundary": {}, "population": POPULATION}


@pytest.mark.parametrize("way", cases(WAYS))
def test_both_parts_of_a_front_with_a_hole_are_found(way):
    found = curve(16, slope=-1.0, wave=-0.25, upper=0.7, **WAYS[way])
    a = np.linspace(0.0, 0.7, 200_001)
    q = 1.0 - a - 0.25 * np.sin(4.0 * np.pi * a)
    front, best = a[q <= np.minimum.accumulate(q)], np.minimum.accumulate(q)
    np.testing.assert_allclose(np.interp(found.values[:, 0], a, best), found.values[:, 1], atol=2e-3)
    end = int(np.argmax(np.diff(front)))
    assert found.values[0, 0] < front[end] < front[end + 1] < found.values[-1, 0] + 1e-9
    if way == "boundary":
        ((low, high),) = found.holes
        assert low == pytest.approx(front[end], abs=2e-3)
        assert 0.0 <= high - front[end + 1] < 0.05
        assert "no design was found between p = 0.15" in str(found)


@pytest.mark.usefixtures("python_interrupts")
@pytest.mark.parametrize(("stage", "after", "options"), cases([("trade-off", 2, {}), ("population", 200, POPULATION)]))
def test_ctrl_c_keeps_the_points_found(stage, after, options):
    found = al.trade_off(near(HERE, THERE), WISHES, 5, progress=pressed(stage, after), **options)
    assert found.interrupted
    assert 2 <= len(found.values) <= 5
    np.testing.assert_allclose(roots(found.values).sum(axis=1), np.sqrt(5), atol=2e-3)
    assert "interrupted" in str(found)


def test_the_hypervolume_of_boxes_is_their_union():
    points = np.array([[0.0, 2.0, 1.0], [1.0, 0.0, 2.0], [2.0, 1.0, 0.0], [5.0, 5.0, 5.0]])
    drawn = np.random.default_rng(0).uniform(0.0, 3.0, (400_000, 3))
    share = np.mean((drawn[:, None] >= points).all(axis=2).any(axis=1))
    assert hypervolume(points, np.full(3, 3.0)) == pytest.approx(27 * share, rel=0.01)
    assert hypervolume(points, np.zeros(3)) == 0.0
    np.testing.assert_array_equal(efficient(points, np.full(3, 1e-9)), [True, True, True, False])


def test_a_design_that_is_equal_in_one_wish_and_worse_in_another_is_dominated():
    points = np.array([[0.0, 1.0], [0.0, 2.0], [1.0, 0.0], [1.0, 1e-4]])
    assert efficient(points, np.full(2, 1e-2)).tolist() == [True, False, True, True]
    assert efficient(points, np.full(2, 1e-5)).tolist() == [True, False, True, False]


def test_the_ends_of_a_front_over_many_magnitudes_are_the_best_designs_of_the_wishes():
    """Of x² and 1/x for x from 1e-3 to 1e3."""
    problem = al.Problem(Size(al.Decision(10.0, 1e-3, 1e3)), minimize=al.output("square").mean)
    front = al.trade_off(problem, {name: al.output(name).mean for name in ("square", "reciprocal")}, 4)
    assert front.values[[0, -1]] == pytest.approx(np.array([[1e-6, 1e3], [1e6, 1e-3]]), rel=2e-3)
