"""What can be wrong with a realised mechanical system, in words: shapes, singular matrices, where and when."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from aleator._core.arrays import numbers_to_arrays
from aleator._core.code import told_apart
from aleator._core.compilation import Compiled, Use
from aleator.dynamics import Grid, RungeKutta4, System, simulate
from aleator.mechanics._instant import Instants, instants_of, is_timed
from aleator.mechanics._mechanical import AbstractMechanical, mass_of, rate_map

# Reciprocal condition numbers below this are rounding of zero: answers would have no correct digit left.
_SINGULAR = 1e-12

# A quaternion shorter than this has no direction worth the name.
_VANISHING = 1e-3

# Coordinates this many times as large as at the start are no posture of the model any more.
_ABSURD = 1e4


def diagnosis_at(model: AbstractMechanical, q: Any, when: str) -> str:
    """What is wrong in one posture: a mass matrix that is not positive definite, a singular velocity map.

    Raises `ProblemError` for a mass matrix of another shape than expected, and for what is no body.
    """
    M = np.asarray(mass_of(model, q))
    return model.diagnose(q) or _mass_diagnosis(model, M, q, when) or _map_diagnosis(model, q, when)


def _mass_diagnosis(model: AbstractMechanical, M: np.ndarray, q: Any, when: str) -> str:
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


def _map_diagnosis(model: AbstractMechanical, q: Any, when: str) -> str:
    if model.moves_directly:
        return ""
    H = np.asarray(rate_map(model, q))
    if _are_regular(H):
        return _name_diagnosis(model, H, when)
    worst = model.coordinates[int(np.argmax(np.where(np.isfinite(H), np.abs(H), np.inf).max(axis=1)))]
    return (
        f"The velocity map H of {type(model).__name__} is singular {when} ({_posture(model, q)}): the rate of "
        f"'{worst}' is not determined (gimbal lock). Stay away from this posture, or choose other coordinates, such as "
        "quaternions."
    )


def _are_regular(maps: np.ndarray) -> Any:
    """Whether velocity maps, in the last two axes, tell the rates of all coordinates."""
    finite: Any = np.isfinite(maps).all(axis=(-2, -1))
    maps = np.where(finite[..., None, None], maps, 0.0)
    # In sizes of their own: nanometres and radians do not go together.
    scaled = maps / _sizes(maps, -1)
    scaled = scaled / _sizes(scaled, -2)
    values, alike = (np.linalg.svd(one, compute_uv=False) for one in (maps, scaled))
    return finite & (values[..., -1] > 1e-14 * values[..., 0]) & (alike[..., -1] > 1e-8 * alike[..., 0])


def _sizes(maps: np.ndarray, axis: int) -> np.ndarray:
    sizes = np.abs(maps).max(axis=axis, keepdims=True)
    return np.where(sizes > 0, sizes, 1.0)


def _name_diagnosis(model: AbstractMechanical, H: np.ndarray, when: str) -> str:
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


def diagnosis_of_path(now: Instants, path: Any, effects: Any = None) -> str:
    """The first posture of a path in which something is wrong, with its time.

    `path` holds coordinates as given, quaternions of any length; `effects` are the matrices by which torques act on
    what they must move, where they are to be looked at: each needs the rank of its number of rows.
    """
    model, times, path = now.model, np.asarray(now.times), jnp.asarray(path)
    if found := quaternion_diagnosis(model, times, path) or _map_diagnosis_along(now, path) or _mass_along(now, path):
        return found
    return "" if effects is None else _effect_diagnosis_along(model, times, path, np.asarray(effects))


def quaternion_diagnosis(model: AbstractMechanical, times: np.ndarray, path: Any) -> str:
    """Where a path of coordinates as given passes near a quaternion of zeros, which has no direction."""
    if model.moves_directly:
        return ""
    normalised = np.asarray(jax.vmap(model.normalised)(path))
    vanished = np.abs(normalised) > np.abs(np.asarray(path)) / _VANISHING
    if not vanished.any():
        return ""
    instant, coordinate = (int(found[0]) for found in np.nonzero(vanished))
    return (
        f"{type(model).__name__}: the quaternion of '{model.coordinates[coordinate]}' has no length at t = "
        f"{times[instant]:.4g} s ({_posture(model, path[instant])}), and so no direction. Prescribe quaternions that "
        "keep away from zero."
    )


def _map_diagnosis_along(now: Instants, path: Array) -> str:
    if now.model.moves_directly:
        return ""
    q = jax.vmap(now.model.normalised)(path)
    bad = ~_are_regular(np.asarray(now.each(rate_map, q)))
    return _first_diagnosis(now, q, bad)


def _mass_along(now: Instants, path: Array) -> str:
    """Where a mass that changes with time is none any more; of others the start tells."""
    if not is_timed(now.model):
        return ""
    q = jax.vmap(now.model.normalised)(path)
    masses = np.asarray(now.each(mass_of, q))
    finite: Any = np.isfinite(masses).all(axis=(1, 2))
    least = np.linalg.eigvalsh(np.where(finite[:, None, None], masses, 0.0)).min(axis=1, initial=np.inf)
    return _first_diagnosis(now, q, ~finite | (least <= 0))


def _first_diagnosis(now: Instants, q: Array, bad: np.ndarray) -> str:
    first = int(np.argmax(bad))
    return diagnosis_at(now.at(first), q[first], f"at t = {float(now.times[first]):.4g} s") if bad.any() else ""


def _effect_diagnosis_along(model: AbstractMechanical, times: np.ndarray, path: Array, effects: np.ndarray) -> str:
    """Where torques lose their effect: at an instant, or between two as the determinant changes its sign."""
    finite: Any = np.isfinite(effects).all(axis=(1, 2))
    effects = np.where(finite[:, None, None], effects, 0.0)
    size = np.abs(effects).max(axis=(0, 2), initial=0.0)
    effects = effects / np.where(size > 0, size, 1.0)[:, None]
    values = np.linalg.svd(effects, compute_uv=False)
    lost = ~finite | (values[:, -1] <= _SINGULAR * values.max(initial=0.0))
    turned = np.zeros(len(lost), dtype=bool)
    if effects.shape[1] == effects.shape[2]:
        signs = np.linalg.slogdet(effects)[0]
        turned[:-1] = signs[:-1] * signs[1:] < 0
    if not (lost | turned).any():
        return ""
    first = int(np.argmax(lost | turned))
    when = f"at t = {times[first]:.4g} s"
    if not lost[first]:
        when = f"between t = {times[first]:.4g} s and t = {times[first + 1]:.4g} s"
    return (
        f"The torques of {type(model).__name__} lose their effect {when} ({_posture(model, path[first])}): the matrix "
        "by which they act on what they must move is singular there. Start from a motion that stays away from this "
        "posture, or add a torque."
    )


def diagnosis_along(
    system: System, grid: Grid, effects: Callable[[System, Instants, Array], Array] | None = None
) -> str:
    """What is wrong along an integrated motion, or in the posture in which it ends to be finite; empty if nothing.

    `effects(system, now, path)`: see `diagnosis_of_path`. A motion that grows out of all bounds says nothing of the
    model: steps that are too long for a stiff one make it grow as well.
    """
    model: AbstractMechanical = system.model  # type: ignore[attr-defined]
    system, times = numbers_to_arrays(system), np.asarray(grid.times)
    now = instants_of(model, grid)
    path = np.asarray(_FOLLOWED(system, numbers_to_arrays(grid)))
    moderate = np.isfinite(path).all(axis=1) & (np.abs(path) <= _ABSURD * (1 + np.abs(path[0]).max())).all(axis=1)
    if moderate.all():
        return diagnosis_of_path(now, path, effects and effects(system, now, jnp.asarray(path)))
    following = int(np.argmin(moderate))
    last = max(following - 1, 0)
    if effects is not None and not np.isfinite(path[following]).all():
        # At once, and not by growing: what is prescribed is known there too, and tells whether torques still act.
        onward = np.where(np.isfinite(path[following]), path[following], path[last])
        known = jnp.asarray(np.where(np.arange(len(path))[:, None] < following, path, onward))
        if found := _effect_diagnosis_along(model, times, known, np.asarray(effects(system, now, known))):
            return found
    return diagnosis_at(now.at(last), jnp.asarray(path[last]), f"about t = {times[last]:.4g} s")


def _followed(system: System, grid: Grid) -> Array:
    names = system.model.coordinates  # type: ignore[attr-defined]
    found = simulate(system, grid, {}, RungeKutta4(), only=names)
    return jnp.stack([found[name] for name in names], axis=1)


# Once for all systems of a family: each is asked.
_FOLLOWED = Compiled(_followed, use=Use.ONCE, code=functools.partial(told_apart, _followed))


def _posture(model: AbstractMechanical, q: Any) -> str:
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in zip(model.coordinates, q, strict=True))
