"""Points of a front that a neighbour's design may better, and fronts of problems with several optima."""

import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import aleator as al
from aleator.sweep._front import Place, doubtful
from zoo import TwoBasins

CURVES = {
    "1/b": (lambda b: 1 / b, lambda b: -1 / b**2),
    "concave": (lambda b: 4 - b**2, lambda b: -2 * b),
    "constant": (lambda b: 3.0 + 0 * b, lambda b: 0 * b),
    "exp(-2b)": (lambda b: np.exp(-2 * b), lambda b: -2 * np.exp(-2 * b)),
}
BOUNDS = np.linspace(0.5, 1.0, 9)


def places(objective, slope, lifted=()):
    return [Place(b, objective(b) + (1.0 if b in lifted else 0.0), slope(b)) for b in BOUNDS.tolist()]


@pytest.mark.parametrize("name", CURVES)
def test_no_point_of_a_smooth_front_is_in_doubt(name):
    assert list(doubtful(places(*CURVES[name]), 1, 4.0)) == []


@pytest.mark.parametrize("name", CURVES)
def test_a_point_above_the_curve_is_in_doubt_from_each_neighbour(name):
    for i, relaxing in itertools.product((0, 4, 8), (1, 0)):
        pairs = set(doubtful(places(*CURVES[name], lifted=[BOUNDS[i]]), relaxing, 4.0))
        assert pairs == {(BOUNDS[i], BOUNDS[j]) for j in (i - 1, i + 1) if 0 <= j < len(BOUNDS)}


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
