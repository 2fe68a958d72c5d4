"""Programs with declared sparse Jacobians and Hessians: the answers of the dense ones, and sizes these cannot have."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from nlp_problems import INF, evaluation, program
from scipy.optimize import brentq
from scipy.sparse import csr_array

from aleator._core.errors import ProblemError
from aleator.nlp import Evaluation, FilterSQP, Hessian, InteriorPoint, Ipopt, NonlinearProgram, Slsqp, Status

INTERIOR = [Ipopt(), InteriorPoint()]
named = pytest.mark.parametrize("solver", INTERIOR, ids=lambda one: type(one).__name__)


def targets(count):
    return 1.0 + 0.5 * np.sin(np.arange(count))


def arrow(count, *, sparse=True, hessian=True, scale=1.0):
    """`½ Σ (x_i - t_i)² + ½ count (y - 2)²` with `x_i² = y` for all i: every row shares the last decision."""
    t, size = targets(count), count + 1
    every = np.arange(count)
    columns = np.stack([every, np.full(count, count)], axis=1).ravel()
    sparsity = csr_array((np.ones(2 * count, dtype=bool), (np.repeat(every, 2), columns)), shape=(count, size))
    sparsity.sort_indices()
    diagonal = csr_array((np.ones(size, dtype=bool), (np.arange(size), np.arange(size))), shape=(size, size))

    def evaluate(z):
        x, y = z[:-1] * scale, z[-1]
        numbers = np.stack([2 * x * scale, np.full(count, -1.0)], axis=1).ravel()
        jacobian = csr_array((numbers, sparsity.indices, sparsity.indptr), shape=sparsity.shape)
        return Evaluation(
            0.5 * float(np.sum((x - t) ** 2) + count * (y - 2.0) ** 2),
            np.append(scale * (x - t), count * (y - 2.0)),
            x**2 - y,
            jacobian if sparse else jacobian.toarray(),
        )

    def curvature(z, weight, multipliers):
        del z
        numbers = np.append(scale**2 * (weight + 2 * multipliers), weight * count)
        return csr_array((numbers, diagonal.indices, diagonal.indptr), shape=diagonal.shape)

    return NonlinearProgram(
        evaluate=evaluate,
        start=np.append(np.ones(count) / scale, 1.0),
        lower=np.append(np.full(count, 0.1 / scale), 0.05),
        upper=np.append(np.full(count, 10.0 / scale), 10.0),
        constraint_lower=np.zeros(count),
        constraint_upper=np.zeros(count),
        constraint_scale=np.ones(count),
        variable_scale=np.append(np.full(count, 1 / scale), 1.0),
        sparsity=sparsity if sparse else None,
        hessian=Hessian(curvature, diagonal) if hessian else None,
    )


def optimum(count):
    """The last decision at the optimum: all others are its root, so that one equation is left."""
    t = targets(count)
    return brentq(lambda y: count * (y - 2.0) + np.sum((np.sqrt(y) - t) / (2 * np.sqrt(y))), 0.5, 5.0, xtol=1e-13)


@pytest.mark.slow
def test_a_hundred_thousand_decisions_that_share_one_are_solved_without_a_dense_matrix():
    count = 100_000
    declared = arrow(count)
    tracemalloc.start()
    outcome = Ipopt().solve(declared)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert outcome.ok, outcome.message
    assert outcome.point[-1] == pytest.approx(optimum(count), rel=1e-4)
    np.testing.assert_allclose(outcome.point[:-1], np.sqrt(outcome.point[-1]), rtol=1e-6)
    # A dense Jacobian has 80 GB; memory of the solvers' own code is not counted here.
    assert peak < 300e6


@named
@pytest.mark.parametrize("scale", [1e-3, 200.0])
def test_derivatives_of_either_kind_lead_to_the_same_optimum(solver, scale):
    expected = optimum(30)
    for sparse, hessian in ((True, True), (True, False), (False, True), (False, False)):
        outcome = solver.solve(arrow(30, sparse=sparse, hessian=hessian, scale=scale))
        assert outcome.ok, (sparse, hessian, outcome.message)
        assert outcome.point[-1] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("solver", [FilterSQP(), Slsqp()], ids=lambda one: type(one).__name__)
def test_solvers_of_few_decisions_take_sparse_programs_too(solver):
    for hessian in (True, False):
        outcome = solver.solve(arrow(12, hessian=hessian))
        assert outcome.ok, outcome.message
        assert outcome.point[-1] == pytest.approx(optimum(12), rel=1e-5)


@pytest.mark.parametrize("solver", [*INTERIOR, FilterSQP()], ids=lambda one: type(one).__name__)
def test_fixed_decisions_and_rows_that_bind_nothing_are_left_out(solver):
    declared = arrow(20)
    upper, free = declared.upper.copy(), declared.constraint_upper.copy()
    upper[3] = declared.lower[3] = 1.2
    free[3], declared.constraint_lower[3] = np.inf, -np.inf
    outcome = solver.solve(replace(declared, upper=upper, constraint_upper=free))
    assert outcome.ok, outcome.message
    assert outcome.point[3] == 1.2
    assert outcome.multipliers[3] == 0.0
    rest = np.delete(targets(20), 3)
    expected = brentq(lambda y: 20 * (y - 2.0) + np.sum((np.sqrt(y) - rest) / (2 * np.sqrt(y))), 0.5, 5.0, xtol=1e-13)
    assert outcome.point[-1] == pytest.approx(expected, rel=1e-5)
    # What holds the fixed decision makes the Lagrangian stationary there.
    assert outcome.bound_multipliers[3] == pytest.approx(targets(20)[3] - 1.2)


def test_second_derivatives_that_are_not_finite_do_not_pass_for_an_answer():
    declared = arrow(5)
    sparsity = declared.hessian.sparsity
    lost = csr_array((np.full(sparsity.nnz, np.nan), sparsity.indices, sparsity.indptr), shape=sparsity.shape)
    assert not Ipopt(max_iterations=50).solve(replace(declared, hessian=Hessian(lambda *_: lost, sparsity))).ok


@named
def test_what_a_hessian_raises_reaches_the_caller(solver):
    def fails(*_):
        raise LookupError("no curvature")

    declared = arrow(5)
    with pytest.raises(LookupError, match="no curvature"):
        solver.solve(replace(declared, hessian=Hessian(fails, declared.hessian.sparsity)))


def test_a_jacobian_of_another_sparsity_is_refused():
    declared = arrow(4)
    other = csr_array(np.ones((4, 5)))
    with pytest.raises(ProblemError, match="Expected the Jacobian"):
        Ipopt().solve(replace(declared, evaluate=lambda x: declared.evaluate(x)._replace(jacobian=other)))
    with pytest.raises(ProblemError, match="lower triangle"):
        replace(declared, hessian=declared.hessian._replace(sparsity=csr_array(np.ones((5, 5)))))


def test_slsqp_refuses_what_its_dense_matrices_cannot_hold():
    with pytest.raises(ProblemError, match="expected at most 2000 variables; received 3001"):
        Slsqp().solve(arrow(3000))


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
