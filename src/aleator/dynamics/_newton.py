"""Newton's method for implicit equations: damped, scale-invariant, differentiable to any order."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int

from aleator._core.arrays import Pytree, in_library, is_number, numbers_to_arrays
from aleator._core.leaves import Known, named_leaves

Vector: TypeAlias = Float[Array, " n"]
Matrix: TypeAlias = Float[Array, "n n"]
_MOST_STEPS = 50
_SMALLEST_DAMPING = 2.0**-12

# Step lengths relative to the sizes of the unknowns. Newton iterates to the first, below the rounding noise of most
# equations; where the noise is larger it accepts the second.
_FINISHED = 1e-13
_CLOSE = 1e-10

# The relative rounding error of an equation's terms.
_ROUNDING = 32 * float(jnp.finfo(float).eps)

# Steps shrink quadratically near a regular solution, but only by halves near one where the Jacobian is singular. They
# are told apart by steps no longer than the first of these that follow one longer than the second, above rounding.
_SHORT = 1e-6
_ABOVE_NOISE = 1e-9
_REGULAR_SHRINKAGE = 0.25
_REGULAR_CHANGE = 0.25
_LEAST_REGULARITY = 1e-8
_BALANCING_SWEEPS = 10
Named: TypeAlias = Callable[[Array], Any]
"""Turns the vector of all unknowns into a named tuple."""
_GOLDEN = (5**0.5 - 1) / 2

# So many residuals are listed one by one.
_LISTED = 8


class Root(NamedTuple):
    """Where Newton's method ended, and how.

    - `residuals`: the residuals there, in the equations' own units; `relative`: each divided by the size of its terms;
    - `step`: length of the last Newton step relative to the sizes of the unknowns, as far as it exceeds rounding;
      `shrinkage`: the largest ratio of a step to the one before, once steps are short;
    - `regularity`: distance of the Jacobian from a singular one, between 0 and 1 (the reciprocal condition number in
      the maximum norm, balanced so that it does not depend on the scales of equations and unknowns); `change`: its
      relative change within the rounding errors of the unknowns; `steps`: the number of steps taken.
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
    def regular(self) -> Bool[Any, ""]:
        """Whether the Jacobian determines the step; false where `regularity` is NaN."""
        steady = (self.shrinkage <= _REGULAR_SHRINKAGE) & (self.change <= _REGULAR_CHANGE)
        return (self.regularity >= _LEAST_REGULARITY) & steady

    @property
    def converged(self) -> Bool[Any, ""]:
        """Whether `point` is an isolated solution."""
        library, point = in_library(self.point)
        return self.regular & (self.step <= _CLOSE) & library.isfinite(point).all()


class _Balanced(NamedTuple):
    """A Jacobian divided by scales of its rows and columns, so that its entries are comparable."""

    matrix: Matrix
    rows: Vector
    columns: Vector


class _State(NamedTuple):
    """Where the iteration is.

    - `looks`: how often it has looked at the point where it ended: there, and beside it by the rounding errors `noise`;
    - `jacobian`, `residuals`: at the latest point; `beside`: the Jacobian beside it.
    """

    point: Vector
    size: Vector
    step: Float[Array, ""]
    shrinkage: Float[Array, ""]
    steps: Float[Array, ""]
    noise: Vector
    moving: Bool[Array, ""]
    looks: Float[Array, ""]
    jacobian: Matrix
    residuals: Vector
    beside: Matrix


def newton(
    function: Callable[[Vector], Vector],
    guess: Vector,
    terms: Callable[[Vector], Vector] | Vector | None = None,
    kin: Int[np.ndarray, " n"] | None = None,
) -> Root:
    """Solve `function(unknowns) = 0` from a guess.

    Steps are shortened until they pass the natural monotonicity test of Deuflhard (*Newton Methods for Nonlinear
    Problems*, 2004, section 3.3), which does not depend on the scales of the equations. The scale of an unknown is the
    largest magnitude that it has taken, guess included; unknowns with the same number in `kin`, such as the
    coefficients of one expansion, share the largest of theirs. An unknown that is zero up to rounding has no such
    scale, so steps within rounding error count as zero. That error is `|J⁻¹| m` times the unit roundoff (Skeel, Journal
    of the ACM 26, 1979), where `m` are the magnitudes of the equations' terms: those in the unknowns, and `terms`,
    those in known numbers (default: none): as a function of the unknowns where known numbers stand in one term with
    them. The iteration stops where rounding prevents further progress.

    `point` is differentiable with respect to whatever `function` closes over, in forward and reverse mode and
    repeatedly, by the implicit function theorem at the solution; everything else in the result has derivative zero. May
    be vectorised: roots are found independently. Nothing is raised: see `Root.converged`, which is for one root.
    """

    def known(at: Vector) -> Vector:
        return jnp.zeros_like(at) if terms is None else jax.lax.stop_gradient(terms(at) if callable(terms) else terms)

    # Traced and differentiated once for all the places where the iteration calls them.
    point, account = jax.lax.custom_root(
        function,
        guess,
        lambda f, start: _iterate(jax.jit(f), start, jax.jit(known), kin),
        _solve_tangent,
        has_aux=True,
    )
    return Root(point, *account)


def _iterate(
    function: Callable[[Vector], Vector],
    guess: Vector,
    terms: Callable[[Vector], Vector],
    kin: Int[np.ndarray, " n"] | None,
) -> tuple[Vector, tuple[Array, ...]]:
    """The root and, as a tuple, the other fields of `Root`."""

    def linearised(at: Vector) -> tuple[Matrix, Vector]:
        """The Jacobian and what is left of the equations, which derivatives compute along with themselves."""
        return jax.jacfwd(lambda at: (function(at),) * 2, has_aux=True)(at)

    def sizes_of(values: Vector) -> Vector:
        """The scale of each unknown."""
        sizes = jnp.abs(values)
        return sizes if kin is None else jnp.zeros_like(sizes).at[kin].max(sizes)[kin]

    def advance(state: _State) -> _State:
        point = state.point
        jacobian, left = linearised(point + jnp.where(state.looks == 1, state.noise, 0.0))
        balanced = _balanced(jacobian)
        inverse = jnp.linalg.inv(balanced.matrix)

        def correction(left: Vector) -> Vector:
            """The step for what is left of the equations, with the Jacobian of `point`."""
            return balanced.columns * (inverse @ (-left / balanced.rows))

        direction = correction(left)
        noise = _noise(jacobian, balanced, inverse, jnp.maximum(state.size, sizes_of(point + direction)), terms(point))
        # An unknown that is zero up to rounding has no scale yet, since its final magnitude is not known.
        size = jnp.where(state.size > noise, state.size, jnp.maximum(noise, sizes_of(direction)))
        step = _length(direction, size, noise)

        def is_refused(damping: Array) -> Bool[Array, ""]:
            ahead = _length(correction(function(point + damping * direction)), size, noise)
            # Unlike `ahead > ...`, this refuses NaN.
            return ~(ahead <= (1 - damping / 4) * step)

        last = (step <= _FINISHED) | ~state.moving
        damping = jax.lax.while_loop(
            lambda damping: ~last & (damping >= _SMALLEST_DAMPING) & is_refused(damping),
            lambda damping: damping / 2,
            jnp.ones(()),
        )
        moved = damping >= _SMALLEST_DAMPING
        tells = (step <= _SHORT) & (state.step > _ABOVE_NOISE)
        following = jnp.where(moved, point + damping * direction, point)
        steps = state.steps + moved
        ahead = _State(
            point=following,
            size=jnp.maximum(state.size, sizes_of(following)),
            step=step,
            shrinkage=jnp.where(tells, jnp.maximum(state.shrinkage, step / state.step), state.shrinkage),
            steps=steps,
            noise=noise,
            moving=moved & ~last & (steps < _MOST_STEPS),
            looks=state.looks,
            jacobian=jacobian,
            residuals=left,
            beside=jacobian,
        )
        first = state.looks == 0
        seen = state._replace(
            looks=state.looks + 1,
            jacobian=jnp.where(first, jacobian, state.jacobian),
            residuals=jnp.where(first, left, state.residuals),
            beside=jacobian,
        )
        return jax.tree.map(lambda moving, still: jnp.where(state.moving, moving, still), ahead, seen)

    zero, n = jnp.zeros(()), len(guess)
    unknown = jnp.zeros((n, n))
    start = _State(
        *(guess, sizes_of(guess), jnp.asarray(jnp.inf), zero, zero, jnp.zeros_like(guess), jnp.asarray(True)),
        *(zero, unknown, jnp.zeros_like(guess), unknown),
    )
    # It ends by two looks from where it has stopped, so that a program contains the equations once.
    end = jax.lax.while_loop(lambda state: state.looks < 2, advance, start)
    jacobian = end.jacobian
    balanced = _balanced(jacobian)
    inverse = jnp.linalg.inv(balanced.matrix)
    regularity = 1 / jnp.abs(inverse).sum(axis=1).max()
    moved = (end.beside - jacobian) * balanced.columns[None, :] / balanced.rows[:, None]
    change = jnp.abs(inverse @ moved).sum(axis=1).max()
    sizes = jnp.abs(jacobian) @ end.size + terms(end.point)
    relative = end.residuals / jnp.where(sizes > 0, sizes, 1.0)
    return end.point, (end.residuals, relative, end.step, end.shrinkage, regularity, change, end.steps)


def _length(step: Vector, size: Vector, noise: Vector) -> Float[Array, ""]:
    """The length of a step relative to the scales of the unknowns; components within rounding count as zero."""
    return jnp.where(jnp.abs(step) <= noise, 0.0, jnp.abs(step) / jnp.where(size > 0, size, 1.0)).max()


def _noise(jacobian: Matrix, balanced: _Balanced, inverse: Matrix, size: Vector, terms: Vector) -> Vector:
    """The rounding errors of the unknowns."""
    open_rows = (jnp.abs(jacobian) @ size + terms) / balanced.rows
    return _ROUNDING * balanced.columns * (jnp.abs(inverse) @ open_rows)


def _balanced(jacobian: Matrix) -> _Balanced:
    """The Jacobian scaled to row and column sums of 1 (of absolute values), as nearly as possible.

    Sinkhorn and Knopp, Pacific Journal of Mathematics 21 (1967). The result does not depend on the units of equations
    and unknowns. It is NaN where an equation does not depend on any unknown, or an unknown is in no equation.
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


def named_root(
    equations: Callable[[Pytree, Any], Float[Array, " n"]], numbers: Pytree, guess: Any
) -> tuple[Root, Named]:
    """Solve `equations(numbers, unknowns) = 0` from a guess, a named tuple of arrays: see `newton`."""
    start, named = ravel_pytree(guess)

    def terms(vector: Vector) -> Vector:
        return constant_terms(lambda values: equations(values, named(vector)), numbers)

    return newton(lambda vector: equations(numbers, named(vector)), start, terms), named


def constant_terms(equations: Callable[[Pytree], Float[Array, " n"]], known: Pytree) -> Float[Array, " n"]:
    """The magnitudes of the terms that known numbers add to each equation: their rounding limits the unknowns.

    Computed by derivatives along all numbers at once, with weights under which terms of opposite sign do not cancel.
    """
    dynamic, static = eqx.partition(numbers_to_arrays(known), eqx.is_inexact_array)
    numbers, combined = ravel_pytree(dynamic)
    if not numbers.size:
        return jnp.zeros_like(equations(known))
    order = np.arange(1, numbers.size + 1)
    weights = np.stack([0.5 + order * _GOLDEN % 1, (-1.0) ** order * (0.5 + order * _GOLDEN**2 % 1)])

    def of(numbers: Float[Array, " numbers"]) -> Float[Array, " n"]:
        return equations(eqx.combine(combined(numbers), static))

    _, along = jax.vmap(lambda weight: jax.jvp(of, (numbers,), (numbers * weight,)))(jnp.asarray(weights))
    return jnp.nan_to_num(jnp.abs(along).max(axis=0), nan=0.0, posinf=0.0)


def failure_text(root: Root, reached: Any, guess: Any) -> str:
    """Where Newton's method went from a guess to other unknowns, as named tuples, and what is left of the equations."""
    worst = int(np.argmax(np.nan_to_num(np.abs(root.relative), nan=np.inf)))
    count = root.relative.size
    every = ", ".join(f"{float(one):.3g}" for one in np.asarray(root.residuals))
    return (
        f"From the guess {listed(guess._asdict())} it reached in {int(root.steps)} steps "
        f"{listed(reached._asdict())}, where equation {worst + 1} of {count} is left with a residual of "
        f"{float(root.residuals[worst]):.3g}{f' (all: {every})' if 1 < count <= _LISTED else ''}{_remark(root)}."
    )


def numbers_in(system: eqx.Module) -> dict[str, Any]:
    """The numbers in the fields of a realised system, by name."""
    own = jax.tree.map(lambda one: None if _is_known(one) else one, system, is_leaf=_is_known)
    return {name: leaf for name, leaf in named_leaves(own) if is_number(leaf) or isinstance(leaf, int)}


def _is_known(node: Any) -> bool:
    return isinstance(node, Known)


def listed(numbers: Mapping[str, Any]) -> str:
    """Numbers with their names."""
    style: Any = {"float_kind": "{:.6g}".format}
    return ", ".join(f"{name}={np.array2string(np.asarray(value), formatter=style)}" for name, value in numbers.items())


def _remark(root: Root) -> str:
    if not np.isfinite(root.residuals).all():
        return ", which is not a finite number"
    if not root.regular:
        return "; the Jacobian is singular there: the equations do not determine the unknowns, or two solutions meet"
    return ""
