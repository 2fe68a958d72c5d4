"""Solvers are told only of entries of a Jacobian that are not zero, and learn of others when these show up."""

from dataclasses import replace

import numpy as np
from nlp_problems import INF, evaluation, program

from aleator.nlp import FilterSQP, Status
from aleator.nlp._pattern import Pattern


def test_a_pattern_keeps_entries_column_by_column():
    jacobian = np.array([[0.0, 2.0, 0.0], [3.0, 0.0, 0.0]])
    pattern = Pattern(jacobian != 0)
    assert list(zip(pattern.rows, pattern.columns, strict=True)) == [(1, 0), (0, 1)]
    np.testing.assert_array_equal(pattern.entries(10 * jacobian), [30.0, 20.0])
    assert not pattern.outgrown


def test_a_pattern_notices_what_outgrows_it_and_is_whole_in_the_end():
    jacobian = np.eye(6)
    pattern = Pattern(jacobian != 0)
    jacobian[0, 5] = 1.0
    pattern.entries(jacobian)
    assert pattern.outgrown
    wider = pattern.widened()
    assert len(wider.rows) == 7
    jacobian[5, 0] = 1.0
    wider.entries(jacobian)
    assert len(wider.widened().rows) == 36


def test_rows_that_hardly_depend_on_anything_at_the_start_are_solved():
    # Minimise the sum of x_i, with x_i >= 0.5 and row i: (x_i - 1)_+² + (x_{i+1} - x_i)² <= 1, flat at the start.
    n = 12

    def evaluate(x):
        jacobian = np.zeros((n, n))
        ahead = np.roll(x, -1)
        over = np.maximum(x - 1.0, 0.0)
        rows = over**2 + (ahead - x) ** 2
        for i in range(n):
            jacobian[i, i] = 2 * over[i] - 2 * (ahead[i] - x[i])
            jacobian[i, (i + 1) % n] += 2 * (ahead[i] - x[i])
        return evaluation(-x.sum(), -np.ones(n), rows, jacobian)

    start = np.linspace(0.6, 0.7, n)
    declared = program(evaluate, start, np.full(n, 0.5), rows=[(-INF, 1.0)] * n)
    # Told of the entries at the start alone, of which those of the first part are zero by chance.
    narrow = np.eye(n, dtype=bool)
    outcome = FilterSQP().solve(replace(declared, sparsity=narrow))
    assert outcome.status is Status.SOLVED
    # All x equal to 2 meet every row with equality, and by symmetry and convexity no sum is larger.
    np.testing.assert_allclose(outcome.point, 2.0, atol=1e-6)
    np.testing.assert_allclose(outcome.multipliers, 0.5, atol=1e-5)
