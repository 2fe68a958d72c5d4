"""A portfolio finds the best of many optima, and says how sure one may be of it."""

from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from executors import pressed
from zoo import TwoBasins


class Swell(al.AlgebraicSystem):
    """A level that is a wave in one decision and a bowl in another: as many minima as there are waves."""

    rise: al.Number
    phase: al.Number
    depth: al.Number

    def outputs(self):
        return {"x": self.rise * (jnp.sin(3.0 * self.phase) + 0.1 * self.phase + self.depth**2)}


X = al.output("x")
SEARCH = al.solvers.DifferentialEvolution(evaluations=300, population=24)


def problem(upper=6.0, minimize=X.mean, **more):
    decisions = al.Decision(3.0, 0.0, upper), al.Decision(0.5, -1.0, 1.0)
    return al.Problem(Swell(al.Uniform(2.0, half_width=0.2), *decisions), minimize=minimize, **more)


def minima():
    """The local minima of the mean, `depth` being zero, best first."""
    phase = np.linspace(0.0, 6.0, 600001)
    level = 2.0 * (np.sin(3.0 * phase) + 0.1 * phase)
    inner = np.flatnonzero((level[1:-1] < level[:-2]) & (level[1:-1] < level[2:])) + 1
    ends = [one for one, beside in ((0, 1), (-1, -2)) if level[one] < level[beside]]
    return np.sort(level[[*inner, *ends]])


def test_all_optima_are_listed_best_first_with_their_basins_and_how_sure_one_may_be():
    found = al.portfolio(problem(), 24)
    np.testing.assert_allclose([one.objective for one in found.optima], minima(), rtol=1e-5, atol=1e-6)
    assert found.best.ok
    assert found.best.objective == pytest.approx(minima()[0], rel=1e-5)
    assert sum(one.starts for one in found.optima) == found.starts == 24
    assert sum(one.random for one in found.optima) == found.solved == found.random
    assert all(str(one.starts) in str(found) for one in found.optima)
    assert f"{found.unseen:.0%}" in found.sure()


@pytest.mark.parametrize(("random", "unseen", "said"), [(2, 1.0, "Nothing can be said"), (6, 1 * 2 / (6 * 5), "7%")])
def test_how_sure_one_may_be_is_the_share_of_boender_and_rinnooy_kan(random, unseen, said):
    optimum = al.results.Optimum(0.0, {"phase": 2.0}, random + 1, random)
    found = al.results.Portfolio(None, (optimum,), random + 1, random, random, None)
    assert found.unseen == pytest.approx(unseen)
    assert said in found.sure()
    assert ("%" in found.sure()) == (unseen < 1)


@pytest.mark.slow
def test_an_objective_at_its_lower_bound_is_proven_best_and_one_optimum_wherever_it_is_found():
    # Every `phase` has a `depth`, or none, at which the objective is zero, to rounding.
    found = al.portfolio(problem(minimize=(X.mean - 0.2) ** 2), 8, search=None)
    assert found.best.objective == pytest.approx(0.0, abs=1e-9)
    assert found.proven
    assert "No design is better" in found.sure()
    assert [one.objective < 1e-12 for one in found.optima].count(True) == 1
    assert found.searched is None
    assert found.random == 7


@pytest.mark.usefixtures("python_interrupts")
def test_ctrl_c_keeps_what_was_found():
    found = al.portfolio(problem(), 20, search=SEARCH, progress=pressed("local searches", 3))
    assert found.interrupted
    assert 0 < found.starts < 20
    assert found.best.ok
    assert "interrupted" in str(found)
    found = al.portfolio(problem(), 6, search=SEARCH, progress=pressed("local searches", 0))
    assert found.interrupted
    assert found.starts == 0
    assert found.best.objective == pytest.approx(minima()[0], rel=1e-5)
    assert "Nothing can be said" in found.sure()


# --- Points of a front that a neighbour's design may better, and fronts of problems with several optima ---------------


def two_basins(start: float, limit) -> al.Problem:
    loss, a = al.output("loss").mean, al.output("a").mean
    return al.Problem(TwoBasins(al.Decision(start, 0.0, 8.0)), minimize=loss, subject_to=[limit(a).named("a")])


def test_the_optimum_of_a_tighter_limit_is_found_for_weaker_ones():
    problem = two_basins(4.5, lambda mean: mean <= 6.0)
    assert al.solve(problem).objective == pytest.approx(3.0)  # from its own start, in the other basin
    for bounds in ([2.0, 4.0, 6.0], [6.0, 4.0, 2.0]):
        front = al.pareto(problem, "a", bounds)
        assert front.objectives == pytest.approx([1.0, 1.0, 1.0])
        assert dict(zip(bounds, front.neighbours, strict=True))[2.0] is None
        assert front.neighbours.count(None) == 1
    with ThreadPoolExecutor(2) as executor:
        there = al.pareto(problem, "a", bounds, executor=executor)
    assert there.objectives.tobytes() == front.objectives.tobytes()
    assert there.neighbours == front.neighbours


@pytest.mark.parametrize("start", [2.8, 6.5])
def test_no_point_is_worse_than_a_solve_of_its_own(start):
    # From 2.8 each of these ends in the basin of 1; the bound of 4 begins beyond and its nearest design lies there.
    problem, bounds = two_basins(start, lambda mean: mean >= 0.0), [4.0, 2.0, 0.5, 5.5]
    front = al.pareto(problem, "a", bounds)
    own = [al.solve(problem.with_bound("a", bound)).objective for bound in bounds]
    assert (front.objectives <= np.array(own) + 1e-6).all()
    assert (np.diff(front.objectives[np.argsort(bounds)]) >= -1e-6).all()
