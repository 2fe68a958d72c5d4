"""The tree of bodies in order, with fixed bodies merged into their carriers, for the recursions."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from aleator._core.errors import ProblemError
from aleator.mechanics._body import Body, inertia, placement
from aleator.mechanics._joints import AbstractJoint, Fixed
from aleator.mechanics._spatial import Inertia, Pose, added, composed, inertia_outside

GROUND = -1
"""The parent of links that are attached to the ground."""


class Link(NamedTuple):
    """A moving body, with everything fixed to it.

    - `parent`: the index of the link that carries it, or `GROUND`;
    - `placement`: its joint's frame in that link's frame;
    - `q`, `v`: the slices of its coordinates and speeds in the full vectors.
    """

    name: str
    parent: int
    joint: AbstractJoint
    placement: Pose
    inertia: Inertia
    q: slice
    v: slice


class Tree(NamedTuple):
    """Links, parents before children; and for each body the link to which it belongs and its pose there."""

    links: tuple[Link, ...]
    places: dict[str, tuple[int, Pose | None]]

    @property
    def speeds(self) -> int:
        """The number of speeds."""
        return self.links[-1].v.stop if self.links else 0


def build_tree(bodies: Iterable[Body]) -> Tree:
    """The tree of some bodies. Raises `ProblemError` if they do not form a tree, or for an impossible body (see
    `Body`).
    """
    links: list[Link] = []
    places: dict[str, tuple[int, Pose | None]] = {}
    for body in sorted_bodies(bodies):
        parent, carrier = (GROUND, None) if body.parent is None else places[body.parent]
        place = placement(body) if carrier is None else composed(carrier, placement(body))
        if isinstance(body.joint, Fixed):
            places[body.name] = (parent, place)
            if parent != GROUND:
                joined = added(links[parent].inertia, inertia_outside(place, inertia(body)))
                links[parent] = links[parent]._replace(inertia=joined)
            continue
        q = links[-1].q.stop if links else 0
        v = links[-1].v.stop if links else 0
        coordinates, speeds = slice(q, q + len(body.joint.coordinates)), slice(v, v + len(body.joint.speeds))
        places[body.name] = (len(links), None)
        links.append(Link(body.name, parent, body.joint, place, inertia(body), coordinates, speeds))
    return Tree(tuple(links), places)


def sorted_bodies(bodies: Iterable[Body]) -> list[Body]:
    """The bodies, parents before children, otherwise in the given order.

    Raises `ProblemError` for names that occur twice, for unknown parents and for cycles.
    """
    waiting = list(bodies)
    _check_names(waiting)
    ready: list[Body] = []
    while waiting:
        known = {None, *(body.name for body in ready)}
        following = next((body for body in waiting if body.parent in known), None)
        if following is None:
            names = [body.name for body in waiting]
            raise ProblemError(f"bodies() must return a tree rooted at the ground; {names} form a cycle.")
        waiting.remove(following)
        ready.append(following)
    return ready


def _check_names(bodies: Sequence[Body]) -> None:
    names = [body.name for body in bodies]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ProblemError(f"bodies() needs one name for each body; {twice} occur twice.")
    unknown = sorted({body.parent for body in bodies if body.parent is not None} - set(names))
    if unknown:
        raise ProblemError(f"bodies() names the parents {unknown}, which are no bodies; expected some of {names}.")
