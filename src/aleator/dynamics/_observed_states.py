"""A system that observes its own states, for those who need their course instead of its outputs."""

from collections.abc import Mapping
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from typing_extensions import override

from aleator.dynamics._evaluation import derivative
from aleator.dynamics._system import System
from aleator.trajectories import AbstractSignal

STATES = "states"


@final
class ObservedStates(System):
    """The same system, with one output `STATES`: its states side by side."""

    system: System
    states: tuple[str, ...] = eqx.field(static=True)  # type: ignore[misc]

    def __init__(self, system: System):
        self.system, self.states = system, system.states  # type: ignore[misc]

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> Any:
        return derivative(self.system, t, z, inputs)

    @override
    def outputs(self, t: Any, z: Any, **inputs: Any) -> dict[str, Any]:
        del t, inputs
        return {STATES: jnp.concatenate([jnp.ravel(one) for one in jax.tree.leaves(z)])}

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        return self.system.starting(t, inputs)

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        return self.system.signals()
