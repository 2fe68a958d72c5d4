"""Systems: the interface of all of them, and ordinary differential equations with named states, inputs and outputs."""

import abc
import inspect
from collections import namedtuple
from collections.abc import Callable, Collection, Mapping
from functools import cache
from types import MethodType
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import refusal, refuse_leaf, refuse_slip, traceable
from aleator._core.errors import ProblemError
from aleator._core.functions import first_line, returned
from aleator._core.leaves import Module, Printed, is_leaf, named_leaves
from aleator.dynamics._event import Event
from aleator.trajectories import AbstractSignal

# The methods of a system with algebraic variables.
_IMPLICIT = ("residual", "algebraic_guess")
# What a system may declare.
_OPTIONAL = ("units", "events", "initial", "algebraic", *_IMPLICIT, "unknowns", "guess")


class AbstractSystem(Module, Printed):
    """What can be simulated: a `System`, which evolves in time, or an `AlgebraicSystem`, which has no time.

    - `has_time`: whether it evolves in time; `units`: the units of its outputs as far as they are known, for reports;
      `rates_of`: outputs that are rates of others, by name, whose units follow from those.
    """

    has_time: ClassVar[bool]
    units: ClassVar[Mapping[str, str]] = {}
    rates_of: ClassVar[Mapping[str, str]] = {}

    def __init_subclass__(cls, **options: Any) -> None:
        """Refuse a method or table with a slip in its name, which would be left out without a word."""
        super().__init_subclass__(**options)
        optional = [name for name in _OPTIONAL if hasattr(cls, name)]
        for name in vars(cls).keys() - inspect.get_annotations(cls).keys() - {*dir(cls.__base__), *_OPTIONAL}:
            is_declared = inspect.isfunction(vars(cls)[name]) or isinstance(vars(cls)[name], Mapping | tuple)
            if is_declared:
                refuse_slip(cls.__name__, name, optional)

    @property
    def formulated(self) -> Module:
        """The model that its equations are about: itself, or that of which it is a formulation."""
        return self

    @property
    def plain(self) -> Any:
        """The system without what was put around it: itself."""
        return self

    @property
    def title(self) -> str:
        """The name of its class, for messages."""
        return type(self).__name__

    @property
    @abc.abstractmethod
    def is_integrated(self) -> bool:
        """Whether it has states, which are integrated over time."""

    def diagnose(self, grid: Any) -> str:
        """What is wrong with the realised system on a grid, in a sentence with its remedy; empty if nothing.

        It is asked before anything is compiled.
        """
        del grid
        return ""

    def destabilised(self, grid: Any) -> str:
        """That feedback lets errors of the realised system grow faster than without, in a sentence; empty if it does
        not, or there is none.
        """
        del grid
        return ""


class System(AbstractSystem):
    """A dynamical system `dz/dt = rhs(t, z, inputs)` with outputs: ordinary physics, written once.

    Subclass it with the parameters as fields and the states' names in `states`; any number in a field may then be
    replaced by a distribution or a decision. In `rhs` and `outputs` the state is a named tuple (`z.z_s`, or unpacked),
    and each further argument is the input of that name: `def rhs(self, t, z, road)`. Each method receives only the
    inputs that it names (all of them, if it ends in `**inputs`, where `further_inputs` may name those that the
    system takes). `signal_fields` are the fields that only `signals` reads.

    Variables without rates, which follow at each instant from equations, are named in `algebraic`, and the equations
    are written as `residual(self, t, z, road)`: as many numbers, all of them zero. The state then has them too,
    `z.pressure`, in `rhs`, `outputs` and `residual`. Their values near a solution come from
    `algebraic_guess(self, t, z, road)`, whose `z` has the states alone; zero by default. Of several solutions Newton's
    method finds the one it reaches from this guess, so let the guess depend on what tells them apart; `Rodas5P` takes
    the guess at the start alone, and then follows the solution from step to step. The equations must determine the
    algebraic variables at a fixed state (index 1).

    `events` names what happens at certain states, such as an impact: see `Event`.

    Their signatures are open here, so that each system names its own inputs. `units` may give the units of outputs, for
    reports.
    """

    has_time: ClassVar[bool] = True
    states: ClassVar[tuple[str, ...]]
    algebraic: ClassVar[tuple[str, ...]] = ()
    signal_fields: ClassVar[tuple[str, ...]] = ()
    further_inputs: ClassVar[tuple[str, ...] | None] = None
    events: ClassVar[Mapping[str, Event]] = {}

    @property
    @override
    def is_integrated(self) -> bool:
        return bool(self.states)

    @abc.abstractmethod
    def rhs(self, *args: Any, **kwargs: Any) -> Any:
        """`rhs(self, t, z, ...)`: the time derivatives of the states, as a sequence in the order of `states`."""

    @abc.abstractmethod
    def outputs(self, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """`outputs(self, t, z, ...)`: quantities of interest by name, such as accelerations, distances and forces."""

    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[Any, dict[str, Any]]:
        """`rhs` and `outputs` with all their inputs: one after the other, unless overridden because both follow from
        the same equations.
        """
        del args
        return evaluated(self, self.rhs, t, z, inputs), evaluated(self, self.outputs, t, z, inputs)

    def residual(self, *args: Any, **kwargs: Any) -> Any:
        """`residual(self, t, z, ...)`: the equations of the algebraic variables, a sequence of numbers that vanish."""
        del args, kwargs
        return ()

    def algebraic_guess(self, *args: Any, **kwargs: Any) -> Mapping[str, Any]:
        """`algebraic_guess(self, t, z, ...)`: values near the algebraic variables by name; those not named are zero."""
        del args, kwargs
        return {}

    @property
    def declared_events(self) -> Mapping[str, Event]:
        """Its events; those of the model that it formulates, whose functions take that, if it has states."""
        events = getattr(self.formulated, "events", {})
        return events if self.states or self.formulated is self else {}

    def event_levels(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, " events"]:
        """The functions of all events, in order; an event is where one crosses zero."""
        del args
        levels = []
        for name, event in self.declared_events.items():
            who = f"{self.title}.events['{name}']"
            value = evaluated(self, MethodType(event.function, self.formulated), t, z, inputs, who)
            level, kind = traceable(who, value), jnp.result_type(value)
            # A comparison jumps where the event is, and no whole number crosses zero.
            if level.shape or not jnp.issubdtype(kind, jnp.floating):
                raise ProblemError(
                    f"{who}: expected one real number that crosses zero, such as z.y; received {kind} of shape "
                    f"{level.shape}."
                )
            levels.append(level)
        return jnp.stack(levels)

    def after_events(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, "events states"]:
        """The states side by side after each event, if it happened now."""
        del args
        return jnp.stack([self._after(name, event, t, z, inputs) for name, event in self.declared_events.items()])

    def _after(self, name: str, event: Event, t: Any, z: Any, inputs: dict[str, Any]) -> Float[Array, " states"]:
        who, values = f"{self.title}.events['{name}'].jump", {one: getattr(z, one) for one in self.states}
        jump = {} if event.jump is None else evaluated(self, MethodType(event.jump, self.formulated), t, z, inputs, who)
        if not isinstance(jump, Mapping) or not set(jump) <= set(values):
            raise ProblemError(
                f"{who}: expected new values by the names of some of the states {self.states}, as a dict; "
                f"received {jump!r}."
            )
        for one, value in jump.items():
            value = traceable(f"{who}, '{one}'", value)
            if value.shape != (shape := jnp.shape(values[one])):
                raise ProblemError(f"{who}: expected '{one}' of shape {shape}; received {value.shape}.")
            values[one] = value
        return jnp.concatenate([jnp.ravel(one) for one in self.allowed_after(t, values, jump, inputs).values()])

    def allowed_after(self, t: Any, states: dict[str, Any], jump: Collection[str], inputs: Any) -> dict[str, Any]:
        """The states by name after a jump of some of them to these, which it may not allow."""
        del t, jump, inputs
        return states

    def initial(self) -> Mapping[str, Any]:
        """Initial values by state; states not named start at zero."""
        return {}

    @property
    def solves_start(self) -> bool:
        """Whether `starting` solves equations, as constraints are, which takes a program of its own."""
        return False

    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        """Initial values at the time `t` with the inputs' values there: those of `initial`, if it tells them all."""
        del t, inputs
        if not callable(self.initial):
            raise refusal(f"{type(self).__name__}.initial", "a method that returns values by state", self.initial)
        return self.initial()

    def plain_states(self, z: Any) -> Any:
        """Those of its plain system, which come first."""
        return state_type(self.plain.states)(*z[: len(self.plain.states)])

    def continuing(self, link: Callable[..., dict[str, Any]], ended: Any, end: "End") -> dict[str, Any]:
        """The states with which it begins as a phase after another one, by name.

        - `link(system, t, z)`: that of the plain systems; `ended`: the system of the phase before; `end`: its end.
        """
        return link(ended, end.t, ended.plain_states(end.z))

    def signals(self) -> Mapping[str, AbstractSignal]:
        """Inputs that are part of the system itself, by name, such as a prescribed motion or torques."""
        return {}

    def signals_from(
        self, signals: Mapping[str, AbstractSignal], begun: Float[Array, " states"]
    ) -> Mapping[str, AbstractSignal]:
        """Its signals where it begins with other states, side by side, than those of its equations."""
        del begun
        return signals

    def focused(self, only: Collection[str]) -> "System":
        """The same system where only the outputs `only` are needed, so that it may skip the work for others."""
        del only
        return self


class AbstractCombined(System):
    """A system whose rates and outputs follow from the same equations: it defines `rates_and_outputs` alone."""

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> Any:
        return self.rates_and_outputs(t, z, **inputs)[0]

    @override
    def outputs(self, t: Any, z: Any, **inputs: Any) -> dict[str, Any]:
        return self.rates_and_outputs(t, z, **inputs)[1]

    @abc.abstractmethod
    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[Any, dict[str, Any]]:
        """Both, with all their inputs."""


class End(NamedTuple):
    """How a phase ends in a realisation.

    - `system`: its equations; `t`, `z`: the time and the states; `inputs`: those at a time, by name; `plan`: the end of
      the plan, which has its own time, if an event ends it.
    """

    system: System
    t: Any
    z: Any
    inputs: Callable[[Any], dict[str, Any]]
    plan: "End | None" = None


def state_type(names: tuple[str, ...]) -> Any:
    """The named tuple type of a state. Raises `ProblemError` unless each name is valid as an attribute."""
    if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
        raise ProblemError(f"Expected names of states or unknowns as a tuple, such as ('x', 'v'); received {names!r}.")
    return _state_type(names)


@cache
def _state_type(names: tuple[str, ...]) -> Any:
    try:
        return namedtuple("State", names)  # type: ignore[misc]
    except ValueError as error:
        raise ProblemError(
            "Names of states and unknowns must be distinct Python names without a leading underscore; received "
            f"{names}: {first_line(error)}."
        ) from error


def evaluated(
    system: System, method: Callable[..., Any], t: Any, z: Any, inputs: dict[str, Array], who: str = ""
) -> Any:
    """`method(t, z, ...)` with the inputs that it names; `who` it is in messages, by default a method of the system."""
    named, _, takes_all = _inputs_of(method)
    taken = {name: signal for name, signal in inputs.items() if takes_all or name in named}
    return returned(who, method, t, z, **taken) if who else called(system, method, t, z, **taken)


def called(system: eqx.Module, method: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Call `method` of `system`. Raises `ProblemError` for whatever the user's code raises, with a remedy if known."""
    return returned(f"{type(system).__name__}.{method.__name__}", method, *arguments, **named)


class _Inputs(NamedTuple):
    """The inputs that a method names, those without a default, and whether it takes `**inputs`."""

    named: tuple[str, ...]
    needed: tuple[str, ...]
    takes_all: bool


def _inputs_of(method: Callable[..., Any]) -> _Inputs:
    parameters = list(inspect.signature(method).parameters.values())
    open_ended = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    further = [one for one in parameters[2:] if one.kind not in open_ended]
    return _Inputs(
        tuple(one.name for one in further),
        tuple(one.name for one in further if one.default is inspect.Parameter.empty),
        any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters),
    )


def _methods(system: System) -> list[Callable[..., Any]]:
    """The methods that a system writes with inputs among their arguments."""
    further = [getattr(system, name) for name in _IMPLICIT if _writes(system, name)]
    functions = (
        one for event in system.declared_events.values() for one in (event.function, event.jump) if one is not None
    )
    return [system.rhs, system.outputs, *further, *(MethodType(one, system) for one in functions)]


def _writes(system: System, name: str) -> bool:
    return getattr(type(system), name) is not getattr(System, name)


def input_names(system: System) -> tuple[str, ...]:
    """The external inputs of a system's methods: their arguments after time and state."""
    named = dict.fromkeys(name for method in _methods(system) for name in _inputs_of(method).named)
    return tuple(name for name in (*named, *(system.further_inputs or ())) if name not in system.signals())


def check_variables(system: System) -> None:
    """Refuse names that are none, and algebraic variables without equations or the other way round."""
    name = system.title
    for names in (system.states, system.algebraic):
        state_type(names)
    state_type((*system.states, *system.algebraic))
    events = system.declared_events
    if not (isinstance(events, Mapping) and all(isinstance(one, Event) for one in events.values())):
        raise refusal(f"{name}.events", "events by name, such as {'floor': al.Event(...)}", events)
    if events and not system.states:
        raise ProblemError(f"{name}: events {sorted(events)} need states that reach them; received none.")
    written = [one for one in _IMPLICIT if _writes(system, one)]
    if system.algebraic and "residual" not in written:
        raise ProblemError(
            f"{name} names the algebraic variables {system.algebraic}, but no equations for them: write "
            "residual(self, t, z), which returns as many numbers that vanish."
        )
    if written and not system.algebraic:
        raise ProblemError(
            f'{name} writes {" and ".join(written)}, but names no algebraic variables: expected `algebraic = ("y",)` '
            "in the class."
        )


def check_inputs(system: System, inputs: Collection[str]) -> None:
    """Refuse inputs that a system does not take, and systems that lack an input."""
    name, methods = system.title, [_inputs_of(one) for one in _methods(system)]
    needed = {name for method in methods for name in method.needed}.union(system.further_inputs or ())
    missing = sorted(needed - set(inputs) - set(system.signals()))
    if inputs and system.signal_fields and not needed - set(system.signals()):
        # Its further arguments are for signals that it makes of its own fields.
        fields = " and ".join(f"`{one}`" for one in system.signal_fields)
        raise ProblemError(
            f"{name} takes no inputs: its signals are given where it is made, as its {fields}; received the inputs "
            f"{sorted(inputs)}. Write {name}(..., {system.signal_fields[0]}=...)."
        )
    is_open = any(one.takes_all for one in methods) and system.further_inputs is None
    unknown = [] if is_open else sorted(set(inputs) - set(input_names(system)))
    if missing or unknown:
        raise ProblemError(f"{name} takes the inputs {sorted(input_names(system))}; received {sorted(inputs)}.")


def refuse_unrealised(**parts: Any) -> None:
    """Raise `ProblemError` if a distribution or a decision is left in the parts to simulate; traced numbers pass."""
    for name, leaf in named_leaves(parts):
        refuse_leaf(name, leaf)
    leaves = [
        f"'{jax.tree_util.keystr(path, simple=True, separator='.')}' is a {type(leaf).__name__}"
        for path, leaf in jax.tree_util.tree_leaves_with_path(parts, is_leaf=is_leaf)
        if is_leaf(leaf)
    ]
    if leaves:
        raise ProblemError(
            f"simulate: expected one realised system, with plain numbers throughout; received {', '.join(leaves)}. "
            "Replace these by numbers, declare an al.Problem, or pass a function that simulates to al.expand or "
            "al.references.monte_carlo, which realise the system."
        )
