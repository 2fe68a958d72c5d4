"""Public robots from files of other packages, read by aleator and by MuJoCo, and what both make of the same state."""

import importlib.util
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import jax
import mujoco
import numpy as np
import pytest

from compiling import compiled

# Joint limits, contact and friction are forces of constraints: they are in neither matrix nor bias of MuJoCo.
_KEPT = {"link", "joint"}


def file_of(package, path):
    """A file of an installed package, which is not imported; the test is skipped where it is missing."""
    found = importlib.util.find_spec(package)
    if found is None:
        pytest.skip(f"the robots of the package {package} are not installed")
    return Path(found.submodule_search_locations[0]) / path


def urdf_by_mujoco(text):
    """A URDF in MuJoCo, without the geometry, whose files it would want."""
    # Prefixes of other programs that a file does not declare.
    root = ElementTree.fromstring(re.sub(r"(</?|\s)\w+:(?=[\w.]+[\s=>/])", r"\1", text))
    for element in [one for one in root if one.tag not in _KEPT]:
        root.remove(element)
    for link in root.findall("link"):
        for part in [one for one in link if one.tag != "inertial"]:
            link.remove(part)
    extension = ElementTree.SubElement(root, "mujoco")
    settings = {"fusestatic": "true", "balanceinertia": "false", "boundmass": "0", "boundinertia": "0"}
    ElementTree.SubElement(extension, "compiler", settings)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def states(robot, count, seed):
    """Random coordinates, whose quaternions have length one, speeds and accelerations."""
    random = np.random.default_rng(seed)
    q, v, v_dot = (random.normal(size=(count, len(names))) for names in (robot.coordinates, robot.speeds, robot.speeds))
    return np.array([robot.normalised(one) for one in q]), v, v_dot


def by_aleator(robot, q, v, v_dot):
    """Mass matrix, bias, generalised gravity and inverse dynamics at several states."""

    def at(q, v, v_dot):
        return {
            "mass matrix": robot.mass_matrix(q),
            "bias": robot.bias(q, v),
            "at rest": robot.bias(q, 0 * v),
            "inverse": robot.inverse_dynamics(q, v, v_dot),
        }

    return jax.tree.map(np.asarray, compiled(jax.vmap(at))(q, v, v_dot))


def by_mujoco(model, robot, q, v, v_dot):
    """The same by MuJoCo, in the order of aleator's names."""
    coordinates, speeds = orders(model, robot)
    found = []
    for one, rates, accelerations in zip(q, v, v_dot, strict=True):
        data = mujoco.MjData(model)
        data.qpos[coordinates] = one
        mujoco.mj_forward(model, data)
        at_rest = (data.qfrc_bias - data.qfrc_passive)[speeds]
        data.qvel[speeds] = rates
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        bias = (data.qfrc_bias - data.qfrc_passive)[speeds]
        matrix = full[np.ix_(speeds, speeds)]
        found.append(
            {"mass matrix": matrix, "bias": bias, "at rest": at_rest, "inverse": matrix @ accelerations + bias}
        )
    return {name: np.array([one[name] for one in found]) for name in found[0]}


def orders(model, robot):
    """Where aleator's coordinates and speeds are in the vectors of MuJoCo, by the names of joints."""
    coordinates, speeds = [], []
    for body in robot.bodies():
        ends = getattr(body.joint, "coordinates", ())
        if ends:
            joint = _joint(model, body.name)
            coordinates += range(model.jnt_qposadr[joint], model.jnt_qposadr[joint] + len(ends))
            speeds += range(model.jnt_dofadr[joint], model.jnt_dofadr[joint] + len(body.joint.speeds))
    assert sorted(coordinates) == list(range(model.nq))
    return np.array(coordinates), np.array(speeds)


def _joint(model, name):
    """The joint of a name, or the one without a name on the body of this name."""
    for joint in range(model.njnt):
        body = int(model.jnt_bodyid[joint])
        own = model.joint(joint).name or model.body(body).name or f"body_{body}"
        if name in (own, f"{own}_joint"):
            return joint
    raise AssertionError(name)


def assert_same(ours, theirs, tolerance=1e-9):
    """Every quantity agrees relative to its largest entry."""
    for name, value in theirs.items():
        np.testing.assert_allclose(ours[name], value, rtol=0, atol=tolerance * np.abs(value).max(), err_msg=name)
