"""Newton's method on small systems with known roots, with none, and with several; its derivatives.

All systems of a size are branches of one program.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aleator.dynamics._newton import newton
from aleator.dynamics._sparse import Sparsity
from compiling import compiled
from zoo import cases

# Equations, guess and root; no root where the search must fail.
SCALAR = {
    "a cube": (lambda x: [x**3 - 2.0], [1.0], [2.0 ** (1 / 3)]),
    # The logarithm is not a number where undamped steps lead, and those of the arctangent grow without bound.
    "a logarithm": (lambda x: [jnp.log(x) - 0.5], [9.0], [np.exp(0.5)]),
    "an arctangent": (lambda x: [jnp.arctan(x - 2.0)], [40.0], [2.0]),
    "a tiny root": (lambda x: [x - 1e-9], [0.0], [1e-9]),
    "a guess that is near": (lambda x: [x**2 - 1.0], [1.01], [1.0]),
    "no root": (lambda x: [x**2 + 1.0], [1.0], None),
    "a root at infinity": (lambda x: [jnp.exp(x)], [1.0], None),
    "not a number at the guess": (lambda x: [jnp.sqrt(x - 2.0)], [1.0], None),
    "a double root": (lambda x: [x**2], [1.0], None),
    "a double root near the guess": (lambda x: [x**2 - 2.0 * x + 1.0], [1.0000003], None),
}


def circles(apart):
    """Of radius one, whose centres leave two roots `(√(1 - apart²), ± apart)`."""
    return lambda x, y: [x**2 + y**2 - 1.0, (x - 2.0 * np.sqrt(1 - apart**2)) ** 2 + y**2 - 1.0]


PAIRS = {
    "a circle and a line": (lambda x, y: [x**2 + y**2 - 25.0, x - y + 1.0], [2.0, 5.0], [3.0, 4.0]),
    # Rosenbrock's valley, as equations.
    "a valley": (lambda x, y: [1.0 - x, 10.0 * (y - x**2)], [-1.2, 1.0], [1.0, 1.0]),
    **{
        # Zero but for rounding.
        f"zero, {a:g}": (lambda x, y, a=a: [x + 0.1 * y - 0.3 / a, a * y - 3.0], [0.0, 1.0], [0.0, 3.0 / a])
        for a in (0.5, 3.0)
    },
    "thrice the same": (lambda x, y: [0.1 * x + 0.3 * y - 1.0, 0.3 * x + 0.9 * y - 3.0], [0.5, 0.7], None),
    "an unknown in no equation": (lambda x, y: [x - 1.0, 0.0 * y], [1.0, 1.0], None),
    **{f"circles that touch, {y:g}": (circles(0.0), [1.0, y], None) for y in (1e-9, 0.3)},
}
NEARLY = {
    (apart, sign): (circles(apart), [1.0, 0.3 * sign], [np.sqrt(1 - apart**2), sign * apart])
    for apart in (1e-2, 1e-4)
    for sign in (1.0, -1.0)
}
TABLES = {"scalar": SCALAR, "pairs": PAIRS | NEARLY}


@cache
def solved(table):
    rows = list(TABLES[table].values())
    branches = [lambda x, f=function: jnp.stack(f(*x)) for function, *_ in rows]

    def solve(branch, guess):
        found = newton(lambda x: jax.lax.switch(branch, branches, x), guess)
        return found.point, found.converged, found.steps, found.relative

    guesses = np.array([guess for _, guess, _ in rows])
    found = [np.asarray(part) for part in compiled(jax.vmap(solve))(np.arange(len(rows)), guesses)]
    return dict(zip(TABLES[table], zip(*found, strict=True), strict=True))


@pytest.mark.parametrize("table", cases(TABLES, 1))
def test_roots_are_found_to_rounding_and_systems_without_a_regular_root_end_as_failures(table):
    found = solved(table)
    converged = {name: bool(row[1]) for name, row in found.items()}
    assert converged == {name: exact is not None for name, (*_, exact) in TABLES[table].items()}
    for name, (_, _, exact) in TABLES[table].items():
        if exact is not None and name not in NEARLY:
            np.testing.assert_allclose(found[name][0], exact, rtol=1e-14, atol=1e-15, err_msg=str(name))
            assert np.abs(found[name][3]).max() < 1e-14
    if table == "scalar":
        # Quadratic convergence squares the error at each step: from 1e-2 to 1e-4, 1e-8, 1e-16.
        assert found["a guess that is near"][2] <= 5


@pytest.mark.parametrize("case", NEARLY, ids=str)
def test_two_solutions_that_nearly_meet_are_told_apart(case):
    np.testing.assert_allclose(solved("pairs")[case][0], NEARLY[case][2], rtol=1e-15 / case[0] ** 2)


def test_a_failing_point_leaves_the_others_of_its_batch_and_their_slopes_as_they_are():
    def at(c):
        found = newton(lambda x: x**2 - c, jnp.ones(1))
        return found.point[0], (found.point[0], found.converged)

    levels = np.array([2.0, -1.0, 3.0, 0.0, 1e-6])
    found = compiled(jax.vmap(jax.grad(at, has_aux=True)))(levels)
    slopes, (roots, converged) = jax.tree.map(np.asarray, found)
    assert converged.tolist() == [True, False, True, False, True]
    np.testing.assert_allclose(roots[converged], np.sqrt([2.0, 3.0, 1e-6]), rtol=1e-14)
    np.testing.assert_allclose(slopes[converged], 0.5 / np.sqrt([2.0, 3.0, 1e-6]), rtol=1e-13)


def test_derivatives_of_every_order_follow_from_the_implicit_function_theorem():
    def cube_root(c):
        return newton(lambda x: x**3 - c, jnp.ones(1)).point[0]

    once = jax.grad(cube_root)
    twice = jax.jacfwd(once)
    found = compiled(lambda c: (once(c), twice(c), jax.grad(twice)(c), jax.jacfwd(cube_root)(c)))(2.0)
    slope = 2.0 ** (-2 / 3) / 3
    exact = [slope, -2 * 2.0 ** (-5 / 3) / 9, 10 * 2.0 ** (-8 / 3) / 27, slope]
    np.testing.assert_allclose(np.array([*map(float, found)]), exact, rtol=1e-12)


# --- Square matrices by few tangents and their band, against dense ones of NumPy --------------------------------------


GENERATOR = np.random.default_rng(3)


def banded(n, below, above):
    places = np.subtract.outer(np.arange(n), np.arange(n))
    return (places <= below) & (places >= -above)


# The pattern, how many tangents tell it, and how many diagonals are below and above the main one.
PATTERNS = {
    "three diagonals": (banded(40, 1, 1), 3, (1, 1)),
    "more below": (banded(80, 3, 1), 5, None),
    "in another order": (
        banded(48, 1, 1)[np.ix_(*[GENERATOR.permutation(48)] * 2)] | np.eye(48, dtype=bool),
        None,
        None,
    ),
    "a full row": (banded(40, 1, 1) | (np.arange(40) == 7)[:, None], 40, None),
    "few": (banded(3, 1, 1), 3, None),
}


@pytest.mark.parametrize("name", cases(PATTERNS, 2))
def test_equations_are_solved_as_dense_ones_with_pivots_and_derivatives(name):
    pattern, tangents, band = PATTERNS[name]
    sparsity, n = Sparsity.of(pattern), len(pattern)
    if tangents is not None:
        assert len(sparsity.seeds) == tangents
    if band is not None:
        assert sparsity.band == band
    # Nothing on the main diagonal: no elimination goes without pivots.
    matrix, added = (np.where(pattern, GENERATOR.normal(size=(n, n)), 0.0) for _ in range(2))
    right, mass = GENERATOR.normal(size=n), np.zeros(n)

    @compiled
    def solved(matrix, added, right):
        def of(matrix):
            entries = sparsity.entries(jnp.asarray(sparsity.seeds) @ matrix.T)
            return sparsity.solver(sparsity.diagonal(mass) + entries)(right)

        return jax.jvp(of, (matrix,), (added,))

    value, change = solved(matrix, added, right)
    expected = np.linalg.solve(matrix, right)
    np.testing.assert_allclose(value, expected, rtol=1e-8)
    np.testing.assert_allclose(change, -np.linalg.solve(matrix, added @ expected), rtol=1e-6)
