"""`Body`: one rigid body of a tree, with its joint and its mass properties."""

from typing import Any, final

import equinox as eqx
import numpy as np

from aleator._core.border import a_name
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.mechanics._joints import AbstractJoint, Fixed
from aleator.mechanics._spatial import Block, Inertia, Pose, all_known, as_array, from_angles, is_known, library, skew

# The rounding error allowed in an inertia on the verge of the possible, relative to its largest moment.
_ROUNDING = 1e-9


@final
class Body(Module):
    """A rigid body of an `al.Multibody`, with the joint that connects it to its parent. Lengths in m, angles in rad.

    - `name`, `parent`: its own name and that of the body it is connected to; `None` for the ground;
    - `joint`: `al.joints.Revolute`, `al.joints.Prismatic`, `al.joints.Ball`, `al.joints.Free`, or `al.joints.Fixed` for
      a part rigidly fixed to its parent;
    - `position` (3,), `orientation`: the joint's frame in the parent's frame; the orientation is roll, pitch and yaw
      (about x, then y, then z of the parent), or a rotation matrix (3, 3). At zero coordinates the body's frame is the
      joint's;
    - `mass` in kg, `center` (3,): the centre of mass in the body's frame;
    - `inertia` in kg·m², about the centre of mass and along the body's axes: three principal moments, the six numbers
      xx, yy, zz, xy, xz, yz, or a matrix (3, 3). A plane model needs only one moment, such as `(0, 0, J)`.

    Each number may also be a tracer, alone or within a sequence. Known numbers are checked when the tree is built (for
    distributions, those at the ends of their support, when a problem is declared): `ProblemError` is raised for a
    negative mass, an orientation that is not a rotation, and an inertia that no body can have.
    """

    name: str = eqx.field(static=True)
    parent: str | None = eqx.field(static=True, default=None, kw_only=True)
    joint: AbstractJoint | Fixed = eqx.field(kw_only=True)
    mass: Any = eqx.field(kw_only=True)
    center: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    inertia: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    position: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)
    orientation: Any = eqx.field(default=(0.0, 0.0, 0.0), kw_only=True)

    def __check_init__(self):
        if not isinstance(self.name, str) or not self.name:
            raise ProblemError(f"Body: expected a name; received {self.name!r}.")
        if not isinstance(self.joint, AbstractJoint | Fixed):
            raise ProblemError(
                f"Body '{self.name}': expected a joint, such as al.joints.Revolute('z') or al.joints.Fixed(); received "
                f"{self.joint!r}."
            )
        if self.parent is not None:
            a_name(f"Body '{self.name}': parent", self.parent)
        if all_known(self.mass, self.center, self.inertia):
            inertia(self)
        if all_known(self.position, self.orientation):
            placement(self)


def placement(body: Body) -> Pose:
    """The frame of a body's joint in its parent's frame."""
    return frame(f"Body '{body.name}'", body.position, body.orientation)


def frame(what: str, position: Any, orientation: Any) -> Pose:
    """A frame by its origin and by three angles or a rotation matrix. Raises `ProblemError` for what is none."""
    given = as_array(orientation, f"{what}: orientation", (3,), (3, 3))
    rotation = from_angles(given) if given.shape == (3,) else given
    if is_known(rotation) and not _turns(np.asarray(rotation)):
        raise ProblemError(f"{what}: orientation: expected a rotation matrix; received {orientation!r}.")
    return Pose(rotation, as_array(position, f"{what}: position", (3,)))


def _turns(matrix: np.ndarray) -> bool:
    return np.allclose(matrix @ matrix.T, np.eye(3), rtol=0, atol=_ROUNDING) and np.linalg.det(matrix) > 0


def inertia(body: Body) -> Inertia:
    """The inertia of a body in its own frame."""
    mass = as_array(body.mass, f"Body '{body.name}': mass", ())
    if is_known(mass) and np.asarray(mass) < 0:
        raise ProblemError(f"Body '{body.name}': expected a mass that is not negative; received {body.mass}.")
    center = as_array(body.center, f"Body '{body.name}': center", (3,))
    across = skew(center)
    return Inertia(mass, mass * center, _moments(body) - mass * (across @ across))


def _moments(body: Body) -> Block:
    """The inertia about the centre of mass, as a matrix."""
    where = f"Body '{body.name}': inertia"
    given = as_array(body.inertia, where, (3,), (6,), (3, 3))
    matrix = _matrix(given)
    if is_known(matrix):
        _check_moments(np.asarray(matrix), where)
    return matrix


def _matrix(given: Block) -> Block:
    if given.shape == (3, 3):
        return given
    xp = library(given)
    if given.shape == (3,):
        return xp.diag(given)
    xx, yy, zz, xy, xz, yz = given
    return xp.stack([xp.stack([xx, xy, xz]), xp.stack([xy, yy, yz]), xp.stack([xz, yz, zz])])


def _check_moments(matrix: np.ndarray, where: str) -> None:
    """Refuse a matrix that is not symmetric or has principal moments that no body can have."""
    slack = _ROUNDING * np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > slack:
        raise ProblemError(f"{where}: expected a symmetric matrix; received {matrix.tolist()}.")
    smallest, middle, largest = np.linalg.eigvalsh(matrix)
    if smallest < -slack:
        raise ProblemError(f"{where}: expected principal moments that are not negative; received {smallest:.6g}.")
    if middle > slack and largest > smallest + middle + slack:
        raise ProblemError(
            f"{where}: no body has a principal moment ({largest:.6g}) beyond the sum of the other two ({smallest:.6g} "
            f"+ {middle:.6g}). For a plane model give the one moment that matters and two zeros."
        )
