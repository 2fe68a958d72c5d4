"""The tree of bodies that joints make, as arrays over all bodies and all speeds."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from aleator.mechanics._bodies import (
    STRAIGHT,
    AbstractAxial,
    Ball,
    Body,
    Fixed,
    Free,
    Inertia,
    Prismatic,
    behind,
    inertias,
    placement,
    sorted_bodies,
)
from aleator.mechanics._spatial import (
    GROUND,
    Numbers,
    Pose,
    all_known,
    as_array,
    from_angles,
    is_known,
    library,
    product,
    skew,
    stacked,
    times,
)

# What joints along or about an axis have for each speed.
_PASSIVE = ("damping", "stiffness", "rest", "armature")


class Tree(NamedTuple):
    """Bodies as columns of arrays, called rows here, in the order of their depth. A body on a free joint is two.

    - `places`: the row of each body by name, and its pose there if it is fixed to it; `above`: the row that carries
      each row, or `GROUND`;
    - `kinds`: the joint of each row, `Prismatic` also for what moves along three axes; `q`, `v`: the slices of its
      coordinates and speeds in the full vectors;
    - `placement`: the joints' frames, in the frames of the rows above;
    - `carries` (speeds, rows): one where a speed moves a row; `carrier`: the row whose joint each speed belongs to;
    - `turns` (speeds,): one for rotations, zero for translations; `axes` (3, speeds): in the frames of their carriers;
    - `lumps`: the inertia of moving rows, with what is fixed to them, in their frames;
    - `damping`, `stiffness`, `rest`, `armature` (speeds,): see `AbstractAxial`.
    """

    places: dict[str, tuple[int, Pose | None]]
    above: tuple[int, ...]
    kinds: tuple[type, ...]
    q: tuple[slice, ...]
    v: tuple[slice, ...]
    placement: Pose
    carries: Float[np.ndarray, "speeds rows"]
    carrier: tuple[int, ...]
    turns: Float[np.ndarray, " speeds"]
    axes: Float[Numbers, "3 speeds"]
    lumps: tuple["Lumps", ...]
    damping: Float[Numbers, " speeds"]
    stiffness: Float[Numbers, " speeds"]
    rest: Float[Numbers, " speeds"]
    armature: Float[Numbers, " speeds"]

    def rows(self, *kinds: type) -> list[int]:
        """The rows whose joints are of some kinds."""
        return [row for row, kind in enumerate(self.kinds) if kind in kinds]

    def coordinates(self, rows: Sequence[int]) -> list[int]:
        """The places of the coordinates of some rows."""
        return [place for row in rows for place in range(self.q[row].start, self.q[row].stop)]


class _Row(NamedTuple):
    """One row of a tree that is being built: its kind, the row above, and the body whose joint begins with it."""

    kind: type
    above: int
    depth: int
    body: int | None
    q: slice
    v: slice


def build_tree(bodies: Iterable[Body]) -> Tree:
    """The tree of some bodies. Raises `ProblemError` if they do not form a tree, or for an impossible body (see
    `Body`).
    """
    bodies = sorted_bodies(bodies)
    listed: list[_Row] = []
    row_of: dict[str | None, int] = {None: GROUND}
    axes: list[Any] = []
    numbers: list[Any] = []
    carrier: list[int] = []
    q = 0
    for i, body in enumerate(bodies):
        above, own = row_of[body.parent], i
        for kind, along, coordinates in _parts(body.joint):
            spans = slice(q, q + coordinates), slice(len(axes), len(axes) + len(along))
            listed.append(_Row(kind, above, 0 if above == GROUND else listed[above].depth + 1, own, *spans))
            # What turns behind what moves freely has the frame of that.
            above, own, q = len(listed) - 1, None, q + coordinates
            axes += list(along)
            carrier += [above] * len(along)
            numbers += [_passive(body.joint)] * len(along)
        row_of[body.name] = above
    order = sorted(range(len(listed)), key=lambda i: listed[i].depth)
    rows = [listed[i] for i in order]
    place_of = {GROUND: GROUND, **{row: i for i, row in enumerate(order)}}
    above = tuple(place_of[row.above] for row in rows)
    carries = np.zeros((len(axes), len(rows)))
    for i, row in enumerate(rows):
        carries[:, i] = carries[:, above[i]] if above[i] != GROUND else 0.0
        carries[row.v, i] = 1.0
    frames = _frames(bodies)
    by_body = [place_of[row_of[body.name]] for body in bodies]
    held = [frame if isinstance(body.joint, Fixed) else None for body, frame in zip(bodies, frames, strict=True)]
    return Tree(
        {body.name: place for body, place in zip(bodies, zip(by_body, held, strict=True), strict=True)},
        above,
        tuple(row.kind for row in rows),
        tuple(row.q for row in rows),
        tuple(row.v for row in rows),
        side_by_side([STRAIGHT if row.body is None else frames[row.body] for row in rows]),
        carries,
        tuple(place_of[row] for row in carrier),
        np.array([listed[row].kind is not Prismatic for row in carrier], dtype=float),
        stacked(axes, (3,)),
        _lumps(bodies, by_body, frames),
        *(stacked([part[k] for part in numbers], ()) for k in range(len(_PASSIVE))),
    )


def side_by_side(poses: Sequence[Pose]) -> Pose:
    return Pose(stacked([pose.rotation for pose in poses], (3, 3)), stacked([pose.position for pose in poses], (3,)))


class Lumps(NamedTuple):
    """Inertias as columns, and the rows in whose frames they are; a row may have several."""

    rows: tuple[int, ...]
    inertia: Inertia


def _lumps(bodies: Sequence[Body], rows: Sequence[int], frames: Sequence[Pose]) -> tuple[Lumps, ...]:
    """Those whose numbers are known, one for each row, and the others apart: what follows of these is often computed
    for many more points.
    """
    held = [i for i, row in enumerate(rows) if row != GROUND and not _is_light(bodies[i])]
    poses = [frame if isinstance(body.joint, Fixed) else STRAIGHT for body, frame in zip(bodies, frames, strict=True)]
    is_traced = [
        not all_known(body.mass, body.center, body.inertia, pose) for body, pose in zip(bodies, poses, strict=True)
    ]
    lumps: list[Lumps] = []
    for some in ([i for i in held if not is_traced[i]], [i for i in held if is_traced[i]]):
        if not some:
            continue
        lump = Lumps(tuple(rows[i] for i in some), inertias([bodies[i] for i in some]))
        if any(isinstance(bodies[i].joint, Fixed) for i in some):
            lump = lump._replace(inertia=moved(lump.inertia, side_by_side([poses[i] for i in some])))
        if len(set(lump.rows)) < len(some) and not is_traced[some[0]]:
            heavy = sorted(set(lump.rows))
            sums = np.array([[float(row == place) for place in heavy] for row in lump.rows])
            lump = Lumps(tuple(heavy), Inertia(*(part @ sums for part in lump.inertia)))
        lumps.append(lump)
    return tuple(lumps)


def moved(inertia: Inertia, poses: Pose) -> Inertia:
    """Inertias of bodies in frames at some poses, in the outer frame (parallel axes)."""
    mass, first = inertia.mass, times(poses.rotation, inertia.first)
    second = product(product(poses.rotation, inertia.second), library(*poses).swapaxes(poses.rotation, 0, 1))
    across = skew(poses.position)
    mixed = product(across, skew(first))
    far = mass[None, None] * product(across, across)
    return Inertia(mass, first + mass[None] * poses.position, second - mixed - mixed.swapaxes(0, 1) - far)


def _parts(joint: Any) -> list[tuple[type, list[Any], int]]:
    """The rows that a joint takes: of what kind, with which axes and how many coordinates."""
    if isinstance(joint, AbstractAxial):
        return [(type(joint), [joint.direction()], 1)]
    moving, turning = (Prismatic, list(np.eye(3)), 3), (Ball, list(np.eye(3)), 4)
    return [moving, turning] if isinstance(joint, Free) else [turning] if isinstance(joint, Ball) else []


def _passive(joint: Any) -> list[Any]:
    return [as_array(getattr(joint, part, 0), f"{type(joint).__name__}: {part}", ()) for part in _PASSIVE]


def _is_light(body: Body) -> bool:
    """Whether a body is known to have no inertia."""
    return all(is_known(leaf) and not np.any(leaf) for leaf in jax.tree.leaves((body.mass, body.inertia)))


def _frames(bodies: Sequence[Body]) -> list[Pose]:
    """The frame of each body's joint in that of the nearest row below.

    Each by itself: where one is uncertain, the others are not. Traced angles become matrices at once.
    """
    given = [as_array(body.orientation, f"Body '{body.name}': orientation", (3,), (3, 3)) for body in bodies]
    rotations = [placement(body).rotation if is_known(one) else one for body, one in zip(bodies, given, strict=True)]
    angles = [i for i, rotation in enumerate(rotations) if rotation.shape == (3,)]
    if angles:
        turned = from_angles(stacked([rotations[i] for i in angles], (3,)))
        for column, i in enumerate(angles):
            rotations[i] = turned[..., column]
    fixed: dict[str | None, Pose] = {}
    frames: list[Pose] = []
    for body, rotation in zip(bodies, rotations, strict=True):
        own = Pose(rotation, as_array(body.position, f"Body '{body.name}': position", (3,)))
        frames.append(behind(fixed[body.parent], own) if body.parent in fixed else own)
        if isinstance(body.joint, Fixed):
            fixed[body.name] = frames[-1]
    return frames
