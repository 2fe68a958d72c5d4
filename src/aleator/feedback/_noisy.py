"""White noise: the covariance of the states, beside each realisation, by its differential equation."""

from collections.abc import Mapping
from typing import Any, ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.interpreters.partial_eval import dce_jaxpr
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.dynamics import AbstractExtended, AbstractSystem, Phases, System, derivative_and_observation, initial_state
from aleator.feedback._closed_loop import PLANNED, ClosedLoop
from aleator.trajectories import AbstractSignal, WhiteNoise

VARIANCE = ".variance"
"""After the name of an output: the part of its variance that white noise causes."""


@final
class Noisy(AbstractExtended):
    """A system with white noise among its inputs or in its sensors, and the covariance that this gives to its states.

    For small noise: `P' = A P + P A' + B W B'` with the derivatives `A` and `B` of the rates by states and noise along
    the realisation without noise, from `P = 0`; the variance of an output is `C P C'`.

    `white`: the inputs that are white noise, as the problem names them: `inputs`.
    """

    own: System
    inputs: dict[str, WhiteNoise]
    taken: tuple[str, ...] = eqx.field(static=True)
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
        W = jnp.concatenate([one.covariance for _, one in sorted(self._noise.items())])
        drift, effect = slopes[:n].T @ P, slopes[n:]
        variances = {
            f"{name}{VARIANCE}": jnp.einsum("i...,ij,j...->...", change[:n], P, change[:n])
            for name, change in changes.items()
        }
        return [*rates, drift + drift.T + effect.T @ (W[:, None] * effect)], outputs | variances

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


def noisy(system: AbstractSystem | Phases, inputs: Mapping[str, Any]) -> tuple[AbstractSystem | Phases, dict[str, Any]]:
    """A system with the covariance of its states if there is white noise, and its inputs without this.

    Raises `ProblemError` for events that set states anew, which change the covariance too.
    """
    white = {name: one for name, one in inputs.items() if isinstance(one, WhiteNoise)}
    others = {name: one for name, one in inputs.items() if name not in white}
    sensors = system.feedback.noise if isinstance(system, ClosedLoop) else {}
    inside = [one for one in sensors.values() if not isinstance(one, WhiteNoise)]
    phases = [(one.system, one.inputs) for one in system.phases.values()] if isinstance(system, Phases) else []
    parts = others, inside, getattr(system, "own", system), phases
    if any(map(_is_white, jax.tree.leaves(parts, is_leaf=_is_white))):
        raise ProblemError(
            "WhiteNoise: expected it as an input of a problem or as the noise of a sensor, by itself: "
            "inputs={'w': al.processes.WhiteNoise(...)}; received it in another signal, a system or a phase."
        )
    if not white and not (isinstance(system, ClosedLoop) and system.white):
        return system, dict(inputs)
    if not (isinstance(system, System) and system.states):
        raise ProblemError(f"WhiteNoise: expected a system with states; received {type(system).__name__}.")
    jumps = [name for name, event in system.declared_events.items() if event.jump is not None]
    if jumps:
        raise ProblemError(
            f"WhiteNoise: '{jumps[0]}' of {system.title} sets states anew, and with them their covariance: expected "
            "events without a jump, or noise with germ variables, al.processes.RandomProcess."
        )
    return Noisy(own=system, inputs=white, taken=tuple(others)), others


def _is_white(node: Any) -> bool:
    return isinstance(node, WhiteNoise)
