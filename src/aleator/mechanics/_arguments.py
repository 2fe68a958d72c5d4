"""The arguments of dynamics: motions and torques, by name or as one trajectory, a start and a guess."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import in_library, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import realised_shape, stored_numbers
from aleator.mechanics._instant import Columns
from aleator.mechanics._mechanical import AbstractMechanical
from aleator.trajectories import AbstractSignal, AbstractTrajectory, PowerSeries, Stack

Signals = AbstractSignal | dict[str, AbstractSignal]
"""Signals as given: one for all names, or one for each name, after which its decisions are named."""


def signals_for(names: tuple[str, ...], given: Any, what: str) -> Signals:
    """Signals for all names, as given; names missing from a mapping get zero.

    Raises `ProblemError` for unknown names, for values that are not signals, and for a signal of another size.
    """
    if isinstance(given, AbstractTrajectory) and given.shape != (len(names),):
        raise ProblemError(
            f"{what}: expected a trajectory of shape ({len(names)},), for {list(names)}; received shape {given.shape}."
        )
    if isinstance(given, AbstractSignal):
        return given
    if not isinstance(given, Mapping):
        raise ProblemError(
            f"{what}: expected a trajectory, or trajectories by name, for {list(names)}; "
            f"received {type(given).__name__} {given!r}."
        )
    if unknown := sorted(set(given) - set(names)):
        raise ProblemError(f"{what}: there is no {unknown}; expected some of {list(names)}.")
    if not given:
        return PowerSeries(start=(np.zeros(len(names)),))
    return {name: _single(given.get(name, 0.0), f"{what} of '{name}'") for name in names}


def motions_for(names: tuple[str, ...], given: Any, what: str) -> Signals:
    """Trajectories for all names. Raises `ProblemError` for a missing one, or a signal without derivatives."""
    if isinstance(given, Mapping) and (missing := [name for name in names if name not in given]):
        raise ProblemError(f"{what}: expected a trajectory for each of {list(names)}; received none for {missing}.")
    signals = signals_for(names, given, what)
    motion = combined(names, signals)
    if not isinstance(motion, AbstractTrajectory) or motion.derivatives < 2:
        raise ProblemError(
            f"{what}: a prescribed motion needs velocity and acceleration: expected trajectories, such as al.BSpline "
            f"or al.PowerSeries; received {given!r}."
        )
    return signals


def combined(names: tuple[str, ...], given: Signals) -> AbstractSignal:
    """One signal of all names in order; it is a trajectory if each of them is one."""
    if not isinstance(given, Mapping):
        return given
    parts = tuple(given[name] for name in names)
    trajectories = tuple(part for part in parts if isinstance(part, AbstractTrajectory))
    return Stack(trajectories) if len(trajectories) == len(parts) else Columns(parts)


def _single(given: Any, where: str) -> AbstractSignal:
    if isinstance(given, AbstractTrajectory) and given.shape != ():
        raise ProblemError(f"{where}: expected a trajectory of one number; received shape {given.shape}.")
    if isinstance(given, AbstractSignal):
        return given
    if realised_shape(given) != ():
        raise ProblemError(f"{where}: expected a trajectory or one number; received {given!r}.")
    # A number, even an uncertain or decided one, is a constant signal.
    return PowerSeries(start=(given,))


def checked_start(model: AbstractMechanical, names: tuple[str, ...], start: Any, kind: str) -> dict[str, Any]:
    """A start by name, with arrays copied. Refuses names that are not integrated coordinates or velocities."""
    what = f"{kind} of {type(model).__name__}"
    if not isinstance(start, Mapping | None):
        raise ProblemError(f"{what}: expected a start by name, for some of {list(names)}; received {start!r}.")
    given = dict(start or {})
    if unknown := sorted(set(given) - set(names)):
        raise ProblemError(f"{what}: there is no {unknown} to start; expected some of {list(names)}.")
    for name, number in given.items():
        if realised_shape(number) != ():
            received = f"shape {realised_shape(number)}"
            rate = f" Give its velocity as '{name}_rate'." if f"{name}_rate" in names else ""
            raise ProblemError(f"{what}: expected one number as the start of '{name}'; received {received}.{rate}")
    return {name: stored_numbers(f"{what}: start of '{name}'", number) for name, number in given.items()}


def coordinates_at(model: AbstractMechanical, start: Mapping[str, Any]) -> Float[Array, " coordinates"]:
    """Initial coordinates, valid ones; those not given are zero, or those of the identity quaternion."""
    names = model.coordinates
    zeros: Any = np.zeros(len(names))
    unturned = model.normalised(zeros)
    return jax_array(model.normalised(_stacked([start.get(*given) for given in zip(names, unturned, strict=True)])))


def vector(names: tuple[str, ...], start: Mapping[str, Any]) -> Float[Array, " names"]:
    """Initial values in order; those not given are zero."""
    return jax_array(_stacked([start.get(name, 0.0) for name in names]))


def _stacked(values: list[Any]) -> Any:
    xp, values = in_library(values)
    return xp.stack([xp.asarray(value, dtype=float) for value in values]) if values else np.zeros(0)


def checked_guess(
    kind: str, model: AbstractMechanical, loose: Sequence[Collection[str]], start: Collection[str], guess: Any
) -> dict[str, Any]:
    """A guess by name, for coordinates; `loose` are the names of coordinates and velocities that are not prescribed.

    Raises `ProblemError` for a guess where no constraints need one, for more constraints than velocities are left to
    them (what these leave over, a prescribed motion may obey by itself, if it binds velocities alone), and for a start
    that keeps more than can be chosen, but not all.
    """
    what, every, bound = f"{kind} of {type(model).__name__}", len(model.constraints), len(model.holonomic)
    if not bound and guess is not None:
        raise ProblemError(f"{what}: expected no guess, for no constraint binds coordinates; received {guess!r}.")
    if not every:
        return {}
    twice = [name for name in model.constraints if model.constraints.count(name) > 1]
    if twice:
        raise ProblemError(f"{what}: expected a name of its own for each constraint; received '{twice[0]}' twice.")
    left, driven = len(loose[1]), len(model.speeds) - len(loose[1])
    if left < (bound if driven else every):
        prescribed = f", of which {driven} are prescribed," if driven else ""
        raise ProblemError(
            f"{what}: expected at most as many constraints as velocities that can follow them; received {every} "
            f"constraints ({', '.join(model.constraints)}) on {len(model.speeds)} velocities{prescribed} which leave "
            f"{left}. Leave out constraints that others imply, or prescribe less."
        )
    freedoms = left - bound, max(left - every, 0)
    named = ([name for name in whole if name in start] for whole in loose)
    for names, whole, most in zip(named, loose, freedoms, strict=True):
        count = len(model.speeds_along(names)) if whole is loose[0] else len(names)
        if count > most and len(names) < len(whole):
            raise ProblemError(
                f"{what}: expected a start of at most {most}, for the rest follows from its {every} constraints, or of "
                f"all of {list(whole)}; received {names}. Put those that are only near in guess."
            )
    return checked_start(model, model.coordinates, guess, f"{kind}, guess")
