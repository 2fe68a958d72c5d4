"""What can be wrong with a realised mechanical system, in words: shapes, singular matrices, where and when."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled
from aleator.dynamics import Grid, RungeKutta4, System, simulate
from aleator.mechanics._mechanical import AbstractMechanical

# Reciprocal condition numbers below this are rounding of zero: answers would have no correct digit left.
_SINGULAR = 1e-12


def trouble_at(model: AbstractMechanical, q: Any, when: str) -> str:
    """What is wrong in one posture: a shape, a mass matrix that is not positive definite, a singular velocity map."""
    name, n, speeds, actuators = type(model).__name__, len(model.coordinates), len(model.speeds), len(model.actuators)
    v = jnp.zeros(speeds)
    parts: tuple[tuple[str, Callable[[], Any], tuple[int, ...]], ...] = (
        ("mass_matrix(q)", lambda: model.mass_matrix(q), (speeds, speeds)),
        ("bias(q, v)", lambda: model.bias(q, v), (speeds,)),
        ("actuation(q)", lambda: model.actuation(q), (speeds, actuators)),
        ("velocity_map(q)", lambda: model.velocity_map(q), (n, speeds)),
    )
    for part, value, shape in parts:
        received = np.shape(value())
        if received != shape:
            return f"{name}.{part}: expected shape {shape}; received {received}."
    return model.trouble(q) or _mass_trouble(model, q, when) or _map_trouble(model, q, when)


def _mass_trouble(model: AbstractMechanical, q: Any, when: str) -> str:
    M = np.asarray(model.mass_matrix(q))
    posture = _posture(model, q)
    if not np.isfinite(M).all():
        return f"The mass matrix of {type(model).__name__} is not finite {when} ({posture})."
    if not np.allclose(M, M.T, rtol=1e-8, atol=1e-12 * np.abs(M).max(initial=1.0)):
        return f"The mass matrix of {type(model).__name__} is not symmetric {when} ({posture})."
    # Beside their own diagonal entries: metres and kilogrammes do not go together with radians and grammes.
    size = np.sqrt(np.abs(np.diagonal(M)))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(M / np.outer(size, size))
    if values.size and values[0] <= _SINGULAR * max(values[-1], 0.0):
        worst = model.speeds[int(np.argmax(np.abs(vectors[:, 0])))]
        kind = "singular" if abs(values[0]) <= _SINGULAR * max(values[-1], 0.0) else "not positive definite"
        return (
            f"The mass matrix of {type(model).__name__} is {kind} {when} ({posture}): nothing resists '{worst}'. "
            "Give a mass or an inertia to what moves with it, and check the signs of masses."
        )
    return ""


def _map_trouble(model: AbstractMechanical, q: Any, when: str) -> str:
    if model.moves_directly:
        return ""
    H = np.asarray(model.velocity_map(q))
    finite = np.isfinite(H).all()
    if finite:
        values = np.linalg.svd(H, compute_uv=False)
        if values[-1] > 1e-8 * values[0]:
            return _name_trouble(model, H, when)
    worst = model.coordinates[int(np.argmax(np.where(np.isfinite(H), np.abs(H), np.inf).max(axis=1)))]
    return (
        f"The velocity map H of {type(model).__name__} is singular {when} ({_posture(model, q)}): the rate of "
        f"'{worst}' is not determined (gimbal lock). Stay away from this posture, or choose other coordinates, such as "
        "quaternions."
    )


def _name_trouble(model: AbstractMechanical, H: np.ndarray, when: str) -> str:
    """A velocity that is called the rate of a coordinate and is none: outputs of that name would not be it."""
    for i, name in enumerate(model.coordinates):
        if f"{name}_rate" not in model.speeds:
            continue
        alone = np.arange(len(model.speeds)) == model.speeds.index(f"{name}_rate")
        if not np.allclose(H[i], alone, rtol=0, atol=1e-12):
            return (
                f"{type(model).__name__}: the velocity '{name}_rate' is called the rate of '{name}', which "
                f"velocity_map(q) makes another {when}. Name the velocities in velocity_names."
            )
    return ""


def trouble_of_path(model: AbstractMechanical, times: np.ndarray, path: Any) -> str:
    """The first posture of a path in which something is wrong, with its time."""
    if model.moves_directly:
        return ""
    maps = np.asarray(jax.vmap(model.velocity_map)(jnp.asarray(path)))
    finite = np.asarray(np.isfinite(maps).all(axis=(1, 2)))
    values = np.linalg.svd(np.where(finite[:, None, None], maps, 0.0), compute_uv=False)
    bad = ~finite | (values[:, -1] <= 1e-8 * values[:, 0])
    if not bad.any():
        return ""
    first = int(np.argmax(bad))
    return trouble_at(model, jnp.asarray(path)[first], f"at t = {times[first]:.4g} s")


def trouble_along(system: System, grid: Grid) -> str:
    """The posture and time at which an integrated motion ends to be finite, and what is wrong there; empty if
    nothing.
    """
    model: AbstractMechanical = system.model  # type: ignore[attr-defined]
    path = np.asarray(_FOLLOWED(numbers_to_arrays(system), numbers_to_arrays(grid)))
    finite = np.isfinite(path).all(axis=1)
    if finite.all():
        return trouble_of_path(model, np.asarray(grid.times), path)
    last = max(int(np.argmin(finite)) - 1, 0)
    return trouble_at(model, jnp.asarray(path[last]), f"about t = {float(np.asarray(grid.times)[last]):.4g} s")


def _followed(system: System, grid: Grid) -> Array:
    names = system.model.coordinates  # type: ignore[attr-defined]
    found = simulate(system, grid, {}, RungeKutta4(), only=names)
    return jnp.stack([found[name] for name in names], axis=1)


# Once for all systems of a family: each is asked.
_FOLLOWED = Compiled(_followed)


def _posture(model: AbstractMechanical, q: Any) -> str:
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in zip(model.coordinates, q, strict=True))
