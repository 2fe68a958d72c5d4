"""`Solution`: the answer to a problem, with what certifies it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.design._certificate import (
    Between,
    ConstraintResult,
    ExpansionQuality,
    Moments,
    Times,
)
from aleator.design._grid_error import GridError
from aleator.design._opinion import SecondOpinion
from aleator.design._problem import Problem
from aleator.design._response import grid_at
from aleator.design._worst_case import WorstCase
from aleator.nlp import Status


@final
@dataclass(frozen=True)
class Solution:
    """An optimal design and its certificate. `print(solution)` shows both.

    - `decisions`: by name, in user units; `vector`: the same as one vector, in the order of `problem.survey`;
    - `objective`: its value in user units;
    - `constraints`: values, activity and multipliers, in the order of `problem.constraints`;
    - `moments`: mean and standard deviation of each functional in the problem, by its text (`"∫comfort dt"`);
    - `statistics`: every statistic that stands in the problem, by its text (`"Q0.99[rms(x)]"`);
    - `at_bounds`: names of the decisions that stand at one of their own bounds;
    - `idle`: names of the decisions, left at their start, on which nothing in the problem was seen to depend;
    - `bound_multipliers`: of the decisions' own bounds, by name;
    - `violation`, `stationarity`, `complementarity`: residuals of the optimality conditions, scaled, computed from the
      point and its multipliers and not taken from the solver;
    - `multipliers`: all constraint multipliers in one vector, for warm starts;
    - `evaluations`: points at which the problem was simulated;
    - `between`: how far limits over time are exceeded between instants; None where that was not looked at;
    - `grid_error`: how far a finer grid and an integrator of another order differ; None where time plays no part;
    - `opinion`: what a few fresh simulations at the answer say of the expansions; None where nothing is uncertain, or
      nothing was solved;
    - `worst_case`: the worst realisations of limits on the worst case; None where there are none;
    - `misled`: where nothing was solved, a sentence on what the grid is far off at the start of the search; else empty.
    """

    problem: Problem
    status: Status
    decisions: Mapping[str, Any]
    vector: Float[np.ndarray, " n"]
    objective: float
    constraints: tuple[ConstraintResult, ...]
    moments: Mapping[str, Moments]
    statistics: Mapping[str, Float[np.ndarray, "..."]]
    at_bounds: tuple[str, ...]
    bound_multipliers: Mapping[str, Any]
    multipliers: Float[np.ndarray, " m"]
    violation: float
    stationarity: float
    complementarity: float
    iterations: int
    evaluations: int
    times: Times
    solver: str
    message: str
    expansion: ExpansionQuality
    between: Between | None = None
    grid_error: GridError | None = None
    idle: tuple[str, ...] = ()
    opinion: SecondOpinion | None = None
    worst_case: WorstCase | None = None
    misled: str = ""

    @property
    def ok(self) -> bool:
        """Whether it was solved to tolerance, and limits hold between instants too where that was looked at."""
        return self.status is Status.SOLVED

    @property
    def instants(self) -> Float[np.ndarray, " instants"]:
        """The instants of the grid, s."""
        return np.asarray(grid_at(self.problem, jnp.asarray(self.vector)).times)

    @property
    def active(self) -> tuple[str, ...]:
        """Names of the active constraints, then of the decisions that stand at a bound."""
        names = [one.name for one in self.constraints if np.any(one.active)]
        return tuple(dict.fromkeys([*names, *self.at_bounds]))

    def is_at_bound(self, name: str) -> bool:
        """Whether a decision, or an entry of one that is an array, stands at one of its own bounds."""
        return any(entry.split("[")[0] == name for entry in self.at_bounds)

    @property
    def violated(self) -> tuple[ConstraintResult, ...]:
        """The constraints that do not hold, worst first."""
        broken = [one for one in self.constraints if not one.holds]
        return tuple(sorted(broken, key=lambda one: -one.violation / one.scale))

    def multiplier(self, name: str) -> float:
        """The price of the bound called `name`: see `ConstraintResult.price`."""
        return sum(one.price for one in self.constraints if one.name == name)

    def why(self) -> str:
        """Why it is not solved: the constraints that do not hold, where and by how much."""
        if self.ok:
            return "The problem is solved."
        if self.status is Status.NOT_HELD and self.between is not None:
            return (
                f"{self.solver}: solved at the instants of the grid, but {self.between.sentence()}, or between=1 to "
                "look at the instants alone."
            )
        if self.status is Status.WORST_CASE_BROKEN and self.worst_case is not None:
            return f"{self.solver}: {self.status.value}. {self.worst_case.broken()}"
        if self.status is Status.COARSE and self.grid_error is not None:
            return (
                f"{self.solver}: solved on {self.grid_error.steps} steps, but {self.grid_error}. {self.message}".strip()
            )
        if self.status is Status.CONTRADICTED and self.opinion is not None:
            return (
                f"{self.solver}: solved for the expansion, but {self.opinion.samples} fresh simulations contradict it: "
                f"{self.opinion.broken}. Raise the order of the expansion."
            )
        if self.status is Status.UNRESOLVED:
            return (
                f"{self.solver}: solved for the expansion of order {self.expansion.order}, but {self.message}. Raise "
                "the order; or say that you accept it, al.Expansion(order, tolerance=...), and trust al.validate alone."
            )
        broken = "; ".join(one.sentence() + self._realisation(one) for one in self.violated)
        coarse = f" Perhaps for its grid: {self.misled}. Use more steps." if self.misled else ""
        return f"{self.solver}: {self.status.value}. {broken or self.message}.{coarse}"

    def _realisation(self, one: ConstraintResult) -> str:
        """By which system a limit on the worst case is broken, in words; nothing for other constraints."""
        worst = None if self.worst_case is None else self.worst_case.of(one.text)
        return "" if worst is None else f" (with {worst.system})"

    def __str__(self) -> str:
        return _solution_text(self)


def _solution_text(solution: Solution) -> str:
    """Status, objective, decisions, constraints and certificate, a line each."""
    rows = [
        ("status", f"{solution.status.value} by {solution.solver}"),
        ("objective", f"{solution.objective:.8g} = {solution.problem.objective}"),
        *(
            ("decision", f"{name} = {_shown(value)}{_at_bound(solution, name)}")
            for name, value in solution.decisions.items()
        ),
        *(("constraint", _constraint_text(one)) for one in solution.constraints),
        *([] if solution.between is None else [("between", solution.between.sentence())]),
        *([] if solution.grid_error is None else [("grid", str(solution.grid_error))]),
        *(("worst case", row) for row in (solution.worst_case.rows() if solution.worst_case else ())),
        ("certificate", _certificate_text(solution)),
        ("expansion", _expansion_text(solution)),
        *([("derivatives", _tangent_text(solution.expansion))] if solution.expansion.worst_tangent else []),
        *([("fresh", solution.opinion.sentence())] if solution.opinion else []),
        *([("not seen", solution.expansion.unseen.sentence())] if solution.expansion.unseen else []),
        ("effort", _effort_text(solution)),
    ]
    return "\n".join(f"{label:<12} {text}" for label, text in rows)


def _shown(value: Any) -> str:
    return np.array2string(np.asarray(value), precision=7, separator=", ")


def _at_bound(solution: Solution, name: str) -> str:
    idle = [entry for entry in solution.idle if entry.split("[")[0] == name]
    if idle:
        return f" (at its start: nothing asked here was seen to depend on {', '.join(idle)})"
    return " (at its bound)" if solution.is_at_bound(name) else ""


def _constraint_text(one: ConstraintResult) -> str:
    if not one.holds:
        return one.sentence()
    when = "" if one.worst_time is None else f" at t = {one.worst_time:.4g} s"
    state = (
        f"active{when}, price {one.price:.4g}"
        if np.any(one.active)
        else f"slack {-float(np.max(one.excess)):.4g}{when}"
    )
    return f"{one.name}: {one.text}: {state}"


def _certificate_text(solution: Solution) -> str:
    return (
        f"violation {solution.violation:.1e}, stationarity {solution.stationarity:.1e}, "
        f"complementarity {solution.complementarity:.1e} (scaled)"
    )


def _expansion_text(solution: Solution) -> str:
    quality = solution.expansion
    if quality.points == 1:
        return "nothing is uncertain"
    return (
        f"order {quality.order}, {quality.terms} terms, {quality.points} points, condition number "
        f"{quality.condition_number:.3g}, worst leave-one-out error {quality.worst:.2e}"
    )


def _tangent_text(quality: ExpansionQuality) -> str:
    """How well the derivatives by distribution parameters are resolved, and what follows where they are not."""
    worst = quality.worst_tangent
    assert worst is not None
    said = (
        f"by distribution parameters: worst leave-one-out error {worst.error:.2e} "
        f"({worst.functional} by {worst.parameter})"
    )
    if worst.error <= quality.tolerance:
        return said
    return (
        f"{said}: not resolved, so prices and stationarity are those of the expansion; raise the order for the model's"
    )


def _effort_text(solution: Solution) -> str:
    times = solution.times
    return (
        f"{solution.iterations} iterations, {solution.evaluations} evaluations; "
        f"import {times.import_:.2f} s, compile {times.compile_:.2f} s, solve {times.solve:.3f} s"
    )
