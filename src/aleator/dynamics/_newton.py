"""Newton's method for implicit equations: damped, indifferent to scales, differentiable as often as wanted."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

Vector: TypeAlias = Float[Array, " n"]
Matrix: TypeAlias = Float[Array, "n n"]

_MOST_STEPS = 50
_SMALLEST_DAMPING = 2.0**-12
# Lengths of steps, relative to the unknowns' own sizes. Newton goes on to the first, below the noise of rounding in
# most equations; where the noise is larger it is content with the second.
_FINISHED = 1e-13
_CLOSE = 1e-10
# Rounding leaves this share of an equation's terms open.
_ROUNDING = 32 * float(jnp.finfo(float).eps)
# Near a regular solution steps shrink quadratically; towards one where the Jacobian is singular, by halves. The two are
# told apart by steps no longer than the first of these, which come after one longer than the second: above rounding.
_SHORT = 1e-6
_ABOVE_NOISE = 1e-9
_REGULAR_SHRINKAGE = 0.25
_REGULAR_CHANGE = 0.25
_LEAST_REGULARITY = 1e-8
_BALANCING_SWEEPS = 10


class Root(NamedTuple):
    """Where Newton's method ended, and how.

    - `residuals`: the equations there, in their own units; `relative`: each divided by the size of its terms;
    - `step`: length of the last Newton step relative to the sizes of the unknowns, as far as it is above rounding;
      `shrinkage`: the largest ratio of a step to the one before, once they are short;
    - `regularity`: distance of the Jacobian from a singular one, between 0 and 1 (the inverse of its condition number
      in the maximum norm, balanced so that no scale of an equation or an unknown counts); `change`: how much it
      changes, relative to itself, within what rounding leaves open; `steps`: how many were taken.
    """

    point: Vector
    residuals: Vector
    relative: Vector
    step: Float[Array, ""]
    shrinkage: Float[Array, ""]
    regularity: Float[Array, ""]
    change: Float[Array, ""]
    steps: Float[Array, ""]

    @property
    def regular(self) -> Bool[Array, ""]:
        """Whether the Jacobian determines the step, also if it is not a number: then it does not."""
        steady = (self.shrinkage <= _REGULAR_SHRINKAGE) & (self.change <= _REGULAR_CHANGE)
        return (self.regularity >= _LEAST_REGULARITY) & steady

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether `point` is a solution, one by itself."""
        return self.regular & (self.step <= _CLOSE) & jnp.isfinite(self.point).all()


class _Balanced(NamedTuple):
    """A Jacobian over the scales of its rows and columns, which make its entries comparable."""

    matrix: Matrix
    rows: Vector
    columns: Vector


class _State(NamedTuple):
    point: Vector
    size: Vector
    step: Float[Array, ""]
    shrinkage: Float[Array, ""]
    steps: Float[Array, ""]
    moving: Bool[Array, ""]


def newton(
    function: Callable[[Vector], Vector],
    guess: Vector,
    terms: Vector | None = None,
    kin: Int[np.ndarray, " n"] | None = None,
) -> Root:
    """Solve `function(unknowns) = 0` from a guess.

    Steps are shortened until they pass the natural monotonicity test of Deuflhard (*Newton Methods for Nonlinear
    Problems*, 2004, section 3.3), which does not depend on the scales of the equations. Unknowns are measured by
    themselves, by the largest value that each has taken, guess included; those of one number in `kin`, such as the
    coefficients of one expansion, by the largest that any of them has taken. One that is zero up to rounding has no
    such size: steps no longer than rounding leaves open count as none. That is `|J⁻¹| m` times the unit of rounding
    (Skeel, Journal of the ACM 26, 1979), where `m` are the sizes of the equations' terms: of unknowns and of `terms`,
    those that do not depend on unknowns (default: none). It stops where rounding lets it go no further.

    `point` is differentiable in whatever `function` closes over, forwards, backwards and repeatedly, by the implicit
    function theorem at the solution; all else in the result has derivative zero. May be vectorised: each root is found
    by itself. Nothing is raised: see `Root.converged`, which is of one root.
    """
    constant = jnp.zeros_like(guess) if terms is None else jax.lax.stop_gradient(terms)
    point, account = jax.lax.custom_root(
        function, guess, lambda f, start: _iterate(f, start, constant, kin), _solve_tangent, has_aux=True
    )
    return Root(point, *account)


def _iterate(
    function: Callable[[Vector], Vector], guess: Vector, terms: Vector, kin: Int[np.ndarray, " n"] | None
) -> tuple[Vector, tuple[Array, ...]]:
    """The root and, as a tuple, the rest of `Root`."""

    def sizes_of(values: Vector) -> Vector:
        """By what each unknown is measured."""
        sizes = jnp.abs(values)
        return sizes if kin is None else jnp.zeros_like(sizes).at[kin].max(sizes)[kin]

    def advance(state: _State) -> _State:
        point = state.point
        jacobian = jax.jacfwd(function)(point)
        balanced = _balanced(jacobian)
        inverse = jnp.linalg.inv(balanced.matrix)

        def correction(at: Vector) -> Vector:
            """The step at `at` with the Jacobian of `point`."""
            return balanced.columns * (inverse @ (-function(at) / balanced.rows))

        direction = correction(point)
        noise = _noise(jacobian, balanced, inverse, jnp.maximum(state.size, sizes_of(point + direction)), terms)
        # What is zero up to rounding has no size of its own, as long as it is not known where it goes.
        size = jnp.where(state.size > noise, state.size, jnp.maximum(noise, sizes_of(direction)))
        step = _length(direction, size, noise)

        def is_refused(damping: Array) -> Bool[Array, ""]:
            ahead = _length(correction(point + damping * direction), size, noise)
            # Not the same as `ahead > ...`, where a number is not one.
            return ~(ahead <= (1 - damping / 4) * step)

        last = step <= _FINISHED
        damping = jax.lax.while_loop(
            lambda damping: ~last & (damping >= _SMALLEST_DAMPING) & is_refused(damping),
            lambda damping: damping / 2,
            jnp.ones(()),
        )
        moved = damping >= _SMALLEST_DAMPING
        tells = (step <= _SHORT) & (state.step > _ABOVE_NOISE)
        following = jnp.where(moved, point + damping * direction, point)
        return _State(
            point=following,
            size=jnp.maximum(state.size, sizes_of(following)),
            step=step,
            shrinkage=jnp.where(tells, jnp.maximum(state.shrinkage, step / state.step), state.shrinkage),
            steps=state.steps + moved,
            moving=moved & ~last,
        )

    zero = jnp.zeros(())
    start = _State(guess, sizes_of(guess), jnp.asarray(jnp.inf), zero, zero, jnp.asarray(True))
    end = jax.lax.while_loop(lambda state: state.moving & (state.steps < _MOST_STEPS), advance, start)
    residuals = function(end.point)
    jacobian = jax.jacfwd(function)(end.point)
    balanced = _balanced(jacobian)
    inverse = jnp.linalg.inv(balanced.matrix)
    regularity = 1 / jnp.abs(inverse).sum(axis=1).max()
    noise = _noise(jacobian, balanced, inverse, end.size, terms)
    moved = jax.jacfwd(function)(end.point + noise) - jacobian
    change = jnp.abs(inverse @ (moved * balanced.columns[None, :] / balanced.rows[:, None])).sum(axis=1).max()
    sizes = jnp.abs(jacobian) @ end.size + terms
    relative = residuals / jnp.where(sizes > 0, sizes, 1.0)
    return end.point, (residuals, relative, end.step, end.shrinkage, regularity, change, end.steps)


def _length(step: Vector, size: Vector, noise: Vector) -> Float[Array, ""]:
    """The length of a step relative to the sizes of the unknowns; what is not above rounding counts as none."""
    return jnp.where(jnp.abs(step) <= noise, 0.0, jnp.abs(step) / jnp.where(size > 0, size, 1.0)).max()


def _noise(jacobian: Matrix, balanced: _Balanced, inverse: Matrix, size: Vector, terms: Vector) -> Vector:
    """What rounding leaves open of the unknowns."""
    open_rows = (jnp.abs(jacobian) @ size + terms) / balanced.rows
    return _ROUNDING * balanced.columns * (jnp.abs(inverse) @ open_rows)


def _balanced(jacobian: Matrix) -> _Balanced:
    """The Jacobian with rows and columns of sum 1 (in absolute value), as nearly as there are such scales.

    Sinkhorn and Knopp, Pacific Journal of Mathematics 21 (1967). The result does not depend on the units of equations
    and unknowns. Where an equation does not depend on the unknowns, or an unknown is in none, it is not a number.
    """
    sizes = jnp.abs(jax.lax.stop_gradient(jacobian))

    def sweep(_: Array, scales: tuple[Vector, Vector]) -> tuple[Vector, Vector]:
        _, columns = scales
        rows = sizes @ columns
        return rows, 1 / (sizes / rows[:, None]).sum(axis=0)

    start = jnp.ones(len(sizes)), 1 / sizes.sum(axis=0)
    rows, columns = jax.lax.fori_loop(0, _BALANCING_SWEEPS, sweep, start)
    return _Balanced(jacobian * columns[None, :] / rows[:, None], rows, columns)


def _solve_tangent(linear: Callable[[Vector], Vector], right: Vector) -> Vector:
    """Solve `linear(x) = right` for `x`: the implicit function theorem."""
    balanced = _balanced(jax.jacfwd(linear)(right))
    return balanced.columns * jnp.linalg.solve(balanced.matrix, right / balanced.rows)
