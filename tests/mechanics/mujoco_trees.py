"""Random trees of bodies, once for aleator and once as MJCF for MuJoCo's C library, from the same numbers."""

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from aleator.mechanics._bodies import Ball, Body, Fixed, Free, Prismatic, Revolute
from aleator.mechanics._multibody import Multibody


class Tree(Multibody):
    given: tuple[Body, ...]

    def bodies(self):
        return self.given


def random_tree(kinds, parents, seed):
    """Bodies `b0`, `b1`, ... with joints of these kinds on these parents (-1: ground), and their MJCF."""
    random = np.random.default_rng(seed)
    parts = [_part(random, f"b{i}", kind) for i, kind in enumerate(kinds)]
    bodies = [part["body"](None if parent < 0 else f"b{parent}") for part, parent in zip(parts, parents, strict=True)]
    return Tree(tuple(bodies)), mujoco.MjModel.from_xml_string(_document(parts, parents))


def _part(random, name, kind):
    """One body: how to make it, and its XML without what hangs on it."""
    # MuJoCo gives free bodies in the world's frame.
    position, angles = (np.zeros(3), np.zeros(3)) if kind == "free" else (random.normal(size=3), random.normal(size=3))
    mass, center = float(random.uniform(0.5, 2.0)), 0.3 * random.normal(size=3)
    a, b, c = random.uniform(0.05, 0.3, 3)
    moments = np.array([b + c, a + c, a + b])
    turn = Rotation.random(random_state=random)
    matrix = turn.as_matrix() @ np.diag(moments) @ turn.as_matrix().T
    axis = random.normal(size=3)
    damping, stiffness, rest = random.uniform(0.1, 2.0, 3).tolist()
    joint = {
        "revolute": Revolute(axis, damping=damping, stiffness=stiffness, rest=rest, armature=damping / 4),
        "prismatic": Prismatic(axis, damping=damping, stiffness=stiffness, rest=rest, armature=damping / 2),
        "ball": Ball(),
        "free": Free(),
        "fixed": Fixed(),
    }[kind]
    spring = f'axis="{_text(axis)}" damping="{damping!r}" stiffness="{stiffness!r}" springref="{rest!r}"'
    tag = {
        "revolute": f'<joint name="{name}" type="hinge" {spring} armature="{damping / 4!r}"/>',
        "prismatic": f'<joint name="{name}" type="slide" {spring} armature="{damping / 2!r}"/>',
        "ball": f'<joint name="{name}" type="ball"/>',
        "free": f'<freejoint name="{name}"/>',
        "fixed": "",
    }[kind]
    quaternion = np.roll(turn.as_quat(), 1)
    head = (
        f'<body name="{name}" pos="{_text(position)}" euler="{_text(angles)}">{tag}<inertial pos="{_text(center)}" '
        f'mass="{mass!r}" diaginertia="{_text(moments)}" quat="{_text(quaternion)}"/>'
    )
    # Every way to give the same inertia and orientation takes its turn.
    six = matrix[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    orientation = Rotation.from_euler("xyz", angles).as_matrix() if name in ("b1", "b3") else angles

    def body(parent):
        return Body(
            name,
            parent=parent,
            joint=joint,
            mass=mass,
            center=tuple(center),
            inertia=tuple(six) if name in ("b0", "b1") else matrix,
            position=list(position),
            orientation=orientation,
        )

    return {"body": body, "head": head}


def _text(numbers):
    return " ".join(repr(float(number)) for number in numbers)


def _document(parts, parents):
    def below(parent):
        return "".join(part["head"] + below(i) + "</body>" for i, part in enumerate(parts) if parents[i] == parent)

    return f"""<mujoco>
      <compiler angle="radian" eulerseq="XYZ" inertiafromgeom="false" boundmass="0" boundinertia="0"
                balanceinertia="false" fusestatic="false"/>
      <option gravity="0 0 -9.81"/>
      <worldbody>{below(-1)}</worldbody>
    </mujoco>"""


def orders(tree, mj):
    """Where aleator's coordinates and speeds are in MuJoCo's vectors, which go through the tree by branches."""
    names = [body.name for body in tree.given if not isinstance(body.joint, Fixed)]
    joints = {body.name: body.joint for body in tree.given}

    def order(first, ends):
        starts = {name: first[mj.joint(name).id] for name in names}
        return np.concatenate([starts[name] + np.arange(len(getattr(joints[name], ends))) for name in names])

    return order(mj.jnt_qposadr, "coordinates"), order(mj.jnt_dofadr, "speeds")
