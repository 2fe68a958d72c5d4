"""`BodyLoad`, an external load on a body of a tree."""

from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.border import a_name
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.mechanics._spatial import GROUND, Screws, as_array, columns, cross, times
from aleator.mechanics._tree_dynamics import Posture, along_screws
from aleator.mechanics._trees import Tree


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


def generalised(kind: str, tree: Tree, posture: Posture, loads: Any) -> Float[Array, " speeds"]:
    """The generalised force of the loads. Those on bodies fixed to the ground drop out.

    Raises `ProblemError` for anything but a load, and for an unknown body.
    """
    if not isinstance(loads, tuple | list) or not all(isinstance(load, BodyLoad) for load in loads):
        raise ProblemError(f"{kind}.body_loads returns a tuple of al.BodyLoad; received {loads!r}.")
    for load in loads:
        if load.body not in tree.places:
            raise ProblemError(
                f"{kind}.body_loads: there is no body '{load.body}'; expected one of {sorted(tree.places)}."
            )
    loads = [load for load in loads if tree.places[load.body][0] != GROUND]
    if not loads:
        return jnp.zeros(tree.axes.shape[1])
    at: list[Any] = []
    for load in loads:
        within, local = tree.places[load.body][1], as_array(load.at, "at", (3,))
        at.append(local if within is None else within.position + within.rotation @ local)
    rows = [tree.places[load.body][0] for load in loads]
    force, moment = (
        jnp.stack([as_array(getattr(load, part), part, (3,)) for load in loads], axis=1) for part in ("force", "moment")
    )
    arms = columns(posture.arms, rows) + times(columns(posture.poses.rotation, rows), jnp.stack(at, axis=1))
    return along_screws(posture.screws, tree.carries[:, rows], Screws(moment + cross(arms, force), force))
