"""Diagnosis of a problem's realised systems at the initial decisions, before compilation."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator._core.errors import ProblemError
from aleator.design._declaration import AbstractProblem
from aleator.design._expression import Constraint, Expression
from aleator.design._functionals import Path
from aleator.design._statistic import Statistic
from aleator.dynamics import AbstractSystem, Simulation
from aleator.mechanics import AbstractFormulation
from aleator.statistics import Mean
from aleator.uncertainty import AbstractGerm, at_means, placements, realise, uncertain_numbers

# Quantile at which unbounded variables are tried, on either side: one realisation in a billion lies beyond.
_TAIL = 1e-9


def refuse_diagnosed(problem: AbstractProblem) -> None:
    """Raise `ProblemError` for any fault that a system diagnoses, or if its torques cannot hold its start.

    Systems are diagnosed at the means; then with each uncertain number at either end of its distribution and the others
    at their medians; and with each decided number of the system itself (not of a prescribed motion) at either bound.
    """
    if not _speaks(problem.system):
        return
    start = jax_array(problem.placements.vector("initial"))
    _refuse(_at_means(problem, start), "")
    for germ in _extremes(list(problem.placements.germs.values())):
        numbers = uncertain_numbers(problem.placements, jax_array(germ), start)
        where = ", ".join(f"{name} = {float(number):.4g}" for name, number in numbers.items())
        _refuse(realise(problem.simulation, jax_array(germ), start), f" In the system with {where}.")
    for name, decisions in _bounds(problem):
        _refuse(_at_means(problem, decisions), f" In the system with {name}.")
    _refuse_unheld(problem)


def _speaks(system: AbstractSystem) -> bool:
    return type(system).diagnose is not AbstractSystem.diagnose


def _at_means(problem: AbstractProblem, decisions: Any) -> Simulation:
    return realise(at_means(problem.simulation), jax_array(np.zeros(0)), jax_array(decisions))


def _refuse(simulation: Simulation, who: str) -> None:
    try:
        diagnosis = simulation.system.diagnose(simulation.grid)
    except ProblemError as error:
        diagnosis = str(error)
    if diagnosis:
        raise ProblemError(diagnosis + who)


def _extremes(germs: list[AbstractGerm]) -> Iterator[Float[np.ndarray, " variables"]]:
    """Germ points with one variable at an end of its distribution, the others at their medians."""
    middle = np.array([float(germ.quantile(np.array(0.5))) for germ in germs])
    for i, germ in enumerate(germs):
        for end, level in zip(germ.support(), (_TAIL, 1 - _TAIL), strict=True):
            point = middle.copy()
            point[i] = end if np.isfinite(end) else float(germ.quantile(np.array(level)))
            yield point


def _bounds(problem: AbstractProblem) -> Iterator[tuple[str, Float[np.ndarray, " n"]]]:
    """Decisions with one number of the system at a finite bound and the others at their start, with its name.

    Entries of an array are moved together: the moments of a body, for example, may be impossible one at a time.
    """
    system = problem.system
    places, own = (
        problem.placements,
        placements(system.model if isinstance(system, AbstractFormulation) else system).decisions,
    )
    start, names = places.vector("initial"), places.entry_names()
    for i in (
        place.where.start
        for name, place in places.decisions.items()
        if name in own and place.where.stop - place.where.start == 1
    ):
        for bound in (places.vector("lower")[i], places.vector("upper")[i]):
            if np.isfinite(bound) and bound != start[i]:
                decisions = start.copy()
                decisions[i] = bound
                yield f"{names[i]} = {bound:.4g}", decisions


def _refuse_unheld(problem: AbstractProblem) -> None:
    """Refuse limits below the holding torques, where the system starts at rest whatever the decisions are."""
    held = _held(problem)
    for constraint in problem.constraints:
        least, most = _range(constraint.expression, held)
        if least > float(constraint.upper) + 1e-9 or most < float(constraint.lower) - 1e-9:
            named = {name: held[name] for atom in constraint.expression.atoms for name in atom.subjects}
            raise ProblemError(_unheld(constraint, named))


def _unheld(constraint: Constraint, torques: dict[str, float]) -> str:
    needed = ", ".join(f"{name} = {value:.4g}" for name, value in torques.items())
    return (
        f"Constraint '{constraint.name}' ({constraint}) cannot hold the system still at the start, which needs "
        f"{needed} at the means. Raise the limit, lighten the load, start in another posture, or do not prescribe the "
        "acceleration at the start."
    )


def _range(expression: Expression, held: dict[str, float]) -> tuple[float, float]:
    """The range of an expression of means and spreads of torques at the start; unbounded for other expressions."""
    value, least, most = float(expression.constant), 0.0, 0.0
    for factor, atom in zip(expression.factors, expression.atoms, strict=True):
        path = isinstance(atom, Statistic) and isinstance(atom.functionals[0], Path) and atom.functionals[0].output
        if path not in held or not (atom.is_spread or isinstance(atom.kind, Mean)):  # type: ignore[attr-defined]
            return -np.inf, np.inf
        if not atom.is_spread:
            value += float(factor) * held[path]
        elif factor != 0:
            # The spread of torques is not known here, except that it is not negative.
            least, most = (least, np.inf) if factor > 0 else (-np.inf, most)
    return value + least, value + most


def _held(problem: AbstractProblem) -> dict[str, float]:
    """The holding torques at the means, as far as they are the same at other, distant decisions."""
    start, lower, upper = (problem.placements.vector(name) for name in ("initial", "lower", "upper"))
    along = np.linspace(0.25, 0.45, len(start))
    between = np.isfinite(lower) & np.isfinite(upper)
    held = _holding(problem, start)
    for part, step in ((along, 1 + along), (1 - along, -1 - along)):
        inside = np.where(between, lower, 0.0) + part * np.where(between, upper - lower, 0.0)
        decisions = np.where(between, inside, np.clip(start + step, lower, upper))
        other = _holding(problem, decisions) if held else {}
        held = {name: one for name, one in held.items() if np.isclose(one, other.get(name, np.nan), rtol=1e-9)}
    return held


def _holding(problem: AbstractProblem, decisions: Float[np.ndarray, " n"]) -> dict[str, float]:
    simulation = _at_means(problem, decisions)
    try:
        held = simulation.system.holding(simulation.grid)
    except ProblemError:
        # A system that cannot be built there needs no torque.
        return {}
    return {name: float(one) for name, one in held.items()}
