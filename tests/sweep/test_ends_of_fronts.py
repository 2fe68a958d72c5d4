"""Ends, holes and edges of fronts against their closed forms, and what of them is told or refused."""

import signal

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.sweep._places import box, simplex

X, Y, Z = (al.output(name) for name in "xyz")


class Space(al.AlgebraicSystem):
    """Three decisions, disturbed."""

    unknowns = ()
    a: al.Number
    b: al.Number
    c: al.Number
    off: al.Number

    def outputs(self):
        return {"x": self.a + self.off, "y": self.b + self.off, "z": self.c + self.off}


def space(*limits, lower=-4.0, upper=4.0, start=0.5, minimize=X.mean, decisions=None):
    a, b, c = (al.Decision(start, lower, upper) for _ in "abc")
    system = Space(a, b, c, al.Uniform(0.0, half_width=0.1))
    return al.Problem(system, minimize=minimize, subject_to=limits, decisions=decisions)


def near(a, b):
    return (X.mean - a) ** 2 + (Y.mean - b) ** 2


HERE, THERE = near(1.0, 0.0), near(-1.0, 0.0)


def test_a_concave_front_is_whole_although_a_slope_vanishes_at_its_end():
    # Best at b = 0, on q = 1 - p²; at p = 0 nothing tells that q falls with p.
    found = al.trade_off(space(lower=0.0, upper=1.0), {"p": X.mean, "q": 1.0 - X.mean**2 + Y.mean}, 8)
    assert len(found.values) == 8
    np.testing.assert_allclose(found.values[:, 1], 1.0 - found.values[:, 0] ** 2, atol=1e-4)
    assert np.diff(found.values[:, 0]).max() < 0.4
    # dq/dp = -2p.
    inner = found.weights[1:-1]
    np.testing.assert_allclose(inner[:, 0] / inner[:, 1], 2.0 * found.values[1:-1, 0], rtol=1e-3, atol=1e-3)
    assert not found.holes


def test_a_hole_of_a_front_is_told():
    def fall(a):
        return 1.0 - a - 0.25 * jnp.sin(4.0 * jnp.pi * a)

    wishes = {"p": X.mean, "q": al.expressions.function(fall, X.mean)}
    found = al.trade_off(space(lower=0.0, upper=0.7), wishes, 20)
    a = np.linspace(0.0, 0.7, 200_001)
    q = np.asarray(fall(a))
    front = a[q <= np.minimum.accumulate(q)]
    end = int(np.argmax(np.diff(front)))
    ((low, high),) = found.holes
    assert low == pytest.approx(front[end], abs=2e-3)
    assert 0.0 <= high - front[end + 1] < 0.03
    assert "no design was found between p = 0.15" in str(found)


@pytest.mark.parametrize("method", ["weights", "boundary"])
def test_no_end_of_a_front_is_dominated_where_a_slope_is_infinite(method):
    # Best at b = 0, on q = 1 - √p.
    wishes = {"p": X.mean, "q": 1.0 - X.mean**0.5 + Y.mean}
    found = al.trade_off(space(lower=0.0, upper=1.0), wishes, 5, method=method)
    np.testing.assert_allclose(found.values[:, 1], 1.0 - np.sqrt(np.maximum(found.values[:, 0], 0.0)), atol=1e-4)
    np.testing.assert_allclose(found.worst, 1.0, atol=1e-3)
    np.testing.assert_allclose(found.best, 0.0, atol=1e-6)


def test_a_flat_wish_is_at_its_best_at_its_end():
    found = al.trade_off(space(), {"p": (X.mean - 1.0) ** 8 + Y.mean**2, "q": (X.mean + 1.0) ** 2 + Y.mean**2}, 5)
    np.testing.assert_allclose(found.best, 0.0, atol=1e-7)
    # Within the tolerance of solvers the eighth power leaves a distance of a tenth.
    assert found.worst[1] == pytest.approx(4.0, rel=0.06)
    assert found.worst[0] == pytest.approx(256.0, rel=1e-3)


def test_a_wish_that_is_flat_far_away_is_sought_from_the_best_design_of_another():
    # From here the first step for one of the bells leads far out, where both are flat.
    def bell(sign):
        means = (one.mean for one in (X, Y, Z))
        square = sum(((one - sign / np.sqrt(3)) ** 2 for one in means), start=0.0 * X.mean)
        return al.expressions.function(lambda s: 1.0 - jnp.exp(-s), square)

    found = al.trade_off(space(start=0.4), {"plus": bell(1.0), "minus": bell(-1.0)}, 3)
    np.testing.assert_allclose(found.best, 0.0, atol=1e-6)
    np.testing.assert_allclose(found.worst, 1.0 - np.exp(-4.0), rtol=1e-3)
    np.testing.assert_allclose(found.values[1], 1.0 - np.exp(-1.0), rtol=1e-4)


def test_weights_at_the_ends_are_those_beside_them():
    found = al.trade_off(space((X.mean + 2.0 * Y.mean >= 1.0).named("line")), {"p": X.mean, "q": Y.mean}, 4)
    np.testing.assert_allclose(found.weights[:, 0] / found.weights[:, 1], 0.5, rtol=1e-4)
    np.testing.assert_allclose(found.values[[0, -1]], [[-4.0, 2.5], [4.0, -1.5]], atol=1e-5)


def test_weights_are_unknown_where_a_front_gets_ever_steeper():
    found = al.trade_off(space(), {"here": HERE, "there": THERE}, 3)
    assert np.isnan(found.weights[[0, -1]]).all()
    assert found.weights[1, 0] == pytest.approx(found.weights[1, 1], rel=1e-3)


def test_designs_are_told_in_the_problem_that_was_given():
    problem = space((Y.mean >= 0.25).named("high"))
    found = al.trade_off(problem, {"here": HERE, "there": THERE}, 3)
    middle = found.solutions[1]
    assert set(middle.decisions) == {"a", "b", "c"}
    assert middle.vector.shape == (3,)
    assert [one.name for one in middle.constraints] == ["high"]
    assert "trade-off" not in str(middle)
    assert middle.objective == pytest.approx(float(found.weights[1] @ found.values[1]))
    # Both wishes' slopes by b are 2b; their weights times it are the limit's price.
    assert middle.multiplier("high") == pytest.approx(0.5 * found.weights[1].sum(), rel=1e-5)
    again = al.solve(middle.problem, warm_start=middle)
    assert again.decisions["a"] == pytest.approx(0.0, abs=1e-5)
    # A further front of such a problem begins with the given one's limits alone.
    further = al.trade_off(middle.problem, {"here": HERE, "up": near(0.0, 1.0)}, 3)
    # Best between (1, 1/4) and (0, 1).
    np.testing.assert_allclose(further.worst, [2.0, 1.0 + 0.75**2], rtol=1e-3)


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        (
            lambda: space(decisions={"trade-off.level": al.Decision(1.0)}),
            r"'trade-off\.level' is one of trade_off's own",
        ),
        (lambda: space((X.mean <= 1.0).named("trade-off: wish here")), "one of trade_off's own"),
        (lambda: al.soft(space((X.mean <= 1.0).named("low")), weight=9.0, exact=True), r"al\.value\('low\.excess'\)"),
        (
            lambda: al.Problem(Space(0.0, 0.0, 0.0, al.Uniform(0.0, half_width=0.1)), minimize=X.mean),
            "no decisions",
        ),
    ],
)
def test_problems_whose_front_would_be_wrong_are_refused(problem, words):
    with pytest.raises(al.ProblemError, match=words):
        al.trade_off(problem(), {"here": HERE, "there": THERE}, 3)


def test_the_excess_of_a_soft_limit_may_be_a_wish():
    problem = al.soft(space((X.mean <= 1.0).named("low")), weight=9.0, exact=True)
    found = al.trade_off(problem, {"far": near(2.0, 0.0), "excess": al.value("low.excess")}, 3)
    # (2 - a)² with a = 1 + excess.
    np.testing.assert_allclose(found.values[:, 0], (1.0 - found.values[:, 1]) ** 2, atol=1e-3)
    np.testing.assert_allclose(found.worst, [1.0, 1.0], atol=1e-3)


@pytest.mark.parametrize("still", [X.std, 0.0 * X.mean + 3.0])
def test_a_wish_that_no_decision_changes_is_refused(still):
    with pytest.raises(al.ProblemError, match="wish 'still': no decision changes it"):
        al.trade_off(space(), {"here": HERE, "still": still}, 3)


def test_equal_wishes_do_not_conflict():
    found = al.trade_off(space(), {"one": HERE, "other": HERE}, 5)
    assert len(found.values) == 1
    assert "do not conflict" in str(found)


def test_names_of_several_lines_are_refused():
    with pytest.raises(al.ProblemError, match="a name of one line"):
        al.trade_off(space(), {"here\nand": HERE, "there": THERE}, 3)


def test_columns_of_a_printed_front_are_apart():
    values = np.array([[-8.88178e-16, -8.88178e-16], [-1.23456e-100, 1.0]])
    front = al.results.TradeOff(("p", "q"), (HERE, THERE), values, (), values[0], values[0], values)
    assert [len(row.split()) for row in str(front).splitlines()[:3]] == [2, 2, 2]


def test_fronts_of_anchors_that_coincide_are_filled():
    # r = 3 - a - b - c, best at c = 1: the plane p + q + r = 2, on which both p and q are best at one corner.
    wishes = {"p": X.mean, "q": Y.mean, "r": 3.0 - X.mean - Y.mean - Z.mean}
    found = al.trade_off(space(lower=0.0, upper=1.0), wishes, 8)
    assert len(found.values) == 8
    np.testing.assert_allclose(found.values.sum(axis=1), 2.0, atol=1e-4)
    assert np.ptp(found.values[:, 0] - found.values[:, 1]) > 0.5


def test_three_wishes_have_as_many_designs_as_were_asked_for():
    assert [len(simplex(3, count)) for count in range(1, 20)] == list(range(1, 20))
    for one in simplex(4, 12):
        assert one.sum() == pytest.approx(1.0)
    # Lines in the direction of the diagonal that meet the unit cube.
    for one in box(3, 6):
        low, high = np.max(-one), np.min(1.0 - one)
        assert low < high


@pytest.mark.usefixtures("python_interrupts")
@pytest.mark.parametrize("after", [1, 2])
def test_ctrl_c_while_the_best_of_each_wish_is_sought_keeps_those_found(after):
    def stop(task, done, total):
        if task == "best of each wish" and done == after:
            signal.raise_signal(signal.SIGINT)

    wishes = {"one": HERE, "two": THERE, "three": near(0.0, 1.0)}
    found = al.trade_off(space(), wishes, 12, progress=stop)
    assert found.interrupted
    assert len(found.values) == after
    np.testing.assert_allclose(np.sort(found.best[:after]), 0.0, atol=1e-6)
    assert np.isnan(found.best[after:]).all()
    assert "interrupted" in str(found)
    assert "do not conflict" not in str(found)


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_in_a_population_keeps_its_designs():
    def stop(task, done, total):
        if task == "population" and done > 200:
            signal.raise_signal(signal.SIGINT)

    found = al.trade_off(space(), {"here": HERE, "there": THERE}, 5, method="population", progress=stop)
    assert found.interrupted
    assert len(found.values) == 5
    # √p + √q = 2.
    np.testing.assert_allclose(np.sqrt(np.maximum(found.values, 0.0)).sum(axis=1), 2.0, atol=1e-3)


@pytest.mark.parametrize("reference", [["a", "b"], [1j, 1.0], [np.nan, 1.0], [np.inf, 1.0], [1.0], 3.0])
def test_a_reference_that_is_no_point_is_refused(reference):
    values = np.array([[0.0, 1.0], [1.0, 0.0]])
    front = al.results.TradeOff(("p", "q"), (HERE, THERE), values, (), values.min(0), values.max(0), values)
    assert front.hypervolume([2.0, 2.0]) == pytest.approx(3.0)
    with pytest.raises(al.ProblemError, match="2 finite numbers, one a wish"):
        front.hypervolume(reference)
