"""`BSpline`: clamped B-splines with given end conditions and free control points in between.

Their bases come from the Cox-de Boor recursion, as matrices from control points to values and derivatives.
"""

from functools import lru_cache
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core import border as check
from aleator._core.arrays import block_diagonal, in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, is_leaf, lowest, realised_shape, stored_numbers
from aleator.trajectories._signals import AbstractTrajectory, Fractions, as_array, conditions

_KIND = "BSpline"


@final
class BSpline(AbstractTrajectory):
    """A clamped B-spline of any degree (section 5.2.2): `B(u) = sum of basis_i(u) p_i` over the duration, equation
    (52).

    - `free`: the control points that the end conditions do not determine, shape (free, ...):
      `al.Decision(guess, -3.0, 3.0)`, or numbers. A point is a number, or a vector with one number per joint;
    - `start`, `end`: `(value, velocity, acceleration)` there, or the first one or two of them, or none: each condition
      determines one control point besides the free ones. Its numbers may be uncertain or decided too;
    - `degree`: the degree of the polynomials between knots;
    - `knots`: the interior knots, increasing, between 0 and 1; uniform by default. Or `spans`: relative lengths between
      successive knots, as positive numbers, distributions or a `Decision`, which keeps decided knots in order.

    The curve stays in the convex hull of its control points, so bounds on these hold for the curve at all times; see
    `hull`. Raises `ProblemError` for too few control points, end conditions of another shape or on a derivative that
    the degree does not have, and knots that are out of order or not plain numbers.
    """

    free: Any
    start: tuple[Any, ...]
    end: tuple[Any, ...]
    degree: int = eqx.field(static=True)
    knots: tuple[float, ...] | None = eqx.field(static=True)
    spans: Any

    curve_fields: ClassVar[tuple[str, ...]] = ("free", "start", "end")

    def __init__(
        self,
        free: Any,
        *,
        start: Any = (),
        end: Any = (),
        degree: int = 3,
        knots: Any = None,
        spans: Any = None,
    ):
        self.free = stored_numbers(f"{_KIND}: control points", free)
        if len(realised_shape(self.free)) == 0:
            raise ProblemError(
                f"{_KIND}: expected several control points, such as al.Decision(np.zeros(8), -3.0, 3.0); received one."
            )
        self.degree = check.whole(f"{_KIND}: its degree", degree)
        self.start = conditions(_KIND, "start", start, self.shape)
        self.end = conditions(_KIND, "end", end, self.shape)
        most = max(len(self.start), len(self.end)) - 1
        if most > self.degree:
            raise ProblemError(
                f"{_KIND}: a curve of degree {self.degree} has no derivative of order {most} to prescribe at an end: "
                "raise the degree, or drop that condition."
            )
        interior = self.count - self.degree - 1
        if interior < 0:
            raise ProblemError(
                f"{_KIND}: degree {degree} needs at least {degree + 1} control points in all; received "
                f"{realised_shape(self.free)[0]} free ones and {len(self.start)} conditions at the start and "
                f"{len(self.end)} at the end. Give {-interior} more free control points."
            )
        if knots is not None and spans is not None:
            raise ProblemError(f"{_KIND}: expected knots or spans; received both.")
        self.spans = None if spans is None else _checked_spans(spans, interior + 1)
        self.knots = None if spans is not None else _checked_knots(knots, interior)

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return realised_shape(self.free)[1:]

    @property
    def count(self) -> int:
        """The total number of control points."""
        return realised_shape(self.free)[0] + len(self.start) + len(self.end)

    def values(self, fractions: Fractions, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        """As in `AbstractTrajectory.values`; derivatives by the splines of equations (56) and (57)."""
        weights = basis_matrix(fractions, self.all_knots(), self.degree, order)
        # Known knots make one known matrix of both.
        xp, weights, change = in_library(weights, self._points_by_conditions())
        weights = jax_array(weights @ change) if xp is jnp else weights @ change
        xp, weights, numbers, duration = in_library(weights, self._conditions(duration), duration)
        values = xp.tensordot(weights, numbers, axes=1)
        return jax_array(values / duration**order if order else values)

    def all_knots(self) -> tuple[float, ...] | Float[Array, " knots"]:
        """All knots over [0, 1], the ends repeated `degree + 1` times."""
        if self.knots is not None:
            return tuple(clamped(self.knots, self.degree).tolist())
        ends = jnp.cumsum(as_array(self.spans))
        return clamped(ends[:-1] / ends[-1], self.degree)

    @override
    def breaks(self) -> Float[np.ndarray, " ends"]:
        """The distinct knots, ends included."""
        return np.unique(np.asarray(self.all_knots()))

    def control_points(self, duration: Any = 1.0, order: int = 0) -> Float[Array, "n ..."]:
        """All control points, or those of a time derivative (equation 54), for a duration in s."""
        if order > self.degree:
            return jnp.zeros((1, *self.shape))
        xp, change, numbers = in_library(self._points_by_conditions(), self._conditions(duration))
        points = xp.tensordot(change, numbers, axes=1)
        if order == 0:
            return jax_array(points)
        change = derived(self.all_knots(), self.degree, order)
        xp, change, points, duration = in_library(change, points, duration)
        return jax_array(xp.tensordot(change, points, axes=1) / duration**order)

    def hull(self, duration: Any = 1.0, order: int = 0) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Lower and upper bounds of the curve, or of a time derivative, at all times: those of its control points."""
        library, points = in_library(self.control_points(duration, order))
        return jax_array(library.min(points, axis=0)), jax_array(library.max(points, axis=0))

    def _conditions(self, duration: Any) -> Any:
        """The conditions at the start, the free control points, the conditions at the end: shape (count, ...).

        Velocities are multiplied by the duration, accelerations by its square.
        """
        ends = [[as_array(one) for one in end] for end in (self.start, self.end)]
        xp, ends, free, duration = in_library(ends, as_array(self.free), duration)
        start, end = (
            [(one * duration**order if order else one)[None] for order, one in enumerate(conditions)]
            for conditions in ends
        )
        return xp.concatenate([*start, free, *end[::-1]])

    def _points_by_conditions(self) -> Any:
        """The matrix that gives all control points from `_conditions`."""
        start, end = (self._eliminated(side) for side in (0, 1))
        xp, start, free, end = in_library(start, np.eye(realised_shape(self.free)[0]), end[::-1, ::-1])
        return block_diagonal(xp, start, free, end)

    def _eliminated(self, side: int) -> Any:
        """The control points that the conditions at one end determine, by these, outermost first."""
        end, knots, count = np.array([float(side)]), self.all_knots(), len((self.start, self.end)[side])
        rows = [basis_matrix(end, knots, self.degree, order)[0][:: -1 if side else 1] for order in range(count)]
        xp, rows = in_library(rows)
        points: list[Any] = []
        for condition, weights in zip(np.eye(count), rows, strict=True):
            # At an end, a derivative of order k depends on the outermost k + 1 control points only.
            known = sum((weights[i] * point for i, point in enumerate(points)), start=xp.zeros(count))
            points.append((condition - known) / weights[len(points)])
        return xp.stack(points) if points else xp.zeros((0, 0))


def fit_control_points(
    path: Any, free: int, *, start: Any = (), end: Any = (), degree: int = 3, duration: float = 1.0
) -> Float[np.ndarray, "free ..."]:
    """The free control points of the `BSpline` with these end conditions that fits a path best, in least squares.

    - `path`: values at uniform instants from start to end, shape (instants, ...), at least `free` of them;
    - `start`, `end`, `degree`: as for `BSpline`, in plain numbers;
    - `duration`: s, which scales velocities and accelerations at the ends.

    A first guess for an optimiser:
    `al.Decision(al.fit_control_points(np.linspace(q_0, q_f, 50), 8, start=..., end=...))`. Raises `ProblemError` for
    too few instants, and for numbers that are not finite or not plain.
    """
    who = "fit_control_points"
    samples, free = check.real_array(f"{who}: path", path), check.whole(f"{who}: free", free)
    duration = check.positive(f"{who}: duration", duration)
    if samples.ndim == 0 or len(samples) < free or not np.isfinite(samples).all():
        raise ProblemError(
            f"fit_control_points: path: expected finite values at {free} or more instants; received shape "
            f"{samples.shape}."
        )
    if any(is_leaf(number) for number in jax.tree.leaves((start, end), is_leaf=is_leaf)):
        raise ProblemError(
            "fit_control_points: expected plain numbers at the ends; received distributions or decisions."
        )
    bare = BSpline(np.zeros((free, *samples.shape[1:])), start=start, end=end, degree=degree)
    fractions = np.linspace(0.0, 1.0, len(samples))
    weights = basis_matrix(fractions, bare.all_knots(), degree, 0)
    rest = samples - np.asarray(bare.values(fractions, duration))
    inner = weights[:, len(bare.start) : bare.count - len(bare.end)]
    solution = np.linalg.lstsq(inner, rest.reshape(len(samples), -1), rcond=None)[0]
    return solution.reshape(free, *samples.shape[1:])


def _checked_knots(knots: Any, interior: int) -> tuple[float, ...]:
    if knots is None:
        return tuple((i / (interior + 1)) for i in range(1, interior + 1))
    if any(isinstance(knot, AbstractLeaf | Tracer) for knot in jax.tree.leaves(knots, is_leaf=is_leaf)):
        raise ProblemError(
            f"{_KIND}: expected plain numbers as knots; received {knots!r}. Decided or uncertain knots are given by "
            f"the lengths between them, such as spans=al.Decision(np.ones({interior + 1}), 0.2, 5.0)."
        )
    values = tuple(np.ravel(check.real_array(f"{_KIND}: knots", knots)).tolist())
    ordered = all(a < b for a, b in zip((0.0, *values), (*values, 1.0), strict=True))
    if len(values) != interior or not ordered:
        raise ProblemError(f"{_KIND}: expected {interior} increasing knots between 0 and 1; received {list(values)}.")
    return values


def _checked_spans(spans: Any, count: int) -> Any:
    lengths = stored_numbers(f"{_KIND}: spans", spans)
    least = lowest(lengths)
    if realised_shape(lengths) != (count,) or (least is not None and least <= 0):
        raise ProblemError(
            f"{_KIND}: expected {count} positive spans, or distributions that stay positive, or a Decision of that "
            f"many with positive lower bounds, such as al.Decision(np.ones({count}), 0.2, 5.0); received {spans!r}."
        )
    return lengths


def clamped(interior: Any, degree: int) -> Any:
    """The knots of a clamped spline over [0, 1]: each end `degree + 1` times, with the interior knots in between."""
    xp, interior = _vectors(interior)
    return xp.concatenate([xp.zeros(degree + 1), interior, xp.ones(degree + 1)])


def basis(u: Any, knots: Any, degree: int) -> Any:
    """All basis functions at the points `u`, by the Cox-de Boor recursion (equation 53): shape (points, functions).

    The first and the last interval extend beyond the ends, since rounding may put a point there.
    """
    xp, u, knots = _vectors(u, knots)
    u = u[:, None]

    def ratio(numerator: Any, denominator: Any) -> Any:
        proper = denominator > 0  # where knots coincide, 0
        return xp.where(proper, numerator / xp.where(proper, denominator, 1.0), 0.0)

    left, right = knots[:-1][None], knots[1:][None]
    within = ((u >= left) | (left <= knots[0])) & ((u < right) | (right >= knots[-1]))
    values = xp.where(within & (left < right), 1.0, 0.0)
    for p in range(1, degree + 1):
        rising = ratio(u - knots[: -p - 1][None], (knots[p:-1] - knots[: -p - 1])[None])
        falling = ratio(knots[p + 1 :][None] - u, (knots[p + 1 :] - knots[1:-p])[None])
        values = rising * values[:, :-1] + falling * values[:, 1:]
    return values


def derived(knots: Any, degree: int, order: int) -> Any:
    """The matrix from a spline's control points to those of its derivative (equation 54): (n - order, n)."""
    xp, knots = _vectors(knots)
    change = xp.eye(len(knots) - degree - 1)
    for p in range(degree, degree - order, -1):
        knots = knots[1:-1]
        change = (p / (knots[p:] - knots[:-p]))[:, None] * xp.diff(change, axis=0)
    return change


def matrix(u: Any, knots: Any, degree: int, order: int = 0) -> Any:
    """From control points to the derivative of some order at the points `u`: shape (points, control points)."""
    if order > degree:
        return np.zeros((len(u), len(knots) - degree - 1))
    return basis(u, knots[order : len(knots) - order], degree - order) @ derived(knots, degree, order)


@lru_cache(maxsize=256)
def _fixed_matrix(u: bytes, knots: tuple[float, ...], degree: int, order: int) -> Float[np.ndarray, "points n"]:
    return matrix(np.frombuffer(u), knots, degree, order)


def basis_matrix(u: Any, knots: tuple[float, ...] | Array, degree: int, order: int) -> Any:
    """The same as `matrix`, but cached for plain points and fixed knots, where it is a constant of the compiled
    program.
    """
    if isinstance(u, np.ndarray) and isinstance(knots, tuple):
        return _fixed_matrix(np.ascontiguousarray(u, dtype=float).tobytes(), knots, degree, order)
    return matrix(u, knots, degree, order)


def _vectors(*vectors: Any) -> tuple[Any, ...]:
    """The library for some vectors, which may be tuples of plain numbers, and the vectors in it."""
    return in_library(*(np.array(one) if isinstance(one, tuple) else one for one in vectors))
