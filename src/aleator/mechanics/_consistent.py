"""Where a constrained system begins: coordinates and velocities that its constraints allow, found from those given.

And what can be wrong, in words: a start that contradicts them, redundancy, singular postures.
"""

import functools
from collections.abc import Callable, Collection
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.dynamics import newton
from aleator.mechanics._constraints import Loose, constraint_rate, jacobian_of
from aleator.mechanics._given import checked_start
from aleator.mechanics._matrices import merged, solve_any, spread, taken
from aleator.mechanics._mechanical import AbstractMechanical, constraint_of


class Kept(NamedTuple):
    """The places of coordinates and velocities that stay as they are given; the others follow from the constraints."""

    coordinates: tuple[int, ...]
    speeds: tuple[int, ...]

    def loose(self, model: AbstractMechanical) -> Loose:
        """The places of all others."""
        return Loose(
            tuple(i for i in range(len(model.coordinates)) if i not in self.coordinates),
            tuple(i for i in range(len(model.speeds)) if i not in self.speeds),
        )


def kept_of(
    model: AbstractMechanical, start: Collection[str], prescribed: tuple[int, ...] = (), driven: tuple[int, ...] = ()
) -> Kept:
    """What is kept of a start: what is prescribed, and what `start` names."""
    coordinates = {*prescribed, *(i for i, name in enumerate(model.coordinates) if name in start)}
    speeds = {*driven, *(i for i, name in enumerate(model.speeds) if name in start)}
    return Kept(tuple(sorted(coordinates)), tuple(sorted(speeds)))


def checked_guess(
    kind: str, model: AbstractMechanical, names: tuple[str, ...], start: Collection[str], guess: Any, driven: int
) -> dict[str, Any]:
    """A guess by name, for coordinates that the start leaves open; `driven` is the number of prescribed velocities.

    Raises `ProblemError` for a guess where no constraints need one, or of what the start keeps, for more constraints
    than velocities are left to them, and for a start that keeps more than can be chosen.
    """
    what, m = f"{kind} of {type(model).__name__}", len(model.constraints)
    if not m:
        if guess is not None:
            raise ProblemError(f"{what}: expected no guess, for it has no constraints; received {guess!r}.")
        return {}
    twice = [name for name in model.constraints if model.constraints.count(name) > 1]
    if twice:
        raise ProblemError(f"{what}: expected a name of its own for each constraint; received '{twice[0]}' twice.")
    if m > len(model.speeds) - driven:
        prescribed = f", of which {driven} are prescribed," if driven else ""
        raise ProblemError(
            f"{what}: expected at most as many constraints as velocities that can follow them; received {m} "
            f"constraints ({', '.join(model.constraints)}) on {len(model.speeds)} velocities{prescribed} which leave "
            f"{len(model.speeds) - driven}. Leave out constraints that others imply, or prescribe less."
        )
    chosen = [name for name in start if name in model.coordinates], [name for name in start if name in model.speeds]
    freedoms = len(model.speeds) - driven - m
    for given, count in ((chosen[0], len(model.speeds_along(chosen[0]))), (chosen[1], len(chosen[1]))):
        if count > freedoms:
            raise ProblemError(
                f"{what}: expected a start of at most {freedoms}, for the rest follows from its {m} constraints; "
                f"received {given}. Put those that are only near in guess."
            )
    return checked_start(model, tuple(name for name in names if name not in start), guess, f"{kind}, guess")


def start_unknown(kind: str, model: AbstractMechanical) -> str:
    """Why the start of a constrained system is not known without its first instant."""
    return (
        f"{kind} of {type(model).__name__}: the start follows from its constraints and what is prescribed at the first "
        "instant, which is known only where it is integrated. Simulate it."
    )


def consistent_start(
    model: AbstractMechanical, q: Float[Array, " coordinates"], v: Float[Array, " speeds"], loose: Loose
) -> tuple[Float[Array, " coordinates"], Float[Array, " speeds"]]:
    """Coordinates and velocities beside those given, moved where they are loose, that the constraints allow."""
    q = consistent_coordinates(model, q, loose.coordinates)
    return q, consistent_velocities(model, q, v, loose.speeds)


def consistent_coordinates(
    model: AbstractMechanical, near: Float[Array, " coordinates"], moving: tuple[int, ...]
) -> Float[Array, " coordinates"]:
    """The posture nearest to the one given that the constraints allow, by some of the coordinates; or not a number.

    Near is meant by the coordinates as they are, rad and m alike. Differentiable, by the implicit function theorem.
    """
    count, given = len(moving), taken(near, moving)
    # Rounding of angles and lengths of about 1, for a start may obey the constraints with coordinates of zero.
    sizes = 1 + jnp.abs(near)
    terms = jnp.abs(jax.jacfwd(functools.partial(constraint_of, model))(near)) @ sizes
    kept = [i for i in range(len(near)) if i not in moving]

    def posture(at: Array) -> Array:
        return model.normalised(merged(at, moving, taken(near, kept), kept))

    def bound(at: Array) -> Array:
        return constraint_of(model, posture(at))

    def nearest(unknowns: Array) -> Array:
        at, multipliers = unknowns[:count], unknowns[count:]
        missing, pulled = jax.vjp(bound, at)
        return jnp.concatenate([at - given + pulled(multipliers)[0], missing])

    if count == len(model.constraints):
        root = newton(bound, given, terms)
    else:
        unknowns = jnp.concatenate([given, jnp.zeros(len(model.constraints))])
        root = newton(nearest, unknowns, jnp.concatenate([taken(sizes, moving), terms]))
    return posture(jnp.where(root.converged, root.point[:count], jnp.nan))


def consistent_velocities(
    model: AbstractMechanical, q: Array, near: Float[Array, " speeds"], moving: tuple[int, ...]
) -> Float[Array, " speeds"]:
    """The velocities nearest to those given that the constraints allow, by some of them; not a number where none."""
    G = taken(jacobian_of(model, q).T, moving).T
    return near - spread(solve_any(G, constraint_rate(model, q, near)), moving, len(near))


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
