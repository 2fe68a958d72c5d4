"""Interior points that eliminate tied variables: the optima of IPOPT, closed forms, and what is left to IPOPT."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array, csr_array

from aleator._core.errors import ProblemError
from aleator.nlp import Condensing, Evaluation, Hessian, Ipopt, NonlinearProgram, Status, Ties
from aleator.nlp._elimination import Elimination, SingularTiesError
from zoo import cases


def pattern(dense):
    found = csr_array(dense != 0)
    found.sort_indices()
    return found


def filled(sparsity, dense):
    rows = np.repeat(np.arange(sparsity.shape[0]), np.diff(sparsity.indptr))
    return csr_array((dense[rows, sparsity.indices], sparsity.indices, sparsity.indptr), shape=sparsity.shape)


def arrow(seed, blocks=6, each=3, decided=4):
    """Realisations `A_p w_p + 0.2 w_p² = B_p d + b_p` of a few decisions `d`, near to targets, with two rows of means:
    an equality and an inequality that binds or not. The decisions come last.
    """
    rng = np.random.default_rng(seed)
    inner, size = blocks * each, blocks * each + decided
    a = 3 * np.eye(each) + 0.5 * rng.standard_normal((blocks, each, each))
    b = rng.standard_normal((blocks, each, decided))
    offset, target = 0.5 * rng.standard_normal((blocks, each)), rng.standard_normal(inner)
    linear = np.zeros((inner + 2, size))
    for p in range(blocks):
        these = slice(p * each, (p + 1) * each)
        linear[these, these], linear[these, inner:] = a[p], -b[p]
    linear[inner, 0:inner:each] = linear[inner + 1, 1:inner:each] = 1 / blocks
    quadratic = 0.2 * np.eye(inner + 2, size)
    quadratic[inner:] = 0.0
    shift = np.append(offset.ravel(), [0.0, 0.0])
    sparsity, diagonal = pattern(np.abs(linear) + quadratic), pattern(np.eye(size))
    weights = np.append(np.ones(inner), np.full(decided, 0.3))
    middle = np.append(target, np.zeros(decided))

    def evaluate(z):
        values = linear @ z + quadratic @ z**2 - shift
        gradient = weights * (z - middle)
        jacobian = filled(sparsity, linear + 2 * quadratic * z)
        return Evaluation(float(0.5 * weights @ (z - middle) ** 2), gradient, values, jacobian)

    def curvature(z, weight, multipliers):
        return filled(diagonal, np.diag(weight * weights + 2 * quadratic.T @ multipliers))

    upper = np.full(size, np.inf)
    upper[inner:] = 0.8
    return NonlinearProgram(
        evaluate=evaluate,
        start=np.zeros(size),
        lower=-upper,
        upper=upper,
        constraint_lower=np.append(np.zeros(inner + 1), -0.1),
        constraint_upper=np.append(np.zeros(inner + 1), 0.1),
        constraint_scale=np.ones(inner + 2),
        variable_scale=np.ones(size),
        sparsity=sparsity,
        hessian=Hessian(curvature, diagonal),
        ties=Ties(np.arange(inner), np.arange(inner), np.repeat(np.arange(blocks), each)),
    )


def copies(objective, slope, curve, *, start=0.5, bounds=(-1.0, 2.0), factors=(1.0,) * 5):
    """Minimise `Σ f(w_p)` subject to `factor_p w_p = d`: a function of the one decision, which comes first."""
    factors = np.array(factors)
    count = factors.size
    dense = np.concatenate([-np.ones((count, 1)), np.diag(factors)], axis=1)
    sparsity, diagonal = (
        pattern(np.concatenate([-np.ones((count, 1)), np.eye(count)], axis=1)),
        pattern(np.eye(count + 1)),
    )

    def evaluate(z):
        w = z[1:]
        return Evaluation(float(objective(w).sum()), np.append(0.0, slope(w)), dense @ z, filled(sparsity, dense))

    def curvature(z, weight, multipliers):
        return filled(diagonal, np.diag(np.append(0.0, weight * curve(z[1:]))))

    return NonlinearProgram(
        evaluate=evaluate,
        start=np.full(count + 1, start),
        lower=np.append(bounds[0], np.full(count, -np.inf)),
        upper=np.append(bounds[1], np.full(count, np.inf)),
        constraint_lower=np.zeros(count),
        constraint_upper=np.zeros(count),
        constraint_scale=np.ones(count),
        variable_scale=np.ones(count + 1),
        sparsity=sparsity,
        hessian=Hessian(curvature, diagonal),
        ties=Ties(np.arange(count), 1 + np.arange(count), np.arange(count)),
    )


def same(own, other):
    np.testing.assert_allclose(own.point, other.point, atol=1e-6)
    np.testing.assert_allclose(own.multipliers, other.multipliers, atol=1e-5)
    np.testing.assert_allclose(own.bound_multipliers, other.bound_multipliers, atol=1e-5)


@pytest.mark.parametrize("seed", cases(range(3)))
def test_realisations_of_shared_decisions_have_the_optimum_and_the_multipliers_of_ipopt(seed):
    program = arrow(seed)
    own, other = Condensing().solve(program), Ipopt().solve(program)
    assert own.ok, own.message
    assert own.message == "solved"
    same(own, other)


def test_fixed_variables_and_rows_that_bind_nothing_are_left_out():
    program = arrow(1)
    lower, upper = program.lower.copy(), program.upper.copy()
    # A decision, and a tied variable, whose row then is no tie.
    lower[-1] = upper[-1] = 0.1
    lower[0] = upper[0] = -0.2
    loose = program.constraint_upper.copy()
    loose[-1] = np.inf
    free = program.constraint_lower.copy()
    free[-1] = -np.inf
    program = replace(program, lower=lower, upper=upper, constraint_upper=loose, constraint_lower=free)
    own, other = Condensing().solve(program), Ipopt().solve(program)
    assert own.message == "solved"
    assert own.point[0] == -0.2
    assert own.multipliers[-1] == 0.0
    same(own, other)


def test_multipliers_start_it_warm():
    program = arrow(2)
    cold = Condensing().solve(program)
    warm = Condensing().solve(program, start=cold.point, multipliers=cold.multipliers)
    assert warm.message == "solved"
    assert warm.iterations < cold.iterations
    same(warm, cold)


SQUARE = (lambda w: (w - 1) ** 2, lambda w: 2 * (w - 1), lambda w: np.full_like(w, 2.0))


def test_contradicting_limits_are_infeasible():
    program = copies(*SQUARE, bounds=(0.2, 2.0))
    upper = program.upper.copy()
    upper[3] = 0.1
    outcome = Condensing().solve(replace(program, upper=upper))
    assert outcome.status is Status.INFEASIBLE, outcome.message
    assert "by IPOPT, because no step was acceptable" in outcome.message


def test_a_realisation_that_is_not_determined_is_named_and_left_to_ipopt():
    outcome = Condensing().solve(copies(*SQUARE, factors=(1.0, 2.0, 1.0, 0.0, 1.0)))
    assert outcome.ok, outcome.message
    assert "IPOPT" in outcome.message
    assert "variable 4 of realisation 3" in outcome.message
    # The row of that realisation says that the decision is zero, and its variable is free.
    np.testing.assert_allclose(outcome.point, [0.0, 0.0, 0.0, 0.0, 1.0, 0.0], atol=1e-6)


def test_points_that_cannot_be_evaluated_shorten_the_step():
    def objective(w):
        return w - np.log(np.where(w > 0.3, w - 0.3, np.nan))

    program = copies(objective, lambda w: 1 - 1 / (w - 0.3), lambda w: 1 / (w - 0.3) ** 2, start=1.9)
    outcome = Condensing().solve(program)
    assert outcome.message == "solved"
    np.testing.assert_allclose(outcome.point, 1.3, atol=1e-6)


def failing(where, error):
    """A program whose model raises an error after its start."""
    program = arrow(4)
    assert program.hessian is not None

    def fails(z, *rest):
        if not rest and np.all(z == program.start):
            return program.evaluate(z)
        raise error

    if where == "evaluate":
        return replace(program, evaluate=fails)
    return replace(program, hessian=program.hessian._replace(evaluate=fails))


@pytest.mark.parametrize("where", ["evaluate", "hessian"])
def test_an_interrupt_ends_it_and_an_error_reaches_the_caller(where):
    assert Condensing().solve(failing(where, KeyboardInterrupt)).status is Status.INTERRUPTED
    with pytest.raises(LookupError):
        Condensing().solve(failing(where, LookupError))


@pytest.mark.parametrize("seed", cases(range(3)))
def test_solves_in_levels_are_those_of_a_dense_matrix(seed):
    rng = np.random.default_rng(seed)
    count, more = 40, 5
    # Blocks of one to four variables that depend on earlier ones, all shuffled.
    starts = np.unique(rng.integers(0, count, 16))
    label = np.searchsorted(starts, np.arange(count), side="right")
    dense = np.where(label[:, None] > label, rng.random((count, count)) < 0.1, 0.0) * rng.standard_normal(
        (count, count)
    )
    dense += (label[:, None] == label) * rng.standard_normal((count, count)) + 3 * np.eye(count)
    whole = np.concatenate([dense, rng.standard_normal((count, more))], axis=1)
    rows, columns = rng.permutation(count), rng.permutation(count + more)
    whole = np.concatenate([whole, np.ones((1, count + more))])[np.append(rows, count)][:, columns]
    jacobian = filled(pattern(whole), whole)
    place_of_column = np.argsort(columns)
    # Row i holds equation rows[i]; it is tied to another variable, and the solver must find the right one.
    ties = Ties(np.arange(count), place_of_column[rng.permutation(count)], np.full(count, -1))
    elimination = Elimination(ties, jacobian)
    factors = elimination.factorised(jacobian.data)
    square = whole[elimination.rows][:, elimination.variables]
    right = rng.standard_normal((count, 3))
    np.testing.assert_allclose(factors.solve(right), np.linalg.solve(square, right), atol=1e-9)
    np.testing.assert_allclose(factors.solve_transposed(right), np.linalg.solve(square.T, right), atol=1e-9)
    np.testing.assert_array_equal(
        elimination.by_decided(jacobian.data), whole[elimination.rows][:, elimination.decided]
    )
    np.testing.assert_array_equal(elimination.own, [count])


def test_ties_in_which_a_variable_stands_nowhere_are_singular():
    matrix = csr_array(coo_array((np.ones(3), ([0, 1, 2], [0, 0, 2])), shape=(3, 3)))
    with pytest.raises(SingularTiesError, match=r"variable 1 of realisation 7 is not determined"):
        Elimination(Ties(np.arange(3), np.arange(3), np.full(3, 7)), matrix)


def test_rows_that_are_no_equalities_tie_nothing():
    program = arrow(6, blocks=1)
    with pytest.raises(ProblemError, match="Expected equalities"):
        replace(program, ties=program.ties._replace(rows=program.ties.rows[::-1] + 2))
