"""The phases that a grid with events inside it stands for, as code: what `al.Simultaneous` asks to be written.

Collocation ties states at fixed shares of a time, which is the same part of the motion in all realisations. So events
that happen inside a grid are phases that end there, and there must be equally many of them in each realisation.
"""

import inspect
from collections import Counter
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator._core.compilation import Compiled, Use
from aleator.design import Problem, events_of, functionals_of
from aleator.dynamics import Grid, System, events_in_steps
from aleator.uncertainty import realise

# Steps in the place of each in which events are counted, and steps of a phase at least.
_FINER, _LEAST = 4, 4


def _met(problem: Problem, points: Float[Array, "realisations germs"], decisions: Float[Array, " n"]) -> Any:
    events = events_of(functionals_of(problem.expressions))

    def one(germ: Array) -> Any:
        whole = realise(problem.simulation, germ, decisions)
        system, grid = whole.traced, whole.grid.finer(_FINER)
        assert isinstance(system, System)
        assert isinstance(grid, Grid)
        return events_in_steps(whole.integrator, system, grid, whole.signals(system), events)

    return jax.vmap(one)(points)


_MET = Compiled(_met, use=Use.ONCE)


def phases_to_write(problem: Problem, names: list[str], points: Float[np.ndarray, "realisations germs"]) -> str:
    """What to write in the place of a grid inside which events happen: sentences, with code where it is known.

    - `names`: the events; `points`: the collocation points, at which they are sought for the initial decisions.
    """
    system, grid = problem.system, problem.grid
    advice = (
        "End a phase there, al.Grid(until=...) in al.Phases with the jump as a link, or use al.Sequential(), "
        "the default"
    )
    if not (isinstance(system, System) and isinstance(grid, Grid)) or grid.periodic or grid.t_start != 0:
        return f"{advice}."
    decisions = problem.placements.vector("initial")
    which, counts, faults = map(np.asarray, _MET(problem, jax_array(points), jax_array(decisions)))
    last = [] if grid.until is None else [len(names)]
    orders = Counter(
        tuple(int(i) for i in np.repeat(which[k], counts[k]) if i not in last) for k in np.flatnonzero(~faults)
    )
    if not orders or faults.any():
        return f"{advice}."
    met = {tuple(names[i] for i in order): count / len(which) for order, count in orders.most_common()}
    told = [(", ".join(f"'{name}'" for name in order) or "none", share) for order, share in met.items()]
    if len(met) > 1:
        shares = "; ".join(f"{share:.0%} of them meet {order}" for order, share in told[:3])
        return (
            "Phases would have to follow one another alike in all realisations, but at the initial decisions "
            f"{shares}: bound the distributions, end the grid before, or use al.Sequential(), the default."
        )
    if type(system).__module__.partition(".")[0] == __name__.partition(".")[0]:
        return f"{advice}. At the initial decisions each realisation meets {told[0][0]}."
    code = "\n".join(f"    {line}".rstrip() for line in _written(system, grid, next(iter(met))))
    return f"{advice}. At the initial decisions each realisation meets {told[0][0]}:\n\n{code}"


def _written(system: System, grid: Grid, order: tuple[str, ...]) -> list[str]:
    """The class of a system whose events have no jumps, and its phases up to each event that it meets in order."""
    name, until, latest = type(system).__name__, grid.until or "end", f"{grid.latest:g}"
    rhs = [one for one in inspect.signature(type(system).rhs).parameters if one not in ("self", "t", "z")]
    inputs = ", ".join(["", *rhs]), ", ".join(["", *(f"{one}={one}" for one in rhs)])
    steps = max(_LEAST, -(-grid.steps // (len(order) + 1)))
    ends = [*order, until]
    parts = [f"part_{i + 1}" for i in range(len(ends))]
    given = ", ..." if rhs else ""
    return [
        f"class {name}InPhases({name}):  # `clock` is the time, which `t` of a phase is not",
        f'    states = (*{name}.states, "clock")',
        "    events = {",
        *(
            f'        "{one}": al.Event({name}.events["{one}"].function, direction={event.direction}),'
            for one, event in system.declared_events.items()
        ),
        *([] if grid.until else [f'        "end": al.Event(lambda self, t, z: z.clock - {latest}, direction=1),']),
        "    }",
        "",
        f"    def rhs(self, t, z{inputs[0]}):",
        f"        return *super().rhs(z.clock, z{inputs[1]}), 1.0",
        "",
        f"system = {name}InPhases(...)",
        "flight = al.Phases(",
        *(
            f'    {part}=al.Phase(system, al.Grid(until="{end}", at_most={latest}, steps={steps}){given}),'
            for part, end in zip(parts, ends, strict=True)
        ),
        "    link={",
        *(
            f'        "{part}": lambda self, t, z: {name}.events["{end}"].jump(self, z.clock, z),'
            for part, end in zip(parts[1:], order, strict=True)
            if system.declared_events[end].jump is not None
        ),
        "    },",
        ")",
    ]
