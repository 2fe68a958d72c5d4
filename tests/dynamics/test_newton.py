import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import root

from aleator.dynamics._newton import newton
from compiling import compiled


def solved(function, guess):
    return jax.jit(lambda guess: newton(lambda x: jnp.stack(function(*x)), guess))(jnp.asarray(guess, dtype=float))


@pytest.mark.parametrize(
    ("function", "guess", "exact"),
    [
        (lambda x: [x**3 - 2.0], [1.0], [2.0 ** (1 / 3)]),
        (lambda x: [jnp.exp(x) - 5.0], [30.0], [np.log(5.0)]),
        # The logarithm is not a number where undamped steps lead, and those of the arctangent grow without bound.
        (lambda x: [jnp.log(x) - 0.5], [9.0], [np.exp(0.5)]),
        (lambda x: [jnp.arctan(x - 2.0)], [40.0], [2.0]),
        (lambda x: [x - 1e-9], [0.0], [1e-9]),
        (lambda x: [jnp.sin(x)], [0.1], [0.0]),
        (lambda x, y: [x**2 + y**2 - 25.0, x - y + 1.0], [2.0, 5.0], [3.0, 4.0]),
        # Rosenbrock's valley, as equations.
        (lambda x, y: [1.0 - x, 10.0 * (y - x**2)], [-1.2, 1.0], [1.0, 1.0]),
    ],
)
def test_newton_finds_the_root_to_rounding(function, guess, exact):
    found = solved(function, guess)
    assert found.converged
    np.testing.assert_allclose(found.point, exact, rtol=1e-14, atol=1e-15)
    assert np.abs(found.relative).max() < 1e-14


def test_newton_agrees_with_scipy_on_random_quadratic_equations():
    random = np.random.default_rng(3)
    matrix, curved, start = random.normal(size=(6, 6)) + 6 * np.eye(6), random.normal(size=(6, 6)), np.ones(6)

    def function(x):
        return matrix @ x + 0.3 * (curved @ x**2) - np.arange(6.0)

    reference = root(function, start, tol=1e-13)
    found = compiled(lambda start: newton(function, start))(start)
    assert found.converged
    assert reference.success
    np.testing.assert_allclose(found.point, reference.x, rtol=1e-11)


def test_steps_do_not_depend_on_the_units_of_equations_and_unknowns():
    # A crank of 30 mm and a rod of 80 mm at 40°: the slider's position beside the rod's angle, in turn in nanometres
    # and in kilometres, with equations in other units still.
    def slider(unit, first, second):
        def equations(x, angle):
            height = 30.0 * np.sin(np.deg2rad(40.0)) - 80.0 * jnp.sin(angle)
            length = 30.0 * np.cos(np.deg2rad(40.0)) + 80.0 * jnp.cos(angle) - x / unit
            return [first * height, second * length]

        return solved(equations, [120.0 * unit, 0.3])

    plain = slider(1.0, 1.0, 1.0)
    angle = np.arcsin(30.0 * np.sin(np.deg2rad(40.0)) / 80.0)
    exact = [30.0 * np.cos(np.deg2rad(40.0)) + 80.0 * np.cos(angle), angle]
    np.testing.assert_allclose(plain.point, exact, rtol=1e-14)
    for unit, first, second in [(1e6, 1e9, 1e-8), (1e-6, 1e-12, 1e12)]:
        other = slider(unit, first, second)
        assert other.converged
        assert other.steps == plain.steps
        np.testing.assert_allclose(other.point / jnp.array([unit, 1.0]), exact, rtol=1e-14)


def test_newton_converges_quadratically():
    # One step more squares the error: from 1e-2 it takes 1e-4, 1e-8, 1e-16.
    assert solved(lambda x: [x**2 - 1.0], [1.01]).steps <= 5


@pytest.mark.parametrize(
    ("function", "guess"),
    [
        (lambda x: [x**2 + 1.0], [1.0]),
        (lambda x: [jnp.exp(x)], [1.0]),
        (lambda x, y: [x + y - 1.0, x + y - 2.0], [0.3, 0.4]),
        (lambda x: [jnp.sqrt(x - 2.0)], [1.0]),
        (lambda x: [x * jnp.nan], [1.0]),
    ],
    ids=["no root", "a root at infinity", "contradictory equations", "not a number at the guess", "never a number"],
)
def test_equations_without_solution_end_as_a_failure(function, guess):
    assert not solved(function, guess).converged


@pytest.mark.parametrize(
    ("function", "guess"),
    [
        (lambda x: [x**2], [1.0]),
        (lambda x: [(x - 1.0) ** 2], [1.0001]),
        (lambda x: [(x - 1.0) ** 3], [1.5]),
        (lambda x: [x**2 - 2.0 * x + 1.0], [1.3]),
        (lambda x: [x**2 - 2.0 * x + 1.0], [1.0000003]),
        (lambda x: [x**2], [0.0]),
        (lambda x, y: [x + y - 1.0, 2.0 * x + 2.0 * y - 2.0], [0.5, 0.5]),
        (lambda x, y: [0.1 * x + 0.3 * y - 1.0, 0.3 * x + 0.9 * y - 3.0], [0.5, 0.7]),
        (lambda x, y: [x - 1.0, x**2 - 1.0], [1.0, 1.0]),
        (lambda x, y: [x - 1.0, 0.0 * y], [1.0, 1.0]),
        (lambda x, y: [x**2 - y, y - x**2], [1.0, 1.0]),
        # Two circles that touch.
        (lambda x, y: [x**2 + y**2 - 1.0, (x - 2.0) ** 2 + y**2 - 1.0], [1.0, 0.3]),
        (lambda x, y: [x**2 + y**2 - 1.0, (x - 2.0) ** 2 + y**2 - 1.0], [0.9, 0.37]),
        (lambda x, y: [x**2 + y**2 - 1.0, (x - 1.7) ** 2 + y**2 - 0.49], [0.9, 0.37]),
    ],
)
def test_a_singular_solution_ends_as_a_failure_and_not_as_garbage(function, guess):
    found = solved(function, guess)
    assert not found.converged


def test_a_failing_point_leaves_the_others_of_its_batch_as_they_are():
    def at(c):
        found = newton(lambda x: x**2 - c, jnp.ones(1))
        return found.point[0], (found.point[0], found.converged)

    levels = jnp.array([2.0, -1.0, 3.0, 0.0, 1e-6])
    slopes, (roots, converged) = compiled(jax.vmap(jax.grad(at, has_aux=True)))(levels)
    assert converged.tolist() == [True, False, True, False, True]
    np.testing.assert_allclose(roots[converged], np.sqrt([2.0, 3.0, 1e-6]), rtol=1e-14)
    np.testing.assert_allclose(slopes[converged], 0.5 / np.sqrt([2.0, 3.0, 1e-6]), rtol=1e-13)


@pytest.mark.parametrize("apart", [1e-2, 1e-3, 1e-4])
def test_two_solutions_that_nearly_meet_are_told_apart(apart):
    # Circles of radius 1 that nearly touch: y = ± sqrt(1 - x²).
    x = np.sqrt(1 - apart**2)
    for sign in (1.0, -1.0):
        found = solved(lambda p, q: [p**2 + q**2 - 1.0, (p - 2.0 * x) ** 2 + q**2 - 1.0], [1.0, 0.3 * sign])
        assert found.converged
        np.testing.assert_allclose(found.point, [x, sign * apart], rtol=1e-15 / apart**2)


@pytest.mark.parametrize(("first", "second"), [(jax.grad, jax.jacfwd), (jax.jacfwd, jax.grad)])
def test_derivatives_of_every_order_follow_from_the_implicit_function_theorem(first, second):
    def cube_root(c):
        return newton(lambda x: x**3 - c, jnp.ones(1)).point[0]

    def derivatives(c):
        once = first(cube_root)
        twice = second(once)
        return once(c), twice(c), first(twice)(c)

    c = 2.0
    once, twice, thrice = compiled(derivatives)(c)
    np.testing.assert_allclose(once, c ** (-2 / 3) / 3, rtol=1e-14)
    np.testing.assert_allclose(twice, -2 * c ** (-5 / 3) / 9, rtol=1e-13)
    np.testing.assert_allclose(thrice, 10 * c ** (-8 / 3) / 27, rtol=1e-12)


def test_derivatives_are_exact_whatever_the_scales():
    # x = p 1e6, y = exp(-q) 1e-6 by equations of 1e9 and 1e-9.
    def at(parameters):
        p, q = parameters

        def function(z):
            return jnp.stack([1e9 * (z[0] - p * 1e6), 1e-9 * (jnp.log(z[1] * 1e6) + q + (z[0] / 1e6 - p))])

        return newton(function, jnp.array([1e6, 1e-6])).point

    jacobian = compiled(jax.jacrev(at))(jnp.array([1.5, 0.3]))
    np.testing.assert_allclose(jacobian[0], [1e6, 0.0], rtol=1e-13)
    np.testing.assert_allclose(jacobian[1], [0.0, -np.exp(-0.3) * 1e-6], rtol=1e-13, atol=1e-19)


def random_systems(count, size, *, singular=False):
    """Random systems `D (A z - b) = 0` of unknowns in other units, `x = E z`, about half of which are zero."""
    random = np.random.default_rng(11)
    A = 0.3 * random.normal(size=(count, size, size)) + 2 * np.eye(size)
    A = A[:, random.permutation(size)]
    if singular:
        A[:, -1] = np.einsum("ck,cki->ci", random.normal(size=(count, size - 1)), A[:, :-1])
    z = random.normal(size=(count, size)) * (random.random((count, size)) < 0.5)
    rows, columns = (10.0 ** random.uniform(-8, 8, (count, size)) for _ in range(2))
    guesses = (z + 0.2 * random.normal(size=z.shape)) * (random.random(z.shape) < 0.5)
    return A, z, rows, columns, guesses


def residuals_of(A, b, rows, columns, curvature):
    def function(x):
        z = x / columns
        return rows * (A @ z - b + curvature * (A.T @ (z * jnp.roll(z, 1) + jnp.sin(z) ** 2)))

    return function


@pytest.mark.slow
@pytest.mark.parametrize("size", [2, 5])
@pytest.mark.parametrize("curvature", [0.0, 0.02], ids=["linear", "curved"])
def test_regular_systems_with_zeros_in_their_solutions_are_solved_in_any_units(size, curvature):
    A, z, rows, columns, guesses = random_systems(300, size)
    ones = np.ones(size)
    b = compiled(jax.vmap(lambda A, z: residuals_of(A, 0 * z, ones, ones, curvature)(z)))(A, z)

    def solve(b, A, rows, columns, guess):
        found = newton(residuals_of(A, b, rows, columns, curvature), guess * columns)
        return found.point, found.converged

    points, converged = jax.jit(jax.vmap(solve))(b, A, rows, columns, guesses)
    assert np.asarray(converged).all()
    np.testing.assert_allclose(points / columns, z, atol=1e-12)
    slopes, _ = compiled(jax.vmap(jax.jacfwd(solve, has_aux=True)))(b, A, rows, columns, guesses)
    if not curvature:
        np.testing.assert_allclose(slopes / columns[:, :, None], np.linalg.inv(A), atol=1e-10)
    assert np.isfinite(slopes).all()


def test_singular_systems_are_called_singular_in_any_units():
    A, z, rows, columns, guesses = random_systems(300, 4, singular=True)
    b = np.einsum("cij,cj->ci", A, z)
    regular = compiled(
        jax.vmap(
            lambda A, b, rows, columns, guess: newton(residuals_of(A, b, rows, columns, 0.0), guess * columns).regular
        )
    )(A, b, rows, columns, guesses)
    assert not np.asarray(regular).any()


@pytest.mark.parametrize("a", [0.5, 1.0, 2.0, 3.0])
def test_an_unknown_that_is_zero_up_to_rounding_is_found(a):
    found = solved(lambda x, y: [x + 0.1 * y - 0.3 / a, a * y - 3.0], [0.0, 1.0])
    assert found.converged
    np.testing.assert_allclose(found.point, [0.0, 3.0 / a], rtol=1e-15, atol=1e-16)


@pytest.mark.parametrize("start", [1e-9, 1e-5, 0.1])
def test_a_double_root_is_singular_however_close_the_guess(start):
    # Circles that touch, at y = 0.
    assert not solved(lambda x, y: [x**2 + y**2 - 1.0, (x - 2.0) ** 2 + y**2 - 1.0], [1.0, start]).converged


def test_an_unknown_that_starts_at_rest_is_measured_by_its_kin():
    """`x² = 4` and `y = (x - 1)²` from (1, 0): the first step leaves y at zero, where it has no size of its own."""

    def equations(z):
        return jnp.array([z[0] ** 2 - 4.0, z[1] - (z[0] - 1.0) ** 2])

    root = compiled(lambda guess: newton(equations, guess, kin=np.array([0, 0])))(jnp.array([1.0, 0.0]))
    assert bool(root.converged)
    np.testing.assert_allclose(root.point, [2.0, 1.0], rtol=1e-14)
