"""`Multibody`: a mechanical system from its bodies and joints."""

import abc
import weakref
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.mechanics._bodies import GROUND, Body, Tree, build_tree, sorted_bodies, with_numbers, without_numbers
from aleator.mechanics._couplings import Coupling, parted
from aleator.mechanics._instant import is_timed, later, timed_methods
from aleator.mechanics._joints import AbstractJoint
from aleator.mechanics._loops_and_loads import (
    BodyLoad,
    Closure,
    checked_closures,
    refuse_moving_places,
    residuals,
    wrenches_of,
)
from aleator.mechanics._mechanical import AbstractMechanical, evaluated
from aleator.mechanics._recursions import (
    forward_dynamics,
    generalised,
    inverse_dynamics,
    mass_matrix,
    moving,
    world_poses,
)
from aleator.mechanics._spatial import Block, Numbers, Pose, as_array, composed, cross, library, momentum, plus, power

Result = TypeVar("Result")


class Multibody(AbstractMechanical):
    """A tree of rigid bodies rooted at the ground. Subclass it with parameters as fields, and write `bodies()`.

        class Pendulum(al.Multibody):
            length: al.Number = 1.0

            def bodies(self):
                return (al.Body("bob", joint=al.joints.Revolute("y"), mass=1.0, center=(0.0, 0.0, -self.length)),)

    Coordinates, speeds and forces are those of the joints: `bob` (rad), `bob_rate` (rad/s) and a torque (N·m); see
    `al.joints.Ball` and `al.joints.Free` for theirs. They are in the order of the bodies, parents first. `gravity` is
    in m/s², in the world's axes; a field or property may replace it.

    Override `bias` to add friction, drag and gyroscopic forces of rotors, and `mass_matrix` to add inertia that is
    neither a body's nor a joint's `armature`:

        def bias(self, q, v):
            return super().bias(q, v) + 0.2 * jnp.tanh(v / 1e-3)

    External forces, such as wind and contact, are given by `body_loads(q, v)`, as a tuple of `al.BodyLoad`, or by
    `load(q, v)`, as a generalised force; the two add up.

    Loops are closed by `closures()`, a tuple of `al.joints.Closure`: joints between bodies of the tree. Constraints of
    your own, `constraint_names` and `constraint(q)`, are added to them.

    Any number in a field may be a distribution, a decision or a signal, but the set of bodies and joints is fixed.
    Masses and inertias may vary with time, as in `al.Mechanical`: mass leaves a body at the body's velocity. The places
    of joints may not: use one more joint, with its motion prescribed in `al.HybridDynamics`. The cost of inverse and
    forward dynamics is proportional to the number of bodies (Featherstone, Rigid Body Dynamics Algorithms, 2008), and a
    body on `al.joints.Fixed` is free; where `bias` or `mass_matrix` is overridden, they use these instead.

    Raises `ProblemError` if the bodies do not form a tree.
    """

    # Not annotated: otherwise a dataclass would put a subclass's field of this name before all its others.
    gravity = (0.0, 0.0, -9.81)

    @abc.abstractmethod
    def bodies(self) -> Sequence[Body]:
        """The bodies, as functions of the numbers in the fields."""

    def closures(self) -> Sequence[Closure | Coupling]:
        """The joints that close loops, from the numbers in the fields; none by default."""
        return ()

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of the joints' coordinates, by body."""
        return tuple(name + end for name, joint in self._joints() for end in joint.coordinates)

    @property
    @override
    def moves_directly(self) -> bool:
        """True if every joint has one degree of freedom."""
        own = type(self).velocity_map is Multibody.velocity_map
        return own and all(joint.coordinates == ("",) for _, joint in self._joints())

    @property
    def speeds(self) -> tuple[str, ...]:
        """The names of the joints' speeds, by body."""
        return tuple(name + end for name, joint in self._joints() for end in joint.speeds)

    @property
    @override
    def standard_units(self) -> Mapping[str, str]:
        """The units of the joints. Those of torques are by the torques' names."""
        units = {}
        for name, joint in self._joints():
            units |= {name + end: unit for end, unit in zip(joint.coordinates, joint.units, strict=False)}
            for end, unit in zip(joint.speeds, joint.speed_units, strict=True):
                speed = name + end
                units[speed] = unit
                for force in ("torque", "reaction"):
                    units[f"{speed.removesuffix('_rate')}_{force}"] = "N" if unit == "m/s" else "N·m"
        for closure in self._loops():
            units |= {f"{name}_multiplier": unit for name, unit in zip(closure.names, closure.units, strict=False)}
        return units

    @property
    @override
    def closure_names(self) -> tuple[str, ...]:
        return tuple(name for closure in self._loops() for name in closure.names)

    @override
    def closure_equations(self, q: Float[Array, " coordinates"]) -> Float[Array, " equations"]:
        joints, couplings = parted(self._closures())
        left = residuals(type(self).__name__, joints, self.poses(q)) if joints else jnp.zeros(0)
        return jnp.concatenate([left, self._apart(couplings, q)]) if couplings else left

    def _apart(self, couplings: Sequence[Coupling], q: Float[Array, " coordinates"]) -> Float[Array, " couplings"]:
        """What is left of the equations of couplings."""
        at = dict(zip(self.coordinates, q, strict=True))
        return jnp.stack([coupling.residual(at) for coupling in couplings])

    @override
    def closure_jacobian(self, q: Float[Array, " coordinates"]) -> Float[Array, "equations speeds"]:
        tree, (joints, couplings) = self._tree(), parted(self._closures())
        poses = _poses(tree, q)
        rows = [closure.jacobian(tree, q, poses) for closure in joints]
        if couplings:
            rows.append(jax.jacfwd(lambda at: self._apart(couplings, at))(q) @ self.velocity_map(q))
        return jnp.concatenate([jnp.zeros((0, tree.speeds)), *rows])

    def mass_matrix(self, q: Float[Numbers, " coordinates"]) -> Float[Array, "speeds speeds"]:
        """`M(q)`, by the composite-rigid-body algorithm."""
        return mass_matrix(self._tree(), q)

    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """`C(q, v) v + N(q, v)`, with gravity, springs and dampers, by the recursive Newton-Euler algorithm."""
        return inverse_dynamics(self._tree(), self._gravity(), q, v, jnp.zeros_like(v))

    def inverse_dynamics(
        self, q: Float[Numbers, " coordinates"], v: Float[Numbers, " speeds"], v_dot: Float[Numbers, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The generalised force that a motion requires, by the recursive Newton-Euler algorithm."""
        if not self._is_bodies_alone():
            return super().inverse_dynamics(q, v, v_dot)
        return inverse_dynamics(self._tree(), self._gravity(), q, v, v_dot)

    def forward_dynamics(
        self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], force: Float[Array, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The acceleration `v̇` under a generalised force, by the articulated-body algorithm.

        NaN where a joint moves no inertia.
        """
        if not self._is_bodies_alone():
            return super().forward_dynamics(q, v, force)
        return forward_dynamics(self._tree(), self._gravity(), q, v, force)

    def body_loads(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Sequence[BodyLoad]:
        """External forces and moments on the bodies; none by default."""
        del q, v
        return ()

    @property
    @override
    def is_loaded(self) -> bool:
        return super().is_loaded or type(self).body_loads is not Multibody.body_loads

    @override
    def external(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """The sum of `load` and the loads on the bodies."""
        tree = self._tree()
        wrenches = wrenches_of(type(self).__name__, tree, q, evaluated(self, "body_loads", q, v))
        return super().external(q, v) + generalised(tree, q, wrenches)

    def velocity_map(self, q: Float[Array, " coordinates"]) -> Float[Array, "coordinates speeds"]:
        """`H(q)`, with `q̇ = H(q) v`: block diagonal, one block per joint."""
        tree = self._tree()
        blocks = [link.joint.velocity_map(q[link.q]) for link in tree.links]
        return jax.scipy.linalg.block_diag(*blocks) if blocks else jnp.zeros((0, 0))

    def normalised(self, q: Float[Numbers, " coordinates"]) -> Float[Numbers, " coordinates"]:
        """The coordinates, with quaternions normalised; a zero quaternion becomes the identity."""
        if all(type(joint).normalised is AbstractJoint.normalised for _, joint in self._joints()):
            return q
        return library(q).concatenate([link.joint.normalised(q[link.q]) for link in self._tree().links])

    @property
    @override
    def computes_by_numpy(self) -> bool:
        """True for the bodies alone, without loops or loads, on joints of one degree of freedom."""
        own = type(self).actuation is AbstractMechanical.actuation and self._is_bodies_alone()
        return own and self.moves_directly and not (self.is_loaded or self.constraints or is_timed(self))

    @override
    def refuse_impossible(self) -> None:
        """What bodies and joints refuse themselves, such as impossible inertias, negative damping or armature."""
        for link in self._tree().links:
            at_rest: Any = [np.zeros(part.stop - part.start) for part in (link.q, link.v)]
            link.joint.passive(*at_rest)
            link.joint.rotors()

    @override
    def speeds_along(self, coordinates: Collection[str]) -> tuple[int, ...]:
        """The velocities of the joints concerned, each of which needs all its coordinates."""
        places: list[int] = []
        first = 0
        for name, joint in self._joints():
            own = [name + end for end in joint.coordinates]
            given = [one for one in own if one in coordinates]
            if given and given != own:
                raise ProblemError(
                    f"{type(self).__name__}: the coordinates {own} of the joint of '{name}' belong together; received "
                    f"only {given}. Prescribe all of them, or none."
                )
            places += range(first, first + len(joint.speeds)) if given else ()
            first += len(joint.speeds)
        return tuple(places)

    def kinetic_energy(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, ""]:
        """The kinetic energy of the bodies and of the joints' rotors, J."""
        tree = self._tree()
        twists = moving(tree, q, v).twists
        energies = [power(twist, momentum(link.inertia, twist)) for link, twist in zip(tree.links, twists, strict=True)]
        turning = [(link.joint.rotors(), v[link.v]) for link in tree.links]
        energies += [rates @ rotors @ rates for rotors, rates in turning if rotors is not None]
        return 0.5 * sum(energies, start=jnp.zeros(()))

    def potential_energy(self, q: Float[Array, " coordinates"]) -> Float[Array, ""]:
        """The energy of gravity (zero at the world's origin) and of springs, J."""
        tree, gravity, total = self._tree(), self._gravity(), jnp.zeros(())
        for link, pose in zip(tree.links, world_poses(tree, q), strict=True):
            first = link.inertia.mass * pose.position + pose.rotation @ link.inertia.first
            total = total + link.joint.energy(q[link.q]) - gravity @ first
        return total

    def poses(self, q: Float[Array, " coordinates"]) -> dict[str, Pose]:
        """The pose of each body in the world, by name: `rotation` (3, 3) and `position` (3,), m."""
        return _poses(self._tree(), q)

    def point(self, q: Float[Array, " coordinates"], body: str, local: Any = (0.0, 0.0, 0.0)) -> Float[Array, "3"]:
        """The position in the world of a point of a body, `local` in its frame, m."""
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
        return world_poses(tree, q)[index].rotation @ plus(jnp.zeros(3), twist.linear, cross(twist.angular, arm))

    def _is_bodies_alone(self) -> bool:
        """Whether the equations of motion are those of the bodies alone, without overrides."""
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

    def _closures(self) -> Sequence[Closure | Coupling]:
        return checked_closures(type(self).__name__, evaluated(self, "closures"))

    def _joints(self) -> list[tuple[str, AbstractJoint]]:
        """The moving bodies with the structure of their joints; also before distributions are realised."""
        return _joints_of(self)

    def _loops(self) -> Sequence[Closure | Coupling]:
        """The closures, of which only the structure counts; also before distributions are realised."""
        return () if type(self).closures is Multibody.closures else _closures_of(self)

    def _gravity(self) -> Block:
        return as_array(self.gravity, f"{type(self).__name__}.gravity", (3,))


def once_for_each(function: Callable[[Any], Result]) -> Callable[[Any], Result]:
    """A function of a model, told by its identity: called again only for another one.

    Its results outlive traces: they must hold no array that is being traced.
    """
    known: dict[int, tuple[Any, Result]] = {}

    def forget(key: int, dead: Any) -> None:
        if known.get(key, (None,))[0] is dead:
            del known[key]

    def remembered(model: Any) -> Result:
        key = id(model)
        reference, result = known.get(key, (lambda: None, None))
        if reference() is not model:
            result = function(model)
            known[key] = weakref.ref(model, lambda dead: forget(key, dead)), result
        return result  # type: ignore[return-value]

    return remembered


@once_for_each
def _joints_of(model: Multibody) -> list[tuple[str, AbstractJoint]]:
    """The moving bodies of a model with their joints; cached, since building bodies is slow."""
    bodies = sorted_bodies(with_numbers(model)._bodies())
    return [(body.name, without_numbers(body.joint)) for body in bodies if isinstance(body.joint, AbstractJoint)]


@once_for_each
def _closures_of(model: Multibody) -> list[Closure | Coupling]:
    """The closures of a model; cached too. Raises `ProblemError` where those of a base class are lost."""
    model, who = with_numbers(model), type(model).__name__
    joints, couplings = parted(model._closures())
    names = {one.name for one in (*joints, *couplings)}
    for base in type(model).__mro__[1:]:
        own = "closures" in vars(base) and base is not Multibody and "closures" not in timed_methods(base)
        if lost := sorted({one.name for one in vars(base)["closures"](model)} - names) if own else []:
            raise ProblemError(
                f"{who}.closures leaves out {lost} of {base.__name__}: return (*super().closures(), ...)."
            )
    return [without_numbers(one) for one in (*joints, *couplings)]


def _poses(tree: Tree, q: Array) -> dict[str, Pose]:
    carriers = world_poses(tree, q)
    poses: dict[str, Pose] = {}
    for name, (index, within) in tree.places.items():
        if within is None:
            poses[name] = carriers[index]
        else:
            poses[name] = within if index == GROUND else composed(carriers[index], within)
    return poses


def _local(given: Any) -> Block:
    return as_array(given, "A point of a body", (3,))


def _of(by_name: dict[str, Any], body: str) -> Any:
    if body not in by_name:
        raise ProblemError(f"There is no body '{body}'; expected one of {sorted(by_name)}.")
    return by_name[body]
