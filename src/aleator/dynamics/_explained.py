"""Why an event that is needed is not found in a realisation, or a cycle does not close."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from aleator._core.border import meant
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator.dynamics._closing import Recorded, is_family, repeats
from aleator.dynamics._crossings import AT_START, GIVEN_UP, LOST, MANY, NO_NUMBER, STAYS, TOGETHER, Course, course
from aleator.dynamics._equations import TracedSystem
from aleator.dynamics._evaluation import initial_state
from aleator.dynamics._grid import Grid, Inputs, inputs_on
from aleator.dynamics._newton import listed, numbers_in
from aleator.dynamics._record import ONLY_STATES, STATES, Asked
from aleator.dynamics._steps import Method, needed, watched
from aleator.dynamics._system import System


def explain_course(
    method: Method,
    system: System,
    grid: Grid,
    inputs: Inputs,
    events: frozenset[str],
    given_up: Callable[[Course, float], str],
) -> str:
    """Why an event that is needed is not found in a realisation, with its numbers, or a method gives up; empty if
    neither is so.

    - `given_up`: why a method came no further than some time.
    """
    # The guess of a cycle stands on the event.
    names = watched(system, grid, events) if grid.periodic else needed(system, grid, events)
    if not (names or method.begun(grid)):
        return ""
    asked, is_final = Asked(frozenset(), events=events), jnp.asarray(False) if grid.until in names else None
    one = evaluate(lambda: course(method, system, grid, inputs, asked, names, is_final), use=Use.ONCE)
    who = _named(system)
    times = {name: float(t) for name, t in one.seen.items()}
    end = times.get(grid.until or "", float(grid.t_final))
    kind, event, t, _, number = (np.asarray(part)[int(np.argmax(np.asarray(one.fault.kind) > 0))] for part in one.fault)
    if kind == GIVEN_UP:
        return given_up(one, float(t))
    if kind > 0 and not t > end:
        others = [f"'{name}'" for i, name in enumerate(names) if i != int(event)]
        other = others[0] if len(others) == 1 else f"one of {', '.join(others)}"
        start = jax.eval_shape(lambda: initial_state(system, grid.t_start, inputs_on(grid, inputs)(grid.t_start)))
        state = np.repeat(system.states, [one.size for one in start])[int(number)]
        return f"{who} {_FAULTS[int(kind)].format(name=names[int(event)], t=float(t), other=other, state=state)}"
    if np.isnan(end) and (place := _unfinished(method, system, grid, inputs)) is not None:
        return (
            f"{who} has rates that are not finite after t = {place:.4g} s, before '{grid.until}' is met: a step of the "
            "grid leads to where the equations have no value. Take more steps or a smaller at_most, so that steps are "
            "shorter, or let rates go on there, such as jnp.sqrt(jnp.maximum(h, 0))."
        )
    if np.isnan(end):
        return (
            f"{who} never meets '{grid.until}', at which its grid ends, from {float(grid.t_start):.4g} to "
            f"{float(grid.t_final):.4g} s: raise at_most, take more steps if these are too long, or bound "
            "what leads past it, distributions and decisions. A function that only touches zero does not cross it."
        )
    if missing := [name for name in names if name in events and not times[name] <= end]:
        return (
            f"{who} never meets '{missing[0]}', which is asked for by al.at, from {float(grid.t_start):.4g} to "
            f"{end:.4g} s. Take a longer grid, or bound the distributions and decisions that lead past it."
        )
    return ""


def _unfinished(method: Method, system: System, grid: Grid, inputs: Inputs) -> float | None:
    """The last instant, s, up to which states are finite if no event ends the grid; None if they are to its end."""
    whole = Grid(float(grid.t_final), grid.steps, float(grid.t_start))
    one = evaluate(
        lambda: course(method, system, whole, inputs, ONLY_STATES, watched(system, whole, frozenset())), use=Use.ONCE
    )
    is_finite = np.isfinite(np.asarray(one.record.history[STATES])[np.asarray(one.places)]).all(axis=1)
    return None if is_finite.all() else float(whole.times[max(int(np.argmin(is_finite)) - 1, 0)])


def events_in_steps(
    method: Method, system: System, grid: Grid, inputs: Inputs, events: frozenset[str]
) -> tuple[Int[Array, " steps"], Int[Array, " steps"], Bool[Array, ""]]:
    """The last event in each step of a grid, how many there are in it, and whether they cannot be known; the one that
    ends the grid comes after all others.

    - `events`: those that count besides events with a jump.
    """
    names = needed(system, grid, events)
    is_final = None if grid.until is None else jnp.asarray(False)
    fault = course(method, system, grid, inputs, Asked(frozenset()), names, is_final).fault
    return fault.event, fault.met, (fault.kind > 0).any()


def refuse_unknown_event(system: System, name: str | None) -> None:
    """Raise `ProblemError` for the name of an event that a system does not have."""
    if name is not None and name not in system.declared_events:
        known = list(system.declared_events)
        remedy = meant(name, known) if known else " Write events = {...: al.Event(...)} in the class."
        raise ProblemError(f"{system.title} has no event '{name}'; expected one of {known}.{remedy}")


def explain_cycle(record: Recorded, system: TracedSystem, grid: Grid, inputs: Inputs) -> str:
    """Why a cycle does not close, with the numbers of the realisation."""
    if not evaluate(lambda: repeats(system, grid, inputs), use=Use.ONCE):
        return (
            f"{_named(system)} does not repeat: its equations contain a time that does not come again, so that the "
            "rates at the end of the grid are not those at its start. A grid of known length is as long as the period "
            "of what depends on time, and one from event to event needs equations without time."
        )
    if evaluate(lambda: is_family(record, system, grid, inputs), use=Use.ONCE):
        remedy = (
            "add a limit such as (al.terminal('v').mean - al.initial('v').mean).equals(0.0), or let an event end the "
            "grid if they are shifts in time"
            if grid.until is None
            else f"begin just behind '{grid.until}'"
        )
        return (
            f"{_named(system)} has no single cycle: beside the one at the values of initial(), others of a family "
            "close too, as those of a conserved energy, and no equation chooses among them. Leave out periodic=True, "
            f"so that initial() chooses, and {remedy}."
        )
    event = "" if grid.until is None else f" after '{grid.until}', which it meets by t = {float(grid.t_final):.4g} s"
    return (
        f"{_named(system)} does not close its cycle: from the values of initial(), Newton's method finds no states to "
        f"which it returns{event}. Return values closer to those of a cycle, on the event or just behind it, from "
        "initial(), or bound the distributions and decisions that lead where none is."
    )


def _named(system: System) -> str:
    numbers = listed(numbers_in(system))
    return f"{system.title}{f' with {numbers}' if numbers else ''}"


_FAULTS = {
    LOST: (
        "meets '{name}' in the step after t = {t:.4g} s, but the time is not found: steps are too long beside the "
        "motion, or its function touches zero with next to no rate. Take more steps, or bound what leads there."
    ),
    MANY: (
        "meets '{name}' again and again within one step, at about t = {t:.4g} s. Infinitely many events in a finite "
        "time have no simulation: end the grid before, or let al.Grid(until=...) end it at another event. If "
        "there is an end to them, take more steps."
    ),
    AT_START: (
        "starts at '{name}', and moves on through it from t = {t:.4g} s. Start on one side of it, or choose the other "
        "direction: al.Event(..., direction=1) counts where its function rises, -1 where it falls."
    ),
    NO_NUMBER: (
        "meets '{name}' at t = {t:.4g} s, where its jump sets '{state}' to what is not a finite number. Let it return "
        "finite numbers, such as jnp.sqrt(jnp.maximum(h, 0)), or bound the distributions and decisions that lead there."
    ),
    TOGETHER: (
        "meets '{name}' and {other} at the same time, t = {t:.4g} s, where their order decides. Make one event "
        "of both, or let them happen one after the other."
    ),
    STAYS: (
        "stays at '{name}' after t = {t:.4g} s: its jump leaves the rate of the function at zero. Let the jump lead "
        "away from it, or end the grid there, al.Grid(until='{name}', ...)."
    ),
}
