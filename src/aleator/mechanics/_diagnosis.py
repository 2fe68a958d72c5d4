"""Diagnosis of a realised mechanical system: wrong shapes and singular matrices, with posture and time."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator.dynamics import Grid, RungeKutta4, System, simulate
from aleator.mechanics._constraint_diagnosis import constraint_diagnosis_along, lost_rank
from aleator.mechanics._constraints import Loose
from aleator.mechanics._instant import Instants, instants_of, is_timed
from aleator.mechanics._mechanical import AbstractMechanical, mass_of, rate_map

# Reciprocal condition numbers below this count as zero: results would have no correct digit left.
_SINGULAR = 1e-12

# A quaternion shorter than this has no meaningful direction.
_VANISHING = 1e-3

# Coordinates this many times as large as at the start are no longer a meaningful posture.
_ABSURD = 1e4


def diagnosis_at(model: AbstractMechanical, q: Any, when: str) -> str:
    """What is wrong in one posture: a mass matrix that is not positive definite, or a singular velocity map.

    Raises `ProblemError` for a mass matrix of the wrong shape, and for an impossible body.
    """
    M = np.asarray(mass_of(model, q))
    return model.diagnose(q) or _mass_diagnosis(model, M, q, when) or _map_diagnosis(model, q, when)


def _mass_diagnosis(model: AbstractMechanical, M: np.ndarray, q: Any, when: str) -> str:
    posture = _posture(model, q)
    if not np.isfinite(M).all():
        return f"The mass matrix of {type(model).__name__} is not finite {when} ({posture})."
    if not np.allclose(M, M.T, rtol=1e-8, atol=1e-12 * np.abs(M).max(initial=1.0)):
        return f"The mass matrix of {type(model).__name__} is not symmetric {when} ({posture})."
    # Scaled by the diagonal entries, since metres and kilograms are not comparable with radians and grams.
    size = np.sqrt(np.abs(np.diagonal(M)))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(M / np.outer(size, size))
    if values.size and values[0] <= _SINGULAR * max(values[-1], 0.0):
        worst = model.speeds[int(np.argmax(np.abs(vectors[:, 0])))]
        kind = "singular" if abs(values[0]) <= _SINGULAR * max(values[-1], 0.0) else "not positive definite"
        return (
            f"The mass matrix of {type(model).__name__} is {kind} {when} ({posture}): nothing resists '{worst}'. Give "
            "mass or inertia to the bodies that move with it, and check the signs of masses."
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
        f"'{worst}' is not determined (gimbal lock). Avoid this posture, or choose other coordinates, such as "
        "quaternions."
    )


def _are_regular(maps: np.ndarray) -> Any:
    """Whether velocity maps, in the last two axes, determine the rates of all coordinates."""
    finite: Any = np.isfinite(maps).all(axis=(-2, -1))
    maps = np.where(finite[..., None, None], maps, 0.0)
    # Scaled row by row, since nanometres and radians are not comparable.
    scaled = maps / _sizes(maps, -1)
    scaled = scaled / _sizes(scaled, -2)
    values, alike = (np.linalg.svd(one, compute_uv=False) for one in (maps, scaled))
    return finite & (values[..., -1] > 1e-14 * values[..., 0]) & (alike[..., -1] > 1e-8 * alike[..., 0])


def _sizes(maps: np.ndarray, axis: int) -> np.ndarray:
    sizes = np.abs(maps).max(axis=axis, keepdims=True)
    return np.where(sizes > 0, sizes, 1.0)


def _name_diagnosis(model: AbstractMechanical, H: np.ndarray, when: str) -> str:
    """A velocity named as the rate of a coordinate that is not: the output of that name would be wrong."""
    for i, name in enumerate(model.coordinates):
        if f"{name}_rate" not in model.speeds:
            continue
        alone = np.arange(len(model.speeds)) == model.speeds.index(f"{name}_rate")
        if not np.allclose(H[i], alone, rtol=0, atol=1e-12):
            return (
                f"{type(model).__name__}: the velocity '{name}_rate' is named as the rate of '{name}', but by "
                f"velocity_map(q) it is not {when}. Name the velocities in velocity_names."
            )
    return ""


def diagnosis_of_path(now: Instants, path: Any, effects: Any = None) -> str:
    """What is wrong in the first bad posture of a path, with its time.

    `path` holds coordinates as given, with quaternions of any length; `effects` are the matrices by which torques act
    on the motions they must realise, where these are to be checked: each needs full row rank.
    """
    model, times, path = now.model, np.asarray(now.times), jnp.asarray(path)
    if found := quaternion_diagnosis(model, times, path) or _map_diagnosis_along(now, path) or _mass_along(now, path):
        return found
    return "" if effects is None else _effect_diagnosis_along(model, times, path, np.asarray(effects))


def quaternion_diagnosis(model: AbstractMechanical, times: np.ndarray, path: Any) -> str:
    """Where a path of given coordinates passes near a zero quaternion, which has no direction."""
    if model.moves_directly:
        return ""
    normalised = np.asarray(jax.vmap(model.normalised)(path))
    vanished = np.abs(normalised) > np.abs(np.asarray(path)) / _VANISHING
    if not vanished.any():
        return ""
    instant, coordinate = (int(found[0]) for found in np.nonzero(vanished))
    return (
        f"{type(model).__name__}: the quaternion of '{model.coordinates[coordinate]}' is zero at t = "
        f"{times[instant]:.4g} s ({_posture(model, path[instant])}), and so has no direction. Prescribe quaternions "
        "that stay away from zero."
    )


def _map_diagnosis_along(now: Instants, path: Array) -> str:
    if now.model.moves_directly:
        return ""
    q = jax.vmap(now.model.normalised)(path)
    bad = ~_are_regular(np.asarray(now.each(rate_map, q)))
    return _first_diagnosis(now, q, bad)


def _mass_along(now: Instants, path: Array) -> str:
    """Where a time-dependent mass matrix is no longer positive definite; constant ones are checked at the start."""
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
    """Where torques lose their effect: at an instant, or between two where the determinant changes sign."""
    found = lost_rank(times, effects)
    if found is None:
        return ""
    when, first = found
    return (
        f"The torques of {type(model).__name__} lose their effect {when} ({_posture(model, path[first])}): the matrix "
        "by which they act on the motion they must realise is singular there. Start from a motion that avoids this "
        "posture, or add a torque."
    )


def diagnosis_along(
    system: System,
    grid: Grid,
    effects: Callable[[System, Instants, Array], Array] | None = None,
    loose: Loose | None = None,
) -> str:
    """What is wrong along an integrated motion, or in the last posture that is finite; empty if nothing.

    `effects(system, now, path)`: see `diagnosis_of_path`; `loose`: what follows the constraints, if there are any. A
    motion that grows without bound does not show a fault of the model: steps too long for a stiff model have the same
    effect.
    """
    model: AbstractMechanical = system.model  # type: ignore[attr-defined]
    system, times = numbers_to_arrays(system), np.asarray(grid.times)
    now = instants_of(model, grid)
    path = np.asarray(_FOLLOWED(system, numbers_to_arrays(grid)))
    moderate = np.isfinite(path).all(axis=1) & (np.abs(path) <= _ABSURD * (1 + np.abs(path[0]).max())).all(axis=1)
    if moderate.all():
        if loose is not None and (found := constraint_diagnosis_along(now, jnp.asarray(path), loose)):
            return found
        return diagnosis_of_path(now, path, effects and effects(system, now, jnp.asarray(path)))
    following = int(np.argmin(moderate))
    last = max(following - 1, 0)
    if loose is not None and np.isnan(path[following]).all():
        if last == 0:
            return (
                f"The constraints of {type(model).__name__} cannot be obeyed right after the start "
                f"({_posture(model, path[0])}): accelerations that are not finite there, a dead centre, or lengths "
                "that do not reach. Check forces and energies in this posture, or begin in another one: by start=, or "
                "by guess= for coordinates that follow from the constraints; or take shorter steps."
            )
        return (
            f"The constraints of {type(model).__name__} cannot be obeyed beyond about t = {times[last]:.4g} s "
            f"({_posture(model, path[last])}): a dead centre, or lengths that do not reach. Change lengths or motion "
            "so that it keeps away from there, or take shorter steps if it moves far in one."
        )
    if effects is not None and not np.isfinite(path[following]).all():
        # It ends abruptly, not by growth: the prescribed motion is known there, and shows whether torques still act.
        onward = np.where(np.isfinite(path[following]), path[following], path[last])
        known = jnp.asarray(np.where(np.arange(len(path))[:, None] < following, path, onward))
        if found := _effect_diagnosis_along(model, times, known, np.asarray(effects(system, now, known))):
            return found
    return diagnosis_at(now.at(last), jnp.asarray(path[last]), f"about t = {times[last]:.4g} s")


def _followed(system: System, grid: Grid) -> Array:
    names = system.model.coordinates  # type: ignore[attr-defined]
    found = simulate(system, grid, {}, RungeKutta4(), only=names)
    return jnp.stack([found[name] for name in names], axis=1)


# Compiled once for all systems of a family, each of which is checked.
_FOLLOWED = Compiled(_followed, use=Use.ONCE)


def _posture(model: AbstractMechanical, q: Any) -> str:
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in zip(model.coordinates, q, strict=True))
