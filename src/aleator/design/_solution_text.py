"""A solution as a few lines of text."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from aleator.design._solution import ConstraintResult, Solution


def solution_text(solution: "Solution") -> str:
    """Status, objective, decisions, constraints and certificate, a line each."""
    rows = [
        ("status", f"{solution.status.value} by {solution.solver}"),
        ("objective", f"{solution.objective:.8g} = {solution.problem.objective}"),
        *(
            ("decision", f"{name} = {_shown(value)}{_at_bound(solution, name)}")
            for name, value in solution.decisions.items()
        ),
        *(("constraint", _constraint_text(one)) for one in solution.constraints),
        ("certificate", _certificate_text(solution)),
        ("expansion", _expansion_text(solution)),
        ("effort", _effort_text(solution)),
    ]
    return "\n".join(f"{label:<12} {text}" for label, text in rows)


def _shown(value: Any) -> str:
    return np.array2string(np.asarray(value), precision=7, separator=", ")


def _at_bound(solution: "Solution", name: str) -> str:
    return " (at its bound)" if any(entry.split("[")[0] == name for entry in solution.at_bounds) else ""


def _constraint_text(one: "ConstraintResult") -> str:
    if not one.holds:
        return one.sentence()
    when = "" if one.worst_time is None else f" at t = {one.worst_time:.4g} s"
    state = (
        f"active{when}, price {one.price:.4g}"
        if np.any(one.active)
        else f"slack {-float(np.max(one.excess)):.4g}{when}"
    )
    return f"{one.name}: {one.text}: {state}"


def _certificate_text(solution: "Solution") -> str:
    return (
        f"violation {solution.violation:.1e}, stationarity {solution.stationarity:.1e}, "
        f"complementarity {solution.complementarity:.1e} (scaled)"
    )


def _expansion_text(solution: "Solution") -> str:
    quality = solution.expansion
    if quality.points == 1:
        return "nothing is uncertain"
    return (
        f"order {quality.order}, {quality.terms} terms, {quality.points} points, condition number "
        f"{quality.condition_number:.3g}, worst leave-one-out error {quality.worst:.2e}"
    )


def _effort_text(solution: "Solution") -> str:
    times = solution.times
    return (
        f"{solution.iterations} iterations, {solution.evaluations} evaluations; "
        f"import {times.import_:.2f} s, compile {times.compile_:.2f} s, solve {times.solve:.3f} s"
    )
