"""The base class of forward, inverse and hybrid dynamics: systems made from a mechanical model, and their diagnosis.

Diagnosis names singular matrices and rules that a model breaks, with posture and time. All that it asks of a model is
one program; prescribed motions of bodies on simple joints need none.
"""

import abc
import contextlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.arrays import in_library, numbers_to_arrays
from aleator._core.border import one_of
from aleator._core.compilation import Compiled, Use
from aleator._core.leaves import is_traced, transparent
from aleator.dynamics import Grid, RungeKutta4, System, simulate
from aleator.mechanics._consistent import constraint_diagnosis_along, lost_rank, posture_text, start_diagnosis
from aleator.mechanics._constraints import Loose, all_loose
from aleator.mechanics._instant import at, instants_of, is_timed
from aleator.mechanics._mechanical import AbstractMechanical, jacobian_of, mass_of, rate_map

# Reciprocal condition numbers below this count as zero: results would have no correct digit left.
_SINGULAR = 1e-12

# A quaternion shorter than this has no meaningful direction.
_VANISHING = 1e-3

# Coordinates this many times as large as at the start are no longer a meaningful posture.
_ABSURD = 1e4


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
    - `given`, `valid`: the prescribed coordinates, and the same made valid, if these may differ.
    """

    row: Any
    near: Any
    own: Any
    motion: Any
    postures: Posture
    given: Any
    valid: Any


@transparent("model")
class AbstractFormulation(System):
    """A system that solves the equations of motion of a mechanical model for the unknown motions and torques.

    The model's numbers keep their own names, without the prefix `model`.
    """

    model: eqx.AbstractVar[AbstractMechanical]

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """As `started`. Constraints are solved by one program: operation by operation takes several times as long."""
        if self.model.constraints and not is_traced((self, t, inputs)):
            # No program can be traced of some code, such as of what branches on a number.
            with contextlib.suppress(Exception):
                return _STARTED(*numbers_to_arrays((self, t, dict(inputs))))
        return self.started(t, inputs)

    def started(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """The states at the start, with the inputs there, as constraints allow; none by default."""
        del t, inputs
        return {}

    @abc.abstractmethod
    def beginning(self, model: AbstractMechanical, grid: Grid) -> tuple[Any, Any]:
        """Coordinates at the start as they are given, and what `diagnose_start` needs, of the model there."""

    @property
    def loose(self) -> Loose:
        """What follows the constraints along the motion; by default everything."""
        return all_loose(self.model)

    @property
    def loose_at_start(self) -> Loose:
        """What follows the constraints at the start, where values may be named; by default the same."""
        return self.loose

    def effects(self, model: AbstractMechanical, q: Array) -> Any:
        """How the torques to be found act in a valid posture; `None` where none are, or each acts for itself."""
        del model, q
        return None

    def prescribed_path(self, grid: Grid) -> Any:
        """The coordinates at each instant, those that are not prescribed as at the start; `None` if none are."""
        del grid
        return None

    def diagnose_start(self, effects: Any, own: Any) -> str:
        """What else is wrong at the start, beside constraints and matrices; empty if nothing."""
        del effects, own
        return ""

    def posture(self, model: AbstractMechanical, q: Array) -> Posture:
        """What diagnosis asks of the model at one instant. Traceable."""
        q = model.normalised(q)
        return Posture(
            q,
            mass_of(model, q),
            None if model.moves_directly else rate_map(model, q),
            jacobian_of(model, q)[:, np.array(self.loose.speeds)] if model.constraints else None,
            self.effects(model, q),
            model.stated_twice(q),
        )

    @override
    def diagnose(self, grid: Grid) -> str:
        times = np.asarray(grid.times)
        found = self._diagnosis(times, examined(self, grid))
        # A program of code that has changed since may let a fault pass, but must not refuse what is right.
        return found and self._diagnosis(times, examined(self, grid, eqx.filter_jit(lambda *given: _examined(*given))))

    def _diagnosis(self, times: np.ndarray, seen: Examination) -> str:
        """What is wrong at the start, in the first bad posture, or where the motion ends; empty if nothing.

        A motion that grows without bound does not show a fault of the model: steps too long for a stiff model have the
        same effect.
        """
        model, (q, v) = self.model, seen.motion
        first = at(_known(model), *seen.row)
        first.refuse_impossible()
        if model.constraints and not (np.isfinite(q[0]).all() and np.isfinite(v[0]).all()):
            return start_diagnosis(first, seen.near, self.loose_at_start)
        moderate = np.isfinite(q).all(axis=1) & (np.abs(q) <= _ABSURD * (1 + np.abs(q[0]).max())).all(axis=1)
        good = len(q) if moderate.all() or not self.states else max(int(np.argmin(moderate)), 1)
        ends = good < len(q) and not np.isfinite(q[good]).all()
        postures = _rows(seen.postures, slice(good))
        # What is prescribed is known where the rest ends, and shows whether torques still act there.
        effects = _rows(seen.postures.effects, slice(good + 1 if ends else good))
        return (
            _posture_diagnosis(model, _rows(postures, 0), "at the start")
            or self.diagnose_start(_rows(effects, 0), seen.own)
            or _quaternion_diagnosis(model, times, seen)
            or constraint_diagnosis_along(model, self.loose, times, q, postures.jacobian)
            or _first_diagnosis(model, times, postures)
            or _effect_diagnosis(model, times, seen.postures.q, effects)
            or (_unobeyed(model, times[good - 1], q[good - 1]) if model.constraints and ends else "")
        )

    @property
    def changes(self) -> bool:
        """Whether what is checked may change along the motion."""
        model = self.model
        return bool(self.states) or is_timed(model) or not (model.moves_directly and model.acts_directly)


def model_given(who: str, model: Any) -> AbstractMechanical:
    """The model, unchanged. Raises `ProblemError` for anything but a mechanical system."""
    return one_of(f"{who}: model", model, AbstractMechanical, "al.Lagrangian or al.Multibody")


def examined(system: AbstractFormulation, grid: Grid, program: Callable[..., Any] | None = None) -> Examination:
    """What diagnosis asks of a realised system, as arrays of NumPy; by another program than the common one if given."""
    system, grid = _known((system, grid))
    if system.model.computes_by_numpy and not system.changes:
        return _known(_examined(system, grid))
    return _known((program or _EXAMINED)(*numbers_to_arrays((system, grid))))


def _examined(system: AbstractFormulation, grid: Grid) -> Examination:
    model, now = system.model, instants_of(system.model, grid)
    row = now.row(0)
    near, own = system.beginning(at(model, *row), grid)
    if not system.changes:
        _, near, postures = in_library(near, system.posture(model, near))
        motion, postures = jax.tree.map(lambda one: one[None], ((near, near), postures))
        return Examination(row, near, own, motion, postures, None, None)
    given = system.prescribed_path(grid)
    valid = None if model.moves_directly or given is None else jax.vmap(model.normalised)(given)
    q, v = _integrated(system, grid) if system.states else (cast(Any, given), given)
    finite = jnp.isfinite(q)
    last = jax.lax.cummax(jnp.where(finite.all(axis=1), jnp.arange(len(q)), 0))
    postures = now.each(system.posture, jnp.where(finite, q, q[last]))
    return Examination(row, near, own, (q, v), postures, given, valid)


def _integrated(system: AbstractFormulation, grid: Grid) -> Any:
    """Coordinates and velocities at each instant."""
    parts = system.model.coordinates, system.model.speeds
    found = simulate(system, grid, {}, RungeKutta4(), only=[name for names in parts for name in names])
    return tuple(jnp.stack([found[name] for name in names], axis=1) for names in parts)


def _started(system: AbstractFormulation, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
    return system.started(t, inputs)


# Compiled once for all systems of a family, each of which is checked.
_EXAMINED, _STARTED = Compiled(_examined, use=Use.ONCE), Compiled(_started, use=Use.ONCE)


def _known(tree: Any) -> Any:
    """A tree with NumPy's arrays in the place of JAX's."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, tree)


def _rows(tree: Any, which: Any) -> Any:
    """The rows of some instants, or the row of one."""
    return jax.tree.map(lambda rows: rows[which], tree)


def _posture_diagnosis(model: AbstractMechanical, posture: Posture, when: str) -> str:
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
    if values.size and values[0] <= _SINGULAR * max(values[-1], 0.0):
        worst = model.speeds[int(np.argmax(np.abs(vectors[:, 0])))]
        kind = "singular" if abs(values[0]) <= _SINGULAR * max(values[-1], 0.0) else "not positive definite"
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


def _quaternion_diagnosis(model: AbstractMechanical, times: np.ndarray, seen: Examination) -> str:
    """Where prescribed coordinates pass near a zero quaternion, which has no direction."""
    if seen.valid is None:
        return ""
    vanished = np.abs(seen.valid) > np.abs(seen.given) / _VANISHING
    if not vanished.any():
        return ""
    instant, coordinate = np.argwhere(vanished)[0]
    return (
        f"{type(model).__name__}: the quaternion of '{model.coordinates[coordinate]}' is zero at t = "
        f"{times[instant]:.4g} s ({posture_text(model, seen.given[instant])}), and so has no direction. Prescribe "
        "quaternions that stay away from zero."
    )


def _first_diagnosis(model: AbstractMechanical, times: np.ndarray, postures: Posture) -> str:
    """What is wrong in the first posture whose mass matrix or velocity map is singular."""
    finite: Any = np.isfinite(postures.mass).all(axis=(1, 2))
    masses = np.where(finite[:, None, None], postures.mass, 0.0)
    bad = ~finite | (np.linalg.eigvalsh(masses).min(axis=1, initial=np.inf) <= 0)
    if postures.rates is not None:
        bad |= ~_are_regular(postures.rates)
    first = int(np.argmax(bad))
    return _posture_diagnosis(model, _rows(postures, first), f"at t = {times[first]:.4g} s") if bad.any() else ""


def _effect_diagnosis(model: AbstractMechanical, times: np.ndarray, q: np.ndarray, effects: np.ndarray | None) -> str:
    """Where torques lose their effect: at an instant, or between two where the determinant changes sign."""
    found = None if effects is None else lost_rank(times, effects)
    if found is None:
        return ""
    when, first = found
    return (
        f"The torques of {type(model).__name__} lose their effect {when} ({posture_text(model, q[first])}): the matrix "
        "by which they act on the motion they must realise is singular there. Start from a motion that avoids this "
        "posture, or add a torque."
    )


def _unobeyed(model: AbstractMechanical, time: float, q: np.ndarray) -> str:
    """Constraints that the motion cannot obey any further."""
    return (
        f"The constraints of {type(model).__name__} cannot be obeyed beyond about t = {time:.4g} s "
        f"({posture_text(model, q)}): a dead centre, lengths that do not reach, or accelerations that are not finite. "
        "Change lengths, start or motion so that it keeps away from there, check forces and energies, or take shorter "
        "steps."
    )
