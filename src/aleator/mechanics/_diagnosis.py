"""What can be wrong with a mechanical system, in words: the first instant and posture where it is.

Mass matrices, velocity maps, effects of torques and constraints that are singular; what cannot be obeyed any further;
starts that constraints contradict or leave open.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from aleator.mechanics._constraints import Stated, agrees, rate_terms, velocity_rule
from aleator.mechanics._mechanical import AbstractMechanical, constraint_of
from aleator.mechanics._partial import Partition

# Masses with reciprocal condition numbers below this: results would have no correct digit left.
_SINGULAR_MASS = 1e-12

# Singular values smaller than this beside the largest, in sizes of their own, are rounding of zero.
_SINGULAR = 1e-9

# What may be left of a constraint, beside its slope times the coordinates.
_LEFT = 1e-8

# Coordinates this many times as large as at the start are no longer a meaningful posture.
_ABSURD = 1e4

# A quaternion shorter than this has no meaningful direction.
_VANISHING = 1e-3

_ELSEWHERE = "Coordinates near a posture that it can take, from which its start is found, are given by guess=."


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

    - `row`: the first instant, see `Instants.row`; `near`: the coordinates there as they are given;
    - `history`: simulated outputs by name; `None` if nothing can change after the first instant;
    - `q`: the coordinates at each instant, not finite where they could not be integrated; `postures`: there, or at the
      last posture before; `path`: the coordinates as they are prescribed.
    """

    row: Any
    near: Any
    history: Any
    q: Any
    postures: Posture
    path: Any = None


def diagnosis(
    model: AbstractMechanical,
    parts: Partition,
    stated: Stated,
    times: np.ndarray,
    seen: Examination,
    speeds: Callable[[], Array],
    unrealisable: str,
) -> str:
    """What is wrong at the start, in the first bad posture, or where the motion ends; empty if nothing.

    A motion that grows without bound does not show a fault of the model: steps too long for a stiff model have the same
    effect.
    """
    model.refuse_impossible()
    finite, history = np.isfinite(seen.q).all(axis=1), seen.history or {}
    begins = all(np.isfinite(history[name][0]) for name in (*model.coordinates, *model.speeds) if name in history)
    if model.constraints and not begins:
        rules = jax.jit(lambda q: velocity_rule(model, q)) if model.velocity_constraint_names else lambda _: {}
        broken = _broken(model, rules(seen.near))
        return broken or _missed(model, parts, times, seen, 0) or start_diagnosis(model, seen, stated, speeds)
    largest = np.abs(np.nan_to_num(seen.q)).max(axis=1, initial=0.0)
    moderate = finite & (largest <= _ABSURD * (1 + largest[0]))
    good = len(finite) if moderate.all() or not parts.others else max(int(np.argmin(moderate)), 1)
    ends = None if finite.all() else int(np.argmin(finite))
    seen = seen._replace(postures=jax.tree.map(lambda rows: rows[: good + (ends == good)], seen.postures))
    first = [text for _, text in sorted(_faults(model, parts, times, seen, good, unrealisable), key=lambda one: one[0])]
    if first or ends is None:
        return first[0] if first else ""
    return _missed(model, parts, times, seen, ends) or _unobeyed(model, times, seen, ends)


def _faults(
    model: AbstractMechanical, parts: Partition, times: np.ndarray, seen: Examination, good: int, unrealisable: str
) -> Iterator[tuple[int, str]]:
    """The first instant of each fault, and what it is."""
    who, postures = type(model).__name__, seen.postures

    def posture(i: int) -> str:
        return posture_text(model, postures.q[min(i, len(postures.q) - 1)])

    def when(i: int) -> str:
        return "at the start" if i == 0 else f"at t = {times[i]:.4g} s"

    if broken := _broken(model, {rule: (one[0], two[0]) for rule, (one, two) in postures.stated.items()}):
        yield -1, broken
    for i, fault in enumerate(map(partial(_mass_fault, model), postures.mass[:good])):
        if fault:
            yield i, f"The mass matrix of {who} is {fault[0]} {when(i)} ({posture(i)}){fault[1]}"
            break
    H, G = (None if one is None else one[:good] for one in (postures.rates, postures.jacobian))
    if H is not None:
        yield from _misnamed_rates(model, H[0])
    if seen.path is not None and not model.moves_directly and parts.prescribed:
        valid = np.abs(postures.q) > np.abs(seen.path[: len(postures.q)]) / _VANISHING
        for i, coordinate in np.argwhere(valid)[:1]:
            yield (
                int(i),
                f"{who}: the quaternion of '{model.coordinates[coordinate]}' is zero {when(i)} "
                f"({posture_text(model, seen.path[i])}), and so has no direction. Prescribe quaternions that stay away "
                "from zero.",
            )
    follow = _named([model.speeds[j] for j in parts.undriven])
    for matrices, what, why in (
        (
            H if H is None else H.swapaxes(1, 2),
            f"The velocity map H of {who} loses its rank",
            "rates of coordinates are not determined there (gimbal lock). Avoid this posture, or choose other "
            "coordinates, such as quaternions.",
        ),
        (
            G,
            f"The constraints of {who} lose their rank",
            f"how {follow} follow is not determined there (a dead centre). Stay away from this posture, or prescribe "
            "another coordinate.",
        ),
        (
            postures.effects,
            f"The torques of {who} lose their effect",
            "the matrix by which they act on the motion they must realise is singular there. Start from a motion that "
            "avoids this posture, or add a torque.",
        ),
    ):
        if matrices is not None and (lost := lost_rank(times, matrices)) is not None:
            never = matrices is postures.effects and lost[0] == "at the start"
            yield lost[1], unrealisable if never else f"{what} {lost[0]} ({posture(lost[1])}): {why}"


def _broken(model: AbstractMechanical, stated: Mapping[str, tuple[Any, Any]]) -> str:
    """The first rule of which a model states two things."""
    for rule, (first, second) in stated.items():
        slack = 1e-9 * np.abs(second).max(initial=0.0)
        if not np.allclose(first, second, rtol=1e-6, atol=slack, equal_nan=True):
            return f"{type(model).__name__}.{rule}"
    return ""


def _mass_fault(model: AbstractMechanical, M: np.ndarray) -> tuple[str, str] | None:
    """What is wrong with a mass matrix, and what to do."""
    if not np.isfinite(M).all():
        return "not finite", "."
    if not np.allclose(M, M.T, rtol=1e-8, atol=1e-12 * np.abs(M).max(initial=1.0)):
        return "not symmetric", "."
    # Scaled by the diagonal entries, since metres and kilograms are not comparable with radians and grams.
    size = np.sqrt(np.abs(np.diagonal(M)))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(M / np.outer(size, size))
    if not values.size or values[0] > _SINGULAR_MASS * max(values[-1], 0.0):
        return None
    worst = model.speeds[int(np.argmax(np.abs(vectors[:, 0])))]
    kind = "singular" if abs(values[0]) <= _SINGULAR_MASS * max(values[-1], 0.0) else "not positive definite"
    return kind, (
        f": nothing resists '{worst}'. Give mass or inertia to the bodies that move with it, and check the signs of "
        "masses."
    )


def _misnamed_rates(model: AbstractMechanical, H: np.ndarray) -> Iterator[tuple[int, str]]:
    """Velocities named as the rates of coordinates that they are not."""
    for row, name in zip(H, model.coordinates, strict=True):
        alone = np.array([speed == f"{name}_rate" for speed in model.speeds])
        if alone.any() and not np.allclose(row, alone, rtol=0, atol=1e-12):
            yield (
                0,
                f"{type(model).__name__}: the velocity '{name}_rate' is named as the rate of '{name}', but by "
                "velocity_map(q) it is not. Name the velocities in velocity_names.",
            )


def _missed(model: AbstractMechanical, parts: Partition, times: np.ndarray, seen: Examination, ends: int) -> str:
    """What a prescribed motion breaks, or asks of torques in vain, at the instant where it ends, by how much."""
    who, prescribed = type(model).__name__, _named([model.coordinates[i] for i in parts.prescribed])
    errors, shortfalls = (
        np.zeros(len(times)) if amount is None else np.nan_to_num(amount, posinf=np.inf)
        for amount in map((seen.history or {}).get, ("motion_error", "torque_shortfall"))
    )
    worst = int(np.argmax(errors))
    if errors[ends] > _SINGULAR * (1 + np.abs(np.nan_to_num(seen.postures.q[-1])).max(initial=0.0)):
        what, remedy = "a rate misses velocity_map(q) times the velocities", "rates that are H(q) v, or all coordinates"
        if model.velocity_constraint_names:
            what = f"it misses what {_named(model.velocity_constraint_names)} asks of the velocities"
            remedy = "a motion that obeys it, or fewer coordinates"
        return (
            f"{who}: the motion prescribed for {prescribed} is none that it can make: at t = {times[worst]:.4g} s "
            f"{what} by {errors[worst]:.3g}. Prescribe {remedy}."
        )
    if shortfalls[ends] > 0:
        return (
            f"{who}: within torque_bounds(q, v) the torques {_named([model.actuators[i] for i in parts.unknown])} "
            f"cannot make the motion prescribed for {prescribed}: at t = {times[ends]:.4g} s they fall short of the "
            f"force that it takes by {shortfalls[ends]:.3g}. Widen the bounds, of which none may cross, or "
            "prescribe another motion."
        )
    return ""


def _unobeyed(model: AbstractMechanical, times: np.ndarray, seen: Examination, ends: int) -> str:
    """Why constraints cannot be obeyed any further, by how much."""
    if not model.holonomic:
        return ""
    who, history = type(model).__name__, seen.history or {}
    before = max(ends - 1, 0)
    return (
        f"The constraints of {who} cannot be obeyed beyond about t = {times[before]:.4g} s "
        f"({posture_text(model, seen.postures.q[min(before, len(seen.postures.q) - 1)])}), where they are missed by "
        f"{history['constraint_drift'][ends]:.3g}: a dead centre, lengths that do not reach, or accelerations that are "
        "not finite. Change lengths, start or motion so that it keeps away from there, check forces and energies, or "
        "take shorter steps."
    )


Linearised: TypeAlias = Callable[[np.ndarray], tuple[np.ndarray, ...]]
"""What is left of holonomic constraints at given coordinates, its slope by these, and `G` and `b` of all rates."""


def start_diagnosis(model: AbstractMechanical, seen: Examination, stated: Stated, speeds: Callable[[], Array]) -> str:
    """Why the constraints allow no state at the start, or do not determine one; `speeds`: there as they are given."""
    what, linearised, near, loose = type(model).__name__, _linearised(model), seen.near, stated.loose
    q, left, slope, jacobian, drift = near, *linearised(near)
    if not all(np.isfinite(one).all() for one in (left, slope, jacobian, drift)):
        return (
            f"{what}: its constraints, or their derivatives, are not finite at {posture_text(model, near)}, "
            f"from where a start is sought. {_ELSEWHERE}"
        )
    if model.holonomic:
        q, left, slope, jacobian, drift = _brought_near(linearised, near, np.array(loose.coordinates))
    q = np.asarray(model.normalised(jnp.asarray(q)))
    size = np.abs(slope).max(axis=1, initial=0.0) * (1 + np.abs(q).max(initial=0.0))
    if not (np.abs(left) <= _LEFT * size).all():
        return (
            f"{what}: no start near {posture_text(model, near)} satisfies its constraints: at "
            f"{posture_text(model, q)} they are left with {_listed(model.holonomic, left)}. Check its "
            f"lengths, or keep less in start=. {_ELSEWHERE}"
        )
    if not agrees(q, near)[list(stated.named.coordinates)].all():
        return (
            f"{what}: the start names all coordinates, {posture_text(model, near)}, and contradicts its constraints, "
            f"which are left with {_listed(model.holonomic, linearised(near)[0])}. {_ELSEWHERE}"
        )
    if _rank(jacobian) < len(jacobian):
        return _dependence(model, q, jacobian)
    follows = _rank(slope[:, loose.coordinates]) == len(slope)
    missed = _listed(model.constraints, jacobian @ np.asarray(speeds()) + drift)
    if follows and _rank(jacobian[:, loose.speeds]) < min(len(jacobian), len(loose.speeds)):
        named = [model.speeds[i] for i in stated.named.speeds]
        return (
            f"{what}: at {posture_text(model, q)} its constraints leave some of the rates "
            f"{_named([model.speeds[i] for i in loose.speeds])} open. Name them in start="
            + (f", in the place of {_named(named)}, with which {missed}." if named else ", or prescribe others.")
        )
    if follows and set(stated.named.speeds) & set(loose.speeds):
        return (
            f"{what}: the start names all velocities, and contradicts its constraints at {posture_text(model, q)}, "
            f"which are missed by {missed}. Leave some of them out."
        )
    return (
        f"{what}: at {posture_text(model, q)} its constraints do not determine how "
        f"{_named([model.coordinates[i] for i in loose.coordinates])} follow the rest (a dead centre). Keep or "
        f"prescribe another coordinate, or begin beside this posture. {_ELSEWHERE}"
    )


def lost_rank(times: np.ndarray, matrices: Float[np.ndarray, "instants m n"]) -> tuple[str, int] | None:
    """When matrices along a path first lose the rank of their rows, and at which instant: there or right after it."""
    finite: Any = np.isfinite(matrices).all(axis=(1, 2))
    matrices = np.where(finite[:, None, None], matrices, 0.0)
    if matrices.shape[1] > matrices.shape[2]:
        return "at the start", 0
    # By the largest row along the path: one that vanishes at an instant is lost there.
    size = np.abs(matrices).max(axis=(0, 2), initial=0.0)
    matrices = matrices / np.where(size > 0, size, 1.0)[:, None]
    values = np.linalg.svd(matrices, compute_uv=False)
    lost = ~finite | (values[:, -1] <= _SINGULAR_MASS * values.max(initial=0.0))
    turned = np.zeros(len(lost), dtype=bool)
    if matrices.shape[1] == matrices.shape[2]:
        signs = np.linalg.slogdet(matrices)[0]
        turned[:-1] = signs[:-1] * signs[1:] < 0
    if not (lost | turned).any():
        return None
    first = int(np.argmax(lost | turned))
    if lost[first]:
        return "at the start" if first == 0 else f"at t = {times[first]:.4g} s", first
    return f"between t = {times[first]:.4g} s and t = {times[first + 1]:.4g} s", first


def _dependence(model: AbstractMechanical, q: np.ndarray, jacobian: np.ndarray) -> str:
    """Constraints that depend on one another: wherever the system is, or in one posture alone."""
    rank, names = _rank(jacobian), _dependent(model, jacobian)
    depend = "binds nothing" if len(names) == 1 else "depend on one another"
    return (
        f"{type(model).__name__}: redundant constraints: expected {len(jacobian)} that are independent; their rank is "
        f"{rank}, for {_named(names)} {depend} at {posture_text(model, q)}. Leave out {len(jacobian) - rank} of these "
        "if they do so everywhere; a loop of hinges in one plane is closed by al.joints.Closure(..., planar=True). If "
        "it is this posture alone, in which the motion may go on in several ways, begin beside it, or choose lengths "
        f"that keep away from it. {_ELSEWHERE}"
    )


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
        largest = size.max(initial=0.0)
        matrix = matrix / np.where(size > 1e-12 * largest, size, np.where(size > 0, largest, 1.0))
    return matrix


def _brought_near(linearised: Linearised, q: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, ...]:
    """A posture that obeys the constraints as nearly as some coordinates bring it, what is left, slope and Jacobian.

    By least squares, so that dependent constraints are told from contradictory ones.
    """
    from scipy.optimize import least_squares

    def moved(at: np.ndarray) -> np.ndarray:
        posture = q.copy()
        posture[moving] = at
        return posture

    found = least_squares(
        lambda at: np.nan_to_num(linearised(moved(at))[0]),
        q[moving],
        lambda at: np.nan_to_num(linearised(moved(at))[1][:, moving]),  # type: ignore[arg-type]
        **dict.fromkeys(("ftol", "xtol", "gtol"), 1e-15),
    )
    return moved(found.x), *map(np.nan_to_num, linearised(moved(found.x)))


def _linearised(model: AbstractMechanical) -> Linearised:
    def bound(at: Array) -> Array:
        return constraint_of(model, model.normalised(at))

    @jax.jit
    def linearised(q: Array) -> tuple[Array, ...]:
        G, b = rate_terms(model, model.normalised(q))
        return bound(q), jax.jacfwd(bound)(q), G, jnp.zeros(len(G)) if b is None else b

    return lambda q: tuple(map(np.asarray, linearised(q)))


def posture_text(model: AbstractMechanical, q: Any) -> str:
    """Coordinates with their names."""
    return _listed(model.coordinates, q)


def _listed(names: tuple[str, ...], values: Any) -> str:
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in zip(names, np.asarray(values), strict=True))


def _named(names: Sequence[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)
