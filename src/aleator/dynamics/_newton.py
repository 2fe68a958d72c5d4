"""Newton's method for implicit equations: damped, indifferent to scales, differentiable as often as wanted."""

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

Vector: TypeAlias = Float[Array, " n"]
Matrix: TypeAlias = Float[Array, "n n"]

_MOST_STEPS = 50
_SMALLEST_DAMPING = 2.0**-12
# Lengths of steps, relative to the unknowns' own scale. Newton goes on to the first, below the noise of rounding in
# most equations; where the noise is larger it is content with the second.
_FINISHED = 1e-13
_CLOSE = 1e-10
# Near a regular solution steps shrink quadratically; towards one where the Jacobian is singular, by halves. The two are
# told apart by steps no longer than the first of these, which come after one longer than the second: above rounding.
_SHORT = 1e-6
_ABOVE_NOISE = 1e-9
_REGULAR_SHRINKAGE = 0.25
_LEAST_REGULARITY = 1e-8


class Root(NamedTuple):
    """Where Newton's method ended, and how.

    - `residuals`: the equations there, in their own units; `relative`: each divided by how much it changes as the
      unknowns change by their own scale;
    - `step`: length of the last Newton step relative to the scale of the unknowns; `shrinkage`: the largest ratio of a
      step to the one before, once they are short;
    - `regularity`: distance of the Jacobian from a singular one, between 0 and 1 (the inverse of its condition number
      in the maximum norm, each equation and unknown in its own scale); `steps`: how many were taken.
    """

    point: Vector
    residuals: Vector
    relative: Vector
    step: Float[Array, ""]
    shrinkage: Float[Array, ""]
    regularity: Float[Array, ""]
    steps: Float[Array, ""]

    @property
    def regular(self) -> Bool[Array, ""]:
        """Whether the Jacobian determines the step, also if it is not a number: then it does not."""
        return (self.regularity >= _LEAST_REGULARITY) & (self.shrinkage <= _REGULAR_SHRINKAGE)

    @property
    def converged(self) -> Bool[Array, ""]:
        """Whether `point` is a solution, one by itself."""
        return self.regular & (self.step <= _CLOSE) & jnp.isfinite(self.point).all()


class _State(NamedTuple):
    point: Vector
    step: Float[Array, ""]
    shrinkage: Float[Array, ""]
    steps: Float[Array, ""]
    moving: Bool[Array, ""]


def newton(function: Callable[[Vector], Vector], guess: Vector) -> Root:
    """Solve `function(unknowns) = 0` from a guess.

    Steps are shortened until they pass the natural monotonicity test of Deuflhard (*Newton Methods for Nonlinear
    Problems*, 2004, section 3.3), which does not depend on the scales of the equations; unknowns are measured by
    themselves (by their guess or current value, whichever is larger; by 1 where both are zero). It stops where rounding
    lets it go no further.

    `point` is differentiable in whatever `function` closes over, forwards, backwards and repeatedly, by the implicit
    function theorem at the solution; all else in the result has derivative zero. May be vectorised: each root is found
    by itself. Nothing is raised: see `Root.converged`, which is of one root.
    """
    point, account = jax.lax.custom_root(
        function, guess, lambda f, start: _iterate(f, start), _solve_tangent, has_aux=True
    )
    return Root(point, *account)


def _iterate(function: Callable[[Vector], Vector], guess: Vector) -> tuple[Vector, tuple[Array, ...]]:
    """The root and, as a tuple, the rest of `Root`."""

    def advance(state: _State) -> _State:
        point = state.point
        scale = _scale(guess, point)
        equations, rows = _equilibrated(jax.jacfwd(function)(point), scale)
        factors = jax.scipy.linalg.lu_factor(equations)

        def correction(at: Vector) -> Vector:
            """The step at `at` with the Jacobian of `point`, in units of `scale`."""
            return jax.scipy.linalg.lu_solve(factors, -function(at) / rows)

        direction = correction(point)
        step = _length(direction)

        def is_refused(damping: Array) -> Bool[Array, ""]:
            ahead = _length(correction(point + damping * scale * direction))
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
        return _State(
            point=jnp.where(moved, point + damping * scale * direction, point),
            step=step,
            shrinkage=jnp.where(tells, jnp.maximum(state.shrinkage, step / state.step), state.shrinkage),
            steps=state.steps + moved,
            moving=moved & ~last,
        )

    zero = jnp.zeros(())
    start = _State(guess, jnp.asarray(jnp.inf), zero, zero, jnp.asarray(True))
    end = jax.lax.while_loop(lambda state: state.moving & (state.steps < _MOST_STEPS), advance, start)
    residuals = function(end.point)
    equations, rows = _equilibrated(jax.jacfwd(function)(end.point), _scale(guess, end.point))
    regularity = 1 / jnp.abs(jnp.linalg.inv(equations)).sum(axis=1).max()
    return end.point, (residuals, residuals / rows, end.step, end.shrinkage, regularity, end.steps)


def _scale(guess: Vector, point: Vector) -> Vector:
    size = jnp.maximum(jnp.abs(guess), jnp.abs(point))
    return jnp.where(size > 0, size, 1.0)


def _length(step: Vector) -> Float[Array, ""]:
    return jnp.abs(step).max()


def _equilibrated(jacobian: Matrix, scale: Vector) -> tuple[Matrix, Vector]:
    """The Jacobian with unknowns in units of `scale` and rows of sum 1 (in absolute value), and the rows' sums before.

    An equation that does not depend on the unknowns has no scale: its row is not a number, and so is the step.
    """
    scaled = jacobian * scale[None, :]
    rows = jnp.abs(scaled).sum(axis=1)
    return scaled / rows[:, None], rows


def _solve_tangent(linear: Callable[[Vector], Vector], right: Vector) -> Vector:
    """Solve `linear(x) = right` for `x`: the implicit function theorem."""
    matrix, rows = _equilibrated(jax.jacfwd(linear)(right), jnp.ones_like(right))
    return jnp.linalg.solve(matrix, right / rows)
