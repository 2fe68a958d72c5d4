"""The answer to a problem: its design, what was limited, what it took, and what certifies it."""

import importlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.leaves import Drawn, Printed
from aleator.design import AbstractFunctional, Constraint, Problem, instants_at, instants_of, problem_text
from aleator.nlp import HELD, Searched, Status
from aleator.solution._certificate import Certificate, Moments, Objection
from aleator.solution._grid import Costates, MeshError, States, Switching, lines, system_text
from aleator.solution._motions import Motions
from aleator.trajectories import AbstractSignal


@final
@dataclass(frozen=True)
class Branching(Printed):
    """How a solution's integers and choices were found, and what is known of all others.

    - `combinations`: how many there are in all;
    - `nodes`: relaxed solves, in which those that are not decided yet are numbers between bounds, or where there are
      few combinations (`listed`), solves of each;
    - `passed_over`: those whose certificate failed, or whose solve did, and which may be better than the answer;
    - `bound`: no combination has an objective below it, as far as each node was solved to its *global* optimum: so it
      is where the relaxed problem is convex, which nobody checks. `gap`: the objective less the bound;
    - `better`: the best combination that was passed over, if its node is below the answer, in words; else empty;
    - `is_finished`: whether all nodes below the answer were looked at; else Ctrl-C or the limit of nodes ended it;
    - `is_proven`: whether no local optimum is involved: every combination was tried, and nothing else is decided.
    """

    combinations: int
    nodes: int
    passed_over: int
    listed: bool
    bound: float
    gap: float
    better: str
    is_finished: bool
    is_proven: bool

    def __str__(self) -> str:
        passed = f"; {self.passed_over} were passed over, whose certificates failed" if self.passed_over else ""
        passed += f", {self.better} among them" if self.better else ""
        if self.listed and self.is_finished:
            local = "" if self.is_proven else ", each to a local optimum"
            return f"the best of {self.combinations} combinations, all of which were solved{local}{passed}"
        many = f"{self.combinations}" if self.combinations < 1e6 else f"10^{math.log10(self.combinations):.0f}"
        ended = "" if self.is_finished else "not finished: "
        return (
            f"{ended}of {many} combinations {self.nodes} nodes were solved; none is below {self.bound:.8g} (gap "
            f"{self.gap:.2g}) if the relaxed problem is convex, which is not checked{passed}"
        )


@final
@dataclass(frozen=True)
class Times(Printed):
    """Wall times in seconds. `compile_` is zero if a problem of the same structure was compiled before."""

    import_: float
    compile_: float
    solve: float

    def __str__(self) -> str:
        return f"import {self.import_:.2f} s, compile {self.compile_:.2f} s, solve {self.solve:.3f} s"


@final
@dataclass(frozen=True)
class Effort(Printed):
    """Iterations, evaluations and times of a solve.

    - `solver`: its name and version; `iterations`: as the solver counts them, over all restarts;
    - `evaluations`: points at which the problem was simulated; `times`: wall times;
    - `at_means`: whether the answer to the deterministic problem started this one; None if that was not solved first;
    - `searched`: the history of a search without derivatives, if there was one; its evaluations are counted;
    - `visited`: the history of the local solver (`al.reporting.search_figure` draws it), if there was one.
    """

    solver: str
    iterations: int
    evaluations: int
    times: Times
    at_means: bool | None = None
    searched: Searched | None = None
    visited: Searched | None = None

    def __str__(self) -> str:
        before = {None: "", True: "from the answer at the means: ", False: "without an answer at the means: "}[
            self.at_means
        ]
        before += "" if self.searched is None else f"{self.searched}; in all "
        return f"{before}{self.iterations} iterations, {self.evaluations} evaluations; {self.times}"


@final
@dataclass(frozen=True)
class ConstraintResult(Printed):
    """One constraint at a solution, in user units.

    - `values`: values of its expression, one number or one per instant; `times`: the instants (s), None for one number;
    - `multipliers`: the shadow prices, `-d objective / d bound`, in the shape of `values`: positive where the
      upper bound is active, negative where the lower one is;
    - `active`: where it is active, in the shape of `values`;
    - `scale`: its magnitude in its own unit, from its bound and its values near the answer (see `constraint_size` of
      the transcription). It holds if it exceeds its bound by at most a millionth of this.
    """

    name: str
    text: str
    lower: float
    upper: float
    values: Float[np.ndarray, "*shape"]
    times: Float[np.ndarray, " instants"] | None
    multipliers: Float[np.ndarray, "*shape"]
    active: np.ndarray
    scale: float

    @property
    def excess(self) -> Float[np.ndarray, "*shape"]:
        """Excess over the nearer bound; negative where the constraint holds with slack."""
        return np.maximum(self.values - self.upper, self.lower - self.values)

    @property
    def violation(self) -> float:
        """Largest excess over a bound; zero if the constraint holds everywhere."""
        return max(0.0, float(np.max(self.excess)))

    @property
    def holds(self) -> bool:
        """Whether it holds everywhere, to a millionth of its magnitude."""
        return self.violation <= HELD * self.scale

    @property
    def worst_time(self) -> float | None:
        """The instant (s) at which the constraint is closest to, or furthest beyond, its bound."""
        if self.times is None:
            return None
        return float(self.times[np.argmax(self.excess.reshape(len(self.times), -1).max(axis=1))])

    @property
    def worst(self) -> float:
        """The value that is closest to, or furthest beyond, its bound."""
        return float(self.values.flat[int(np.argmax(self.excess))])

    @property
    def shadow_price(self) -> float:
        """How much the objective falls for each unit by which the bound is relaxed, summed over its active instants.

        For an equality: how much the objective falls for each unit by which its right-hand side is raised, which may be
        negative.
        """
        return float(np.sum(self.multipliers if self.lower == self.upper else np.abs(self.multipliers)))

    @property
    def _when(self) -> str:
        return "" if self.worst_time is None else f" at t = {self.worst_time:.4g} s"

    def sentence(self) -> str:
        """Which constraint is violated, by how much and when, with its text."""
        bound, relation = (self.upper, "≤") if self.worst > self.upper else (self.lower, "≥")
        relation = "=" if self.lower == self.upper else relation
        asked = f"{self.worst:.6g} where {relation} {bound:.6g} is asked ({self.text})"
        return f"'{self.name}' is violated by {self.violation:.4g}{self._when}: {asked}"

    def __str__(self) -> str:
        if not self.holds:
            return self.sentence()
        active = f"active{self._when}, shadow price {self.shadow_price:.4g}"
        slack = f"slack {-float(np.max(self.excess)):.4g}{self._when}"
        return f"{self.name}: {self.text}: {active if np.any(self.active) else slack}"


@final
@dataclass(frozen=True, repr=False)
class Solution(Drawn):
    """An optimal design and its certificate. `print(solution)` shows both.

    - `status`: how it ended; `message`: that of the solver, or why its answer was rejected;
    - `decisions`: by name, in user units; `vector`: the same as one vector, in the order of `problem.placements`;
    - `objective`: its value in user units;
    - `constraints`: values, activity and multipliers, in the order of `problem.constraints`;
    - `moments`: mean and standard deviation of each functional in the problem, by its text (`"∫comfort dt"`);
    - `statistics`: every statistic in the problem, by its text (`"Q0.99[rms(x)]"`);
    - `at_bounds`: names of the decisions that lie at one of their own bounds;
    - `idle`: names of the decisions that were left at their start because nothing was found to depend on them;
    - `multipliers`: of all rows of constraints in one vector, for warm starts; `bound_multipliers`: of the decisions'
      own bounds, by name;
    - `certificate`: how far the answer can be trusted; `effort`: iterations, evaluations and times;
    - `meshes`: the history of meshes of a simultaneous program, with their errors, that of the answer last (`mesh`);
      empty for others;
    - `mesh_states`: of all realisations of a simultaneous program, at the points of its mesh; `costates`: by what a
      push of a state would change the objective; `switching`: by what a push of an input would. None where states are
      simulated, the latter two also where the search was not finished;
    - `branching`: how integers and choices were found, and what is known of all others; None if there are none;
    - `over_intervals`: the same design at single values of the intervals (see `Interval`), those that hold it first,
      each a solution of the problem with these numbers; empty if there are no intervals. Of these, `constraints` has
      the worst of each limit and `objective` the worst; everything else is that of the value of the worst objective.

    `inputs`, `states` and `outputs` are the motions, computed when they are asked for: `solution.inputs["force"]` is an
    `xarray.Dataset` of its mean and standard deviation over time and of its course in each system of the expansion.
    """

    problem: Problem
    status: Status
    message: str
    decisions: Mapping[str, Any]
    vector: Float[np.ndarray, " n"]
    objective: float
    constraints: tuple[ConstraintResult, ...]
    moments: Mapping[str, Moments]
    statistics: Mapping[str, Float[np.ndarray, "..."]]
    at_bounds: tuple[str, ...]
    idle: tuple[str, ...]
    multipliers: Float[np.ndarray, " m"]
    bound_multipliers: Mapping[str, Any]
    certificate: Certificate
    effort: Effort
    meshes: tuple[MeshError, ...] = ()
    mesh_states: States | None = None
    costates: Costates | None = None
    switching: Switching | None = None
    branching: Branching | None = None
    over_intervals: tuple["Solution", ...] = ()

    @property
    def ok(self) -> bool:
        """Whether it was solved to tolerance, and the certificate holds: it is an answer to the model too."""
        return self.status is Status.SOLVED and self.objection is None

    @property
    def objection(self) -> Objection | None:
        """What the model says against the optimum of a solved program; None if nothing, or if none was solved."""
        return self.certificate.objection if self.status is Status.SOLVED else None

    @property
    def verdict(self) -> str:
        """How it ended, in a phrase: as its program did or, where that is solved, by what its certificate says."""
        return self.status.value if self.objection is None else f"solved, but {self.objection.phrase}"

    @property
    def mesh(self) -> MeshError | None:
        """The mesh of the answer with its errors, the last of `meshes`; None where states are simulated."""
        return self.meshes[-1] if self.meshes else None

    @property
    def problem_text(self) -> str:
        """The problem as mathematics, with the scheme by which it was solved if states were variables."""
        return problem_text(self.problem, f"{self.mesh.scheme} on {self.mesh.intervals} intervals" if self.mesh else "")

    @property
    def instants(self) -> Float[np.ndarray, " instants"]:
        """The instants of the grid, s; those at the means, where an event ends each realisation at its own time."""
        return instants_at(self.problem, self.vector)

    def times_of(self, path: Constraint | AbstractFunctional) -> Float[np.ndarray, " instants"]:
        """The instants of a path, or of a limit on one, s: those of its phase, where there are phases."""
        return instants_of(path, self.problem.grid, lambda: self.instants)

    @property
    def inputs(self) -> Motions:
        """The inputs of the problem over time, see `Motions`."""
        return _motions().motions(self, "inputs")

    @property
    def states(self) -> Motions:
        """The states over time, see `Motions`; those of the mesh, at its points, where they were variables."""
        return _motions().motions(self, "states")

    @property
    def outputs(self) -> Motions:
        """The outputs of the system over time, see `Motions`."""
        return _motions().motions(self, "outputs")

    def signal(self, name: str) -> AbstractSignal:
        """An input, or the mean of an output, as a function of time: an input of another simulation, or a command.

        `float(solution.signal("force")(0.5))` is the force at 0.5 s. Uncertain numbers are at their means. Before and
        after the motion, or its phase, it has the value at its start and at its end. Raises `ProblemError` for a name
        of neither.
        """
        return _motions().signal_of(self, name)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the active constraints, then of the decisions at a bound."""
        names = [one.name for one in self.constraints if np.any(one.active)]
        return tuple(dict.fromkeys([*names, *self.at_bounds]))

    def is_at_bound(self, name: str) -> bool:
        """Whether a decision, or an entry of one that is an array, lies at one of its own bounds."""
        return any(entry.split("[")[0] == name for entry in self.at_bounds)

    @property
    def violated(self) -> tuple[ConstraintResult, ...]:
        """The constraints that do not hold, worst first."""
        broken = [one for one in self.constraints if not one.holds]
        return tuple(sorted(broken, key=lambda one: -one.violation / one.scale))

    def multiplier(self, name: str) -> float:
        """The shadow price of the bound called `name`: see `ConstraintResult.shadow_price`."""
        return sum(one.shadow_price for one in self.constraints if one.name == name)

    def why(self) -> str:
        """Why it is not solved: the constraints that do not hold, where and by how much."""
        if self.ok:
            return "The problem is solved."
        if self.objection is not None:
            reason = f"{self.objection.sentence.rstrip('.')}."
        else:
            worst_case, misled = self.certificate.worst_case, self.certificate.misled
            # The systems that break limits on the worst case, by the texts of these.
            systems = {one.text: system_text(one.numbers) for one in (worst_case.realisations if worst_case else ())}
            broken = "; ".join(
                one.sentence() + (f" (with {systems[one.text]})" if one.text in systems else "")
                for one in self.violated
            )
            said = (part.rstrip(".") for part in (self.status.value, broken, self.message) if part)
            coarse = f" Perhaps for its grid: {misled}." if misled else ""
            reason = f"{'. '.join(said)}.{coarse}"
        return f"{self.effort.solver}: {reason}"

    def __repr__(self) -> str:
        return f"<Solution of {self.problem.system.title}: {in_brief(self)}>"

    def __str__(self) -> str:
        decisions = (
            f"{name} = {np.array2string(np.asarray(value), precision=7, separator=', ')}{self._at_bound(name)}"
            for name, value in self.decisions.items()
        )
        return lines(
            [
                ("status", f"{self.verdict} by {self.effort.solver}"),
                ("objective", f"{self.objective:.8g} = {self.problem.objective}"),
                *(("decision", text) for text in decisions),
                *(("chosen", str(one)) for one in (self.branching,) if one is not None),
                *(("constraint", str(one)) for one in self.constraints),
                *self.certificate.rows(),
                *(("mesh", str(one)) for one in self.meshes[-1:]),
                ("effort", str(self.effort)),
            ]
        )

    def _at_bound(self, name: str) -> str:
        idle = [entry for entry in self.idle if entry.split("[")[0] == name]
        if idle:
            return f" (at its start: nothing in the problem was found to depend on {', '.join(idle)})"
        return " (at its bound)" if self.is_at_bound(name) else ""


def _motions() -> Any:
    """What simulates a solution, which is above it in the order of imports."""
    return importlib.import_module("aleator.solving._motions")


def in_brief(solution: Solution) -> str:
    """The objective, and whether limits hold and the answer is certified: `objective 3.04, feasible`."""
    if solution.ok:
        return f"objective {solution.objective:.6g}, feasible"
    if solution.status is Status.INFEASIBLE:
        return f"infeasible, violation {solution.certificate.violation:.2g}"
    return solution.verdict
