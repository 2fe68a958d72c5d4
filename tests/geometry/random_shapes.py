"""Shapes from vectors of parameters, for random pairs; and their cores in NumPy, for independent answers."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from aleator.geometry import Box, Capsule, Sphere, distance
from compiling import compiled

KINDS = ("sphere", "capsule", "box")
PAIRS_AT_ONCE = 120


def shape(kind, p, dimension):
    """A shape from 10 traced parameters: a place, three more numbers, a turn and a radius."""
    place, extent, turn = p[:dimension], p[3 : 3 + dimension], p[6:9]
    if kind == "sphere":
        return Sphere(place, p[9])
    if kind == "capsule":
        return Capsule(place - extent, place + extent, p[9])
    return Box(place, jnp.abs(extent), turn[0] if dimension == 2 else _rotation(turn))


def core(kind, p, dimension):
    """Centre, half edges (one a row) and radius of the same shape."""
    place, extent, turn = p[:dimension], p[3 : 3 + dimension], p[6:9]
    if kind == "sphere":
        return place, np.zeros((0, dimension)), p[9]
    if kind == "capsule":
        return place, extent[None, :], p[9]
    cos, sin = np.cos(turn[0]), np.sin(turn[0])
    rotation = np.array([[cos, -sin], [sin, cos]]) if dimension == 2 else Rotation.from_quat([*turn, 1.0]).as_matrix()
    return place, np.diag(np.abs(extent)) @ rotation.T, 0.0


def _rotation(turn):
    """The rotation of the quaternion of scalar part 1 and vector part `turn`."""
    x, y, z = turn
    cross = jnp.stack([jnp.stack([0 * x, -z, y]), jnp.stack([z, 0 * x, -x]), jnp.stack([-y, x, 0 * x])])
    return jnp.eye(3) + 2 / (1 + turn @ turn) * (cross + cross @ cross)


def parameters(seed, spread):
    """Random parameters of pairs of shapes whose places differ by about `spread`."""
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(PAIRS_AT_ONCE, 2, 10))
    p[..., :3] *= spread
    p[..., 9] = rng.uniform(0.0, 0.5, size=(PAIRS_AT_ONCE, 2))
    return p


def between(kinds, dimension):
    """The distance of a pair of shapes as a function of their parameters."""
    return lambda p: distance(*(shape(kind, p[i], dimension) for i, kind in enumerate(kinds)))


@functools.cache
def distances(kinds, dimension):
    """The distances of many pairs and their derivatives, compiled once for all tests."""
    value = between(kinds, dimension)
    program = compiled(jax.vmap(lambda p: (value(p), jax.jacfwd(value)(p))))
    return lambda p: tuple(map(np.asarray, program(p)))
