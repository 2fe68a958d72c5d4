"""Limits that cannot hold together: irreducible sets, checked by linear programs, and what relaxing them would cost."""

import numpy as np
import pytest

import aleator as al
from zoo import Decay

COUNT, REACH = 6, 10.0
IDLE = ((0.0, 0.0, 0.0), 1.0)


class Polyhedron(al.AlgebraicSystem):
    """Limits whose numbers are data: the products of their slopes and a place, which a disturbance moves."""

    place: al.Number
    slopes: al.Number
    off: al.Number

    def outputs(self):
        return {f"s{i}": one @ (self.place + self.off) for i, one in enumerate(self.slopes)} | {"a": self.place[0]}


def polyhedron(*limits, reach=REACH):
    """Limits `slopes @ place <= bound`, of which there are always as many; what is left is idle."""
    slopes, bounds = zip(*limits, *[IDLE] * (COUNT - len(limits)), strict=True)
    model = Polyhedron(al.Decision(np.full(3, 0.5), -reach, reach), np.array(slopes), al.Uniform(0.0, half_width=0.1))
    given = [(al.output(f"s{i}").mean <= float(one)).named(f"{i}") for i, one in enumerate(bounds)]
    return al.Problem(model, minimize=al.output("a").mean, subject_to=given)


BUDGET, NEED, OTHER = ((1, 1, 0), 1.0), ((-1, -1, 0), -3.0), ((0, 0, 1), 2.0)
ROUND = ((-1, 1, 0), -1.0), ((0, -1, 1), -1.0), ((1, 0, -1), -1.0), ((1, 0, 0), 5.0)
APART = ((1, 0, 0), 1.0), ((-1, 0, 0), -2.0), ((0, 1, 0), 1.0), ((0, -1, 0), -2.0)


def test_limits_that_contradict_each_other_are_named_alone_with_what_each_is_off_by():
    found = al.conflict(polyhedron(BUDGET, NEED, OTHER))
    assert found.names == ("0", "1")
    np.testing.assert_allclose([one.relaxed for one in found.limits], 2.0, rtol=1e-5)
    assert [one.systems for one in found.limits] == [(), ()]
    assert "no design found" in str(found)
    # Three limits of which any two hold.
    found = al.conflict(polyhedron(*ROUND))
    assert found.names == ("0", "1", "2")
    np.testing.assert_allclose([one.relaxed for one in found.limits], 3.0, rtol=1e-5)
    # Of two pairs, neither is helped by one limit alone.
    found = al.conflict(polyhedron(*APART))
    assert len(found.limits) == 2
    assert all(np.isinf(one.relaxed) for one in found.limits)
    assert "not enough" in str(found)


def test_bounds_of_decisions_in_the_way_are_named():
    found = al.conflict(polyhedron(NEED, reach=1.0))
    assert found.names == ("0",)
    assert found.limits[0].relaxed == pytest.approx(1.0, rel=1e-5)
    assert set(found.decisions) == {"place[0]", "place[1]"}


def test_limits_that_hold_together_are_no_conflict_and_what_was_not_shown_is_not_claimed():
    found = al.conflict(polyhedron(BUDGET, ((-1, 0, 0), -0.5)))
    assert found.names == ()
    assert found.least == 0.0
    assert "can hold together" in str(found)
    found = al.conflict(polyhedron(BUDGET, NEED), solver=al.solvers.Ipopt(max_iterations=1))
    assert not found.shown
    assert "not shown" in str(found)


X = al.output("x")


class Edge(al.AlgebraicSystem):
    """A decision that a disturbance moves."""

    a: al.Number
    off: al.Number

    def outputs(self):
        return {"x": self.a + self.off}


def edge(*limits, start=-1.0):
    model = Edge(al.Decision(start, -4.0, 4.0), al.Uniform(0.0, half_width=0.1))
    return al.Problem(model, minimize=X.mean**2, subject_to=limits)


def test_limits_on_realisations_name_the_systems_in_the_way():
    above, below = X.at_most(1.0, worst_case=True).named("above"), X.at_least(0.9, at_points=True).named("below")
    found = al.conflict(edge(above, below, start=0.5))
    assert found.names == ("above", "below")
    named = {one.name: [system["off"] for system in one.systems] for one in found.limits}
    # The highest of all systems, and the lowest of those at the collocation points.
    np.testing.assert_allclose(named["above"], 0.1)
    (lowest,) = named["below"]
    assert -0.1 < lowest < -0.08
    assert found.limits[0].relaxed == pytest.approx(0.9 - lowest + 0.1 - 1.0, rel=1e-4)
    assert "with off = 0.1" in str(found)


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
    limits = {one.name: one for one in found.limits}
    assert set(limits) == {"start low", "end high", "fast"}
    assert limits["start low"].times == pytest.approx((0.0,))
    assert "t = 0 s" in str(found)
    # From x(0) = 1 at the rate of 0.5: the end misses 0.95 by this much.
    end = np.exp(-np.linspace(0.495, 0.505, 2001))
    assert limits["end high"].relaxed == pytest.approx(0.95 - (np.mean(end) - np.std(end)), rel=1e-3)
