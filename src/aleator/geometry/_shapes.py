"""The shapes: sphere, capsule, box and half-space, in the plane or in space."""

import abc
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Number
from aleator._core.errors import ProblemError
from aleator._core.module import Module
from aleator.geometry._body import TINY, Body, unit
from aleator.geometry._numbers import (
    check_lengths,
    check_number,
    check_point,
    check_radius,
    check_same_size,
    plain,
    realised,
    realised_point,
    shape_of,
    stored,
)


class AbstractShape(Module):
    """A solid in the plane or in space.

    Every number may be plain, traced by JAX or, before the model is realised, a distribution or a decision. So a shape
    may be a field of a model (an obstacle at an uncertain position) or be built in a system's outputs (a link between
    two joints). A vector may be an array or a sequence that mixes all of these.
    """


class AbstractBounded(AbstractShape):
    """A shape of finite size."""

    @abc.abstractmethod
    def body(self) -> Body:
        """The shape as a rounded box of any rank."""


@final
class Sphere(AbstractBounded):
    """The ball of the given `radius` (m) around `center` (m); a disc in the plane, a point where the radius is 0.

    Raises `ProblemError` if `center` does not have 2 or 3 numbers, if a plain number is not finite, or if the radius
    can become negative by its value, its distribution or the bounds of its decision.
    """

    center: Any
    radius: Number

    def __init__(self, center: Any, radius: Any = 0.0):
        self.center = stored("Sphere", "center", center)
        self.radius = stored("Sphere", "radius", radius)
        check_point("Sphere", "center", self.center)
        check_radius("Sphere", self.radius)

    @override
    def body(self) -> Body:
        center = realised_point("Sphere", "center", self.center)
        radius = realised("Sphere", "radius", self.radius)
        return Body(center, jnp.zeros((0, center.size)), jnp.zeros(0), radius)


@final
class Capsule(AbstractBounded):
    """All points within `radius` (m) of the segment from `start` to `end` (m); the segment itself where it is 0.

    For example, a link of an arm between two joints. Where start and end coincide it is a sphere; derivatives are
    finite there, and those with respect to the two ends are the sphere's, shared equally.

    Raises `ProblemError` unless both ends have 2 or both have 3 numbers, if a plain number is not finite, or if the
    radius can become negative by its value, its distribution or the bounds of its decision.
    """

    start: Any
    end: Any
    radius: Number

    def __init__(self, start: Any, end: Any, radius: Any = 0.0):
        self.start = stored("Capsule", "start", start)
        self.end = stored("Capsule", "end", end)
        self.radius = stored("Capsule", "radius", radius)
        check_point("Capsule", "start", self.start)
        check_same_size("Capsule", start=self.start, end=self.end)
        check_radius("Capsule", self.radius)

    @override
    def body(self) -> Body:
        start = realised_point("Capsule", "start", self.start)
        end = realised_point("Capsule", "end", self.end)
        direction, half_length, is_long = unit((end - start) / 2, TINY)
        direction = jnp.where(is_long, direction, jnp.eye(start.size)[0])
        radius = realised("Capsule", "radius", self.radius)
        return Body((start + end) / 2, direction[None, :], half_length[None], radius)


@final
class Box(AbstractBounded):
    """The box around `center` (m) that extends `half_sizes` (m) along each of its own axes; a rectangle in the plane.

    `orientation` turns the box's axes: an angle (rad) in the plane, a rotation matrix of shape (3, 3) in space, whose
    columns are the box's axes. By default they are the coordinate axes.

    Raises `ProblemError` unless both vectors have 2 or both have 3 numbers, if `orientation` has another shape, if a
    plain number is not finite or a plain orientation is not a rotation, or if a half size can become zero or negative
    by its value, its distribution or the bounds of its decision.
    """

    center: Any
    half_sizes: Any
    orientation: Any

    def __init__(self, center: Any, half_sizes: Any, orientation: Any = None):
        self.center = stored("Box", "center", center)
        self.half_sizes = stored("Box", "half_sizes", half_sizes)
        self.orientation = None if orientation is None else stored("Box", "orientation", orientation)
        check_point("Box", "center", self.center)
        check_same_size("Box", center=self.center, half_sizes=self.half_sizes)
        check_lengths("Box", "half_sizes", self.half_sizes)
        if self.orientation is not None:
            _check_orientation(self.orientation, shape_of(self.center)[0])

    @override
    def body(self) -> Body:
        center = realised_point("Box", "center", self.center)
        half_sizes = realised("Box", "half_sizes", self.half_sizes)
        return Body(center, self._directions(center.size), half_sizes, jnp.zeros(()))

    def _directions(self, dimension: int) -> Float[Array, "d d"]:
        """The box's axes, one a row."""
        if self.orientation is None:
            return jnp.eye(dimension)
        orientation = realised("Box", "orientation", self.orientation)
        if dimension == 3:
            return orientation.T
        cos, sin = jnp.cos(orientation), jnp.sin(orientation)
        return jnp.stack([jnp.stack([cos, sin]), jnp.stack([-sin, cos])])


@final
class HalfSpace(AbstractShape):
    """All points `x` with `normal . x <= offset`: a wall or a floor, in the plane a half-plane.

    `normal` points out of the solid and need not be of unit length; `offset` is in m times that length. The floor at
    height 0 is `HalfSpace([0.0, 0.0, 1.0], 0.0)`.

    Raises `ProblemError` if `normal` does not have 2 or 3 numbers, or if a plain number is not finite or a plain normal
    is zero.
    """

    normal: Any
    offset: Number

    def __init__(self, normal: Any, offset: Any):
        self.normal = stored("HalfSpace", "normal", normal)
        self.offset = stored("HalfSpace", "offset", offset)
        check_point("HalfSpace", "normal", self.normal)
        check_number("HalfSpace", "offset", self.offset)
        normal = plain(self.normal)
        if normal is not None and not normal.any():
            raise ProblemError(
                f"HalfSpace: 'normal' must not be zero; received {normal}. Give the direction that points out of the "
                "solid."
            )

    def plane(self) -> tuple[Float[Array, " d"], Float[Array, ""]]:
        """The unit normal, and the plane's distance from the origin along it."""
        normal = realised_point("HalfSpace", "normal", self.normal)
        length = jnp.linalg.norm(normal)
        return normal / length, realised("HalfSpace", "offset", self.offset) / length


def _check_orientation(orientation: Any, dimension: int) -> None:
    wanted, words = ((), "one angle in rad") if dimension == 2 else ((3, 3), "a rotation matrix of shape (3, 3)")
    if shape_of(orientation) != wanted:
        raise ProblemError(
            f"Box: in {dimension} dimensions 'orientation' takes {words}; received shape {shape_of(orientation)}."
        )
    matrix = plain(orientation)
    if dimension == 3 and matrix is not None and not np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=1e-6):
        raise ProblemError(f"Box: 'orientation' is not a rotation matrix: its columns are not orthonormal; {matrix}.")
