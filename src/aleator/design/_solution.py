"""`Solution`: the answer to a problem, with what certifies it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.collocation import UNRESOLVED
from aleator.design._problem import Problem
from aleator.design._response import grid_at
from aleator.nlp import Status

HELD = 1e-6
"""A limit holds where it is exceeded by no more than this part of its scale: solvers meet it to a tolerance."""


@final
@dataclass(frozen=True)
class ConstraintResult:
    """One constraint at a solution, in user units.

    - `values`: its expression, a number or one number an instant; `times`: the instants (s), None for a number;
    - `multipliers`: the price of the bound, `-d objective / d bound`, in the shape of `values`: positive where the
      upper bound is active, negative where the lower one is;
    - `active`: where it is active, in the shape of `values`;
    - `scale`: a typical magnitude, to which tolerances are relative.
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
        """By how much the nearer bound is exceeded; negative inside."""
        return np.maximum(self.values - self.upper, self.lower - self.values)

    @property
    def violation(self) -> float:
        """Largest excess over a bound, zero if it holds everywhere."""
        return max(0.0, float(np.max(self.excess)))

    @property
    def holds(self) -> bool:
        """Whether it holds everywhere, to tolerance."""
        return self.violation <= HELD * self.scale

    @property
    def worst_time(self) -> float | None:
        """The instant (s) at which the constraint is closest to, or furthest beyond, its bound."""
        return None if self.times is None else float(self.times[np.argmax(_by_instant(self.excess))])

    @property
    def price(self) -> float:
        """How much the objective falls for each unit by which the bound is relaxed, summed over its active instants.

        An equality is not relaxed but moved: there it is how much the objective falls for each unit by which the number
        is raised, which may be negative.
        """
        if self.lower == self.upper:
            return float(np.sum(self.multipliers))
        return float(np.sum(np.abs(self.multipliers)))

    @property
    def worst(self) -> float:
        """The value that is closest to, or furthest beyond, its bound."""
        return float(self.values.flat[int(np.argmax(self.excess))])

    def sentence(self) -> str:
        """What is violated, when and by how much."""
        when = "" if self.worst_time is None else f" at t = {self.worst_time:.4g} s"
        worst = self.worst
        bound, relation = (self.upper, "≤") if worst > self.upper else (self.lower, "≥")
        asked = f"{worst:.6g} where {relation} {bound:.6g} is asked"
        return f"'{self.name}' is violated by {self.violation:.4g}{when}: {asked}"


def _by_instant(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1).max(axis=1)


@final
@dataclass(frozen=True)
class Times:
    """Wall times in seconds. `compile_` is zero if a problem of the same structure was compiled before."""

    import_: float
    compile_: float
    solve: float


@final
@dataclass(frozen=True)
class ExpansionQuality:
    """How far the expansion can be trusted at the solution.

    - `order`, `terms`, `points`: those of the expansion, as far as they were reached where it adapts to the problem;
    - `condition_number`: that of the collocation matrix;
    - `leave_one_out`: for each functional, the squared error of predicting a collocation point from all others,
      relative to the variance;
    - `unresolved_from`: for each path that is followed only so far, the instant (s) from which on that error is too
      large: polynomials of one order do not follow a long simulation for ever.
    """

    order: int
    terms: int
    points: int
    condition_number: float
    leave_one_out: Mapping[str, float] = field(default_factory=dict)
    unresolved_from: Mapping[str, float] = field(default_factory=dict)

    @property
    def worst(self) -> float:
        """The largest leave-one-out error."""
        return max(self.leave_one_out.values(), default=0.0)

    @property
    def unresolved(self) -> tuple[str, ...]:
        """The functionals whose statistics cannot be trusted, because their error is too large, at least at the end."""
        errors = self.leave_one_out.items()
        return tuple(text for text, error in errors if not error <= UNRESOLVED or text in self.unresolved_from)

    @property
    def can_be_checked(self) -> bool:
        """Whether points are left to check it by: interpolation and sparse quadrature have none."""
        return not any(np.isposinf(error) for error in self.leave_one_out.values())

    def since(self, text: str) -> str:
        """From when on a path is not resolved, in words; nothing for other functionals."""
        return f" from t = {self.unresolved_from[text]:.4g} s on" if text in self.unresolved_from else ""


@final
@dataclass(frozen=True)
class Between:
    """How far limits over time are exceeded between the instants of the grid, at worst.

    - `worst`: relative to the bound, or to the constraint's scale where that is zero; zero where all hold;
    - `name`: of the constraint; `time`: when, s.
    """

    worst: float
    name: str
    time: float

    @property
    def holds(self) -> bool:
        """Whether all limits hold there, to tolerance."""
        return self.worst <= HELD


@final
@dataclass(frozen=True)
class Moments:
    """Mean and standard deviation of one functional by the expansion: numbers, or one number an instant."""

    mean: Float[np.ndarray, "*shape"]
    std: Float[np.ndarray, "*shape"]


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
    - `bound_multipliers`: of the decisions' own bounds, by name;
    - `violation`, `stationarity`, `complementarity`: residuals of the optimality conditions, scaled, computed from the
      point and its multipliers and not taken from the solver;
    - `multipliers`: all constraint multipliers in one vector, for warm starts;
    - `evaluations`: points at which the problem was simulated;
    - `between`: how far limits over time are exceeded between instants; None where that was not looked at.
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

    @property
    def ok(self) -> bool:
        """Whether the problem was solved to tolerance."""
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
        broken = "; ".join(one.sentence() for one in self.violated)
        return f"{self.solver}: {self.status.value}. {broken or self.message}."

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
        *([] if solution.between is None else [("between", _between_text(solution.between))]),
        ("certificate", _certificate_text(solution)),
        ("expansion", _expansion_text(solution)),
        ("effort", _effort_text(solution)),
    ]
    return "\n".join(f"{label:<12} {text}" for label, text in rows)


def _shown(value: Any) -> str:
    return np.array2string(np.asarray(value), precision=7, separator=", ")


def _at_bound(solution: Solution, name: str) -> str:
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


def _between_text(between: Between) -> str:
    if between.holds:
        return "limits over time hold between the instants of the grid too"
    when = f"after t = {between.time:.4g} s"
    return f"'{between.name}' is exceeded by {between.worst:.2g} of it {when}: use more steps"


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


def _effort_text(solution: Solution) -> str:
    times = solution.times
    return (
        f"{solution.iterations} iterations, {solution.evaluations} evaluations; "
        f"import {times.import_:.2f} s, compile {times.compile_:.2f} s, solve {times.solve:.3f} s"
    )
