"""`BodyLoad`: an external force and moment on one body; and the check that joints' places do not depend on time."""

from collections.abc import Callable, Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jaxtyping import Array, Float

from aleator._core.border import a_name
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.mechanics._bodies import GROUND, Body, Tree, placement
from aleator.mechanics._joints import AbstractAxial
from aleator.mechanics._recursions import world_poses
from aleator.mechanics._spatial import Wrench, added, as_array, cross, plus


@final
class BodyLoad(Module):
    """An external force and moment on one body of an `al.Multibody`: wind, contact, thrust.

    - `body`: its name; `at` (3,): where the force acts, in the body's frame, m; by default its origin;
    - `force` (3,), N, and `moment` (3,), N·m: in the world's axes. A force that rotates with its body is
      `self.poses(q)["rocket"].rotation @ jnp.array([0.0, 0.0, thrust])`.

    Raises `ProblemError` for other shapes and for non-finite numbers.
    """

    body: str = eqx.field(static=True)
    force: Any = (0.0, 0.0, 0.0)
    moment: Any = (0.0, 0.0, 0.0)
    at: Any = (0.0, 0.0, 0.0)

    def __check_init__(self):
        a_name("BodyLoad: body", self.body)
        for part in ("force", "moment", "at"):
            as_array(getattr(self, part), f"BodyLoad on '{self.body}', {part}", (3,))


def wrenches_of(kind: str, tree: Tree, q: Float[Array, " coordinates"], loads: Any) -> Sequence[Wrench]:
    """The wrench of the loads on each link, in its own frame at its origin. Loads on bodies fixed to the ground drop
    out.

    Raises `ProblemError` for anything but a load, and for an unknown body.
    """
    if not isinstance(loads, tuple | list) or not all(isinstance(one, BodyLoad) for one in loads):
        raise ProblemError(f"{kind}.body_loads returns a tuple of al.BodyLoad; received {loads!r}.")
    found = [Wrench(np.zeros(3), np.zeros(3)) for _ in tree.links]
    poses = world_poses(tree, q) if loads else []
    for one in loads:
        if one.body not in tree.places:
            raise ProblemError(
                f"{kind}.body_loads: there is no body '{one.body}'; expected one of {sorted(tree.places)}."
            )
        index, within = tree.places[one.body]
        if index == GROUND:
            continue
        local = as_array(one.at, "at", (3,))
        arm = local if within is None else within.position + within.rotation @ local
        inward = poses[index].rotation.T
        force = inward @ as_array(one.force, "force", (3,))
        moment = plus(inward @ as_array(one.moment, "moment", (3,)), cross(arm, force))
        found[index] = added(found[index], Wrench(moment, force))
    return found


def refuse_moving_places(kind: str, bodies: Callable[[Array], Sequence[Body]]) -> None:
    """Raise `ProblemError` if the place or the axis of a body's joint depends on the time in `bodies(time)`.

    The recursions would miss the velocity that this causes. The dependence is read off the traced equations, not off
    values.
    """
    names: list[str] = []

    def places(s: Array) -> list[Any]:
        found = list(bodies(s))
        names[:] = [body.name for body in found]
        axes = [body.joint.direction() if isinstance(body.joint, AbstractAxial) else 0.0 for body in found]
        return [(jnp.asarray(axis), *map(jnp.asarray, placement(body))) for axis, body in zip(axes, found, strict=True)]

    closed = jax.make_jaxpr(places)(jnp.zeros(()))
    moved = set(closed.jaxpr.invars)
    for equation in closed.jaxpr.eqns:
        if any(not isinstance(one, Literal) and one in moved for one in equation.invars):
            moved.update(equation.outvars)
    for i, variable in enumerate(closed.jaxpr.outvars):
        if not isinstance(variable, Literal) and variable in moved:
            raise ProblemError(
                f"{kind}.bodies: the place or the axis of '{names[i // 3]}' depends on time: only masses and inertias "
                "may do so. Put a joint there, and prescribe its motion in al.HybridDynamics."
            )
