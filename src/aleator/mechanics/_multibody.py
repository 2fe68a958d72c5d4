"""`Multibody`: a mechanical system from its bodies and joints."""

import abc
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf
from aleator.mechanics._body import Body
from aleator.mechanics._body_load import BodyLoad, refuse_moving_places, wrenches_of
from aleator.mechanics._instant import at, later
from aleator.mechanics._joints import AbstractJoint
from aleator.mechanics._mechanical import AbstractMechanical, evaluated
from aleator.mechanics._recursions import (
    forward_dynamics,
    generalised,
    inverse_dynamics,
    mass_matrix,
    moving,
    world_poses,
)
from aleator.mechanics._spatial import Block, Pose, as_array, composed, cross, momentum, plus, power
from aleator.mechanics._tree import GROUND, Tree, build_tree, sorted_bodies
from aleator.trajectories import AbstractSignal


class Multibody(AbstractMechanical):
    """A tree of rigid bodies that hangs on the ground. Subclass it with parameters as fields, and `bodies()`.

        class Pendulum(al.Multibody):
            length: al.Number = 1.0

            def bodies(self):
                return (al.Body("bob", joint=al.joints.Revolute("y"), mass=1.0, center=(0.0, 0.0, -self.length)),)

    Coordinates, speeds and forces are those of the joints: `bob` (rad), `bob_rate` (rad/s) and a torque (N·m); see
    `al.joints.Ball` and `al.joints.Free` for theirs. They come in the order of the bodies, parents first. `gravity` is
    in m/s² and in the world's axes; a field or property may take its place.

    Friction, drag and the forces of rotors are added to the bodies' by overriding `bias`, the inertia of geared motors
    by overriding `mass_matrix`:

        def bias(self, q, v):
            return super().bias(q, v) + 0.2 * jnp.tanh(v / 1e-3)

    Forces from outside, such as wind and contact, are a tuple of `al.BodyLoad` by `body_loads(q, v)`, or a generalised
    force by `load(q, v)`; both act together.

    Any number of a field may be a distribution, a decision or a signal, but which bodies and joints there are is
    structure. Masses and inertias may change with time, as in `al.Mechanical`: what leaves a body has its velocity.
    Where joints are may not: that is the motion of one more joint, which `al.HybridDynamics` prescribes.
    Inverse and forward dynamics cost in proportion to the number of bodies (Featherstone, Rigid Body Dynamics
    Algorithms, 2008), and a body on `al.joints.Fixed` none at all; with a `bias` or a `mass_matrix` of one's own they
    go by these.

    Raises `ProblemError` if the bodies are no tree.
    """

    # Without a type: a dataclass would put a field that takes its place before all others of a subclass.
    gravity = (0.0, 0.0, -9.81)

    @abc.abstractmethod
    def bodies(self) -> Sequence[Body]:
        """The bodies, from the numbers in the fields."""

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of the joints' coordinates, by body."""
        return tuple(name + end for name, joint in self._joints() for end in joint.coordinates)

    @property
    @override
    def moves_directly(self) -> bool:
        """So of joints with one degree of freedom each."""
        own = type(self).velocity_map is Multibody.velocity_map
        return own and all(joint.coordinates == ("",) for _, joint in self._joints())

    @property
    def speeds(self) -> tuple[str, ...]:
        """The names of the joints' speeds, by body."""
        return tuple(name + end for name, joint in self._joints() for end in joint.speeds)

    @property
    @override
    def standard_units(self) -> Mapping[str, str]:
        """As the joints tell. Those of torques go by their names."""
        found = {}
        for name, joint in self._joints():
            found |= {name + end: unit for end, unit in zip(joint.coordinates, joint.units, strict=False)}
            for end, unit in zip(joint.speeds, joint.speed_units, strict=True):
                speed = name + end
                found[speed] = unit
                found[f"{speed.removesuffix('_rate')}_torque"] = "N" if unit == "m/s" else "N·m"
        return found

    def mass_matrix(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds speeds"]:
        """`M(q)`, by the composite-rigid-body algorithm."""
        return mass_matrix(self._tree(), q)

    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """`C(q, v) v + N(q, v)`, of gravity, springs and dampers too, by the recursive Newton-Euler algorithm."""
        return inverse_dynamics(self._tree(), self._gravity(), q, v, jnp.zeros_like(v))

    def inverse_dynamics(
        self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], v_dot: Float[Array, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The generalised force that a motion takes, by the recursive Newton-Euler algorithm."""
        if not self._is_bodies_alone():
            return super().inverse_dynamics(q, v, v_dot)
        return inverse_dynamics(self._tree(), self._gravity(), q, v, v_dot)

    def forward_dynamics(
        self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], force: Float[Array, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The acceleration `v̇` under a generalised force, by the articulated-body algorithm.

        Not a number where a joint moves no inertia.
        """
        if not self._is_bodies_alone():
            return super().forward_dynamics(q, v, force)
        return forward_dynamics(self._tree(), self._gravity(), q, v, force)

    def body_loads(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Sequence[BodyLoad]:
        """Forces and moments from outside on the bodies; none by default."""
        del q, v
        return ()

    @property
    @override
    def is_loaded(self) -> bool:
        return super().is_loaded or type(self).body_loads is not Multibody.body_loads

    @override
    def external(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """The load, and what pushes the bodies."""
        tree = self._tree()
        wrenches = wrenches_of(type(self).__name__, tree, q, evaluated(self, "body_loads", q, v))
        return super().external(q, v) + generalised(tree, q, wrenches)

    def velocity_map(self, q: Float[Array, " coordinates"]) -> Float[Array, "coordinates speeds"]:
        """`H(q)`, with `q̇ = H(q) v`: a block for each joint."""
        tree = self._tree()
        blocks = [link.joint.velocity_map(q[link.q]) for link in tree.links]
        return jax.scipy.linalg.block_diag(*blocks) if blocks else jnp.zeros((0, 0))

    def normalised(self, q: Float[Array, " coordinates"]) -> Float[Array, " coordinates"]:
        """The coordinates, with quaternions of length one; one of zeros becomes that of no turn."""
        joints = [joint for _, joint in self._joints()]
        ends = np.cumsum([0, *(len(joint.coordinates) for joint in joints)])
        parts = [joint.normalised(q[i:j]) for joint, i, j in zip(joints, ends[:-1], ends[1:], strict=True)]
        return jnp.concatenate([jnp.zeros(0), *parts])

    @override
    def diagnose(self, q: Float[Array, " coordinates"]) -> str:
        """Nothing beside what joints refuse by themselves, such as a negative damping."""
        tree = self._tree()
        for link in tree.links:
            link.joint.passive(q[link.q], jnp.zeros(link.v.stop - link.v.start))
        return ""

    @override
    def speeds_along(self, coordinates: Collection[str]) -> tuple[int, ...]:
        """Those of the joints, of which all coordinates are needed."""
        found: list[int] = []
        first = 0
        for name, joint in self._joints():
            own = [name + end for end in joint.coordinates]
            given = [one for one in own if one in coordinates]
            if given and given != own:
                raise ProblemError(
                    f"{type(self).__name__}: the joint of '{name}' moves by {own} together; received {given} alone. "
                    "Prescribe all of them, or none."
                )
            found += range(first, first + len(joint.speeds)) if given else ()
            first += len(joint.speeds)
        return tuple(found)

    def kinetic_energy(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, ""]:
        """The kinetic energy of the bodies, J."""
        tree = self._tree()
        twists = moving(tree, q, v).twists
        energies = [power(twist, momentum(link.inertia, twist)) for link, twist in zip(tree.links, twists, strict=True)]
        return 0.5 * sum(energies, start=jnp.zeros(()))

    def potential_energy(self, q: Float[Array, " coordinates"]) -> Float[Array, ""]:
        """The energy of weights (zero at the world's origin) and of springs, J."""
        tree, gravity, total = self._tree(), self._gravity(), jnp.zeros(())
        for link, pose in zip(tree.links, world_poses(tree, q), strict=True):
            first = link.inertia.mass * pose.position + pose.rotation @ link.inertia.first
            total = total + link.joint.energy(q[link.q]) - gravity @ first
        return total

    def poses(self, q: Float[Array, " coordinates"]) -> dict[str, Pose]:
        """The pose of each body in the world, by name: `rotation` (3, 3) and `position` (3,), m."""
        tree = self._tree()
        carriers = world_poses(tree, q)
        return {name: _placed(place, carriers) for name, place in tree.places.items()}

    def point(self, q: Float[Array, " coordinates"], body: str, local: Any = (0.0, 0.0, 0.0)) -> Float[Array, "3"]:
        """Where a point of a body, `local` in its frame, is in the world, m."""
        pose = _of(self.poses(q), body)
        return jnp.asarray(pose.position + pose.rotation @ _local(local))

    def point_velocity(
        self,
        q: Float[Array, " coordinates"],
        v: Float[Array, " speeds"],
        body: str,
        local: Any = (0.0, 0.0, 0.0),
    ) -> Float[Array, "3"]:
        """The velocity in the world of a point of a body, `local` in its frame, m/s."""
        tree = self._tree()
        index, within = _of(tree.places, body)
        if index == GROUND:
            return jnp.zeros(3)
        arm = _local(local) if within is None else within.position + within.rotation @ _local(local)
        twist = moving(tree, q, v).twists[index]
        return world_poses(tree, q)[index].rotation @ plus(twist.linear, cross(twist.angular, arm))

    def _is_bodies_alone(self) -> bool:
        """Whether the equations of motion are those of the bodies: nothing is added, which recursions know not of."""
        return type(self).bias is Multibody.bias and type(self).mass_matrix is Multibody.mass_matrix

    def _tree(self) -> Tree:
        if self._when is not None:
            refuse_moving_places(type(self).__name__, lambda s: later(self, s)._bodies())
        return build_tree(self._bodies())

    def _bodies(self) -> Sequence[Body]:
        given = evaluated(self, "bodies")
        if not isinstance(given, tuple | list) or not all(isinstance(body, Body) for body in given):
            raise ProblemError(f"{type(self).__name__}.bodies returns a tuple of al.Body; received {given!r}.")
        return given

    def _joints(self) -> list[tuple[str, AbstractJoint]]:
        """The bodies that move, with their joints: asked for before distributions and decisions have become numbers."""
        plain = jax.tree.map(_as_number, self, is_leaf=_is_no_number)
        now = plain if self._when is not None else at(plain, jnp.zeros(()), None)
        bodies = sorted_bodies(now._bodies())
        return [(body.name, body.joint) for body in bodies if isinstance(body.joint, AbstractJoint)]

    def _gravity(self) -> Block:
        return as_array(self.gravity, f"{type(self).__name__}.gravity", (3,))


def _is_no_number(node: Any) -> bool:
    return is_leaf(node) or isinstance(node, AbstractSignal)


def _as_number(leaf: Any) -> Any:
    """Any number, of a decision's or a signal's shape, in the place of a distribution, a decision or a signal."""
    if isinstance(leaf, AbstractSignal):
        plain = jax.tree.map(_as_number, leaf, is_leaf=is_leaf)
        return jnp.ones(jax.eval_shape(plain, jnp.zeros(())).shape)
    return jnp.ones(leaf.shape) if is_leaf(leaf) else leaf


def _placed(place: tuple[int, Pose | None], carriers: Sequence[Pose]) -> Pose:
    index, within = place
    if within is None:
        return carriers[index]
    return within if index == GROUND else composed(carriers[index], within)


def _local(given: Any) -> Block:
    return as_array(given, "A point of a body", (3,))


def _of(by_name: dict[str, Any], body: str) -> Any:
    if body not in by_name:
        raise ProblemError(f"There is no body '{body}'; expected one of {sorted(by_name)}.")
    return by_name[body]
