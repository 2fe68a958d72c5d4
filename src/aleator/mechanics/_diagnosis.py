"""What can be wrong with a mechanical system, in words, with posture and time.

Singular matrices and rules that a model breaks; constraints that a start contradicts, that are redundant or singular.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.mechanics._constraints import Loose
from aleator.mechanics._mechanical import AbstractMechanical, constraint_of, jacobian_of

# Reciprocal condition numbers below this count as zero: results would have no correct digit left.
_SINGULAR_MASS = 1e-12

# A quaternion shorter than this has no meaningful direction.
_VANISHING = 1e-3


class Posture(NamedTuple):
    """What diagnosis asks of a model at each instant, along the first axis; `None` for what needs no check.

    - `mass`: `M`; `rates`: `H`; `jacobian`: `G` of what follows the constraints;
    - `effects`: how the torques to be found act on the motions that they must realise: of full row rank;
    - `stated`: what the model states in two ways, see `AbstractMechanical.stated_twice`.
    """

    q: Any
    mass: Any
    rates: Any
    jacobian: Any
    effects: Any
    stated: Any


class Examination(NamedTuple):
    """What diagnosis asks of a formulation on a grid.

    - `row`: the first instant, see `Instants.row`; `near`: the coordinates there as they are given; `own`: what the
      formulation itself checks there;
    - `motion`: coordinates and velocities at each instant, not finite where they could not be integrated; `postures`:
      there, or at the last posture before; at the first instant alone if nothing can change later;
    - `prescribed`, `valid`: the prescribed coordinates, and the same made valid, if these may differ.
    """

    row: Any
    near: Any
    own: Any
    motion: Any
    postures: Posture
    prescribed: Any
    valid: Any


def rows_of(tree: Any, which: Any) -> Any:
    """The rows of some instants, or the row of one."""
    return jax.tree.map(lambda rows: rows[which], tree)


def posture_diagnosis(model: AbstractMechanical, posture: Posture, when: str) -> str:
    """What is wrong in one posture: a mass matrix that is not positive definite, or a singular velocity map."""
    return (
        _contradiction(model, posture) or _mass_diagnosis(model, posture, when) or _map_diagnosis(model, posture, when)
    )


def _contradiction(model: AbstractMechanical, posture: Posture) -> str:
    first, second = posture.stated or (np.zeros(0), np.zeros(0))
    slack = 1e-9 * np.abs(second).max(initial=0.0)
    agree = np.allclose(first, second, rtol=1e-6, atol=slack, equal_nan=True)
    return "" if agree else f"{type(model).__name__}.{model._rule}"


def _mass_diagnosis(model: AbstractMechanical, at: Posture, when: str) -> str:
    M, posture = at.mass, posture_text(model, at.q)
    if not np.isfinite(M).all():
        return f"The mass matrix of {type(model).__name__} is not finite {when} ({posture})."
    if not np.allclose(M, M.T, rtol=1e-8, atol=1e-12 * np.abs(M).max(initial=1.0)):
        return f"The mass matrix of {type(model).__name__} is not symmetric {when} ({posture})."
    # Scaled by the diagonal entries, since metres and kilograms are not comparable with radians and grams.
    size = np.sqrt(np.abs(np.diagonal(M)))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(M / np.outer(size, size))
    if values.size and values[0] <= _SINGULAR_MASS * max(values[-1], 0.0):
        worst = model.speeds[int(np.argmax(np.abs(vectors[:, 0])))]
        kind = "singular" if abs(values[0]) <= _SINGULAR_MASS * max(values[-1], 0.0) else "not positive definite"
        return (
            f"The mass matrix of {type(model).__name__} is {kind} {when} ({posture}): nothing resists '{worst}'. Give "
            "mass or inertia to the bodies that move with it, and check the signs of masses."
        )
    return ""


def _map_diagnosis(model: AbstractMechanical, at: Posture, when: str) -> str:
    if at.rates is None:
        return ""
    H = at.rates
    if _are_regular(H):
        return _name_diagnosis(model, H, when)
    worst = model.coordinates[int(np.argmax(np.where(np.isfinite(H), np.abs(H), np.inf).max(axis=1)))]
    return (
        f"The velocity map H of {type(model).__name__} is singular {when} ({posture_text(model, at.q)}): the rate of "
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


def quaternion_diagnosis(model: AbstractMechanical, times: np.ndarray, seen: Examination) -> str:
    """Where prescribed coordinates pass near a zero quaternion, which has no direction."""
    if seen.valid is None:
        return ""
    vanished = np.abs(seen.valid) > np.abs(seen.prescribed) / _VANISHING
    if not vanished.any():
        return ""
    instant, coordinate = np.argwhere(vanished)[0]
    return (
        f"{type(model).__name__}: the quaternion of '{model.coordinates[coordinate]}' is zero at t = "
        f"{times[instant]:.4g} s ({posture_text(model, seen.prescribed[instant])}), and so has no direction. Prescribe "
        "quaternions that stay away from zero."
    )


def first_diagnosis(model: AbstractMechanical, times: np.ndarray, postures: Posture) -> str:
    """What is wrong in the first posture whose mass matrix or velocity map is singular."""
    finite: Any = np.isfinite(postures.mass).all(axis=(1, 2))
    masses = np.where(finite[:, None, None], postures.mass, 0.0)
    bad = ~finite | (np.linalg.eigvalsh(masses).min(axis=1, initial=np.inf) <= 0)
    if postures.rates is not None:
        bad |= ~_are_regular(postures.rates)
    first = int(np.argmax(bad))
    return posture_diagnosis(model, rows_of(postures, first), f"at t = {times[first]:.4g} s") if bad.any() else ""


def effect_diagnosis(model: AbstractMechanical, times: np.ndarray, q: np.ndarray, effects: np.ndarray | None) -> str:
    """Where torques lose their effect: at an instant, or between two where the determinant changes sign."""
    lost = None if effects is None else lost_rank(times, effects)
    if lost is None:
        return ""
    when, first = lost
    return (
        f"The torques of {type(model).__name__} lose their effect {when} ({posture_text(model, q[first])}): the matrix "
        "by which they act on the motion they must realise is singular there. Start from a motion that avoids this "
        "posture, or add a torque."
    )


def unobeyed(model: AbstractMechanical, time: float, q: np.ndarray) -> str:
    """Constraints that the motion cannot obey any further."""
    return (
        f"The constraints of {type(model).__name__} cannot be obeyed beyond about t = {time:.4g} s "
        f"({posture_text(model, q)}): a dead centre, lengths that do not reach, or accelerations that are not finite. "
        "Change lengths, start or motion so that it keeps away from there, check forces and energies, or take shorter "
        "steps."
    )


# Singular values smaller than this beside the largest, in sizes of their own, are rounding of zero.
_SINGULAR = 1e-9


# What may be left of a constraint, beside its slope times the coordinates.
_LEFT = 1e-8


_MOST_STEPS = 50


Linearised: TypeAlias = Callable[[np.ndarray], tuple[np.ndarray, ...]]
"""What is left of the constraints at given coordinates, its slope by these, and the Jacobian `G`."""


_ELSEWHERE = "Coordinates near a posture that it can take, from which its start is found, are given by guess=."


def start_diagnosis(model: AbstractMechanical, near: Float[np.ndarray, " coordinates"], loose: Loose) -> str:
    """Why the constraints allow no posture at the start, or do not determine one.

    `near` is the start as it is given, with coordinates that stay and those that are `loose`.
    """
    what, linearised = type(model).__name__, _linearised(model)
    if not all(np.isfinite(one).all() for one in linearised(near)):
        return (
            f"{what}: its constraints, or their derivatives, are not finite at {posture_text(model, near)}, "
            f"from where a start is sought. {_ELSEWHERE}"
        )
    q, left, slope, jacobian = _brought_near(linearised, near, np.array(loose.coordinates))
    q = np.asarray(model.normalised(jnp.asarray(q)))
    size = np.abs(slope).max(axis=1, initial=0.0) * (1 + np.abs(q).max(initial=0.0))
    if not (np.abs(left) <= _LEFT * size).all():
        return (
            f"{what}: no start near {posture_text(model, near)} satisfies its constraints: at "
            f"{posture_text(model, q)} they are left with {_listed(model.constraints, left)}. Check its "
            f"lengths, or keep less in start=. {_ELSEWHERE}"
        )
    if _rank(jacobian) < len(jacobian):
        return _dependence(model, linearised, q, jacobian)
    return (
        f"{what}: at {posture_text(model, q)} its constraints do not determine how "
        f"{_named([model.coordinates[i] for i in loose.coordinates])} follow the rest (a dead centre). Keep or "
        f"prescribe another coordinate, or begin beside this posture. {_ELSEWHERE}"
    )


def constraint_diagnosis_along(
    model: AbstractMechanical, loose: Loose, times: np.ndarray, path: np.ndarray, jacobians: np.ndarray | None
) -> str:
    """Where along a path the constraints lose their rank, at an instant or between two; empty if nowhere.

    `jacobians` are those by the speeds that are `loose`, at each instant; `None` without constraints.
    """
    when = None if jacobians is None else lost_rank(times, jacobians)
    if when is None:
        return ""
    text, i = when
    return (
        f"The constraints of {type(model).__name__} lose their rank {text} "
        f"({posture_text(model, path[i])}): how {_named([model.speeds[j] for j in loose.speeds])} "
        "follow is not determined there (a dead centre). Stay away from this posture, or prescribe another coordinate."
    )


def lost_rank(times: np.ndarray, matrices: Float[np.ndarray, "instants m n"]) -> tuple[str, int] | None:
    """When matrices along a path first lose the rank of their rows, and at which instant: there or right after it."""
    finite: Any = np.isfinite(matrices).all(axis=(1, 2))
    matrices = np.where(finite[:, None, None], matrices, 0.0)
    size = np.abs(matrices).max(axis=(0, 2), initial=0.0)
    matrices = matrices / np.where(size > 0, size, 1.0)[:, None]
    values = np.linalg.svd(matrices, compute_uv=False)
    lost = ~finite | (values[:, -1] <= 1e-12 * values.max(initial=0.0))
    turned = np.zeros(len(lost), dtype=bool)
    if matrices.shape[1] == matrices.shape[2]:
        signs = np.linalg.slogdet(matrices)[0]
        turned[:-1] = signs[:-1] * signs[1:] < 0
    if not (lost | turned).any():
        return None
    first = int(np.argmax(lost | turned))
    if lost[first]:
        return f"at t = {times[first]:.4g} s", first
    return f"between t = {times[first]:.4g} s and t = {times[first + 1]:.4g} s", first


def _dependence(model: AbstractMechanical, linearised: Linearised, q: np.ndarray, jacobian: np.ndarray) -> str:
    """Constraints that depend on one another: wherever the system is, or in one posture alone."""
    what, rank, names = type(model).__name__, _rank(jacobian), _dependent(model, jacobian)
    everything = np.arange(len(model.coordinates))
    # A posture apart, in which no angle happens to be zero.
    apart, left, slope, elsewhere = _brought_near(linearised, q + np.linspace(0.02, 0.05, len(q)), everything)
    reached = (np.abs(left) <= _LEFT * np.abs(slope).max(axis=1) * (1 + np.abs(apart).max())).all()
    if reached and _rank(elsewhere) == len(jacobian):
        return (
            f"{what}: its {len(jacobian)} constraints have only rank {rank} at {posture_text(model, q)}, where "
            f"{_dependent_text(names)} (a singular posture, in which it may go on in several ways). Begin "
            f"beside it, or choose lengths that keep away from it. {_ELSEWHERE}"
        )
    return (
        f"{what}: redundant constraints: expected {len(jacobian)} that are independent; their rank is {rank}, for "
        f"{_dependent_text(names)}. Leave out {len(jacobian) - rank} of these; a loop of hinges in one "
        "plane is closed by al.joints.Closure(..., planar=True)."
    )


def _dependent_text(names: list[str]) -> str:
    return f"{_named(names)} binds nothing" if len(names) == 1 else f"{_named(names)} depend on one another"


def _dependent(model: AbstractMechanical, jacobian: np.ndarray) -> list[str]:
    """The names of constraints that take part in combinations which bind nothing."""
    scaled = _scaled(jacobian)
    vectors, values, _ = np.linalg.svd(scaled)
    values = np.append(values, np.zeros(len(vectors) - len(values)))
    vanishing = vectors[:, values <= _SINGULAR * max(values[0], 1.0)]
    return [name for name, row in zip(model.constraints, vanishing, strict=True) if np.abs(row).max() > 1e-6]


def _rank(matrix: np.ndarray) -> int:
    values = np.linalg.svd(_scaled(matrix), compute_uv=False)
    return int(np.sum(values > _SINGULAR * values.max(initial=0.0)))


def _scaled(matrix: np.ndarray) -> np.ndarray:
    """Each row by its largest entry; columns, metres beside radians, by theirs."""
    for axis in (1, 0):
        size = np.abs(matrix).max(axis=axis, keepdims=True, initial=0.0)
        matrix = matrix / np.where(size > 1e-12 * size.max(initial=0.0), size, np.where(size > 0, size.max(), 1.0))
    return matrix


def _brought_near(linearised: Linearised, q: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, ...]:
    """A posture that obeys the constraints as nearly as Gauss and Newton bring it, what is left, slope and Jacobian.

    On the host, and by least squares, so that dependent constraints are told from contradictory ones.
    """

    def finite(at: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(map(np.nan_to_num, linearised(at)))

    left, slope, jacobian = finite(q)
    for _ in range(_MOST_STEPS):
        step = np.linalg.lstsq(slope[:, moving], left, rcond=_SINGULAR)[0]
        damping, moved, following = 1.0, q, (left, slope, jacobian)
        while damping > 1e-3:
            moved = q.copy()
            moved[moving] -= damping * step
            following = finite(moved)
            if np.linalg.norm(following[0]) < np.linalg.norm(left):
                break
            damping /= 2
        else:
            break
        q, (left, slope, jacobian) = moved, following
        if np.abs(step).max(initial=0.0) <= 1e-14 * (1 + np.abs(q).max(initial=0.0)):
            break
    return q, left, slope, jacobian


def _linearised(model: AbstractMechanical) -> Linearised:
    def bound(at: Array) -> Array:
        return constraint_of(model, model.normalised(at))

    @jax.jit
    def linearised(q: Array) -> tuple[Array, Array, Array]:
        return bound(q), jax.jacfwd(bound)(q), jacobian_of(model, model.normalised(q))

    return lambda q: tuple(map(np.asarray, linearised(jnp.asarray(q))))


def posture_text(model: AbstractMechanical, q: Any) -> str:
    """Coordinates with their names."""
    return _listed(model.coordinates, q)


def _listed(names: tuple[str, ...], values: Any) -> str:
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in zip(names, np.asarray(values), strict=True))


def _named(names: list[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
