"""`Multibody`: a mechanical system from its bodies and joints."""

import abc
from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from itertools import accumulate
from typing import Any, Self, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import members
from aleator._core.errors import ProblemError
from aleator.mechanics._bodies import (
    AbstractJoint,
    Body,
    behind,
    refuse_moving_places,
    sorted_bodies,
    with_numbers,
    without_numbers,
)
from aleator.mechanics._closures import BodyLoad, Closed, Closure, Coupling, closed, couplings_apart, generalised
from aleator.mechanics._instant import is_timed, later, timed_methods
from aleator.mechanics._mechanical import AbstractMechanical, evaluated
from aleator.mechanics._spatial import GROUND, Numbers, Pose, as_array
from aleator.mechanics._tree_dynamics import (
    Posture,
    forward_dynamics,
    inverse_dynamics,
    jacobian_at,
    mass_matrix,
    posture_of,
    potential_energy,
    unit_coordinates,
    velocity_map,
)
from aleator.mechanics._trees import Tree, build_tree

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

    Loops are closed by `closures()`, a tuple of `al.joints.Closure`, joints between bodies of the tree, and of
    `al.joints.Coupling`, coordinates that follow others. Equations of your own, by `constraint_names` and
    `constraint(q)`, are held besides.

    Any number in a field may be a distribution, a decision or a signal, but the set of bodies and joints is fixed.
    Masses and inertias may vary with time, as in `al.Mechanical`: mass leaves a body at the body's velocity. The places
    of joints may not: use one more joint, with its motion prescribed in `al.HybridDynamics`. Where `bias` or
    `mass_matrix` is overridden, inverse and forward dynamics use these.

    Raises `ProblemError` if the bodies do not form a tree.
    """

    # Beside the fields, for equinox tells classes of one field more or less apart.
    __slots__ = ("_facts",)

    # Not annotated: otherwise a dataclass would put a subclass's field of this name before all its others.
    gravity = (0.0, 0.0, -9.81)

    @abc.abstractmethod
    def bodies(self) -> Sequence[Body]:
        """The bodies, as functions of the numbers in the fields."""

    def closures(self) -> Sequence[Closure | Coupling]:
        """What binds bodies beside their joints, from the numbers in the fields; none by default: the joints that close
        loops, and after these couplings of coordinates.
        """
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
    def closing_names(self) -> tuple[str, ...]:
        return tuple(name for closure in self._loops() for name in closure.names)

    @override
    def closing(self, q: Float[Array, " coordinates"]) -> Float[Array, " closing"]:
        loops, couplings = self._closed()
        apart = couplings_apart(couplings, self.coordinates, q)
        return (
            jnp.concatenate([loops.apart(self._posture(q)[1]), apart])
            if couplings
            else loops.apart(self._posture(q)[1])
        )

    @override
    def closing_jacobian(self, q: Float[Array, " coordinates"]) -> Float[Array, "closing speeds"]:
        loops, couplings = self._closed()
        rows = loops.jacobian(self._posture(q)[1])
        if not couplings:
            return rows
        slope = jax.jacfwd(lambda at: couplings_apart(couplings, self.coordinates, at))(q)
        return jnp.concatenate([rows, slope if self.moves_directly else slope @ self.velocity_map(q)])

    def mass_matrix(self, q: Float[Numbers, " coordinates"]) -> Float[Array, "speeds speeds"]:
        """`M(q)` of bodies and rotors."""
        return mass_matrix(*self._posture(q))

    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        """`C(q, v) v + N(q, v)`, with gravity, springs and dampers, by the equations of Newton and Euler."""
        return inverse_dynamics(self._tree(), self._gravity(), q, v)

    def inverse_dynamics(
        self, q: Float[Numbers, " coordinates"], v: Float[Numbers, " speeds"], v_dot: Float[Numbers, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The generalised force that a motion requires, by the equations of Newton and Euler."""
        if not self._is_bodies_alone():
            return super().inverse_dynamics(q, v, v_dot)
        return inverse_dynamics(self._tree(), self._gravity(), q, v, v_dot)

    def forward_dynamics(
        self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], force: Float[Array, " speeds"]
    ) -> Float[Array, " speeds"]:
        """The acceleration `v̇` under a generalised force; NaN where a joint moves no inertia."""
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
        loads = evaluated(self, "body_loads", q, v)
        return super().external(q, v) + generalised(type(self).__name__, *self._posture(q), loads)

    def velocity_map(self, q: Float[Array, " coordinates"]) -> Float[Array, "coordinates speeds"]:
        """`H(q)`, with `q̇ = H(q) v`: block diagonal, one block per joint."""
        return velocity_map(self._tree(), q)

    def normalised(self, q: Float[Numbers, " coordinates"]) -> Float[Numbers, " coordinates"]:
        """The coordinates, with quaternions normalised; a zero quaternion becomes the identity."""
        counts = [len(joint.coordinates) for _, joint in self._joints()]
        # A quaternion is the last four of a joint's coordinates.
        ends = [end for count, end in zip(counts, accumulate(counts), strict=True) if count > 1]
        return unit_coordinates([place for end in ends for place in range(end - 4, end)], q) if ends else q

    @property
    @override
    def computes_by_numpy(self) -> bool:
        """True for the bodies alone, without loops or loads, on joints of one degree of freedom."""
        own = type(self).actuation is AbstractMechanical.actuation and self._is_bodies_alone()
        return own and self.moves_directly and not (self.is_loaded or self.constraints or is_timed(self))

    @override
    def refuse_impossible(self) -> None:
        """What bodies and joints refuse themselves, such as impossible inertias, negative damping or armature."""
        for body in self._tree_bodies():
            if isinstance(body.joint, AbstractJoint):
                body.joint.refuse_impossible()

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
        return 0.5 * v @ mass_matrix(*self._posture(q)) @ v

    def potential_energy(self, q: Float[Array, " coordinates"]) -> Float[Array, ""]:
        """The energy of gravity (zero at the world's origin) and of springs, J."""
        return potential_energy(*self._posture(q), self._gravity(), q)

    def poses(self, q: Float[Array, " coordinates"]) -> dict[str, Pose]:
        """The pose of each body in the world, by name: `rotation` (3, 3) and `position` (3,), m."""
        return _by_name(*self._posture(q))

    def point(self, q: Float[Array, " coordinates"], body: str, local: Any = (0.0, 0.0, 0.0)) -> Float[Array, "3"]:
        """The position in the world of a point of a body, `local` in its frame, m."""
        return _point(*self._posture(q), body, local)[1]

    def point_velocity(
        self,
        q: Float[Array, " coordinates"],
        v: Float[Array, " speeds"],
        body: str,
        local: Any = (0.0, 0.0, 0.0),
    ) -> Float[Array, "3"]:
        """The velocity in the world of a point of a body, `local` in its frame, m/s."""
        tree, posture = self._posture(q)
        row, place = _point(tree, posture, body, local)
        return jnp.asarray(jacobian_at(tree, posture, row, place).linear @ v)

    @override
    def prepared(self) -> Self:
        instant = self._remembering(tree=self._tree())
        return instant._remembering(closed=instant._closed())

    @override
    def seen_at(self, q: Float[Numbers, " coordinates"]) -> Self:
        return self._remembering(posture=(q, self._posture(q)[1]))

    def _remembering(self, **facts: Any) -> Self:
        """The model with its tree or a posture: in no field, so that transformations of the model forget them."""
        instant = copy(self)
        object.__setattr__(instant, "_facts", {**self._remembered(), **facts})
        return instant

    def __getstate__(self) -> dict[str, Any]:
        return vars(self)  # copies and pickles have the fields alone

    def _remembered(self) -> dict[str, Any]:
        return getattr(self, "_facts", {})

    def _posture(self, q: Float[Numbers, " coordinates"]) -> tuple[Tree, Posture]:
        """The tree and its posture at some coordinates."""
        tree = self._tree()
        where, posture = self._remembered().get("posture", (None, None))
        return tree, posture if where is q and posture is not None else posture_of(tree, q)

    def _is_bodies_alone(self) -> bool:
        """Whether the equations of motion are those of the bodies alone, without overrides."""
        return type(self).bias is Multibody.bias and type(self).mass_matrix is Multibody.mass_matrix

    def _tree(self) -> Tree:
        known = self._remembered().get("tree")
        return build_tree(self._tree_bodies()) if known is None else known

    def _tree_bodies(self) -> Sequence[Body]:
        if self._when is not None:
            refuse_moving_places(type(self).__name__, lambda s: later(self, s)._bodies())
        return self._bodies()

    def _bodies(self) -> Sequence[Body]:
        return members(f"{type(self).__name__}.bodies()", evaluated(self, "bodies"), Body)

    def _closed(self) -> tuple[Closed, list[Coupling]]:
        """The closed loops, as columns, and the couplings."""
        if (known := self._remembered().get("closed")) is not None:
            return known
        loops, couplings = self._closures()
        return closed(type(self).__name__, loops, self._tree()), couplings

    def _closures(self) -> tuple[list[Closure], list[Coupling]]:
        every = members(f"{type(self).__name__}.closures()", evaluated(self, "closures"), (Closure, Coupling))
        loops = [closure for closure in every if isinstance(closure, Closure)]
        return loops, [closure for closure in every if isinstance(closure, Coupling)]

    def _joints(self) -> list[tuple[str, AbstractJoint]]:
        """The moving bodies with the structure of their joints; also before distributions are realised."""
        return self._once("joints", self._joints_told)

    def _joints_told(self) -> list[tuple[str, AbstractJoint]]:
        bodies = sorted_bodies(with_numbers(self)._bodies())
        return [(body.name, without_numbers(body.joint)) for body in bodies if isinstance(body.joint, AbstractJoint)]

    def _loops(self) -> Sequence[Closure | Coupling]:
        """The closures, of which only the structure counts; also before distributions are realised.

        Raises `ProblemError` where those of a base class are lost.
        """
        return () if type(self).closures is Multibody.closures else self._once("loops", self._loops_told)

    def _loops_told(self) -> Sequence[Closure | Coupling]:
        model = with_numbers(self)
        loops, couplings = model._closures()
        names = {closure.name for closure in (*loops, *couplings)}
        for base in type(self).__mro__[1:]:
            own = "closures" in vars(base) and base is not Multibody and "closures" not in timed_methods(base)
            if lost := sorted({closure.name for closure in vars(base)["closures"](model)} - names) if own else []:
                raise ProblemError(
                    f"{type(self).__name__}.closures leaves out {lost} of {base.__name__}: return "
                    "(*super().closures(), ...)."
                )
        return [without_numbers(closure) for closure in (*loops, *couplings)]

    def _once(self, name: str, told: Callable[[], Result]) -> Result:
        """What this model has told of its structure, once for all: building bodies is slow."""
        if not hasattr(self, "_facts"):
            object.__setattr__(self, "_facts", {})
        if name not in self._facts:
            self._facts[name] = told()
        return self._facts[name]

    def _gravity(self) -> Any:
        return as_array(self.gravity, f"{type(self).__name__}.gravity", (3,))


def _pose(tree: Tree, posture: Posture, body: str) -> Pose:
    row, within = tree.places[body]
    if row == GROUND:
        return within  # type: ignore[return-value]
    carrier = Pose(posture.poses.rotation[..., row], posture.poses.position[:, row])
    return carrier if within is None else behind(carrier, within)


def _by_name(tree: Tree, posture: Posture) -> dict[str, Pose]:
    return {name: _pose(tree, posture, name) for name in tree.places}


def _point(tree: Tree, posture: Posture, body: str, local: Any) -> tuple[int, Float[Array, "3"]]:
    """A point of a body: the row that it moves with, and its place in the world."""
    if body not in tree.places:
        raise ProblemError(f"There is no body '{body}'; expected one of {sorted(tree.places)}.")
    pose = _pose(tree, posture, body)
    return tree.places[body][0], jnp.asarray(pose.position + pose.rotation @ as_array(local, "A point of a body", (3,)))
