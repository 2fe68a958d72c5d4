"""What a simulation is asked to record, and its record."""

from collections.abc import Callable, Collection, Mapping
from typing import Any, NamedTuple, TypeAlias

from jaxtyping import Array, Float

from aleator._core.errors import ProblemError
from aleator.dynamics._evaluation import derivative, derivative_and_observation, observation
from aleator.dynamics._system import System

History: TypeAlias = dict[str, Float[Array, "instants ..."]]
Integrand: TypeAlias = Callable[[Mapping[str, Array]], Float[Array, "..."]]
"""A function of the outputs at one time."""
Fold: TypeAlias = Callable[[Any, dict[str, Array]], tuple[Any, dict[str, Array]]]
"""From what is carried from instant to instant (None before the first) and the outputs there: what is carried on, and
what is recorded in the place of these outputs."""


class Asked(NamedTuple):
    """What a simulation is asked to record.

    - `instants`: the outputs to record at every instant, by name; None for all;
    - `nodes`: those of them to record at the midpoints of the steps too, for statistics that are integrated over time;
    - `integrands`: functions integrated over time along the realisation, as accurately as its states; `integrated`: the
      outputs that they depend on;
    - `fold`: what is made of the outputs at every instant instead of keeping them, where `Simulation.folds`.
    """

    instants: frozenset[str] | None = None
    nodes: frozenset[str] = frozenset()
    integrands: tuple[Integrand, ...] = ()
    integrated: frozenset[str] = frozenset()
    fold: Fold | None = None

    def folded(self, carried: Any, found: dict[str, Array]) -> tuple[Any, dict[str, Array]]:
        """What is carried on from an instant, and what is recorded of the outputs there: without a fold, all."""
        return ((), found) if self.fold is None else self.fold(carried, found)

    def at_instant(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> dict[str, Array]:
        """What is recorded at an instant of the grid."""
        return chosen(system, observation(system, t, z, now), self.instants)

    def at_node(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> dict[str, Array]:
        """What is recorded at the midpoint of a step, and at its ends."""
        return chosen(system, observation(system, t, z, now), self.nodes)

    def rates(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> tuple[Array, ...]:
        """The integrands at one time."""
        if not self.integrands:
            return ()
        outputs = observation(system, t, z, now)
        return tuple(one(outputs) for one in self.integrands)

    def slopes(self, system: System, t: Any, z: Any, now: dict[str, Array]) -> tuple[Any, tuple[Array, ...]]:
        """The rates of the states, and the integrands, at one time."""
        if not self.integrands:
            return derivative(system, t, z, now), ()
        slopes, outputs = derivative_and_observation(system, t, z, now)
        return slopes, tuple(one(outputs) for one in self.integrands)


class Record(NamedTuple):
    """What a simulation recorded.

    - `history`: outputs at every instant, shape (instants, ...); `nodes`: outputs at every instant and at the midpoint
      of every step, shape (2 steps + 1, ...);
    - `integrals`: in the order of the integrands; `folded`: what a fold carried to the last instant.
    """

    history: History
    nodes: History
    integrals: tuple[Float[Array, "..."], ...]
    folded: Any = ()

    def thinned(self, parts: int) -> "Record":
        """The record of a grid with so many times fewer steps."""
        every = slice(None, None, parts)
        history = {name: values[every] for name, values in self.history.items()}
        # Between two instants of the finer grid lies one more node, so that nodes are as many apart.
        return Record(history, {name: values[every] for name, values in self.nodes.items()}, self.integrals)


def chosen(system: Any, found: dict[str, Array], only: Collection[str] | None) -> dict[str, Array]:
    """The outputs that are asked for. Raises `ProblemError` for any that the system does not have."""
    if only is None:
        return found
    if not set(only) <= set(found):
        raise ProblemError(
            f"{system.title}: expected in `only` a list of some of the outputs {list(found)}; "
            f"received {sorted(only)!r}."
        )
    return {name: value for name, value in found.items() if name in only}
