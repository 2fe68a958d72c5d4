"""`AbstractExtended`: a system with further states beside its own, such as those of a plan that it follows."""

from collections.abc import Mapping
from dataclasses import replace
from operator import attrgetter
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.leaves import transparent
from aleator.dynamics._evaluation import after_events, event_levels
from aleator.dynamics._record import Record
from aleator.dynamics._system import AbstractCombined, End, System, state_type
from aleator.trajectories import AbstractSignal


@transparent("own")
class AbstractExtended(AbstractCombined):
    """A system whose first states are those of its `own` system, whose numbers keep their names.

    `taken`: the inputs that it is given, by name. Algebraic variables of its own system are solved for inside.
    """

    own: eqx.AbstractVar[System]
    taken: eqx.AbstractVar[tuple[str, ...]]
    further: ClassVar[tuple[str, ...]] = ()

    # What is said of it is said of its own system.
    units = property(attrgetter("own.units"))  # type: ignore[assignment]
    rates_of = property(attrgetter("own.rates_of"))  # type: ignore[assignment]
    further_inputs = property(attrgetter("taken"))  # type: ignore[assignment]
    plain = property(attrgetter("own.plain"))  # type: ignore[override]
    title = property(attrgetter("own.title"))  # type: ignore[override]
    formulated = property(attrgetter("own.formulated"))  # type: ignore[override]
    declared_events = property(attrgetter("own.declared_events"))  # type: ignore[override]
    solves_start = property(attrgetter("own.solves_start"))  # type: ignore[override]

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """Those of its own system, then the further ones."""
        return (*self.own.states, *self.further)

    @property
    def planned_events(self) -> Mapping[str, str]:
        """The names that events of its plan have, by those of its own."""
        return self.own.planned_events if isinstance(self.own, AbstractExtended) else {}

    def with_plan(
        self, means: Any, inputs: Mapping[str, AbstractSignal], uncertain: tuple[str, ...]
    ) -> "AbstractExtended":
        """Itself, knowing the means of its plain system, in a tree like this, and the inputs at the means.

        `uncertain`: the inputs that differ from the realisation's.
        """
        if not isinstance(self.own, AbstractExtended):
            return self
        return replace(self, own=self.own.with_plan(means, inputs, uncertain))

    def at_end(self, record: Record, end: End) -> Record:
        """The record of a grid that an event ends; `end`: how."""
        del end
        return record

    def own_states(self, z: Any) -> Any:
        """The states of its own system, as this one names them."""
        return state_type(self.own.states)(*z[: len(self.own.states)])

    def seen_by_own(self, t: Any, z: Any, inputs: dict[str, Array]) -> dict[str, Array]:
        """The inputs of its own system: by default those that are given."""
        del t, z
        return inputs

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        return self.own.signals()

    @override
    def signals_from(
        self, signals: Mapping[str, AbstractSignal], begun: Float[Array, " states"]
    ) -> Mapping[str, AbstractSignal]:
        return self.own.signals_from(signals, begun)

    @override
    def event_levels(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, " events"]:
        return event_levels(self.own, t, self.own_states(z), self.seen_by_own(t, z, inputs))

    @override
    def after_events(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, "events states"]:
        after = after_events(self.own, t, self.own_states(z), self.seen_by_own(t, z, inputs))
        further = jnp.concatenate([jnp.zeros(0), *map(jnp.ravel, z[len(self.own.states) :])])
        return jnp.concatenate([after, jnp.broadcast_to(further, (len(after), further.size))], axis=1)

    @override
    def diagnose(self, grid: Any) -> str:
        return self.own.diagnose(grid)

    @override
    def destabilised(self, grid: Any) -> str:
        return self.own.destabilised(grid)
