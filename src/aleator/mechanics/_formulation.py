"""The base class of forward, inverse and hybrid dynamics: systems made from a mechanical model, and their outputs.

All that diagnosis asks of a model is one program; prescribed motions of bodies on simple joints need none.
"""

import abc
import contextlib
from collections import Counter
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.arrays import in_library, numbers_to_arrays
from aleator._core.border import one_of
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import ProblemError
from aleator._core.identity import own_code
from aleator._core.leaves import is_traced, transparent
from aleator.dynamics import Grid, RungeKutta4, System, simulate
from aleator.mechanics._constraints import Bound, Loose, Solved, all_loose
from aleator.mechanics._diagnosis import (
    Examination,
    Posture,
    constraint_diagnosis_along,
    effect_diagnosis,
    first_diagnosis,
    posture_diagnosis,
    quaternion_diagnosis,
    rows_of,
    start_diagnosis,
    unobeyed,
)
from aleator.mechanics._instant import at, instants_of, is_timed
from aleator.mechanics._mechanical import (
    AbstractMechanical,
    Motion,
    accelerations,
    constraint_of,
    jacobian_of,
    mass_of,
    rate_map,
    rates,
)

# Coordinates this many times as large as at the start are no longer a meaningful posture.
_ABSURD = 1e4


@transparent("model")
class AbstractFormulation(System):
    """A system that solves the equations of motion of a mechanical model for the unknown motions and torques.

    The model's numbers keep their own names, without the prefix `model`.
    """

    model: eqx.AbstractVar[AbstractMechanical]

    further_inputs: ClassVar[tuple[str, ...] | None] = ()

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the model declares, and the standard units of its kind."""
        return {**self.model.standard_units, **self.model.units}

    @property
    def rates_of(self) -> Mapping[str, str]:  # type: ignore[override]
        """Outputs that are rates of others, by name."""
        model, rates = self.model, dict[str, str]()
        for name in model.coordinates:
            rates |= {f"{name}_rate": name, f"{name}_acceleration": f"{name}_rate"}
        return rates | {f"{name}_rate": name for name in (*model.speeds, *model.actuators)}

    @property
    @override
    def formulated(self) -> AbstractMechanical:
        return self.model

    @override
    def outputs(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        return self.rates_and_outputs(*args, **kwargs)[1]

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """As `started`. Constraints are solved by one program: operation by operation takes several times as long."""
        if self.model.constraints and not is_traced((self, t, inputs)):
            # No program can be traced of some code, such as of what branches on a number.
            with contextlib.suppress(Exception):
                return _STARTED(*numbers_to_arrays((self, t, dict(inputs))), own_code(self))
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
        return self._diagnosis(np.asarray(grid.times), examined(self, grid))

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
        postures = rows_of(seen.postures, slice(good))
        # What is prescribed is known where the rest ends, and shows whether torques still act there.
        effects = rows_of(seen.postures.effects, slice(good + 1 if ends else good))
        return (
            posture_diagnosis(model, rows_of(postures, 0), "at the start")
            or self.diagnose_start(rows_of(effects, 0), seen.own)
            or quaternion_diagnosis(model, times, seen)
            or constraint_diagnosis_along(model, self.loose, times, q, postures.jacobian)
            or first_diagnosis(model, times, postures)
            or effect_diagnosis(model, times, seen.postures.q, effects)
            or (unobeyed(model, times[good - 1], q[good - 1]) if model.constraints and ends else "")
        )

    @property
    def changes(self) -> bool:
        """Whether what is checked may change along the motion."""
        model = self.model
        return bool(self.states) or is_timed(model) or not (model.moves_directly and model.acts_directly)


def a_model(who: str, model: Any) -> AbstractMechanical:
    """The model, unchanged. Raises `ProblemError` for anything but a mechanical system."""
    return one_of(f"{who}: model", model, AbstractMechanical, "al.Lagrangian or al.Multibody")


def examined(system: AbstractFormulation, grid: Grid) -> Examination:
    """What diagnosis asks of a realised system, as arrays of NumPy."""
    system, grid = _known((system, grid))
    if system.model.computes_by_numpy and not system.changes:
        return _known(_examined(system, grid, ""))
    return _known(_EXAMINED(*numbers_to_arrays((system, grid)), own_code(system)))


def _examined(system: AbstractFormulation, grid: Grid, code: str) -> Examination:
    del code  # tells programs apart
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
    history = simulate(system, grid, {}, RungeKutta4(), only=[name for names in parts for name in names])
    return tuple(jnp.stack([history[name] for name in names], axis=1) for names in parts)


def _started(system: AbstractFormulation, t: Any, inputs: Mapping[str, Any], code: str) -> Mapping[str, Any]:
    del code  # tells programs apart
    return system.started(t, inputs)


# Compiled once for all systems of a family, each of which is checked.
_EXAMINED, _STARTED = Compiled(_examined, use=Use.BRIEF), Compiled(_started, use=Use.BRIEF)


def _known(tree: Any) -> Any:
    """A tree with NumPy's arrays in the place of JAX's."""
    return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, tree)


def standard_outputs(
    model: AbstractMechanical, motion: Motion, torque_rate: Array | None = None, bound: Bound | None = None
) -> dict[str, Any]:
    """Coordinates, rates, accelerations, torques and their rates by name, and the model's own outputs.

    `bound`: the constraints at this posture, if the model has any.

    Raises `ProblemError` where two of them have the same name, or one of the model's own has a name already taken.
    """
    listed: list[tuple[str, Any]] = []
    for i, name in enumerate(model.coordinates):
        along = (motion.q[i], motion.q_dot[i], motion.q_ddot[i])
        listed += zip((name, f"{name}_rate", f"{name}_acceleration"), along, strict=True)
    coordinate_rates = {f"{name}_rate" for name in model.coordinates}
    for i, name in enumerate(model.speeds):
        if name not in coordinate_rates:
            listed += [(name, motion.v[i]), (f"{name}_rate", motion.v_dot[i])]
    for i, name in enumerate(model.actuators):
        listed.append((name, motion.torque[i]))
        if torque_rate is not None:
            listed.append((f"{name}_rate", torque_rate[i]))
    if bound is not None and model.constraints:
        listed += _of_constraints(model, motion, bound)
    standard = dict(listed)
    if len(standard) < len(listed):
        twice = sorted(name for name, count in Counter(name for name, _ in listed).items() if count > 1)
        raise ProblemError(
            f"{type(model).__name__}: {twice} name two outputs each; rename its coordinates, velocities or actuators."
        )
    own = model.seen_at(motion.q).outputs(motion)
    if not isinstance(own, Mapping):
        raise ProblemError(
            f"{type(model).__name__}.outputs returns a dict of arrays by name; received {type(own).__name__}."
        )
    if taken := sorted(set(standard) & set(own)):
        raise ProblemError(
            f"{type(model).__name__}.outputs: {taken} are standard outputs of every mechanical system; rename yours."
        )
    return {**standard, **own}


def outputs_of(
    model: AbstractMechanical, t: Any, solved: Solved, torque_rate: Any, integrated: Array
) -> dict[str, Any]:
    """The outputs of a motion; with constraints not a number where these were not obeyed, and how far it had drifted.

    `integrated` are the coordinates before they were put back.
    """
    q, v, v_dot, torque, multipliers, obeyed, bound = solved
    motion = Motion(t, q, rates(model, q, v), accelerations(model, q, v, v_dot), v, v_dot, torque, multipliers)
    outputs = standard_outputs(model, motion, torque_rate, bound)
    if not model.constraints:
        return outputs
    drift = {"constraint_drift": jnp.abs(constraint_of(model, model.normalised(integrated))).max()}
    return {name: jnp.where(obeyed, value, jnp.nan) for name, value in {**drift, **outputs}.items()}


def _of_constraints(model: AbstractMechanical, motion: Motion, bound: Bound) -> list[tuple[str, Any]]:
    listed: list[tuple[str, Any]] = [
        ("constraint_error", jnp.abs(constraint_of(model, motion.q)).max()),
        ("constraint_rate_error", jnp.abs(bound.rate(motion.v)).max()),
    ]
    listed += [(f"{name}_multiplier", value) for name, value in zip(model.constraints, motion.multipliers, strict=True)]
    forces = bound.reactions(motion.multipliers)
    return listed + [
        (f"{name.removesuffix('_rate')}_reaction", force) for name, force in zip(model.speeds, forces, strict=True)
    ]
