"""The base class of forward, inverse and hybrid dynamics: systems made from a mechanical model, and their diagnosis.

Diagnosis names singular matrices and rules that a model breaks, with posture and time. All that it asks of a model at
the start is one program, all along the motion another; trees of bodies on simple joints need none at the start.
"""

import abc
import contextlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.arrays import numbers_to_arrays
from aleator._core.compilation import Compiled, Use
from aleator._core.given import one_of
from aleator._core.leaves import is_traced, transparent
from aleator.dynamics import Grid, RungeKutta4, System, simulate
from aleator.mechanics._constraint_diagnosis import constraint_diagnosis_along, lost_rank, start_diagnosis
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
    """What diagnosis asks of a model in one posture, or at each instant of a path; `None` for what needs no check.

    - `q`: the coordinates, valid ones; `mass`: `M`; `rates`: `H`; `jacobian`: `G` of what follows the constraints;
    - `effects`: how the torques to be found act on the motions that they must realise: of full row rank;
    - `stated`: what the model states in two ways, see `AbstractMechanical.stated_twice`.
    """

    q: Any
    mass: Any
    rates: Any
    jacobian: Any
    effects: Any
    stated: Any


class Start(NamedTuple):
    """The first instant: coordinates `near` which those of `posture` are found, the velocities `v`, and what the
    formulation itself checks there.
    """

    near: Any
    v: Any
    posture: Posture
    own: Any


class Path(NamedTuple):
    """The postures along a motion of the coordinates `q`, and what is prescribed of these, as given and made valid."""

    q: Any
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
    def beginning(self, model: AbstractMechanical, grid: Grid) -> Start:
        """The start on a grid, with the model at its first instant. Traceable."""

    def loose(self, *, at_start: bool = False) -> Loose:
        """What follows the constraints; at the start less of it, if values are named there. By default everything."""
        del at_start
        return all_loose(self.model)

    def effects(self, model: AbstractMechanical, q: Array) -> Any:
        """How the torques to be found act in a valid posture; `None` where none are, or each acts for itself."""
        del model, q
        return None

    def prescribed_path(self, grid: Grid) -> Any:
        """The coordinates at each instant, those that are not prescribed as at the start; `None` if none are."""
        del grid
        return None

    def diagnose_start(self, start: Start) -> str:
        """What else is wrong at the start, beside constraints and matrices; empty if nothing."""
        del start
        return ""

    def posture(self, model: AbstractMechanical, q: Array, *, at_start: bool = False) -> Posture:
        """What diagnosis asks of the model at an instant. Traceable."""
        q = model.normalised(q)
        follows = bool(model.constraints) and not at_start
        return Posture(
            q,
            # Where it does not depend on time, integration shows whether it becomes singular.
            mass_of(model, q) if at_start or model._when is not None else None,
            None if model.moves_directly else rate_map(model, q),
            jacobian_of(model, q)[:, np.array(self.loose().speeds)] if follows else None,
            self.effects(model, q),
            model.stated_twice(q) if at_start else None,
        )

    @override
    def diagnose(self, grid: Grid) -> str:
        # A program of code that has changed since may let a fault pass, but must not refuse what is right.
        system, grid = _known((self, grid))
        return system._diagnosed(grid, _examined) and system._diagnosed(grid, _examined_anew)

    def _diagnosed(self, grid: Grid, examined: Callable[..., Any]) -> str:
        model, times = self.model, np.asarray(grid.times)
        row, start = examined(_start, self, grid)
        first = at(model, *row)
        first.refuse_impossible()
        if model.constraints and not (np.isfinite(start.posture.q).all() and np.isfinite(start.v).all()):
            return start_diagnosis(first, start.near, self.loose(at_start=True))
        found = _posture_diagnosis(model, start.posture, "at the start") or self.diagnose_start(start)
        if found or not (self.states or self._changes_along(start.posture)):
            return found
        return self._path_diagnosis(times, grid, examined(_path, self, grid))

    def _changes_along(self, posture: Posture) -> bool:
        """Whether matrices that are checked depend on time or posture."""
        return is_timed(self.model) or posture.rates is not None or posture.effects is not None

    def _path_diagnosis(self, times: np.ndarray, grid: Grid, path: Path) -> str:
        """What is wrong in the first bad posture, or in the last one that is finite; empty if nothing.

        A motion that grows without bound does not show a fault of the model: steps too long for a stiff model have the
        same effect.
        """
        model, q, postures = self.model, path.q, path.postures
        if found := _quaternion_diagnosis(model, times, path):
            return found
        moderate = np.isfinite(q).all(axis=1) & (np.abs(q) <= _ABSURD * (1 + np.abs(q[0]).max())).all(axis=1)
        if moderate.all() or not self.states:
            found = constraint_diagnosis_along(model, self.loose(), times, q, postures.jacobian)
            return found or _first_diagnosis(model, times, postures) or _effect_diagnosis(model, times, path)
        following = int(np.argmin(moderate))
        last = max(following - 1, 0)
        if model.constraints and np.isnan(q[following]).all():
            return _unobeyed(model, times[last], q[last], at_start=last == 0)
        if postures.effects is not None and not np.isfinite(q[following]).all():
            # It ends abruptly, not by growth: the prescribed motion there shows whether torques still act.
            now = instants_of(model, grid)
            onward = np.where(np.isfinite(q[following]), q[following], q[last])
            known = np.where(np.arange(len(q))[:, None] < following, q, onward)
            effects = jax.jit(lambda: now.each(self.effects, jnp.asarray(known)))()
            if found := _effect_diagnosis(model, times, Path(known, postures._replace(effects=effects), None, None)):
                return found
        posture = self.posture(instants_of(model, grid).at(last), jnp.asarray(q[last]), at_start=True)
        return _posture_diagnosis(model, posture, f"about t = {times[last]:.4g} s")


def model_given(who: str, model: Any) -> AbstractMechanical:
    """The model, unchanged. Raises `ProblemError` for anything but a mechanical system."""
    return one_of(f"{who}: model", model, AbstractMechanical, "al.Lagrangian or al.Multibody")


def examined_start(system: AbstractFormulation, grid: Grid) -> Start:
    """The start on a grid, in arrays of NumPy."""
    return _examined(_start, *_known((system, grid)))[1]


def _start(system: AbstractFormulation, grid: Grid) -> tuple[Any, Start]:
    row = instants_of(system.model, grid).row(0)
    return row, system.beginning(at(system.model, *row), grid)


def _path(system: AbstractFormulation, grid: Grid) -> Path:
    model, given = system.model, system.prescribed_path(grid)
    q = given
    if system.states:
        names = model.coordinates
        found = simulate(system, grid, {}, RungeKutta4(), only=names)
        q = jnp.stack([found[name] for name in names], axis=1)
    valid = None if model.moves_directly or given is None else jax.vmap(model.normalised)(given)
    return Path(q, instants_of(model, grid).each(system.posture, q), given, valid)


def _started(system: AbstractFormulation, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
    return system.started(t, inputs)


# Compiled once for all systems of a family, each of which is checked.
_PROGRAMS = {function: Compiled(function, use=Use.ONCE) for function in (_start, _path)}
_STARTED = Compiled(_started, use=Use.ONCE)


def _examined(function: Callable[..., Any], system: AbstractFormulation, grid: Grid) -> Any:
    """`function(system, grid)`, of known numbers and as such."""
    if function is _start and system.model.computes_by_numpy:
        found = function(system, grid)
    else:
        found = _PROGRAMS[function](*numbers_to_arrays((system, grid)))
    return _known(found)


def _examined_anew(function: Callable[..., Any], system: AbstractFormulation, grid: Grid) -> Any:
    return _known(eqx.filter_jit(lambda *given: function(*given))(*numbers_to_arrays((system, grid))))


def _known(tree: Any) -> Any:
    """A tree with NumPy's arrays in the place of JAX's."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, tree)


def _posture_diagnosis(model: AbstractMechanical, posture: Posture, when: str) -> str:
    """What is wrong in one posture: a mass matrix that is not positive definite, or a singular velocity map."""
    return (
        _contradiction(model, posture) or _mass_diagnosis(model, posture, when) or _map_diagnosis(model, posture, when)
    )


def _contradiction(model: AbstractMechanical, posture: Posture) -> str:
    if posture.stated is None:
        return ""
    first, second = map(np.asarray, posture.stated)
    slack = 1e-9 * np.abs(second).max(initial=0.0)
    return (
        ""
        if np.allclose(first, second, rtol=1e-6, atol=slack, equal_nan=True)
        else f"{type(model).__name__}.{model._rule}"
    )


def _mass_diagnosis(model: AbstractMechanical, at: Posture, when: str) -> str:
    if at.mass is None:
        return ""
    M, posture = np.asarray(at.mass), _listed(model, at.q)
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
    H = np.asarray(at.rates)
    if _are_regular(H):
        return _name_diagnosis(model, H, when)
    worst = model.coordinates[int(np.argmax(np.where(np.isfinite(H), np.abs(H), np.inf).max(axis=1)))]
    return (
        f"The velocity map H of {type(model).__name__} is singular {when} ({_listed(model, at.q)}): the rate of "
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


def _quaternion_diagnosis(model: AbstractMechanical, times: np.ndarray, path: Path) -> str:
    """Where prescribed coordinates pass near a zero quaternion, which has no direction."""
    if path.valid is None:
        return ""
    vanished = np.abs(path.valid) > np.abs(path.given) / _VANISHING
    if not vanished.any():
        return ""
    instant, coordinate = np.argwhere(vanished)[0]
    return (
        f"{type(model).__name__}: the quaternion of '{model.coordinates[coordinate]}' is zero at t = "
        f"{times[instant]:.4g} s ({_listed(model, path.given[instant])}), and so has no direction. Prescribe "
        "quaternions that stay away from zero."
    )


def _first_diagnosis(model: AbstractMechanical, times: np.ndarray, postures: Posture) -> str:
    """What is wrong in the first posture whose velocity map, or mass matrix that depends on time, is singular."""
    bad = np.zeros(len(times), dtype=bool)
    if postures.rates is not None:
        bad |= ~_are_regular(postures.rates)
    if postures.mass is not None:
        finite: Any = np.isfinite(postures.mass).all(axis=(1, 2))
        masses = np.where(finite[:, None, None], postures.mass, 0.0)
        bad |= ~finite | (np.linalg.eigvalsh(masses).min(axis=1, initial=np.inf) <= 0)
    if not bad.any():
        return ""
    first = int(np.argmax(bad))
    posture = Posture(*(None if one is None else one[first] for one in postures))
    return _posture_diagnosis(model, posture, f"at t = {times[first]:.4g} s")


def _effect_diagnosis(model: AbstractMechanical, times: np.ndarray, path: Path) -> str:
    """Where torques lose their effect: at an instant, or between two where the determinant changes sign."""
    effects = path.postures.effects
    found = None if effects is None else lost_rank(times, np.asarray(effects))
    if found is None:
        return ""
    when, first = found
    return (
        f"The torques of {type(model).__name__} lose their effect {when} ({_listed(model, path.q[first])}): the matrix "
        "by which they act on the motion they must realise is singular there. Start from a motion that avoids this "
        "posture, or add a torque."
    )


def _unobeyed(model: AbstractMechanical, time: float, q: np.ndarray, *, at_start: bool) -> str:
    """Constraints that the motion cannot obey any further."""
    if at_start:
        return (
            f"The constraints of {type(model).__name__} cannot be obeyed right after the start "
            f"({_listed(model, q)}): accelerations that are not finite there, a dead centre, or lengths "
            "that do not reach. Check forces and energies in this posture, or begin in another one: by start=, or "
            "by guess= for coordinates that follow from the constraints; or take shorter steps."
        )
    return (
        f"The constraints of {type(model).__name__} cannot be obeyed beyond about t = {time:.4g} s "
        f"({_listed(model, q)}): a dead centre, or lengths that do not reach. Change lengths or motion "
        "so that it keeps away from there, or take shorter steps if it moves far in one."
    )


def _listed(model: AbstractMechanical, q: Any) -> str:
    return ", ".join(f"{name} = {float(value):.4g}" for name, value in zip(model.coordinates, q, strict=True))
