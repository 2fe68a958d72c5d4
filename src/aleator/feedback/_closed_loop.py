"""`Feedback`, and the closed loop that it makes of a system: a realisation, and beside it the plan that it follows."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import meant, members, one_of, refusal
from aleator._core.errors import ProblemError
from aleator._core.leaves import Known, Module, is_leaf, stored_number
from aleator.dynamics import (
    AbstractExtended,
    End,
    Event,
    Grid,
    Phases,
    System,
    called,
    check_inputs,
    derivative,
    derivative_and_observation,
    event_levels,
    initial_state,
)
from aleator.dynamics._system import state_type
from aleator.feedback._controllers import AbstractController, Plan, proportional
from aleator.feedback._lqr import LQR, unstable
from aleator.trajectories import AbstractSignal, WhiteNoise, as_array
from aleator.uncertainty import AbstractDecision, placements, refuse_intervals

# Signals of the closed loop: of the plan where it differs from the realisation, of sensors, of gains. Inputs have no
# spaces in their names.
PLANNED, SCHEDULE = " of the plan", "gain schedule"


def noise_of(state: str) -> str:
    """The name of the signal of a sensor's noise."""
    return f"noise of {state}"


@final
class Feedback(Module):
    """A controller in the loop, which corrects the inputs of a plan by what it measures: in each realisation.

    The plan is the system itself at the means of its distributions, with the problem's inputs; decisions shape it.

    - `gains`: numbers, by which the errors (the plan minus what is measured) are multiplied and added to the planned
      inputs: one a measured number, a matrix (actuators by measured numbers), or a dict of these by measured state;
      `lqr(Q, R)`, `computed_torque(...)`, or an `AbstractController` of your own. Any of their numbers may be a
      distribution or a `Decision`;
    - `of`: the states that are measured, by default those of the dict, or all; `to`: the inputs that are commanded, by
      default the only one;
    - `noise`: that of sensors, such as `al.processes.WhiteNoise(1e-6)`: one signal for one of `of`, or signals by name;
    - `limits`: the least and the largest value of commanded inputs, between which actuators stay.

    Further outputs: `"u.command"` and `"u.applied"`, before and after the limits, and `"x.error"` of each measured
    state. Raises `ProblemError` for anything else; a problem raises it for names that its system does not have, and for
    gains, if they are not decided, that make the loop less stable than it is without them.
    """

    gains: AbstractController
    noise: dict[str, AbstractSignal]
    limits: tuple[Any, ...]
    of: tuple[str, ...] | None = eqx.field(static=True)
    to: tuple[str, ...] | None = eqx.field(static=True)
    is_judged: bool = eqx.field(static=True)

    def __init__(
        self,
        gains: Any,
        of: str | Sequence[str] | None = None,
        *,
        to: str | Sequence[str] | None = None,
        noise: Any = None,
        limits: tuple[Any, Any] | None = None,
    ):
        self.gains = gains if isinstance(gains, AbstractController) else proportional(gains)
        numbers = jax.tree.leaves(self.gains, is_leaf=is_leaf)
        self.is_judged = not any(isinstance(number, AbstractDecision) for number in numbers)
        self.of = _names("of", tuple(gains) if of is None and isinstance(gains, Mapping) else of)
        self.to = _names("to", to)
        self.is_judged &= self.to != ()
        by_name = noise if isinstance(noise, Mapping) else dict.fromkeys(self.of or (), noise) if noise else {}
        if noise is not None and not by_name:
            raise refusal("Feedback: noise", "signals by the names of measured states, or of=(...) and one", noise)
        example = "al.processes.WhiteNoise(1e-6)"
        self.noise = {name: one_of("Feedback: noise", one, AbstractSignal, example) for name, one in by_name.items()}
        if limits is not None and not (isinstance(limits, tuple | list) and len(limits) == 2):
            raise refusal("Feedback: limits", "the least and the largest value, such as (-20.0, 20.0)", limits)
        self.limits = tuple(stored_number("Feedback: limits", one) for one in limits or ())
        if self.limits and not any(map(is_leaf, self.limits)) and not self.limits[0] < self.limits[1]:
            raise refusal("Feedback: limits", "the least value before the largest", limits)


def _names(what: str, names: Any) -> tuple[str, ...] | None:
    names = (names,) if isinstance(names, str) else names
    return None if names is None else tuple(members(f"Feedback: {what}", names, str))


@final
class _Open(AbstractController):
    """It commands nothing."""

    @override
    def command(self, t: Any, measured: Any, plan: Plan) -> Mapping[str, Any]:
        return {}


OPEN = Feedback(_Open(), of=(), to=())
"""Of a phase without feedback, whose plan goes on for that of another one."""


class Means(Known):
    """The model at the means of its distributions: these, in a tree like the system with None in all other places.

    `inputs`: all inputs at the means; `uncertain`: those that differ from the realisation's.
    """

    system: Any
    inputs: dict[str, AbstractSignal]
    uncertain: tuple[str, ...] = eqx.field(static=True)


@final
class ClosedLoop(AbstractExtended):
    """A system with feedback: its states, then those of the plan, both with the same equations, evaluated at once.

    `of`, `to`: the states that are measured and the inputs that are commanded; `means`: None until it is realised.
    """

    own: System
    feedback: Feedback
    taken: tuple[str, ...] = eqx.field(static=True)
    of: tuple[str, ...] = eqx.field(static=True)
    to: tuple[str, ...] = eqx.field(static=True)
    means: Means | None = None

    @property
    def further(self) -> tuple[str, ...]:  # type: ignore[override]
        """The states of the plan."""
        return tuple(f"{name}_plan" for name in self.own.states)

    @property
    @override
    def planned_events(self) -> Mapping[str, str]:
        return {name: f"{name}_plan" for name in self.own.declared_events}

    @property
    @override
    def declared_events(self) -> Mapping[str, Event]:
        """Its own, then those of the plan: without jumps, which at most the event that ends a grid has."""
        own = {name: replace(event, jump=None) for name, event in self.own.declared_events.items()}
        return own | {self.planned_events[name]: event for name, event in own.items()}

    @property
    def white(self) -> dict[str, WhiteNoise]:
        """White noise of sensors, by the names of its signals."""
        noise = self.feedback.noise.items()
        return {noise_of(name): one for name, one in noise if isinstance(one, WhiteNoise)}

    @override
    def with_plan(self, means: Any, inputs: Mapping[str, AbstractSignal], uncertain: tuple[str, ...]) -> "ClosedLoop":
        return replace(self, means=Means(means, dict(inputs), uncertain))

    @property
    def model(self) -> System:
        """The system at the means of its distributions."""
        return self.own if self.means is None else eqx.combine(self.means.system, self.own)

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        own = dict(self.own.signals())
        signals = own | {noise_of(name): one for name, one in self.feedback.noise.items()}
        if self.means is None:
            return signals
        planned = {name: self.means.inputs[name] for name in self.means.uncertain}
        planned |= self.model.signals() if jax.tree.leaves(self.means.system) else {}
        schedule = self.feedback.gains.schedule(self.model, self.means.inputs, self.to)
        signals |= {f"{name}{PLANNED}": one for name, one in planned.items()}
        return signals if schedule is None else signals | {SCHEDULE: schedule}

    @override
    def signals_from(
        self, signals: Mapping[str, AbstractSignal], begun: Float[Array, " states"]
    ) -> Mapping[str, AbstractSignal]:
        schedule = signals.get(SCHEDULE)
        return signals if schedule is None else {**signals, SCHEDULE: schedule.along(begun)}  # type: ignore[attr-defined]

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        own, planned = self._told_apart(inputs)
        both = self._side_by_side(lambda system, u: initial_state(system, t, u), (own,), (planned,))
        return dict(zip(self.states, [one[i] for i in (0, 1) for one in both], strict=True))

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[Any, dict[str, Any]]:
        _, planned = self._told_apart(inputs)
        command = self._command(t, z, inputs)
        applied = self.seen_by_own(t, z, inputs, command)
        rates, outputs = self._side_by_side(
            lambda system, z, u: derivative_and_observation(system, t, z, u),
            (self.own_states(z), applied),
            (self._planned_states(z), planned),
        )
        further = {f"{name}.command": value for name, value in command.items()}
        further |= {f"{name}.applied": applied[name] for name in self.to}
        further |= {f"{name}.error": getattr(z, f"{name}_plan") - getattr(z, name) for name in self.of}
        further |= {"lqr.gains": inputs[SCHEDULE]} if isinstance(self.feedback.gains, LQR) else {}
        return [one[i] for i in (0, 1) for one in rates], {name: one[0] for name, one in outputs.items()} | further

    @override
    def event_levels(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, " events"]:
        both = self._side_by_side(
            lambda system, z, u: event_levels(system, t, z, u),
            (self.own_states(z), self.seen_by_own(t, z, inputs)),
            (self._planned_states(z), self._told_apart(inputs)[1]),
        )
        return jnp.ravel(both)

    @override
    def after_events(self, t: Any, z: Any, *args: Any, **inputs: Any) -> Float[Array, "events states"]:
        states = jnp.concatenate([*map(jnp.ravel, z)])
        return jnp.broadcast_to(states, (len(self.declared_events), states.size))

    @override
    def continuing(self, link: Callable[..., dict[str, Any]], ended: "ClosedLoop", end: End) -> dict[str, Any]:
        """The plan goes on from its own end."""
        plan = end if end.plan is None else end.plan
        realised = link(ended.own, end.t, ended.own_states(end.z))
        planned = link(ended.model, plan.t, ended._planned_states(plan.z))
        return dict(
            zip(self.states, [one[name] for one in (realised, planned) for name in self.own.states], strict=True)
        )

    def _told_apart(self, inputs: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """The inputs of the realisation, and those of the plan."""
        own = {name: inputs[name] for name in _without_rates(inputs, self.to) if " " not in name}
        return own, {name: inputs.get(f"{name}{PLANNED}", value) for name, value in own.items()}

    def _planned_states(self, z: Any) -> Any:
        return state_type(self.own.states)(*z[len(self.own.states) : 2 * len(self.own.states)])

    def _command(self, t: Any, z: Any, inputs: dict[str, Array]) -> dict[str, Array]:
        """What the controller commands."""
        _, planned = self._told_apart(inputs)
        measured = {name: getattr(z, name) + inputs.get(noise_of(name), 0.0) for name in self.of}
        for name, value in measured.items():
            if jnp.shape(value) != jnp.shape(getattr(z, name)):
                raise ProblemError(
                    f"Feedback: noise of '{name}': expected one number for each of the state, shape "
                    f"{jnp.shape(getattr(z, name))}; received {jnp.shape(inputs[noise_of(name)])}."
                )
        law, model = self.feedback.gains, self.model

        def rates(z: Any, inputs: dict[str, Array]) -> Any:
            return derivative(model, t, z, inputs)

        plan = Plan(self._planned_states(z), planned, rates, self.to, inputs.get(SCHEDULE))
        command = called(law, law.command, t, state_type(self.of)(**measured), plan)
        if not (isinstance(command, Mapping) and set(command) == set(self.to)):
            raise refusal(f"{type(law).__name__}.command", f"a dict of the commanded inputs {self.to}", command)
        return {name: jnp.reshape(jnp.asarray(value), jnp.shape(planned[name])) for name, value in command.items()}

    @override
    def seen_by_own(
        self, t: Any, z: Any, inputs: dict[str, Array], command: dict[str, Array] | None = None
    ) -> dict[str, Array]:
        own, _ = self._told_apart(inputs)
        command = self._command(t, z, inputs) if command is None else command
        if self.feedback.limits:
            low, high = map(as_array, self.feedback.limits)
            command = {name: jnp.clip(value, low, high) for name, value in command.items()}
        return own | command

    def _side_by_side(self, function: Callable[..., Any], realised: Any, planned: Any) -> Any:
        """`function(system, ...)` of the realisation and of the plan along a first axis, traced once."""
        own = self.own, *realised
        means = None if self.means is None else self.means.system
        other = jax.tree.map(lambda _: None, self.own) if means is None else means, *planned

        def both(mean: Any, one: Any) -> Any:
            return None if mean is None or mean is one else jnp.stack([jnp.asarray(one), jnp.asarray(mean)])

        pairs = jax.tree.map(both, other, own, is_leaf=lambda node: node is None)
        if not jax.tree.leaves(pairs):
            return jax.tree.map(lambda one: jnp.stack([one, one]), function(*own))
        return jax.vmap(lambda part: function(*eqx.combine(part, own)))(pairs)

    @override
    def diagnose(self, grid: Grid) -> str:
        return self.own.diagnose(grid) or (self._unstable(self.model, grid) if self.feedback.is_judged else "")

    @override
    def destabilised(self, grid: Grid) -> str:
        return self._unstable(self.own, grid)

    def _unstable(self, model: System, grid: Grid) -> str:
        if self.means is None or not self.to:
            return ""
        return unstable(self.feedback.gains, model, self.means.inputs, grid, self.of, self.to)


def closed_loop(system: Any, inputs: Mapping[str, Any], feedback: Any, grid: Any) -> ClosedLoop:
    """A system with feedback around its inputs. Raises `ProblemError` for what does not go together."""
    one_of("Problem: feedback", feedback, Feedback, "al.Feedback(gains=[4.0, 2.0], of=('x', 'v'))")
    if not (isinstance(system, System) and system.states):
        remedy = " Give each phase its own: al.Phase(..., feedback=...)." if isinstance(system, Phases) else ""
        raise ProblemError(f"Feedback: expected a system with states; received {type(system).__name__}.{remedy}")
    for part in (system, inputs):
        remedy = "A plan for each value would know it: declare it as a distribution."
        refuse_intervals("Problem: feedback", placements(part), remedy)
    check_inputs(system, inputs)
    states = system.states
    signals = [*(name for name, one in inputs.items() if not isinstance(one, WhiteNoise)), *system.signals()]
    signals = _without_rates(signals, signals)
    _refuse_unknown("of names states that are measured", feedback.of or (), states)
    measured = states if feedback.of is None else feedback.of
    _refuse_unknown("noise is that of measured states", feedback.noise, measured)
    named = getattr(feedback.gains, "numbers", None)
    _refuse_unknown("its gains ask for what is not measured", named if isinstance(named, dict) else (), measured)
    if feedback.gains.needs_all and (missing := [name for name in states if name not in measured]):
        raise ProblemError(
            f"Feedback: {type(feedback.gains).__name__} asks for '{missing[0]}', which is not measured: expected "
            f"of={states}; received of={measured}."
        )
    to = feedback.to
    if to is None and len(signals) != 1:
        raise ProblemError(
            f"Feedback: expected the inputs that it commands, to=..., where there are several, or none; received "
            f"{signals}."
        )
    _refuse_unknown("to names inputs that it commands", to or (), signals)
    last = getattr(grid, "until", None)
    if getattr(grid, "periodic", False) and (last is not None or isinstance(feedback.gains, LQR)):
        raise ProblemError(
            "Feedback: a plan that repeats has no initial states for al.lqr, and a period of its own if an event ends "
            "it: expected gains as numbers, and a known period, al.Grid(2.0, 40, periodic=True)."
        )
    jumps = [name for name, event in system.declared_events.items() if event.jump is not None and name != last]
    if jumps:
        raise ProblemError(
            f"Feedback: '{jumps[0]}' of {system.title} sets states anew, at another time in each realisation than in "
            "the plan, and in between their difference is no error to correct: expected events without a jump. Let it "
            f"end a phase, al.Phase(system, al.Grid(until='{jumps[0]}', ...)), after which a link sets states anew."
        )
    to = tuple(signals) if to is None else to
    return ClosedLoop(own=system, feedback=feedback, taken=tuple(inputs), of=measured, to=to)


def _without_rates(names: Iterable[str], to: Collection[str]) -> list[str]:
    """The names of inputs without those of the rates of commanded ones, which are not known."""
    return [name for name in names if name.removesuffix("_rate") not in {*to} - {name}]


def _refuse_unknown(what: str, names: Any, known: Any) -> None:
    for name in names:
        if name not in known:
            raise ProblemError(
                f"Feedback: {what}: expected some of {list(known)}; received '{name}'.{meant(name, known)}"
            )
