"""`Robot`: the tree of bodies that a file describes, with all its numbers as fields."""

from collections.abc import Collection, Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, transparent
from aleator.mechanics import Body, Closure, Multibody

Key = TypeVar("Key", int, str)


@final
class Coupling(Module):
    """A coordinate that is a polynomial of another one, of which it is measured from references.

    `follower - rest = coefficients[0] + coefficients[1] (leader - leader_rest) + ...`, up to the fourth power; without
    a leader the follower stays where it is. All in the units of the coordinates, rad or m.
    """

    follower: str = eqx.field(static=True)
    leader: str | None = eqx.field(static=True)
    coefficients: Any = (0.0, 1.0, 0.0, 0.0, 0.0)
    rest: Any = 0.0
    leader_rest: Any = 0.0

    def residual(self, at: Mapping[str, Any]) -> Float[Array, ""]:
        """What is left of the equation, for coordinates by name."""
        away = 0.0 if self.leader is None else at[self.leader] - self.leader_rest
        return at[self.follower] - self.rest - jnp.polyval(jnp.flip(jnp.asarray(self.coefficients)), jnp.asarray(away))


@final
@transparent("parts")
class Robot(Multibody):
    """A mechanical system read from a file, by `al.foreign.read_urdf` or `al.foreign.read_mjcf`.

    - `parts`: its bodies by name. Each link of the file is a body with its `mass`, `center` and `inertia`, and each
      joint that moves is a body without mass, with its `joint` (`axis`, `damping`, `stiffness`, `rest`, `armature`),
      `position` and `orientation`; the link behind it is fixed to it. A joint whose name a link has as well ends in
      `_joint`; one without a name is part of its link. Coordinates and torques have the names of the joints;
    - `gravity` (3,), m/s²; a URDF has none, and gets `(0, 0, -9.81)`;
    - `loops`: the joints that close loops, by name, as `al.joints.Closure`; `couplings`: coordinates that follow
      others, by name, with their `coefficients`. Both are constraints, whose multipliers have their names;
    - `limits`: what the file allows, by the names of outputs: `robot.limits["elbow"]` is the lowest and the highest
      angle, beside `elbow_rate` and `elbow_torque`. Nothing enforces them: they are for constraints of a problem;
    - `start`: the coordinates in the file's own posture, where they are not zero;
    - `notes`: what was in the file and is not in the model, in sentences.

    Any of its numbers may be replaced:

        robot = eqx.tree_at(lambda robot: robot.parts["forearm"].mass, robot, al.Uniform(3.0, half_width=0.2))

    For more bodies, loads, or outputs write an `al.Multibody` with a robot as a field, whose `bodies` begin with
    `self.robot.bodies()`, and whose `closures` with `self.robot.closures()`.
    """

    parts: dict[str, Body]
    gravity: Any = (0.0, 0.0, -9.81)
    loops: dict[str, Closure] = eqx.field(default_factory=dict, kw_only=True)
    couplings: dict[str, Coupling] = eqx.field(default_factory=dict, kw_only=True)
    # A dictionary of a pytree comes back in the order of the alphabet.
    order: tuple[str, ...] = eqx.field(static=True, default=(), kw_only=True)
    allowed: tuple[tuple[str, tuple[float, float]], ...] = eqx.field(static=True, default=(), kw_only=True)
    posture: tuple[tuple[str, float], ...] = eqx.field(static=True, default=(), kw_only=True)
    notes: tuple[str, ...] = eqx.field(static=True, default=(), kw_only=True)

    def __check_init__(self):
        if not isinstance(self.parts, dict) or not all(isinstance(body, Body) for body in self.parts.values()):
            raise ProblemError(f"Robot: expected parts as a dictionary of al.Body by name; received {self.parts!r}.")
        if sorted(self.order) != sorted(self.parts):
            raise ProblemError(f"Robot: expected the order of {sorted(self.parts)}; received {self.order!r}.")

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """The lowest and the highest value that the file allows, by the names of outputs."""
        return dict(self.allowed)

    @property
    def start(self) -> dict[str, float]:
        """The coordinates in the file's own posture, where they are not zero."""
        return dict(self.posture)

    @override
    def bodies(self) -> Sequence[Body]:
        return tuple(self.parts[name] for name in self.order)

    @override
    def closures(self) -> Sequence[Closure]:
        return tuple(self.loops[name] for name in sorted(self.loops))

    @property
    @override
    def constraints(self) -> tuple[str, ...]:
        return (*super().constraints, *sorted(self.couplings))

    @override
    def constraint(self, q: Float[Array, " coordinates"]) -> Float[Array, " constraints"]:
        """What is left of the equations of the loops, then of the couplings."""
        return jnp.concatenate([super().constraint(q), self._apart(q)])

    @override
    def constraint_jacobian(self, q: Float[Array, " coordinates"]) -> Float[Array, "constraints speeds"]:
        return jnp.concatenate([self._closure_jacobian(q), jax.jacfwd(self._apart)(q) @ self.velocity_map(q)])

    def _apart(self, q: Float[Array, " coordinates"]) -> Float[Array, " couplings"]:
        """What is left of the equations of the couplings."""
        at = dict(zip(self.coordinates, q, strict=True))
        found = [self.couplings[name].residual(at) for name in sorted(self.couplings)]
        return jnp.stack(found) if found else jnp.zeros(0)


def robot_of(
    path: str | Path,
    bodies: Sequence[Body],
    *,
    gravity: Any = (0.0, 0.0, -9.81),
    loops: Mapping[str, Closure] = MappingProxyType({}),
    couplings: Mapping[str, Coupling] = MappingProxyType({}),
    limits: Mapping[str, tuple[float, float]],
    posture: Mapping[str, float],
    notes: Sequence[str],
) -> Robot:
    """The robot of some bodies, parents first. Raises `ProblemError` for a joint that moves no mass."""
    _refuse_massless(path, bodies)
    return Robot(
        {body.name: body for body in bodies},
        gravity,
        loops=dict(loops),
        couplings=dict(couplings),
        order=tuple(body.name for body in bodies),
        allowed=tuple(limits.items()),
        posture=tuple(posture.items()),
        notes=tuple(notes),
    )


def known(number: float) -> float | int:
    """A number of geometry; zero and one as whole numbers.

    These are structure where a model is traced: what is zero costs nothing there.
    """
    return int(number) if number in (-1.0, 0.0, 1.0) else float(number)


def carriers(joints: Mapping[Key, str], links: Collection[str]) -> dict[Key, str]:
    """The names of the bodies that carry joints: those of the joints, with an ending where a link has the same."""
    found: dict[Key, str] = {}
    for joint, name in joints.items():
        taken = {*links, *joints.values(), *found.values()}
        others = chain((f"{name}_joint",), (f"{name}_joint_{i}" for i in count(2)))
        found[joint] = name if name not in links else next(one for one in others if one not in taken)
    return found


def _refuse_massless(path: str | Path, bodies: Sequence[Body]) -> None:
    carried = {body.name: float(body.mass) for body in bodies}
    for body in reversed(bodies):
        if body.parent is not None:
            carried[body.parent] += carried[body.name]
    for body in bodies:
        joint = body.joint
        if carried[body.name] == 0 and getattr(joint, "coordinates", ()) and not getattr(joint, "armature", 0):
            raise ProblemError(
                f"{path}, joint '{body.name}': expected a joint that moves some mass; received none, neither in its "
                "link nor beyond. Give the link an <inertial>, or fix the joint."
            )
