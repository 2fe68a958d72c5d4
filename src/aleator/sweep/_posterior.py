"""`posterior`: how well data have identified the numbers of a model, as distributions for the next design."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from aleator._core.arrays import jax_array, numbers_to_arrays
from aleator._core.border import one_of
from aleator._core.compilation import Compiled
from aleator._core.errors import ProblemError
from aleator._core.leaves import Printed
from aleator.design import Composed, OneSystem, Problem, SquaredResiduals, functionals_of, responses, step_at
from aleator.dynamics import System
from aleator.solution import Solution
from aleator.uncertainty import (
    AbstractDecision,
    AbstractDistribution,
    LogNormal,
    Normal,
    Placements,
    correlated,
    named_numbers,
    refuse_intervals,
    with_decisions,
)

# Parameters that the data do not tell apart: singular values of the Jacobian, its columns being of length 1.
_DEGENERATE = 1e-8
# What an entry of a singular vector is at least if it takes part.
_TAKES_PART = 0.1


@final
@dataclass(frozen=True)
class Posterior(Printed):
    """The normal distribution of identified numbers, given their data, near the best fit.

    - `names`: of the numbers, one for each entry of the decision vector that may have any value: integers and choices
      are known, once they are found; `mean`: their best values, shape (n,);
    - `covariance`: `s² (JᵀJ)⁻¹`, shape (n, n), by the exact Jacobian `J` of the residuals, shape (data, n);
    - `residuals`: `(model - data) / std`, shape (data,);
    - `variance`: `s²`, the sum of their squares over the degrees of freedom, data less numbers. About 1 where `std` is
      that of the measurement; much larger where the model does not fit its data.

    `print(posterior)` shows it.
    """

    solution: Solution
    names: tuple[str, ...]
    mean: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "n n"]
    residuals: Float[np.ndarray, " data"]
    jacobian: Float[np.ndarray, "data n"]
    variance: float

    @property
    def std(self) -> Float[np.ndarray, " n"]:
        """The standard deviation of each number."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Float[np.ndarray, "n n"]:
        """The correlations of the numbers."""
        return self.covariance / np.outer(self.std, self.std)

    @cached_property
    def distributions(self) -> dict[str, AbstractDistribution]:
        """The numbers as correlated distributions, by name, to be placed in another model.

        They are normal; where a decision's lower bound is zero or above, log-normal with the same mean and spread, so
        that a mass stays positive. Raises `ProblemError` if no distributions have correlations so close to 1.
        """
        places = self.solution.problem.placements
        lower = places.vector("lower")[_continuous(places)]
        each: dict[str, AbstractDistribution] = {
            name: (LogNormal if low >= 0 else Normal)(mean=float(mean), std=float(std))
            for name, mean, std, low in zip(self.names, self.mean, self.std, lower, strict=True)
        }
        return correlated(each, self.correlation) if len(each) > 1 else each

    @property
    def system(self) -> System:
        """The model with these distributions in the places of its decisions: uncertain as the data leave it.

        Raises `ProblemError` for a decision that is an array, in whose place no distribution can stand.
        """

        def placed(name: str, decision: AbstractDecision) -> Any:
            if decision.values is not None:
                return float(self.solution.decisions[name])
            if decision.shape:
                raise ProblemError(
                    f"Posterior.system: '{name}' is an array of decisions, which no distribution replaces; take those "
                    "of its entries from Posterior.distributions."
                )
            one = self.distributions[name]
            return one.shared(decision.shared_name) if decision.shared_name else one

        system = with_decisions(self.solution.problem.simulation, placed).system
        assert isinstance(system, System)
        return system

    def __str__(self) -> str:
        freedom, width = len(self.residuals) - len(self.names), max(map(len, self.names))
        rows = [f"s² = {self.variance:.4g} from {len(self.residuals)} data, {freedom} degrees of freedom"]
        for i, name in enumerate(self.names):
            told = "".join(f", correlation {self.correlation[i, j]:.3f} with {self.names[j]}" for j in range(i))
            rows.append(f"{name:<{width}} = {self.mean[i]:.6g} ± {self.std[i]:.2g}{told}")
        return "\n".join(rows)


def posterior(solution: Solution, *, known_std: bool = False) -> Posterior:
    """How well data have identified the numbers of a model: their covariance at the best fit, `s² (JᵀJ)⁻¹`.

        fit = al.solve(al.Problem(model, grid=grid, minimize=al.residuals("x", times, data)))
        found = al.posterior(fit)
        uncertain_model = found.system  # ready for a robust design

    It is the normal distribution of linear regression about the answer, without knowledge before the data: good where
    the model is nearly linear within the spread of its numbers.

    - `solution`: that of a deterministic problem whose objective is a sum of `al.residuals`, its decisions being the
      numbers to be identified;
    - `known_std`: whether the `std` of the residuals is known to be that of the measurement. Then `s² = 1` in the
      covariance; by default only the ratios of `std` count, and the residuals tell their size.

    Source: Seber and Wild, Nonlinear Regression (1989), section 2.1. Raises `ProblemError` for a fit that failed, an
    objective of anything else, fewer data than numbers, a number that no datum depends on, numbers that the data do not
    tell apart, and one at a bound or a limit, where its distribution is not normal.
    """
    problem = one_of("posterior: solution", solution, Solution).problem
    _refuse_other_problems(solution, one_of("posterior: known_std", known_std, bool))
    free = _continuous(problem.placements)
    names = tuple(name for name, is_free in zip(problem.placements.entry_names(), free, strict=True) if is_free)
    residuals, jacobian = map(np.asarray, _FITTED(numbers_to_arrays(problem), jax_array(solution.vector)))
    jacobian = jacobian[:, free]
    freedom = len(residuals) - len(names)
    if freedom < (0 if known_std else 1):
        raise ProblemError(
            f"posterior: expected more data than numbers to identify; received {len(residuals)} data and {len(names)} "
            f"numbers: {', '.join(names)}."
        )
    lengths = np.linalg.norm(jacobian, axis=0)
    if idle := [name for name, length in zip(names, lengths, strict=True) if length == 0]:
        raise ProblemError(
            f"posterior: expected numbers that the data depend on; received '{idle[0]}', by which no residual changes. "
            "Make it a plain number, or measure an output that depends on it."
        )
    _, singular, directions = np.linalg.svd(jacobian / lengths, full_matrices=False)
    if singular[-1] < _DEGENERATE * singular[0]:
        alike = [f"'{name}'" for name, part in zip(names, directions[-1], strict=True) if abs(part) > _TAKES_PART]
        raise ProblemError(
            f"posterior: expected numbers that the data tell apart; received {' and '.join(alike)}, which can change "
            "together without any residual. Make one of them a plain number, or measure another output."
        )
    variance = float(residuals @ residuals) / freedom if freedom else 1.0
    root = directions.T / singular / lengths[:, None]
    covariance = (1.0 if known_std else variance) * root @ root.T
    return Posterior(solution, names, solution.vector[free], covariance, residuals, jacobian, variance)


def _continuous(places: Placements) -> Bool[np.ndarray, " entries"]:
    """Which entries of the decision vector may have any value."""
    free = np.ones(len(places.entry_names()), bool)
    for place in places.decisions.values():
        free[place.where] = place.decision.values is None
    return free


def _refuse_other_problems(solution: Solution, known_std: bool) -> None:
    problem, objective = solution.problem, solution.problem.objective
    refuse_intervals("posterior", problem.placements)
    rules = [atom.rule if isinstance(atom, Composed) else None for atom in objective.atoms]
    chosen = {name for name, place in problem.placements.decisions.items() if place.decision.values is not None}
    active = [name for name in solution.active if name not in chosen]
    if (
        not rules
        or not all(isinstance(one, SquaredResiduals) for one in rules)
        or min(map(float, objective.factors)) <= 0
    ):
        expected, received = "an objective of al.residuals alone", f"'{objective}'"
    elif known_std and any(getattr(rule, "std", None) is None for rule in rules):
        expected, received = "a `std` in each al.residuals, for known_std", "one without"
    elif problem.placements.distributions:
        expected = "a model without distributions, such as al.deterministic(problem)"
        received = f"{list(problem.placements.distributions)}"
    elif not solution.ok:
        expected, received = "a fit that succeeded", f"one that failed: {solution.why().rstrip('.')}"
    elif active:
        expected = "a fit inside all bounds and limits, where what the data say is normal"
        received = f"one at that of '{active[0]}': widen it, or make a number at its bound a plain one"
    else:
        return
    raise ProblemError(f"posterior: expected {expected}; received {received}.")


def _fitted(problem: Problem, decisions: Float[Array, " n"]) -> tuple[Float[Array, " data"], Float[Array, "data n"]]:
    """The residuals at some decisions, and their Jacobian."""
    functionals = functionals_of((problem.objective,))

    def residuals(decisions: Float[Array, " n"]) -> tuple[Array, Array]:
        samples = responses(problem, functionals, jnp.zeros((1, 0)), decisions)
        values = {one: sample[0] for one, sample in zip(functionals, samples, strict=True)}
        scope = OneSystem(values, named_numbers(problem.simulation, decisions), step_at(problem, decisions))
        rows = [
            jnp.sqrt(factor) * atom.rule.residuals(atom.expressions[0].evaluate(scope)).ravel()  # type: ignore[union-attr]
            for factor, atom in zip(problem.objective.factors, problem.objective.atoms, strict=True)
        ]
        every = jnp.concatenate(rows)
        return every, every

    jacobian, values = jax.jacfwd(residuals, has_aux=True)(decisions)
    return values, jacobian


_FITTED = Compiled(_fitted)
