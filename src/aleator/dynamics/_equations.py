"""The equations of a system, traced once where a problem is declared; every program of the problem is built from them.

A user's methods are called for this alone. Code that changes later cannot matter, and the digest of the equations tells
problems apart, in this process and in any other.
"""

import math
from collections.abc import Callable, Collection, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import NUMBER, Pytree, numbers_to_arrays, refuse_beyond_memory
from aleator._core.equations import Digest, TracedFunction, digest_of, joint_digest, may_lose_derivatives
from aleator._core.leaves import transparent
from aleator.dynamics._algebraic import AlgebraicSystem, equations, first_guess, outputs_at
from aleator.dynamics._evaluation import (
    after_events,
    algebraic_residuals,
    derivative_and_observation,
    event_levels,
    guessed_algebraic,
    initial_state,
    observation,
    with_algebraic,
)
from aleator.dynamics._event import Event
from aleator.dynamics._phases import LinkedSystems, linked_states, named
from aleator.dynamics._record import zeros
from aleator.dynamics._smooth import WIDTHS, Variation
from aleator.dynamics._system import AbstractSystem, End, System, state_type
from aleator.trajectories import AbstractSignal

FINER = 3
"""How many times as many steps simulations inside a model have where it is checked: an odd prime number."""


INSIDE: ContextVar[Variation | None] = ContextVar("inside", default=None)
"""Of simulations inside a model whose equations are being traced."""


@final
@dataclass(unsafe_hash=True)
class Equations:
    """The equations of a system: equal if their digests are.

    - `finer`: the same with more steps, and another integrator, of what is simulated inside the model; None if nothing
      is;
    - `narrower`: the same with half the widths of `al.smooth`; None if there are none;
    - `phases`: the equations of each phase, where there are phases; the functions are then those that begin them.

    A pickle has the digest alone: where it is read, the equations are traced again and compared when they are needed.
    """

    digest: Digest
    _functions: Mapping[str, TracedFunction] | None = field(compare=False, repr=False)
    finer: "Equations | None" = field(default=None, compare=False, repr=False)
    narrower: "Equations | None" = field(default=None, compare=False, repr=False)
    phases: "Mapping[str, Equations]" = field(default_factory=dict, compare=False, repr=False)

    @classmethod
    def of(cls, system: AbstractSystem, start: "Start | None", states: Any = None) -> "Equations":
        """Those of a realised system, which evolves in time from a start, or has no time.

        - `states`: the shapes of those with which a later phase begins; None where the system tells them.
        """
        equations, inside, widths = cls._of(system, start, states)
        finer = cls._of(system, start, states, factor=FINER)[0] if inside.is_met else None
        narrower = cls._of(system, start, states, width=0.5)[0] if widths.is_met else None
        return replace(equations, finer=finer, narrower=narrower)

    @classmethod
    def _of(
        cls, system: AbstractSystem, start: "Start | None", states: Any, *, factor: int = 1, width: float = 1.0
    ) -> tuple["Equations", Variation, Variation]:
        inside, widths = Variation(factor), Variation(width)
        before = INSIDE.set(inside), WIDTHS.set(widths)
        try:
            return cls._traced(system, start, states), inside, widths
        finally:
            INSIDE.reset(before[0])
            WIDTHS.reset(before[1])

    @classmethod
    def _traced(cls, system: AbstractSystem, start: "Start | None", states: Any) -> "Equations":
        if isinstance(system, AlgebraicSystem):
            functions, names = _algebraic(system), [system.unknowns]
        else:
            assert isinstance(system, System)
            assert start is not None
            functions, names = _dynamical(system, start, states), [system.states, system.algebraic, tuple(start.inputs)]
            names += [(name, event.direction) for name, event in system.declared_events.items()]
        # Equations speak of numbers by their order alone.
        parts = {name: digest_of(one.closed) for name, one in functions.items()}
        return cls(
            joint_digest(parts | {f"of {[*names, functions['instant'].rest.names]}": Digest("", True)}), functions
        )

    @classmethod
    def linked(cls, system: LinkedSystems, starts: "Mapping[str, Start]") -> "Equations":
        """Those of realised phases, with the first instant of each."""
        phases, functions, links = dict[str, Equations](), dict[str, TracedFunction](), dict(system.links)
        for name, one in system.phases.items():
            states = None
            if phases:
                before, last = next(reversed(phases.items()))
                ended, start, z = system.phases[before], starts[before], zeros(_shapes(last["initial"]))

                def begun(
                    ended: System, t: Any, z: Any, name: str = name, one: System = one.plain, before: str = before
                ) -> dict[str, Array]:
                    return linked_states(name, one, before, links.get(name), ended, t, z)

                functions[name] = TracedFunction(begun, ended.plain, start.t, ended.plain_states(z))
                end = End(TracedSystem(ended, last), start.t, z, lambda _, start=start: start.inputs)
                states = state_type(one.states)(**eqx.filter_eval_shape(one.continuing, functions[name], ended, end))
            phases[name] = cls.of(one, starts[name], states)
        others = {
            kind: {name: getattr(one, kind) for name, one in phases.items() if getattr(one, kind) is not None}
            for kind in ("finer", "narrower")
        }
        joint = {kind: cls._joint({**phases, **some}, functions) for kind, some in others.items() if some}
        return replace(cls._joint(phases, functions), **joint)

    @classmethod
    def _joint(cls, phases: "Mapping[str, Equations]", functions: Mapping[str, TracedFunction]) -> "Equations":
        parts = {name: one.digest for name, one in phases.items()}
        parts |= {f"to {name}": digest_of(one.closed) for name, one in functions.items()}
        return cls(joint_digest(parts), functions, phases=phases)

    def applied(self, system: AbstractSystem, start: "Callable[[], Start | None]") -> AbstractSystem:
        """A realised system as programs evaluate it: by these equations.

        Raises `ProblemError` if they have to be traced again and the code is another one here.
        """
        self.complete(system, lambda: Equations.of(system, start()))
        if isinstance(system, AlgebraicSystem):
            return TracedAlgebraic(system, self)
        assert isinstance(system, System)
        return TracedSystem(system, self)

    def complete(self, system: AbstractSystem, trace: "Callable[[], Equations]") -> None:
        """Trace the equations of a system again where they are not known. Raises `ProblemError` if they are others."""
        if self._functions is not None:
            return
        again = trace()
        self.digest.refuse_other(again.digest, system.title)
        self._functions, self.phases = again._functions, again.phases
        self.finer, self.narrower = again.finer, again.narrower

    def output_shapes(self) -> dict[str, tuple[int, ...]]:
        """The shape of each output at one instant, by name; none where the equations have to be traced again."""
        if self.phases:
            return named({name: one.output_shapes() for name, one in self.phases.items()})
        if self._functions is None:
            return {}
        function = self["instant"]
        outputs = _shapes(function).outputs
        return {name: one.shape for name, one in zip(function.rest.names, outputs, strict=True)}

    def refuse_large_history(self, who: str, steps: int, only: Collection[str] | None = None) -> None:
        """Raise `ProblemError` if the outputs of one system, or some of them, would not fit into memory twice."""
        shapes = self.output_shapes()
        entries = sum(math.prod(shape) for name, shape in shapes.items() if only is None or name in only)
        what = f"{who}: outputs of {entries:.3g} numbers at {steps + 1:.3g} instants"
        refuse_beyond_memory(what, 2 * NUMBER * entries * (steps + 1), "Take fewer steps, or return fewer numbers.")

    @property
    def may_lose_derivatives(self) -> bool:
        """See `may_lose_derivatives`."""
        functions = self._functions or {}
        own = any(may_lose_derivatives(one.closed.jaxpr) for one in functions.values())
        return own or any(one.may_lose_derivatives for one in self.phases.values())

    def __getitem__(self, name: str) -> TracedFunction:
        assert self._functions is not None
        return self._functions[name]

    def __contains__(self, name: str) -> bool:
        assert self._functions is not None
        return name in self._functions

    def __getstate__(self) -> dict[str, Any]:
        return {"_functions": None, "finer": None, "narrower": None, "phases": {}, "digest": self.digest}


def _shapes(function: TracedFunction) -> Any:
    """The shapes of what equations give."""
    return jax.tree.unflatten(function.results, function.closed.out_avals)


class Start(NamedTuple):
    """Where a system begins: the time, and the inputs there with its own signals."""

    t: Any
    inputs: dict[str, Any]


class _Instant(NamedTuple):
    """What a system says at one instant."""

    rates: Any
    outputs: tuple[Array, ...]
    names: tuple[str, ...]


def _dynamical(system: System, start: Start, states: Any) -> dict[str, TracedFunction]:
    functions = {
        "signals": TracedFunction(lambda system: dict(system.signals()), system),
        # The states of a later phase come from the one before: zeros stand in their place.
        "initial": TracedFunction(initial_state if states is None else lambda *_: zeros(states), system, *start),
    }
    z = functions["initial"](system, *start)
    if system.algebraic:
        functions["guess"] = TracedFunction(guessed_algebraic, system, start.t, z, start.inputs)
        z = with_algebraic(system, z, functions["guess"](system, start.t, z, start.inputs))
        functions["residual"] = TracedFunction(algebraic_residuals, system, start.t, z, start.inputs)
    if system.declared_events:
        functions["levels"] = TracedFunction(event_levels, system, start.t, z, start.inputs)
        functions["after"] = TracedFunction(after_events, system, start.t, z, start.inputs)
    return functions | {"instant": TracedFunction(_instant, system, start.t, z, start.inputs)}


def _instant(system: System, t: Any, z: Any, inputs: dict[str, Any]) -> _Instant:
    if system.states:
        rates, outputs = derivative_and_observation(system, t, z, inputs)
    else:
        rates, outputs = (), observation(system, t, z, inputs)
    return _Instant(rates, tuple(outputs.values()), tuple(outputs))


def _algebraic(system: AlgebraicSystem) -> dict[str, TracedFunction]:
    if not system.is_implicit:
        return {"instant": TracedFunction(_outputs, system)}
    guess = TracedFunction(first_guess, system)
    rho = guess(system)
    size = sum(map(jnp.size, rho))
    return {
        "guess": guess,
        "residual": TracedFunction(lambda system, rho: equations(system, rho, size), system, rho),
        "instant": TracedFunction(_outputs, system, rho),
    }


def _outputs(system: AlgebraicSystem, *rho: Any) -> _Instant:
    outputs = outputs_at(system, *rho)
    return _Instant((), tuple(outputs.values()), tuple(outputs))


def _evaluated(
    function: TracedFunction, arguments: tuple[Any, ...], only: Collection[str] | None = None, with_rates: bool = False
) -> tuple[Any, dict[str, Array]]:
    """The rates, if they are needed, and the outputs by name, or some of them: no other equations are evaluated."""
    names = [name for name in function.rest.names if only is None or name in only]
    where = [function.rest.names.index(name) for name in names]
    rates, values = function.part(
        lambda results: (results.rates if with_rates else (), [results.outputs[i] for i in where]), *arguments
    )
    return rates, dict(zip(names, values, strict=True))


@final
@transparent("system")
class TracedSystem(System):
    """A realised system by its equations.

    - `only`: the outputs that are needed; None for all;
    - `begun`: the states, side by side, that it starts from; None for those of its equations.
    """

    system: System
    equations: Equations = eqx.field(static=True)
    only: frozenset[str] | None = eqx.field(static=True)
    states: tuple[str, ...] = eqx.field(static=True)  # type: ignore[misc]
    algebraic: tuple[str, ...] = eqx.field(static=True)  # type: ignore[misc]
    begun: Float[Array, " states"] | None

    def __init__(self, system: System, equations: Equations, only: frozenset[str] | None = None, begun: Any = None):
        self.system, self.equations, self.only, self.begun = system, equations, only, begun
        self.states, self.algebraic = system.states, system.algebraic  # type: ignore[misc]

    @property
    @override
    def title(self) -> str:
        return self.system.title

    @property
    @override
    def declared_events(self) -> Mapping[str, Event]:
        return self.system.declared_events

    @override
    def event_levels(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, " events"]:
        return self.equations["levels"](self.system, t, z, inputs)

    @override
    def after_events(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, "events states"]:
        return self.equations["after"](self.system, t, z, inputs)

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> Any:
        return self.equations["instant"].part(lambda results: results.rates, self.system, t, z, inputs)

    @override
    def outputs(self, t: Any, z: Any, **inputs: Any) -> dict[str, Any]:
        return _evaluated(self.equations["instant"], (self.system, t, z, inputs), self.only)[1]

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[Any, dict[str, Any]]:
        del args
        return _evaluated(self.equations["instant"], (self.system, t, z, inputs), self.only, with_rates=True)

    @override
    def residual(self, t: Any, z: Any, **inputs: Any) -> Any:
        return (self.equations["residual"](self.system, t, z, inputs),)

    @override
    def algebraic_guess(self, t: Any, z: Any, **inputs: Any) -> Mapping[str, Any]:
        return self.equations["guess"](self.system, t, z, inputs)._asdict()

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        first = self.equations["initial"](self.system, t, dict(inputs))
        return (first if self.begun is None else ravel_pytree(first)[1](self.begun))._asdict()

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        signals = self.equations["signals"](self.system)
        return signals if self.begun is None else self.system.signals_from(signals, self.begun)

    @override
    def focused(self, only: Collection[str]) -> "TracedSystem":
        return TracedSystem(self.system, self.equations, frozenset(only), self.begun)

    def beginning(self, states: Float[Array, " states"]) -> "TracedSystem":
        """The same system from other states."""
        return TracedSystem(self.system, self.equations, self.only, states)


def moving(system: System) -> Pytree:
    """Numbers that the states of a system follow from."""
    if not isinstance(system, TracedSystem):
        return system
    leaves = jax.tree.leaves(eqx.filter(numbers_to_arrays(system.system), eqx.is_array))
    parts = {"instant": lambda results: results.rates}
    parts |= dict.fromkeys(("initial", "residual", "levels", "after"), lambda results: results)
    every = [system.equations[name].sources(part) for name, part in parts.items() if name in system.equations]
    return [leaf for leaf, *is_needed in zip(leaves, *every, strict=False) if any(is_needed)], system.begun


@final
@transparent("system")
class TracedAlgebraic(AlgebraicSystem):
    """A realised algebraic system by its equations."""

    system: AlgebraicSystem
    equations: Equations = eqx.field(static=True)
    unknowns: tuple[str, ...] = eqx.field(static=True)  # type: ignore[misc]

    def __init__(self, system: AlgebraicSystem, equations: Equations):
        self.system, self.equations, self.unknowns = system, equations, system.unknowns  # type: ignore[misc]

    @property
    @override
    def title(self) -> str:
        return self.system.title

    @property
    @override
    def is_implicit(self) -> bool:
        return "residual" in self.equations

    @override
    def check_declaration(self) -> None:
        """It was checked where it was declared."""

    @override
    def guess(self) -> Mapping[str, Any]:
        return self.equations["guess"](self.system)._asdict() if self.is_implicit else {}

    @override
    def residual(self, rho: Any) -> Any:
        return (self.equations["residual"](self.system, rho),)

    @override
    def outputs(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        del kwargs
        return _evaluated(self.equations["instant"], (self.system, *args))[1]
