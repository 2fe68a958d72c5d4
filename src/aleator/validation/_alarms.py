"""Where sampled evidence contradicts a solution: statistics that both give, and limits that hold for all systems."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from aleator.design import Problem, Statistic, expanded_functionals, functionals_of, is_worst_case, sizes
from aleator.references._estimate import group_count
from aleator.solution import Solution
from aleator.statistics import (
    Correlation,
    Covariance,
    Infimum,
    Kurtosis,
    Mean,
    Probability,
    Quantile,
    Skewness,
    Std,
    Supremum,
    Variance,
)
from aleator.validation._compared import Compared
from aleator.validation._disagreement import Disagreement, is_rare, worst_disagreement
from aleator.validation._evidence import Checked, Sampled
from aleator.validation._proportion import Proportion

# A spread below this fraction of the magnitude behind a functional is rounding.
_ROUNDING = 1e-11


class Found(NamedTuple):
    """The samples of a problem, and its solution; see the fields of `Evidence`. `values`: samples of numbers."""

    solution: Solution
    problem: Problem
    samples: int
    functionals: Mapping[str, Sampled]
    statistics: Mapping[str, Checked]
    values: Mapping[str, Float[np.ndarray, " samples"]]
    violations: Mapping[str, Proportion]
    compared: tuple[Compared, ...]


def disagreements(found: Found) -> tuple[Disagreement, ...]:
    """The numbers that samples contradict; none for a deterministic design, which has no expansion."""
    if not found.solution.problem.placements.germs:
        return ()
    told = [*_moments(found), *_statistics(found), *_limits(found)]
    return tuple(told) if not told else tuple(one for one in told if not _is_rounding(one, found))


def _moments(found: Found) -> Iterator[Disagreement]:
    times, samples = found.solution.instants, found.samples
    # Functionals with only a worst case do not use the expansion.
    for text in (one.text() for one in expanded_functionals(found.problem.expressions)):
        one = found.functionals[text]
        when = times if np.ndim(one.mean) else None
        size = float(np.max(np.abs(one.mean)))
        spread = 0.0 if when is None else float(np.max(one.std))
        told_before = _of_the_grid(found.solution, text)
        parts = (
            (f"μ[{text}]", one.expanded_mean, one.mean, one.standard_error),
            (f"σ[{text}]", one.expanded_std, one.std, one.std_error),
        )
        for part in parts:
            told = worst_disagreement(
                *part,
                samples=samples,
                freedom=samples - 1,
                size=size,
                spread=spread,
                known=told_before,
                times=when,
            )
            if told is not None:
                yield told


def _of_the_grid(solution: Solution, text: str) -> float:
    """The known grid error of a functional, by which samples on a finer grid differ."""
    error = solution.certificate.grid_error
    deviation = None if error is None else error.functionals.get(text)
    return 0.0 if deviation is None or np.isnan(deviation.error) else deviation.error


def _statistics(found: Found) -> Iterator[Disagreement]:
    for text, one in found.statistics.items():
        kind, names = one.statistic.kind, [each.text() for each in one.statistic.functionals]
        if isinstance(kind, Mean | Std):
            continue
        expected, estimate, error = one.expanded, one.estimate, one.standard_error
        values = found.values[names[0]]
        if isinstance(kind, Probability):
            contradicts = is_rare(round(estimate * found.samples), found.samples, min(max(expected, 0.0), 1.0))
        elif isinstance(kind, Quantile):
            contradicts = is_rare(int(np.sum(values <= expected)), found.samples, float(kind.level))
        elif isinstance(kind, Supremum | Infimum):
            past = estimate - expected if isinstance(kind, Supremum) else expected - estimate
            contradicts = past > 0.01 * values.std()
        else:
            numbers = np.asarray(expected), np.asarray(estimate), np.asarray(error)
            freedom, size = group_count(found.samples) - 1, _size(one.statistic, [found.values[name] for name in names])
            told = worst_disagreement(text, *numbers, samples=found.samples, freedom=freedom, size=size)
            contradicts = told is not None
        if contradicts:
            yield Disagreement(text, expected, estimate, error)


def _size(statistic: Statistic, values: list[Float[np.ndarray, " samples"]]) -> float:
    """The magnitude to which rounding of a statistic is relative; zero for dimensionless statistics."""
    largest = [float(np.max(np.abs(one))) for one in values]
    if isinstance(statistic.kind, Covariance | Variance):
        return largest[0] * largest[-1]
    return 0.0 if isinstance(statistic.kind, Skewness | Kurtosis | Correlation) else largest[0]


def _limits(found: Found) -> Iterator[Disagreement]:
    """Limits on statistics that the samples break, and limits for all systems that some samples break."""
    for one in found.compared:
        if one.meets is False:
            yield Disagreement(one.text, one.bound, one.value, one.standard_error, one.time, "its bound")
    for limit in found.problem.constraints:
        share = found.violations.get(limit.name)
        atoms = (atom for atom in limit.expression.atoms if isinstance(atom, Statistic))
        for_all = is_worst_case(limit) or any(isinstance(atom.kind, Supremum | Infimum) for atom in atoms)
        if share is not None and share.count and for_all:
            yield Disagreement(f"The share of systems that break '{limit.name}'", 0.0, share.estimate, np.nan)


def _is_rounding(one: Disagreement, found: Found) -> bool:
    """Whether a disagreement is mere rounding, such as of a rate that is zero at the end of every motion."""
    functionals = functionals_of(found.problem.expressions)
    centre = jnp.asarray([germ.quantile(np.array(0.5)) for germ in found.problem.placements.germs.values()])
    magnitudes = sizes(found.problem, centre, jnp.asarray(found.solution.vector))
    for functional, size in zip(functionals, magnitudes, strict=True):
        if one.text in (f"μ[{functional.text()}]", f"σ[{functional.text()}]"):
            return abs(one.estimate - one.expected) <= _ROUNDING * float(size)
    return False
