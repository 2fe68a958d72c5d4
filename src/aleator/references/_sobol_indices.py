"""Sobol indices by pick and freeze: how much of a variance comes from each input, without any expansion."""

from typing import Any, final

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.border import Progress, check_progress, silent
from aleator._core.errors import ProblemError
from aleator.ensemble import Function
from aleator.references._estimate import Estimate, estimate
from aleator.references._monte_carlo import check_whole, ensemble_of, evaluate, refuse_large_sample, scrambled_nets


@final
class SobolIndices:
    """Sobol indices of each germ variable, which is an uncertain input unless inputs are correlated.

    - `first`: by input, its own share of the variance; the rest up to 1 is due to interactions;
    - `total`: by input, the share that would remain if all others were known.

    Each is an `Estimate`, or a dict of them if the outputs are a dict.
    """

    def __init__(self, first: dict[str, Any], total: dict[str, Any]):
        self.first, self.total = first, total

    def __str__(self) -> str:
        return "\n".join(f"{name}: first {self.first[name]}, total {self.total[name]}" for name in self.first)


def sobol_indices(
    function: Function,
    model: Pytree,
    samples: int = 2**14,
    *,
    replicates: int = 16,
    seed: int = 0,
    traced: bool = True,
    batch: int = 4096,
    progress: Progress = silent,
) -> SobolIndices:
    """First-order and total Sobol indices of a function of uncertain inputs, with standard errors.

    Two independent inputs are drawn `samples` times from scrambled Sobol nets; exchanging one germ variable at a time
    takes `(variables + 2) * samples` evaluations of the function. The arguments and errors are those of
    `quasi_monte_carlo`; an output that does not vary has no indices and raises `ProblemError`. Entries of an array that
    do not vary (an initial condition) have indices 0. Source: Saltelli et al. (2010), Variance based sensitivity
    analysis of model output, table 2 (b) for the first order and (f), by Jansen (1999), for the total.
    """
    check_whole("sobol_indices", samples=samples, replicates=replicates, seed=seed, batch=batch)
    check_progress("sobol_indices", progress)
    ensemble = ensemble_of("sobol_indices", function, model, traced=traced)
    names = list(ensemble.places.germs)
    refuse_large_sample("sobol_indices", (len(names) + 2) * samples, len(names))
    both = scrambled_nets("sobol_indices", 2 * len(names), samples, replicates, seed)
    levels = _exchanged(both[:, : len(names)], both[:, len(names) :])
    values = evaluate(ensemble, levels.reshape(-1, len(names)), batch=batch, progress=progress)
    designs = jax.tree.map(lambda leaf: leaf.reshape(samples, len(names) + 2, *leaf.shape[1:]), values)
    for leaf in jax.tree.leaves(designs):
        if not np.any(np.ptp(leaf[:, :2], axis=(0, 1))):
            raise ProblemError("sobol_indices: an output does not vary, so that no input has a share of its variance.")
    first = jax.tree.map(lambda leaf: estimate(_first, leaf, replicates), designs)
    total = jax.tree.map(lambda leaf: estimate(_total, leaf, replicates), designs)
    return SobolIndices(
        {name: jax.tree.map(lambda estimate, i=i: _entry(estimate, i), first) for i, name in enumerate(names)},
        {name: jax.tree.map(lambda estimate, i=i: _entry(estimate, i), total) for i, name in enumerate(names)},
    )


def _exchanged(
    first: Float[np.ndarray, "samples variables"], second: Float[np.ndarray, "samples variables"]
) -> Float[np.ndarray, "samples designs variables"]:
    """Both inputs, then the first one with each of its variables in turn taken from the second."""
    variables = first.shape[1]
    levels = np.repeat(first[:, None], variables + 2, axis=1)
    levels[:, 1] = second
    for i in range(variables):
        levels[:, i + 2, i] = second[:, i]
    return levels


def _first(values: Float[np.ndarray, "samples designs *shape"]) -> Float[np.ndarray, "variables *shape"]:
    # The mean is subtracted, because it would only add noise.
    values = values - values[:, :2].mean(axis=(0, 1))
    first, second, mixed = values[:, :1], values[:, 1:2], values[:, 2:]
    return (second * (mixed - first)).mean(axis=0) / _variance(values)[None]


def _total(values: Float[np.ndarray, "samples designs *shape"]) -> Float[np.ndarray, "variables *shape"]:
    return ((values[:, :1] - values[:, 2:]) ** 2).mean(axis=0) / 2 / _variance(values)[None]


def _variance(values: Float[np.ndarray, "samples designs *shape"]) -> Float[np.ndarray, "*shape"]:
    variance = values[:, :2].var(axis=(0, 1))
    return np.where(variance > 0, variance, np.inf)


def _entry(estimate: Estimate, i: int) -> Estimate:
    return Estimate(estimate.value[i], estimate.standard_error[i], estimate.groups)
