"""Limits that cannot hold together: irreducible sets, checked by linear programs, and what relaxing them would cost."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog

import aleator as al

X, Y, Z = (al.output(name) for name in "xyz")


class Plane(al.AlgebraicSystem):
    """Three decisions, as outputs that a disturbance moves a little."""

    a: al.Number
    b: al.Number
    c: al.Number
    off: al.Number

    def outputs(self):
        return {"x": self.a + self.off, "y": self.b + self.off, "z": self.c + self.off}


def plane(*limits, bound=10.0):
    decisions = (al.Decision(0.5, -bound, bound) for _ in "abc")
    return al.Problem(
        Plane(*decisions, al.Uniform(0.0, half_width=0.1)),
        minimize=(X.mean - 1.0) ** 2 + Y.mean**2 + Z.mean**2,
        subject_to=limits,
    )


def test_two_limits_that_contradict_each_other_are_named_alone():
    found = al.conflict(
        plane(
            (X.mean + Y.mean <= 1.0).named("budget"),
            (X.mean + Y.mean + 0.0 * Z.mean >= 3.0).named("need"),
            (Z.mean <= 2.0).named("other"),
        )
    )
    assert found.names == ("budget", "need")
    # Each is off by 2 in its own unit, whatever its size.
    np.testing.assert_allclose([one.relaxed for one in found.limits], 2.0, rtol=1e-5)
    assert "budget" in str(found)
    assert "other" not in str(found)


def test_three_limits_of_which_any_two_hold():
    found = al.conflict(
        plane(
            (X.mean - Y.mean >= 1.0).named("first"),
            (Y.mean - Z.mean >= 1.0).named("second"),
            (Z.mean - X.mean >= 1.0).named("third"),
            (X.mean <= 5.0).named("idle"),
        )
    )
    assert set(found.names) == {"first", "second", "third"}
    np.testing.assert_allclose([one.relaxed for one in found.limits], 3.0, rtol=1e-5)


def test_bounds_of_decisions_in_the_way_are_named():
    found = al.conflict(plane((X.mean + Y.mean >= 3.0).named("need"), bound=1.0))
    assert found.names == ("need",)
    assert found.limits[0].relaxed == pytest.approx(1.0, rel=1e-5)
    assert set(found.decisions) == {"a", "b"}


def test_limits_that_hold_together_are_no_conflict():
    found = al.conflict(plane((X.mean + Y.mean <= 1.0).named("budget"), (X.mean >= 0.5).named("need")))
    assert found.names == ()
    assert found.least == 0.0
    assert "can hold together" in str(found)


def test_a_limit_that_two_others_break_apart_cannot_be_helped_alone():
    found = al.conflict(
        plane(
            (X.mean <= 1.0).named("x below"),
            (X.mean + 0.0 * Y.mean >= 2.0).named("x above"),
            (Y.mean <= 1.0).named("y below"),
            (Y.mean + 0.0 * Z.mean >= 2.0).named("y above"),
        )
    )
    assert len(found.limits) == 2
    assert all(np.isinf(one.relaxed) for one in found.limits)
    assert "not enough" in str(found)


def drawn(seed):
    """Random limits on three outputs between bounds, of which no point meets all, as arrays."""
    generator = np.random.default_rng(seed)
    while True:
        count = int(generator.integers(4, 9))
        slopes, bounds = generator.normal(size=(count, 3)), generator.normal(size=count) - 0.3
        if not holds(slopes, bounds, range(count)):
            return slopes, bounds


def holds(slopes, bounds, rows):
    rows = list(rows)
    found = linprog(np.zeros(3), A_ub=slopes[rows], b_ub=bounds[rows], bounds=(-10.0, 10.0))
    return found.status == 0


@pytest.mark.parametrize("seed", range(10))
def test_the_set_is_irreducible_by_linear_programs(seed):
    slopes, bounds = drawn(seed)
    limits = [
        (one[0] * X.mean + one[1] * Y.mean + one[2] * Z.mean <= float(bound)).named(f"limit {i}")
        for i, (one, bound) in enumerate(zip(slopes, bounds, strict=True))
    ]
    found = al.conflict(plane(*limits))
    members = [int(name.removeprefix("limit ")) for name in found.names]
    assert members
    assert not holds(slopes, bounds, members)
    for one in members:
        assert holds(slopes, bounds, set(members) - {one})
    for one, limit in zip(members, found.limits, strict=True):
        others = [i for i in range(len(bounds)) if i != one]
        nearest = linprog(slopes[one], A_ub=slopes[others], b_ub=bounds[others], bounds=(-10.0, 10.0))
        needed = nearest.fun - bounds[one] if nearest.status == 0 else np.inf
        assert limit.relaxed == pytest.approx(needed, rel=1e-4)


class Edge(al.AlgebraicSystem):
    """Not a number on one side of an edge."""

    a: al.Number
    off: al.Number

    def outputs(self):
        return {"x": self.a + self.off, "root": jnp.sqrt(self.a - 0.5) + 0.0 * self.off}


@pytest.mark.parametrize("limit", [0.1, 0.5])
def test_limits_that_hold_next_to_an_edge_are_no_conflict(limit):
    root = al.output("root").mean
    found = al.conflict(
        al.Problem(
            Edge(al.Decision(0.9, 0.0, 2.0), al.Uniform(0.0, half_width=0.1)),
            minimize=X.mean,
            subject_to=[(root <= limit).named("root"), (X.mean <= 0.55).named("x")],
        )
    )
    assert found.names == ()
    assert 0.5 <= found.nearest["a"] <= 0.55 + 1e-6


class Decay(al.System):
    states = ("x",)

    rate: al.Number
    start: al.Number

    def initial(self):
        return {"x": self.start}

    def rhs(self, t, z):
        return (-self.rate * z.x,)

    def outputs(self, t, z):
        return {"x": z.x, "late": jnp.where(t > 0.9, z.x, 1.0)}


def test_instants_and_statistics_of_limits_over_time_are_named():
    x = al.path("x")
    problem = al.Problem(
        Decay(al.Uniform(al.Decision(1.0, 0.01, 5.0), half_width=0.005), al.Decision(1.0, 0.5, 2.0)),
        grid=al.Grid(1.0, 20),
        minimize=al.terminal("x").mean,
        subject_to=[
            x.at_most(1.0, sigmas=1.0).named("start low"),
            al.terminal("x").at_least(0.95, sigmas=1.0).named("end high"),
            (al.value("rate.mean") + 0.0 * al.terminal("x").mean >= 0.5).named("fast"),
        ],
    )
    found = al.conflict(problem)
    assert set(found.names) == {"start low", "end high", "fast"}
    low = next(one for one in found.limits if one.name == "start low")
    assert low.times == pytest.approx((0.0,))
    assert "t = 0 s" in str(found)
    # From x(0) = 1 at the rate of 0.5: the end misses 0.95 by this much.
    rates = np.linspace(0.495, 0.505, 2001)
    end = np.exp(-rates)
    needed = 0.95 - (np.mean(end) - np.std(end))
    high = next(one for one in found.limits if one.name == "end high")
    assert high.relaxed == pytest.approx(needed, rel=1e-3)
    with pytest.raises(al.SolveError, match=r"al\.conflict"):
        al.solve(problem)


def test_limits_on_realisations_name_the_systems_in_the_way():
    above, below = (X.at_most(1.0, worst_case=True).named("above"), X.at_least(0.9, at_points=True).named("below"))
    found = al.conflict(plane(above, below))
    assert found.names == ("above", "below")
    named = {one.name: [system["off"] for system in one.systems] for one in found.limits}
    # The highest of all systems, and the lowest of those at the collocation points.
    np.testing.assert_allclose(named["above"], 0.1)
    (lowest,) = named["below"]
    assert -0.1 < lowest < -0.08
    assert found.limits[0].relaxed == pytest.approx(0.9 - lowest + 0.1 - 1.0, rel=1e-4)
    assert "with off = 0.1" in str(found)


def test_limits_on_statistics_name_no_system():
    found = al.conflict(
        plane((X.mean <= 1.0).named("above"), (X.mean >= 2.0).named("below"), Y.at_most(9.0, worst_case=True))
    )
    assert [one.systems for one in found.limits] == [(), ()]


LOW = (al.expressions.function(jnp.log, X.mean) <= -1.0).named("log")


def from_nowhere(*limits):
    """The model is finite neither at the start nor in the middle of the decisions' range."""
    decisions = al.Decision(-1.0, -4.0, 4.0), al.Decision(0.5, -4.0, 4.0), al.Decision(0.5, -4.0, 4.0)
    return al.Problem(Plane(*decisions, al.Uniform(0.0, half_width=0.1)), minimize=Y.mean**2, subject_to=limits)


def test_where_the_start_is_not_finite_searches_begin_elsewhere():
    free = al.conflict(from_nowhere(LOW, (Y.mean >= 2.0).named("high")))
    assert free.names == ()
    assert 0.0 < free.nearest["a"] <= np.exp(-1.0) + 1e-6
    found = al.conflict(from_nowhere(LOW, (X.mean >= 2.0).named("high")))
    assert found.names == ("log", "high")
    assert found.shown
    np.testing.assert_allclose(
        [one.relaxed for one in found.limits], [np.log(2.0) + 1.0, 2.0 - np.exp(-1.0)], rtol=1e-5
    )


def test_nothing_is_said_of_a_model_that_is_finite_nowhere():
    never = (al.expressions.function(jnp.log, X.mean - 30.0) <= 0.0).named("log")
    with pytest.raises(al.SimulationError, match="finite neither at the start nor at 64 other designs"):
        al.conflict(from_nowhere(never, Y.mean <= 1.0))


def test_what_was_not_shown_is_not_claimed():
    # One iteration ends nowhere.
    hurried = al.solvers.Ipopt(max_iterations=1)
    found = al.conflict(
        plane((X.mean * Y.mean <= 1.0).named("budget"), (X.mean * Y.mean + Z.mean**2 >= 3.0).named("need")),
        solver=hurried,
    )
    assert not found.shown
    assert "not shown" in str(found)
