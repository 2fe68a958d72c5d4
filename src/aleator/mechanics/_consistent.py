"""Where a constrained system begins: coordinates and velocities that its constraints allow, found from those given."""

import functools
from collections.abc import Collection
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.dynamics import newton
from aleator.mechanics._constraints import Loose, constraint_rate, jacobian_of
from aleator.mechanics._given import checked_start
from aleator.mechanics._matrices import solve_any
from aleator.mechanics._mechanical import AbstractMechanical, constraint_of
from aleator.mechanics._places import merged, spread, taken


class Kept(NamedTuple):
    """The places of coordinates and velocities that stay as they are given; the others follow from the constraints."""

    coordinates: tuple[int, ...]
    speeds: tuple[int, ...]

    def loose(self, model: AbstractMechanical) -> Loose:
        """The places of all others."""
        return Loose(
            tuple(i for i in range(len(model.coordinates)) if i not in self.coordinates),
            tuple(i for i in range(len(model.speeds)) if i not in self.speeds),
        )


def kept_of(
    model: AbstractMechanical, start: Collection[str], prescribed: tuple[int, ...] = (), driven: tuple[int, ...] = ()
) -> Kept:
    """What is kept of a start: what is prescribed, and what `start` names."""
    coordinates = {*prescribed, *(i for i, name in enumerate(model.coordinates) if name in start)}
    speeds = {*driven, *(i for i, name in enumerate(model.speeds) if name in start)}
    return Kept(tuple(sorted(coordinates)), tuple(sorted(speeds)))


def checked_guess(
    kind: str, model: AbstractMechanical, names: tuple[str, ...], start: Collection[str], guess: Any, driven: int
) -> dict[str, Any]:
    """A guess by name, for coordinates that the start leaves open; `driven` is the number of prescribed velocities.

    Raises `ProblemError` for a guess where no constraints need one, or of what the start keeps, for more constraints
    than velocities are left to them, and for a start that keeps more than can be chosen.
    """
    what, m = f"{kind} of {type(model).__name__}", len(model.constraints)
    if not m:
        if guess is not None:
            raise ProblemError(f"{what}: expected no guess, for it has no constraints; received {guess!r}.")
        return {}
    twice = [name for name in model.constraints if model.constraints.count(name) > 1]
    if twice:
        raise ProblemError(f"{what}: expected a name of its own for each constraint; received '{twice[0]}' twice.")
    if m > len(model.speeds) - driven:
        prescribed = f", of which {driven} are prescribed," if driven else ""
        raise ProblemError(
            f"{what}: expected at most as many constraints as velocities that can follow them; received {m} "
            f"constraints ({', '.join(model.constraints)}) on {len(model.speeds)} velocities{prescribed} which leave "
            f"{len(model.speeds) - driven}. Leave out constraints that others imply, or prescribe less."
        )
    chosen = [name for name in start if name in model.coordinates], [name for name in start if name in model.speeds]
    freedoms = len(model.speeds) - driven - m
    for given, count in ((chosen[0], len(model.speeds_along(chosen[0]))), (chosen[1], len(chosen[1]))):
        if count > freedoms:
            raise ProblemError(
                f"{what}: expected a start of at most {freedoms}, for the rest follows from its {m} constraints; "
                f"received {given}. Put those that are only near in guess."
            )
    return checked_start(model, tuple(name for name in names if name not in start), guess, f"{kind}, guess")


def start_unknown(kind: str, model: AbstractMechanical) -> str:
    """Why the start of a constrained system is not known without its first instant."""
    return (
        f"{kind} of {type(model).__name__}: the start follows from its constraints and what is prescribed at the first "
        "instant, which is known only where it is integrated. Simulate it."
    )


def consistent_start(
    model: AbstractMechanical, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], loose: Loose
) -> tuple[Float[Array, " coordinates"], Float[Array, " speeds"]]:
    """Coordinates and velocities beside those given, moved where they are loose, that the constraints allow."""
    q = consistent_coordinates(model, q, loose.coordinates)
    return q, consistent_velocities(model, q, v, loose.speeds)


def consistent_coordinates(
    model: AbstractMechanical, near: Float[Array, " coordinates"], moving: tuple[int, ...]
) -> Float[Array, " coordinates"]:
    """The posture nearest to the one given that the constraints allow, by some of the coordinates; or not a number.

    Near is meant by the coordinates as they are, rad and m alike. Differentiable, by the implicit function theorem.
    """
    count, given = len(moving), taken(near, moving)
    # Rounding of angles and lengths of about 1, for a start may obey the constraints with coordinates of zero.
    sizes = 1 + jnp.abs(near)
    terms = jnp.abs(jax.jacfwd(functools.partial(constraint_of, model))(near)) @ sizes
    kept = [i for i in range(len(near)) if i not in moving]

    def posture(at: Array) -> Array:
        return model.normalised(merged(at, moving, taken(near, kept), kept))

    def bound(at: Array) -> Array:
        return constraint_of(model, posture(at))

    def nearest(unknowns: Array) -> Array:
        at, multipliers = unknowns[:count], unknowns[count:]
        missing, pulled = jax.vjp(bound, at)
        return jnp.concatenate([at - given + pulled(multipliers)[0], missing])

    if count == len(model.constraints):
        root = newton(bound, given, terms)
    else:
        unknowns = jnp.concatenate([given, jnp.zeros(len(model.constraints))])
        root = newton(nearest, unknowns, jnp.concatenate([taken(sizes, moving), terms]))
    return posture(jnp.where(root.converged, root.point[:count], jnp.nan))


def consistent_velocities(
    model: AbstractMechanical, q: Array, near: Float[Array, " speeds"], moving: tuple[int, ...]
) -> Float[Array, " speeds"]:
    """The velocities nearest to those given that the constraints allow, by some of them; not a number where none."""
    G = taken(jacobian_of(model, q).T, moving).T
    return near - spread(solve_any(G, constraint_rate(model, q, near)), moving, len(near))
