"""An expansion as text: uncertain inputs, moments of each output, main contributors, errors."""

from collections.abc import Iterator, Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator.ensemble import concrete
from aleator.expansion import Basis
from aleator.uncertainty import AbstractDistribution

_CONTRIBUTORS = 4
_LEAST_SHARE = 0.001
# A spread below this part of the mean is rounding.
_ROUNDING = 1e-14


def as_lines(rows: list[tuple[str, str]]) -> str:
    """Labelled lines."""
    width = max([11, *(len(label) for label, _ in rows)])
    return "\n".join(f"{label:<{width}} {text}" for label, text in rows)


def distribution_rows(distributions: Mapping[str, AbstractDistribution]) -> list[tuple[str, str]]:
    """The distribution of each uncertain input."""
    return [(name, f"~ {distribution}") for name, distribution in distributions.items()]


def output_rows(means: Pytree, stds: Pytree, remarks: Pytree) -> list[tuple[str, str]]:
    """Mean and standard deviation of each output, of an array at its largest spread; then its remarks."""
    rows = []
    for name, mean, std, remark in _aligned(means, stds, remarks):
        known_mean, known_std = concrete(mean), concrete(std)
        if known_mean is None or known_std is None:
            rows.append((name, "is being compiled: its numbers are not known yet"))
            continue
        entry = np.unravel_index(int(np.argmax(known_std)), known_std.shape)
        moments = f"mean {known_mean[entry]:.6g}, std {known_std[entry]:.4g}"
        rows.append((name, f"{_where(known_std.shape, entry)}{moments}{remark(entry)}"))
    return rows


def nothing(entry: tuple) -> str:
    """No remark on an entry."""
    del entry
    return ""


def _aligned(*trees: Pytree) -> Iterator[tuple[Any, ...]]:
    paths = [path for path, _ in jax.tree_util.tree_leaves_with_path(trees[0])]
    names = [jax.tree_util.keystr(path, simple=True, separator=".") or "output" for path in paths]
    yield from zip(names, *map(jax.tree.leaves, trees), strict=True)


def _where(shape: tuple[int, ...], entry: tuple) -> str:
    if not shape:
        return ""
    place = ", ".join(str(int(index)) for index in entry)
    return f"{'×'.join(map(str, shape))} numbers, of the largest spread [{place}]: "


def contributors(
    distributions: Mapping[str, AbstractDistribution], basis: Basis, terms: Float[np.ndarray, " terms"]
) -> str:
    """The largest shares of the variance by the inputs that they come from, alone or together (Sobol indices).

    A correlated group counts as one input: Shapley effects give the contributions of its members.
    """
    group = {
        germ: f"({distribution.dependence.group})"
        for distribution in distributions.values()
        if distribution.dependence
        for germ in distribution.germ_names("")
    }
    variance = np.sum(terms[1:] ** 2)
    if not variance > (_ROUNDING * float(np.abs(terms[0]))) ** 2:
        return "it does not vary"
    shares: dict[str, float] = {}
    for degrees, coefficient in zip(basis.indices[1:], terms[1:], strict=True):
        name = "·".join(
            dict.fromkeys(group.get(name, name) for name, degree in zip(basis.names, degrees, strict=True) if degree)
        )
        shares[name] = shares.get(name, 0.0) + float(coefficient**2 / variance)
    largest = sorted(shares.items(), key=lambda item: -item[1])[:_CONTRIBUTORS]
    return ", ".join(f"{name} {100 * share:.3g} %" for name, share in largest if share > _LEAST_SHARE)


def extrapolates(leave_one_out: Any, jackknife: Any, tolerance: float) -> bool:
    """Whether an expansion that predicts its own points extrapolates elsewhere, as into tails."""
    return bool(np.isfinite(leave_one_out) and leave_one_out <= tolerance < jackknife)


def trust(leave_one_out: Any, jackknife: Any, error: Any, tolerance: float) -> str:
    """How well the expansion is resolved: by its leave-one-out error or, without samples, by its last terms."""
    if extrapolates(leave_one_out, jackknife, tolerance):
        return f"jackknife error {float(jackknife):.1e} (EXTRAPOLATED, take al.points.InducedPoints())"
    if not np.isfinite(leave_one_out):
        by, shown = "error by the decay of its degrees", error
    else:
        by, shown = "leave-one-out error", leave_one_out
    verdict = "resolved" if float(error) <= tolerance else "NOT RESOLVED, raise the order"
    return f"{by} {float(shown):.1e} ({verdict})"
