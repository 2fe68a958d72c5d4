"""The paths of a problem: which there are by name, and their limits."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.design import AbstractFunctional, Constraint, Problem, Statistic, functionals_of, is_worst_case
from aleator.reporting._numbers import given
from aleator.solution import Moments

# The multiple of the standard deviation in a band, where no limit says another.
_USUAL = 2.0


class Limits(NamedTuple):
    """The limits on a path: by their values, in words; the largest multiple of the standard deviation in them; their
    names.
    """

    texts: dict[float, str]
    sigmas: float
    names: set[str]


def paths_of(problem: Problem) -> dict[str, AbstractFunctional]:
    """The paths in a problem, each under the name of its output, or under its text where several are of one output."""
    every = [one for one in functionals_of(problem.expressions) if one.is_path]
    outputs = [one.output for one in every]
    return {one.output if outputs.count(one.output) == 1 else one.text(): one for one in every}


def limits_of(problem: Problem, functional: AbstractFunctional, unit: str) -> Limits:
    """The limits on one path alone: on its mean, with a multiple of its standard deviation or without, or on its worst
    case.
    """
    texts: dict[float, str] = {}
    sigmas, names = 0.0, set()
    for one in problem.constraints:
        if functionals_of((one.expression,)) != (functional,) or not _has_values_of_path(one):
            continue
        multiple = one.expression.sigmas or 0.0
        sigmas = max(sigmas, multiple)
        names.add(one.name)
        for bound in (float(one.lower), float(one.upper)):
            if np.isfinite(bound):
                texts[bound] = f"{one.name}: {given(bound, unit)}{_how(one, multiple)}"
    return Limits(texts, sigmas or _USUAL, names)


def _how(limit: Constraint, multiple: float) -> str:
    """For which systems a limit holds, in words."""
    if multiple:
        return f" at {multiple:.3g} σ"
    return " in the worst case" if is_worst_case(limit) else ""


def _has_values_of_path(limit: Constraint) -> bool:
    """Whether what is limited has the path's own values: its worst case, or one statistic of it, not in proportion, and
    its spreads.
    """
    if is_worst_case(limit):
        return True
    pairs = list(zip(limit.expression.factors, limit.expression.atoms, strict=True))
    located = [float(factor) for factor, atom in pairs if not atom.is_spread]
    return located == [1.0] and all(isinstance(atom, Statistic) for _, atom in pairs)


def components(
    name: str, mean: Float[np.ndarray, "instants ..."], std: Float[np.ndarray, "instants ..."]
) -> dict[str, Moments]:
    """A path by its name; of a vector over time, each component by its own."""
    if mean.ndim == 1:
        return {name: Moments(mean, std)}
    means, stds = (one.reshape(len(one), -1) for one in (mean, std))
    return {f"{name}[{i}]": Moments(means[:, i], stds[:, i]) for i in range(means.shape[1])}
