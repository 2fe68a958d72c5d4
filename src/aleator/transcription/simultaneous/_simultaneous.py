"""`Simultaneous`: direct collocation, from a declared problem to its sparse program.

Collocation ties states at fixed shares of a time, which is the same part of the motion in all realisations. So events
that happen inside a grid are phases that end there, and there must be equally many of them in each realisation: such a
grid is refused, with the phases that it stands for, as code.
"""

import inspect
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, final

import jax
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import one_of, positive, refusal, whole
from aleator._core.compilation import Compiled, Use
from aleator._core.errors import ProblemError
from aleator.design import FloquetMultiplier, Problem, events_of, functionals_of
from aleator.dynamics import MOST_STAGES, AbstractScheme, Grid, HermiteSimpson, System, events_in_steps, watched, within
from aleator.nlp import AbstractSolver, Ipopt
from aleator.solution import Solution
from aleator.transcription._abstract import AbstractTranscription, Meanwhile
from aleator.transcription._discretised import discretised, first_scenarios
from aleator.transcription.simultaneous._guesses import Guess
from aleator.transcription.simultaneous._mesh import Mesh, first_nodes, joined
from aleator.transcription.simultaneous._pointwise import Pointwise
from aleator.transcription.simultaneous._refinement import Goal
from aleator.transcription.simultaneous._starts import Start
from aleator.transcription.simultaneous._transcribed import Recipe, SimultaneouslyTranscribed
from aleator.uncertainty import realise

# The least error of a mesh that may be asked for.
_LEAST_ERROR = 1e-12
# Steps in the place of each in which events are counted, and steps of a phase at least.
_FINER, _LEAST = 4, 4


@final
@dataclass(frozen=True)
class Simultaneous(AbstractTranscription):
    """States are variables of the program, and a scheme holds them to the dynamics: direct collocation, or multiple
    shooting.

    The way for long, unstable or stiff systems and for limits on states. Its programs are large and sparse, with exact
    second derivatives, and solved by interior points.

    - `scheme`: how states follow their rates, such as `al.schemes.Radau(3)`;
    - `error`: the error of the states that is asked of every interval of the mesh, relative to their magnitudes. The
      mesh begins as the steps of the grid; intervals that err more are divided until all are as accurate. Limits over
      time then hold at all points of the mesh, not at the instants alone. None leaves the mesh as it is;
    - `most_stages`: schemes with as many stages as are asked for (`al.schemes.Radau`, `GaussLegendre`) may be given
      more, up to so many: on each finer mesh that takes the least points, dividing intervals or raising the order of
      all. Then few long intervals follow smooth states; controls on the mesh are not made finer where intervals are not
      divided. By default the scheme stays as it is;
    - `guess`: the states to start from, where a simulation at the initial decisions is useless: a function of time, in
      s, that returns the states by name or in the system's order, the same for all realisations; a table of them, with
      the instants as "time" (a dict, an `xarray.Dataset` or a NumPy array with named fields), with straight lines
      between; one of these for each phase, by name; or a solution on any grid, by any transcription, of this problem or
      one with the same states: each realisation then starts from the nearest one there (from the mean, where other
      numbers are uncertain), and from the decisions that the solution has. By default states start as simulated, and at
      rest where that fails.

    A guess is only a start: certificates speak of the model, whatever it was.

    Where an event ends the grid, the final time of each realisation is a variable, at which the function of the event
    is zero. Each phase has a mesh of its own.

    Raises `ProblemError` for an algebraic system, for events that do not end a grid, and for phases with feedback after
    an event, or with `al.lqr` after the first.
    """

    scheme: AbstractScheme = field(default_factory=HermiteSimpson)
    error: float | None = None
    most_stages: int | None = None
    guess: Guess | None = field(default=None, compare=False, repr=False)
    _start: Start = field(init=False, repr=False)

    def __post_init__(self) -> None:
        one_of("Simultaneous: scheme", self.scheme, AbstractScheme, "al.schemes.HermiteSimpson()")
        if self.error is not None and not _LEAST_ERROR <= positive("Simultaneous: error", self.error) < 1:
            raise ProblemError(
                f"Simultaneous: error: expected {_LEAST_ERROR:g} (64-bit arithmetic gives no more) to below 1; "
                f"received {self.error!r}."
            )
        if self.most_stages is not None:
            _check_stages(self.scheme, self.error, self.most_stages)
        object.__setattr__(self, "_start", Start.of(self.guess))

    @property
    @override
    def name(self) -> str:
        return f"Simultaneous ({self.scheme})"

    @property
    @override
    def refines(self) -> bool:
        return self.error is not None

    @property
    @override
    def is_guessed(self) -> bool:
        return self.guess is not None

    @override
    def first(self, problem: Problem) -> Float[np.ndarray, " n"]:
        return self._start.decisions(problem)

    @override
    def starting_from(self, solution: Solution) -> "Simultaneous":
        return replace(self, guess=solution)

    @property
    @override
    def solver(self) -> AbstractSolver:
        return Ipopt()

    def count(self, problem: Problem) -> int:
        """How many variables of its program are states: at all points of the first mesh, in every realisation.

        Raises `ProblemError` for what it does not transcribe.
        """
        meshes, phases = self._first_meshes(problem), problem.simulation.phases.values()
        points = sum(len(one.system.states) * mesh.fractions.size for one, mesh in zip(phases, meshes, strict=True))  # type: ignore[attr-defined]
        return points * len(discretised(problem).collocation.points)

    def _first_meshes(self, problem: Problem) -> tuple[Mesh, ...]:
        if not problem.system.has_time:
            raise ProblemError(
                f"al.Simultaneous ties states over time: expected a system that moves in time; received "
                f"{type(problem.system).__name__}, which is algebraic. Use al.Sequential()."
            )
        phases = list(zip(problem.simulation.phases.values(), Pointwise.each(problem), strict=True))
        for (before, _), (_, own) in pairwise(phases):
            if before.plan is not None or own.signals.follow_states:
                raise ProblemError(
                    f"al.Simultaneous knows a plan at the times of its realisations alone: '{own.phase}' begins after "
                    "an event that the plan has at another time, or follows al.lqr along a plan that begins in a phase "
                    "before it. Use al.Sequential(), the default."
                )
        meshes = [Mesh(first_nodes(problem, one), self.scheme, own.signals.have_jumps) for one, own in phases]
        return joined(problem, meshes)

    @override
    def transcribed(self, problem: Problem, meanwhile: Meanwhile) -> SimultaneouslyTranscribed:
        functionals = functionals_of(problem.expressions)
        if names := _inside(problem):
            points = np.asarray(discretised(problem).collocation.points)
            raise ProblemError(
                f"al.Simultaneous ties states at fixed shares of the time: it has no place for the event '{names[0]}' "
                f"inside a grid. {phases_to_write(problem, names, points)}"
            )
        if any(isinstance(one, FloquetMultiplier) for one in functionals):
            raise ProblemError(
                "al.floquet_multiplier() is that of a simulation around the cycle: use al.Sequential(), the default."
            )
        meshes = self._first_meshes(problem)
        discretisation, traced = discretised(problem), numbers_to_arrays(problem)
        scenarios = first_scenarios(problem, np.asarray(discretisation.collocation.points))
        discretisation = discretisation.at_scenarios(scenarios)
        meanwhile(problem, discretisation)
        raised = () if self.most_stages is None else self.scheme.raised(self.most_stages)
        goal = Goal(np.inf if self.error is None else float(self.error), (self.scheme, *raised))
        return Recipe(problem, traced, traced, discretisation, scenarios, goal, self._start).on(meshes)


def _inside(problem: Problem) -> list[str]:
    """The events that are looked for inside the grids of a problem."""
    events, names = events_of(functionals_of(problem.expressions)), list[str]()
    for phase, one in problem.simulation.phases.items():
        if isinstance(one.system, System) and isinstance(one.grid, Grid):
            names += watched(one.system, one.grid, within(phase, events) if phase else events)
    return names


def _check_stages(scheme: AbstractScheme, error: float | None, most: int) -> None:
    """Refuse a largest number of stages that no refined mesh could have."""
    if whole("Simultaneous: most_stages", most) > MOST_STAGES:
        raise refusal("Simultaneous: most_stages", f"at most {MOST_STAGES} stages", most)
    if error is None:
        raise ProblemError(
            "Simultaneous: most_stages says how meshes may be refined: expected an error to refine them for, such as "
            "error=1e-6; received none."
        )
    if not scheme.raised(most):
        raise ProblemError(
            f"Simultaneous: most_stages: expected a scheme whose stages can be raised to {most}, such as "
            f"al.schemes.Radau(3) to 8; received {scheme}."
        )


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
