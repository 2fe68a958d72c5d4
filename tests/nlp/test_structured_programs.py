"""Programs with declared sparse Jacobians and Hessians: the answers of the dense ones, and sizes these cannot have."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.sparse import csr_array

from aleator._core.errors import ProblemError
from aleator.nlp import Evaluation, FilterSQP, Hessian, InteriorPoint, Ipopt, NonlinearProgram, Slsqp

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
