"""What is used of MuJoCo's objects: its library declares no types."""

from typing import Protocol

import numpy as np


class Named(Protocol):
    """An element of a model."""

    name: str


class Options(Protocol):
    """Settings of a model."""

    disableflags: int
    gravity: np.ndarray
    density: float
    viscosity: float


class Model(Protocol):
    """A compiled model, `mujoco.MjModel`: a row of an array for each body, joint, speed and so on."""

    opt: Options
    nbody: int
    njnt: int
    nu: int
    ngeom: int
    ntendon: int
    nmocap: int
    body_gravcomp: np.ndarray
    body_inertia: np.ndarray
    body_ipos: np.ndarray
    body_iquat: np.ndarray
    body_jntadr: np.ndarray
    body_jntnum: np.ndarray
    body_mass: np.ndarray
    body_parentid: np.ndarray
    body_plugin: np.ndarray
    body_pos: np.ndarray
    body_quat: np.ndarray
    dof_armature: np.ndarray
    dof_damping: np.ndarray
    dof_frictionloss: np.ndarray
    dof_jntid: np.ndarray
    eq_active0: np.ndarray
    eq_data: np.ndarray
    eq_obj1id: np.ndarray
    eq_obj2id: np.ndarray
    eq_objtype: np.ndarray
    eq_type: np.ndarray
    jnt_actfrclimited: np.ndarray
    jnt_actfrcrange: np.ndarray
    jnt_axis: np.ndarray
    jnt_bodyid: np.ndarray
    jnt_dofadr: np.ndarray
    jnt_limited: np.ndarray
    jnt_pos: np.ndarray
    jnt_qposadr: np.ndarray
    jnt_range: np.ndarray
    jnt_stiffness: np.ndarray
    jnt_type: np.ndarray
    qpos0: np.ndarray
    qpos_spring: np.ndarray
    site_bodyid: np.ndarray
    site_pos: np.ndarray
    site_quat: np.ndarray
    tendon_frictionloss: np.ndarray

    def body(self, index: int) -> Named:
        """A body."""
        ...

    def joint(self, index: int) -> Named:
        """A joint."""
        ...

    def equality(self, index: int) -> Named:
        """An equation."""
        ...


class Posture(Protocol):
    """Where the bodies of a model are, `mujoco.MjData`."""

    xpos: np.ndarray
    xmat: np.ndarray
    xaxis: np.ndarray
