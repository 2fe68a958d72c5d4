"""White noise: the covariance of the states, beside each realisation, by its differential equation; and, in phases,
feedback and white noise whose plans and covariances go on from one phase to the next.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.dynamics import (
    AbstractExtended,
    AbstractSurroundings,
    AbstractSystem,
    End,
    Inputs,
    LinkedSystems,
    Phases,
    Record,
    Simulation,
    System,
    Wires,
    after_events,
    derivative,
    derivative_and_observation,
    event_levels,
    initial_state,
    observation,
    placed,
)
from aleator.feedback._closed_loop import OPEN, PLANNED, ClosedLoop, Feedback, Means, closed_loop
from aleator.trajectories import AbstractSignal, WhiteNoise

# The arguments of an event without inputs: the system, the time, the states.
_PLAIN = 3

VARIANCE = ".variance"
"""After the name of an output: the part of its variance that white noise causes."""


@final
class Noisy(AbstractExtended):
    """A system with white noise among its inputs or in its sensors, and the covariance that this gives to its states.

    For small noise: `P' = A P + P A' + B W B'` with the derivatives `A` and `B` of the rates by states and noise along
    the realisation without noise, from `P = 0`; the variance of an output is `C P C'`.

    Where an event sets states anew, the deviations of these jump too, and by those of its time (saltation): see
    `_Crossing`. `inputs`: those that are white noise; `until`: the event that ends the grid.
    """

    own: System
    inputs: dict[str, WhiteNoise]
    taken: tuple[str, ...] = eqx.field(static=True)
    until: str | None = eqx.field(static=True)
    further: ClassVar[tuple[str, ...]] = ("covariance",)

    @property
    def _noise(self) -> dict[str, WhiteNoise]:
        return self.inputs | (self.own.white if isinstance(self.own, ClosedLoop) else {})

    @property
    def _moved(self) -> tuple[str, ...]:
        """The states that noise moves: not those of a plan."""
        return self.own.own.states if isinstance(self.own, ClosedLoop) else self.own.states

    @override
    def with_plan(
        self, means: Any, inputs: Mapping[str, AbstractSignal], uncertain: tuple[str, ...]
    ) -> AbstractExtended:
        return super().with_plan(means, {**inputs, **self.inputs}, uncertain)

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        return {**self.own.signals(), **self.inputs}

    @override
    def seen_by_own(self, t: Any, z: Any, inputs: dict[str, Any]) -> dict[str, Any]:
        del t, z
        return inputs | {f"{name}{PLANNED}": inputs[name] for name in self.inputs}

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        start = initial_state(self.own, t, inputs)._asdict()
        n = sum(jnp.size(start[name]) for name in self._moved)
        return {**start, "covariance": jnp.zeros((n, n))}

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[Any, dict[str, Any]]:
        own, fixed = self.own_states(z), self.seen_by_own(t, z, inputs)
        moved = {name: getattr(own, name) for name in self._moved}
        numbers, named = ravel_pytree((list(moved.values()), {name: inputs[name] for name in self._noise}))

        def function(numbers: Any) -> tuple[Any, Any]:
            states, noise = named(numbers)
            at = own._replace(**dict(zip(moved, states, strict=True)))
            return derivative_and_observation(self.own, t, at, fixed | noise)

        def along(direction: Any) -> tuple[Any, Any]:
            return jax.jvp(function, (numbers,), (direction,))

        (rates, outputs), (slopes, changes) = jax.vmap(along, out_axes=(None, 0))(jnp.eye(numbers.size))
        n, P = len(z.covariance), z.covariance
        slopes = jnp.concatenate([getattr(slopes, name).reshape(numbers.size, -1) for name in moved], axis=1)
        noise = [one.covariance for _, one in sorted(self._noise.items())]
        W = jnp.concatenate(noise) if noise else jnp.zeros(0)
        drift, effect = slopes[:n].T @ P + P @ slopes[:n], slopes[n:]
        variances = {
            f"{name}{VARIANCE}": jnp.einsum("i...,ij,j...->...", change[:n], P, change[:n])
            for name, change in changes.items()
        }
        return [*rates, drift + effect.T @ (W[:, None] * effect)], outputs | variances

    @override
    def after_events(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, "events states"]:
        own, fixed = self.own_states(z), self.seen_by_own(t, z, inputs)
        x, at, named = _deviating(own, n := len(z.covariance))

        def rates(z: Any) -> Array:
            return ravel_pytree(derivative(self.own, t, z, fixed))[0][:n]

        rows, slopes = [], rates(own)
        for i, (name, event) in enumerate(self.declared_events.items()):
            after, P = after_events(self.own, t, own, fixed)[i], z.covariance
            if event.jump is not None or name == self.until:
                level = lambda t, x, i=i: event_levels(self.own, t, at(x), fixed)[i]  # noqa: E731
                crossing = _crossing(level, slopes, t, x)
                S = crossing.carried(lambda t, x, i=i: after_events(self.own, t, at(x), fixed)[i][:n], t, x)
                if name != self.until:  # where the next grid begins with the event, the time of this is that of all
                    S -= jnp.outer(rates(named(after)), crossing.later)
                P = S @ P @ S.T
            rows.append(jnp.concatenate([after, jnp.ravel(P)]))
        return jnp.stack(rows)

    @override
    def continuing(self, link: Callable[..., dict[str, Any]], ended: "Noisy", end: End) -> dict[str, Any]:
        """Its states when a phase begins: noise acts by the states that the phase before ends with, and by when."""
        x, at, crossing = ended._ended(end)

        def begun(t: Any, x: Array) -> Array:
            states = link(ended.plain, t, ended.plain_states(at(x)))
            return ravel_pytree([states[name] for name in self.plain.states])[0]

        S = crossing.carried(begun, end.t, x)
        return self.own.continuing(link, ended.own, end) | {"covariance": S @ end.z.covariance @ S.T}

    @override
    def at_end(self, record: Record, end: End) -> Record:
        """At the event that ends a grid, outputs vary with its time too."""
        names = [name for name in record.history if name.endswith(VARIANCE)]
        if self.until is None or not names:
            return record
        x, at, crossing = self._ended(end)
        system = end.system.focused([name.removesuffix(VARIANCE) for name in names])

        def outputs(t: Any, x: Array) -> dict[str, Array]:
            every = observation(system, t, at(x), end.inputs(t))
            return {name: every[name.removesuffix(VARIANCE)] for name in names}

        changes = crossing.carried(outputs, end.t, x)
        P = end.z.covariance
        last = {name: jnp.einsum("...i,ij,...j->...", one, P, one) for name, one in changes.items()}
        history = {name: rows.at[-1].set(last[name]) for name, rows in record.history.items() if name in last}
        return record._replace(history=record.history | history)

    def _ended(self, end: End) -> "tuple[Array, Callable[[Array], Any], _Crossing]":
        """The states that noise moves, all states by these, and the crossing of the event at the end of a grid."""
        x, at, _ = _deviating(end.z, n := len(end.z.covariance))
        if self.until is None:
            return x, at, _Crossing(jnp.zeros(n), jnp.eye(n))
        where = list(self.declared_events).index(self.until)

        def level(t: Any, x: Array) -> Array:
            return event_levels(end.system, t, at(x), end.inputs(t))[where]

        slopes = ravel_pytree(derivative(end.system, end.t, end.z, end.inputs(end.t)))[0][:n]
        return x, at, _crossing(level, slopes, end.t, x)

    def with_noise_itself(self, t: Any, z: Any, inputs: dict[str, Any]) -> set[str]:
        """The outputs that change with the noise at an instant, by its equations: their variance is infinite."""

        def outputs(noise: dict[str, Any]) -> dict[str, Any]:
            fixed = self.seen_by_own(t, z, inputs)
            return derivative_and_observation(self.own, t, self.own_states(z), fixed | noise)[1]

        noise = {name: inputs[name] for name in self._noise}
        closed, shapes = jax.make_jaxpr(outputs, return_shape=True)(noise)
        names = sorted(shapes)
        used = (dce_jaxpr(closed.jaxpr, [one == name for one in names])[1] for name in names)
        return {name for name, inputs in zip(names, used, strict=True) if any(inputs)}


def _deviating(z: Any, n: int) -> tuple[Array, Callable[[Array], Any], Callable[[Array], Any]]:
    """The first numbers of states, these by such numbers, and by all of them."""
    every, named = ravel_pytree(z)
    return every[:n], lambda x: named(every.at[:n].set(x)), named


class _Crossing(NamedTuple):
    """How much later an event is with a deviation of each of the states, and the states there with it.

    - `later`: the derivatives of its time; `states`: those of the states at that time, a column for each deviation.
    """

    later: Float[Array, " n"]
    states: Float[Array, "n n"]

    def carried(self, function: Callable[[Any, Array], Any], t: Any, x: Float[Array, " n"]) -> Any:
        """The derivatives of a function of time and states at the event by the deviations before it, as last axis."""
        at = jnp.asarray(t, dtype=float), x
        along = jax.vmap(lambda *change: jax.jvp(function, at, change)[1], (0, 1), -1)
        return along(self.later, self.states)


def _crossing(
    level: Callable[[Any, Array], Array], rates: Float[Array, " n"], t: Any, x: Float[Array, " n"]
) -> _Crossing:
    """That of zero by a `level` of time and states, at which these are `x` and have `rates`."""
    by_time, by_states = jax.jacfwd(level, (0, 1))(jnp.asarray(t, dtype=float), x)
    later = -by_states / (by_time + by_states @ rates)
    return _Crossing(later, jnp.eye(x.size) + jnp.outer(rates, later))


def noisy(
    system: AbstractSystem | Phases, inputs: Mapping[str, Any] | None, grid: Any
) -> tuple[AbstractSystem | Phases, Mapping[str, Any] | None]:
    """A system with the covariance of its states if there is white noise, and its inputs without this."""
    if isinstance(system, Noisy | Phases | LinkedSystems):
        return system, inputs
    if not is_noisy(system, inputs or {}):
        return system, inputs
    if not (isinstance(system, System) and system.states):
        raise ProblemError(f"WhiteNoise: expected a system with states; received {type(system).__name__}.")
    white, others = parted(inputs or {})
    refuse_driven_events(system, grid)
    return Noisy(own=system, inputs=white, taken=tuple(others), until=getattr(grid, "until", None)), others


def parted(inputs: Mapping[str, Any]) -> tuple[dict[str, WhiteNoise], dict[str, Any]]:
    """The inputs that are white noise, and the others."""
    white = {name: one for name, one in inputs.items() if _is_white(one)}
    return white, {name: one for name, one in inputs.items() if name not in white}


def is_noisy(system: Any, inputs: Mapping[str, Any]) -> bool:
    """Whether there is white noise. Raises `ProblemError` where it is a part of something else."""
    noise = list(system.feedback.noise.values()) if isinstance(system, ClosedLoop) else []
    others = (one for one in [*inputs.values(), *noise, getattr(system, "plain", system)] if not _is_white(one))
    if any(map(_is_white, jax.tree.leaves(list(others), is_leaf=_is_white))):
        raise ProblemError(
            "WhiteNoise: expected it as an input of a problem or a phase, or as the noise of a sensor, by itself: "
            "inputs={'w': al.processes.WhiteNoise(...)}; received it as a part of another signal or a system."
        )
    return any(map(_is_white, [*inputs.values(), *noise]))


def refuse_driven_events(system: System, grid: Any) -> None:
    """Raise `ProblemError` for events that noise moves along an input, whose rate is not known there."""
    until, repeats = getattr(grid, "until", None), getattr(grid, "periodic", False)
    for name, event in system.plain.declared_events.items():
        functions = [one for one in (event.function, event.jump) if one is not None]
        is_crossed = repeats if name == until else event.jump is not None
        if is_crossed and any(len(inspect.signature(one).parameters) > _PLAIN for one in functions):
            raise ProblemError(
                f"WhiteNoise: '{name}' of {system.title} depends on inputs, by whose rates its time would vary: "
                "expected functions of time and states, lambda self, t, z: ..., or noise with germ variables, "
                "al.processes.RandomProcess."
            )


def _is_white(node: Any) -> bool:
    return isinstance(node, WhiteNoise)


class _Phase(NamedTuple):
    """What is put around the system of a phase.

    - `until`: the event that ends it; `feedback`: by the first phase that has it, None if no phase has any; `of`, `to`:
      what it measures and commands.
    """

    name: str
    until: str | None
    feedback: str | None = None
    of: tuple[str, ...] = ()
    to: tuple[str, ...] = ()


@final
class Surroundings(AbstractSurroundings):
    """The feedback and the white noise of phases.

    - `feedback`: by the first phase of each: if any has feedback, the plan goes on in all of them; `inputs`: those that
      are white noise; `phases`: what is put around each; `is_noisy`: whether all of them carry a covariance; `plan`:
      what loops know of the means, None until they are realised.
    """

    feedback: dict[str, Feedback]
    inputs: dict[str, WhiteNoise]
    phases: tuple[_Phase, ...] = eqx.field(static=True)
    is_noisy: bool = eqx.field(static=True)
    plan: Means | None = None

    @override
    def with_plan(self, means: Any, inputs: Inputs, uncertain: tuple[str, ...]) -> "Surroundings":
        return replace(self, plan=Means(means, inputs, uncertain))

    @override
    def around(self, system: System, wires: Wires) -> System:
        phase, plan = next(one for one in self.phases if one.name == wires.phase), self.plan
        if phase.feedback is not None:
            feedback, taken = self.feedback[phase.feedback], tuple(key for key, _ in wires.inputs)
            system = ClosedLoop(own=system, feedback=feedback, taken=taken, of=phase.of, to=phase.to)
        if self.is_noisy:
            white = {key: self.inputs[wire] for key, wire in wires.inputs if wire in self.inputs}
            taken = tuple(key for key, _ in wires.inputs if key not in white)
            system = Noisy(own=system, inputs=white, taken=taken, until=phase.until)
        if plan is None or not isinstance(system, AbstractExtended):
            return system
        inputs = {key: plan.inputs[wire] for key, wire in wires.inputs if wire in plan.inputs}
        uncertain = tuple(key for key, wire in wires.inputs if wire in plan.uncertain)
        return system.with_plan(plan.system[wires.system], inputs, uncertain)


def surrounded(simulation: Simulation, phases: Phases) -> Simulation:
    """The simulation of phases with the feedback and the white noise of each. Raises `ProblemError` as these do."""
    feedback, parts, are_noisy = dict[str, Feedback](), list[_Phase](), list[bool]()
    has_plan = any(phase.feedback is not None for phase in phases.phases.values())
    for name, phase in phases.phases.items():
        system, part = phase.system, _Phase(name, phase.grid.until)
        if has_plan:
            own = OPEN if phase.feedback is None else phase.feedback
            system = loop = closed_loop(phase.system, phase.inputs, own, phase.grid)
            part = part._replace(feedback=placed(feedback, name, own), of=loop.of, to=loop.to)
        parts.append(part)
        are_noisy.append(is_noisy(system, phase.inputs))
    if not (has_plan or any(are_noisy)):
        return simulation
    for phase in phases.phases.values() if any(are_noisy) else ():
        refuse_driven_events(phase.system, phase.grid)
    white, others = parted(simulation.inputs)
    around = Surroundings(feedback, white, tuple(parts), any(are_noisy))
    assert isinstance(simulation.system, LinkedSystems)
    return replace(simulation, system=replace(simulation.system, surroundings=around), inputs=others)
