"""Integers and rows of tables: the best of all combinations, as enumeration finds it; what is said of the others."""

import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al
from aleator.solving import _integers
from zoo import HALF_WIDTH, MASS, STRESS, Bar, algebraic


class Pack(al.AlgebraicSystem):
    """Two counts whose product is needed, and a number that adds to it; its curvature is indefinite."""

    a: al.Number
    b: al.Number
    more: al.Number = 0.0

    def outputs(self):
        return {"cost": 3.0 * self.a + 2.0 * self.b, "size": self.a * self.b + self.more, "more": self.more}


def pack_problem(a: Any, b: Any, more: Any = 0.0, need: Any = 13.3) -> al.Problem:
    cost = al.output("cost").mean + 20.0 * (al.value("more") - 0.3) ** 2
    return al.Problem(Pack(a, b, more), minimize=cost, subject_to=[al.output("size").mean >= need])


def branching_of(solution: al.Solution) -> al.results.Branching:
    assert solution.branching is not None
    return solution.branching


def cost_of(a, b, more=0.0):
    return 3.0 * a + 2.0 * b + 20.0 * (more - 0.3) ** 2


def test_integers_beside_a_number_are_those_of_enumeration():
    need = 13.3
    problem = pack_problem(al.Integer(3, 1, 12), al.Integer(3, 1, 10), al.Decision(0.1, 0.0, 1.0), need)
    solution = al.solve(problem)
    # The number rises from 0.3 where the product alone is too small.
    best = min(
        (cost_of(a, b, max(0.3, need - a * b)), a, b)
        for a, b in itertools.product(range(1, 13), range(1, 11))
        if a * b + 1.0 >= need
    )
    assert solution.objective == pytest.approx(best[0], rel=1e-8)
    assert (solution.decisions["a"], solution.decisions["b"]) == best[1:]
    branching = branching_of(solution)
    assert (branching.is_finished, branching.is_proven, branching.listed) == (True, False, False)
    assert branching.combinations == 120
    assert branching.nodes < 60
    assert branching.bound <= solution.objective <= branching.bound + branching.gap + 1e-12
    assert "if the relaxed problem is convex, which is not checked" in str(solution)
    # The problem of the solution is the one that was asked.
    assert isinstance(solution.problem.placements.decisions["a"].decision, al.Integer)
    assert solution.problem.placements.vector("upper").tolist() == [12.0, 10.0, 1.0]


def test_few_combinations_are_all_solved_and_that_is_proven_where_nothing_else_is_decided():
    parts = {"a": [1.0, 2.0, 5.0, 4.0, 7.0, 8.0], "b": [9.0, 3.0, 3.0, 4.0, 1.0, 6.0]}
    columns = al.Choice.table("part", parts, initial=1)
    solution = al.solve(pack_problem(columns["a"], columns["b"], need=14.0))
    assert (solution.decisions["a"], solution.decisions["b"]) == (4.0, 4.0)
    assert branching_of(solution).is_proven
    beside = al.solve(pack_problem(columns["a"], columns["b"], al.Decision(0.1, 0.0, 1.0), need=14.0))
    assert not branching_of(beside).is_proven
    assert "each to a local optimum" in str(beside)


def test_a_row_of_a_long_table_is_that_of_enumeration():
    rows = np.random.default_rng(0).uniform(1.0, 9.0, (200, 2))
    columns = al.Choice.table("part", {"a": rows[:, 0], "b": rows[:, 1]})
    front = al.Choice([3.0, 4.0])
    solution = al.solve(pack_problem(columns["a"], columns["b"], front, need=35.0))
    best = min((cost_of(a, b, more), a, b) for a, b in rows for more in (3.0, 4.0) if a * b + more >= 35.0)
    assert solution.objective == pytest.approx(best[0], rel=1e-9)
    np.testing.assert_allclose([solution.decisions["a"], solution.decisions["b"]], best[1:], rtol=1e-12)


def test_a_robust_design_with_an_integer_is_the_next_one_that_is_strong_enough():
    load = al.Uniform(10.0, half_width=HALF_WIDTH)
    strong = (STRESS.mean + 3 * STRESS.std <= 0.5).named("stress")
    solution = al.solve(al.Problem(Bar(al.Integer(4, 1, 100), load), minimize=MASS.mean, subject_to=[strong]))
    assert solution.decisions["width"] == np.ceil((10.0 + 3.0 * HALF_WIDTH / np.sqrt(3.0)) / 0.5)
    assert solution.at_bounds == ()
    assert al.solve(solution.problem, warm_start=solution).decisions == solution.decisions


def test_what_no_combination_can_meet_is_said():
    wide = pack_problem(al.Integer(3, 1, 9), al.Integer(3, 1, 9), al.Decision(0.05, 0.0, 0.1), need=82.0)
    assert al.solve(wide, throw=False).branching is None
    with pytest.raises(al.SolveError, match="None of 81 combinations"):
        al.solve(wide)
    # The relaxed problem has a design, between two integers.
    size = al.output("size").mean
    between = al.Problem(
        Pack(al.Integer(3, 1, 40), 0.1), minimize=al.output("cost").mean, subject_to=[size >= 0.21, size <= 0.29]
    )
    with pytest.raises(al.SolveError, match="None of 40 combinations"):
        al.solve(between)


@pytest.mark.parametrize("offset", [0.0, -20.0])
def test_a_leaf_that_begins_at_its_optimum_is_solved(offset):
    """A parabola that is exactly zero at the best integer, less an offset beside which its slopes are rounding."""

    @algebraic
    def valley(n, x, off):
        return {"f": offset + (n - 2.27) ** 2 + (x - 0.47 * n - 0.64) ** 2 + 0.2 * off * x}

    model = valley(al.Integer(3, 0, 60), al.Decision(1.0, 0.0, 200.0), al.Uniform(0.0, half_width=1.0))
    solution = al.solve(al.Problem(model, minimize=al.output("f").mean))
    assert solution.decisions["n"] == 2.0
    assert solution.objective == pytest.approx(offset + 0.27**2, abs=1e-6)
    assert branching_of(solution).passed_over == 0


class Ripple(al.AlgebraicSystem):
    """A wave that no polynomial of low order follows where it is short."""

    waves: al.Number
    off: al.Number

    def outputs(self):
        return {"height": jnp.sin(self.waves * self.off), "waves": self.waves}


@pytest.mark.slow
def test_a_combination_whose_certificate_fails_is_passed_over_and_that_is_told():
    model = Ripple(al.Choice([1.0, 25.0]), al.Normal(0.0, 0.5))
    problem = al.Problem(model, minimize=-al.output("waves").mean + al.output("height").std)
    with pytest.warns(al.AleatorWarning, match=r"A better combination .* was passed over, waves=25 \(objective -24"):
        solution = al.solve(problem)
    assert solution.decisions["waves"] == 1.0
    assert branching_of(solution).passed_over == 1
    assert branching_of(solution).bound < -24.0  # the spread of a sine is at most 1
    assert not branching_of(solution).is_proven
    assert "1 were passed over" in str(solution)


def test_a_search_that_is_not_finished_tells_its_gap(monkeypatch):
    monkeypatch.setattr(_integers, "_MOST", 3)
    solution = al.solve(pack_problem(al.Integer(3, 1, 50), al.Integer(3, 1, 60), need=1234.0))
    branching = branching_of(solution)
    assert not branching.is_finished
    assert branching.gap > 0
    assert branching.bound <= min(cost_of(a, b) for a in range(1, 51) for b in range(1, 61) if a * b >= 1234)
    assert "not finished" in str(solution)


@pytest.mark.parametrize(
    ("declare", "message"),
    [
        (lambda: al.Integer(3), "between finite bounds; received -inf"),
        (lambda: al.Integer(3.5, 1, 9), "initial: expected a whole number"),
        (lambda: al.Integer(3, 5, 9), "lower <= initial <= upper; received 5 <= 3 <= 9"),
        (lambda: al.Integer(3, 1, 10**9), "at most 100000 values"),
        (lambda: al.Choice([]), "a list of numbers"),
        (lambda: al.Choice([1.0, 2.0], 2), "an index of its values, 0 to 1; received 2"),
        (lambda: al.Choice.table("part", {"a": [1.0, 2.0], "b": [1.0]}), "lists of one length"),
        (
            lambda: pack_problem(*[al.Choice.table("part", {"a": [1.0, 2.0]})["a"]] * 2),
            "'a' of the table 'part' stands",
        ),
        (lambda: al.portfolio(pack_problem(al.Integer(3, 1, 9), 1.0)), "received 'a', an al.Integer"),
    ],
)
def test_what_cannot_be_chosen_is_refused(declare, message):
    with pytest.raises(al.ProblemError, match=message):
        declare()


class Valleys(al.AlgebraicSystem):
    """A quartic with two valleys, of which that at `d = -1` is the deeper one."""

    k: al.Number
    d: al.Number

    def outputs(self):
        return {"height": (self.d - 3) ** 2 * (self.d + 1) ** 2 / 4 + 0.3 * self.d + self.k, "k": self.k}


@pytest.mark.parametrize("start", [3.5, 1.0, -1.5])
def test_no_choice_is_left_out_because_its_search_ends_in_another_valley(start):
    model = Valleys(al.Choice([1.0, 2.0, 3.0, 4.0]), al.Decision(start, -6.0, 6.0))
    limit = al.output("height").mean <= 3.0
    solution = al.solve(al.Problem(model, minimize=-al.output("k").mean, subject_to=[limit]))
    heights = np.polynomial.Polynomial.fromroots([3, 3, -1, -1]) / 4 + np.polynomial.Polynomial([0, 0.3])
    lowest = min(heights(root.real) for root in heights.deriv().roots())
    assert solution.decisions["k"] == max(k for k in (1.0, 2.0, 3.0, 4.0) if k + lowest <= 3.0)
    assert branching_of(solution).is_finished
