"""The shapes: sphere, capsule, box and half-space, in the plane or in space.

Those of finite size are all one `Body`. Numbers are checked and stored as given, and returned as arrays once realised.
"""

import abc
import itertools
from typing import Any, NamedTuple, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Number, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, Module, lowest, realised_shape, stored_number, stored_numbers

TINY = 1e-200
"""A squared length below which a vector has no direction."""


class Body(NamedTuple):
    """All points within `radius` of the core `center + sum_i s_i directions_i`, `|s_i| <= extents_i`.

    The `k` directions are orthonormal: none for a sphere, one for a capsule, all for a box.
    """

    center: Float[Array, " d"]
    directions: Float[Array, "k d"]
    extents: Float[Array, " k"]
    radius: Float[Array, ""]

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.center.shape[-1]

    @property
    def rank(self) -> int:
        """The number of directions in which the core extends."""
        return self.extents.shape[-1]

    @property
    def generators(self) -> Float[Array, "k d"]:
        """The half edges of the core, as vectors."""
        return self.extents[:, None] * self.directions

    def points(self, signs: Float[np.ndarray, "n k"]) -> Float[Array, "n d"]:
        """The points of the core at the given multiples of its half edges."""
        return self.center[None, :] + jnp.asarray(signs) @ self.generators

    def vertices(self) -> Float[Array, "n d"]:
        """The `2^k` vertices of the core."""
        return self.points(sign_table(self.rank))


def sign_table(rank: int) -> Float[np.ndarray, "n k"]:
    """Every choice of `rank` signs, one per row."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=rank))).reshape(2**rank, rank)


def unit(
    vectors: Float[Array, "*n d"], smallest_square: float
) -> tuple[Float[Array, "*n d"], Float[Array, "*n"], Array]:
    """Unit vectors, their original lengths, and which of them were long enough to be normalised.

    A vector that is too short is returned unchanged with length 0; its derivatives are finite.
    """
    squares = jnp.sum(vectors**2, axis=-1)
    is_long = squares > smallest_square
    # The argument of the root is guarded: its derivative at zero is infinite, even in a branch that is not used.
    lengths = jnp.sqrt(jnp.where(is_long, squares, 1.0))
    return vectors / lengths[..., None], jnp.where(is_long, lengths, 0.0), is_long


# The matrix of `a ×` is the product of `a` with this.
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)


def cross(first: Float[Array, "*n 3"], second: Float[Array, "*m 3"]) -> Float[Array, "*nm 3"]:
    """The cross product by two equations, where `jnp.cross` takes a dozen: it is traced many times."""
    return jnp.einsum("...ij,...j->...i", jnp.tensordot(first, _CROSS, 1), second)


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
        self.center = _stored_point("Sphere: 'center'", center)
        self.radius = _stored_radius("Sphere: 'radius'", radius)

    @override
    def body(self) -> Body:
        center = _realised_point("Sphere: 'center'", self.center)
        return Body(center, jnp.zeros((0, center.size)), jnp.zeros(0), _realised("Sphere: 'radius'", self.radius))


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
        self.start, self.end = (
            _stored_point(f"Capsule: {name}", one) for name, one in (("'start'", start), ("'end'", end))
        )
        _refuse_other_sizes("Capsule", start=self.start, end=self.end)
        self.radius = _stored_radius("Capsule: 'radius'", radius)

    @override
    def body(self) -> Body:
        start, end = _realised_point("Capsule: 'start'", self.start), _realised_point("Capsule: 'end'", self.end)
        direction, half_length, is_long = unit((end - start) / 2, TINY)
        direction = jnp.where(is_long, direction, jnp.eye(start.size)[0])
        radius = _realised("Capsule: 'radius'", self.radius)
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
        self.center = _stored_point("Box: 'center'", center)
        self.half_sizes = stored_numbers("Box: 'half_sizes'", half_sizes)
        _refuse_other_sizes("Box", center=self.center, half_sizes=self.half_sizes)
        refuse_small("Box: 'half_sizes'", self.half_sizes, may_vanish=False)
        self.orientation = None if orientation is None else stored_numbers("Box: 'orientation'", orientation)
        if self.orientation is not None:
            _check_orientation(self.orientation, realised_shape(self.center)[0])

    @override
    def body(self) -> Body:
        center = _realised_point("Box: 'center'", self.center)
        half_sizes = _realised("Box: 'half_sizes'", self.half_sizes)
        return Body(center, self._directions(center.size), half_sizes, jnp.zeros(()))

    def _directions(self, dimension: int) -> Float[Array, "d d"]:
        """The box's axes, one a row."""
        if self.orientation is None:
            return jax_array(np.eye(dimension))
        orientation = _realised("Box: 'orientation'", self.orientation)
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
        self.normal = _stored_point("HalfSpace: 'normal'", normal)
        self.offset = stored_number("HalfSpace: 'offset'", offset)
        normal = _plain(self.normal)
        if normal is not None and not normal.any():
            raise ProblemError(
                f"HalfSpace: 'normal' must not be zero; received {normal}. Give the direction that points out of the "
                "solid."
            )

    def plane(self) -> tuple[Float[Array, " d"], Float[Array, ""]]:
        """The unit normal, and the plane's distance from the origin along it."""
        normal = _realised_point("HalfSpace: 'normal'", self.normal)
        length = jnp.linalg.norm(normal)
        return normal / length, _realised("HalfSpace: 'offset'", self.offset) / length


def _check_orientation(orientation: Any, dimension: int) -> None:
    wanted, words = ((), "one angle in rad") if dimension == 2 else ((3, 3), "a rotation matrix of shape (3, 3)")
    if realised_shape(orientation) != wanted:
        raise ProblemError(
            f"Box: in {dimension} dimensions 'orientation' takes {words}; received shape {realised_shape(orientation)}."
        )
    matrix = _plain(orientation)
    if dimension == 3 and matrix is not None and not np.allclose(matrix @ matrix.T, np.eye(3), rtol=0.0, atol=1e-6):
        raise ProblemError(f"Box: 'orientation' is not a rotation matrix: its columns are not orthonormal; {matrix}.")


def _plain(value: Any) -> np.ndarray | None:
    """The values of a stored field if they are known; `None` where they are uncertain, decided or traced."""
    return value if isinstance(value, np.ndarray) else None


def _stored_point(what: str, value: Any) -> Any:
    """A vector of the plane or of space as it is stored. Raises `ProblemError` for another shape."""
    numbers = stored_numbers(what, value)
    _refuse_no_point(what, numbers)
    return numbers


def _refuse_no_point(what: str, numbers: Any) -> None:
    if realised_shape(numbers) not in ((2,), (3,)):
        raise ProblemError(
            f"{what} takes 2 numbers in the plane or 3 in space; received shape {realised_shape(numbers)}. For a batch "
            "of shapes, use `jax.vmap`."
        )


def _refuse_other_sizes(owner: str, **fields: Any) -> None:
    sizes = {name: realised_shape(value) for name, value in fields.items()}
    if len(set(sizes.values())) > 1:
        received = " and ".join(f"'{name}' of shape {size}" for name, size in sizes.items())
        raise ProblemError(f"{owner}: expected vectors of the same size; received {received}.")


def _stored_radius(what: str, value: Any) -> Any:
    number = stored_number(what, value)
    refuse_small(what, number, may_vanish=True)
    return number


def refuse_small(what: str, numbers: Any, *, may_vanish: bool) -> None:
    """Raise `ProblemError` if one of some numbers can become negative, or zero where it may not, as far as known."""
    least = lowest(numbers)
    if least is None or least > 0 or (may_vanish and least == 0):
        return
    reach = "numbers that are unbounded below" if least == -np.inf else f"numbers that can reach {least:g}"
    remedy = (
        ". Give larger numbers, distributions that are bounded or spread less, or decisions with higher lower bounds"
    )
    received = reach + remedy if _plain(numbers) is None else f"{numbers}"
    raise ProblemError(f"{what} must be {'zero or more' if may_vanish else 'positive'}; received {received}.")


def _realised(what: str, value: Any) -> Float[Array, "..."]:
    """A field as an array. Raises `ProblemError` if it still holds a distribution or a decision."""
    if isinstance(value, list | tuple):
        return jnp.stack([_realised(what, part) for part in value])
    if isinstance(value, AbstractLeaf):
        raise ProblemError(
            f"{what} holds {value}, which has no value yet. Take distances where the model is realised: in a system's "
            "outputs."
        )
    return jnp.asarray(value, dtype=float)


def _realised_point(what: str, value: Any) -> Float[Array, " d"]:
    """A vector of the plane or of space as an array, checked again: batches show only when distances are taken."""
    point = _realised(what, value)
    _refuse_no_point(what, point)
    return point
