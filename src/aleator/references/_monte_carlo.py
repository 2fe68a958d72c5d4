"""Monte Carlo and randomised quasi-Monte Carlo: a function of uncertain inputs, without any expansion."""

import time
from collections.abc import Callable
from concurrent.futures import Executor
from typing import Any

import jax
import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.elsewhere import check_executor
from aleator._core.errors import ProblemError
from aleator._core.journalled import journalled, parts_so_far
from aleator._core.progress import Progress, check_progress, silent
from aleator.ensemble import AbstractBox, Function, name_of, random_levels
from aleator.references._estimate import group_count
from aleator.references._evaluation import (
    by_executor,
    check_whole,
    ensemble_of,
    evaluate,
    evaluate_kept,
    refuse_large_sample,
)
from aleator.references._random_sample import RandomSample

# Binary digits of a Sobol point. Its coordinates are multiples of 2^-30, including 0.
_DIGITS = 30


def monte_carlo(
    function: Function,
    model: Pytree,
    samples: int = 100_000,
    *,
    seed: int = 0,
    traced: bool = True,
    batch: int = 4096,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> RandomSample:
    """Evaluate a function at random inputs: `al.references.monte_carlo(f, {"w": al.Uniform.bounds(0.9, 1.1)})`.

    - `function`: takes the model with plain numbers in the place of its distributions and returns an array or a dict of
      arrays (any pytree of them); or an `al.foreign.BlackBox`, which may drop samples that fail, and whose samples are
      run in one batch;
    - `model`: a dict or any other pytree with distributions in it, such as a `System`. Decisions are held at their
      initial values;
    - `traced`: False calls the function with plain numbers, point by point, if JAX cannot trace it;
    - `batch`: how many inputs to evaluate at a time; lower it to save memory. The sample does not depend on it;
    - `executor`: evaluates batches at once (see `al.pareto`), with the same result. A black box has one of its own.

    Returns a `RandomSample`, whose statistics are estimates with standard errors. The whole sample is kept, at most 2
    GiB. Standard errors fall as `samples^(-1/2)`. Within `al.journal(folder)` what takes long is kept part by part,
    every few seconds: after a crash the same call goes on from there. A black box keeps its samples one by one (see its
    `journal`); its whole sample is kept there as well, unless it is a command or may drop some.

    Raises `ProblemError` if nothing is uncertain or the sample is too large, `SimulationError` if an output is not
    finite, naming the inputs there.
    """
    check_whole("monte_carlo", samples=samples, seed=seed, batch=batch)
    check_progress("monte_carlo", progress)
    check_executor("monte_carlo", executor)
    if samples < 4:
        raise ProblemError(f"monte_carlo: expected at least 4 samples; received {samples}.")
    ensemble = ensemble_of("monte_carlo", function, model, traced=traced)
    refuse_large_sample("monte_carlo", samples, len(ensemble.places.germs))
    levels = random_levels(np.random.default_rng(seed), samples, len(ensemble.places.germs))
    by = by_executor("monte_carlo", executor, ensemble)

    def sampled() -> RandomSample:
        began = time.perf_counter()
        so_far = parts_so_far()
        values = evaluate_kept(ensemble, levels, batch=batch, progress=progress, by=by, so_far=so_far)
        groups = group_count(len(jax.tree.leaves(values)[0]))
        return RandomSample(values, groups, seed, time.perf_counter() - began)

    return _journalled("monte_carlo", function, model, (samples, seed, traced, batch), sampled)


def quasi_monte_carlo(
    function: Function,
    model: Pytree,
    samples: int = 2**14,
    *,
    replicates: int = 16,
    seed: int = 0,
    traced: bool = True,
    batch: int = 4096,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> RandomSample:
    """Evaluate a function at scrambled Sobol points.

    Returns a `RandomSample` of `samples` inputs in all, divided among `replicates` nets that are scrambled
    independently, so that the spread of the nets gives a valid standard error. Both are powers of two. For smooth
    functions standard errors fall nearly as `samples^(-3/2)`, and never much slower than those of plain Monte Carlo.
    The other arguments, and the errors, are those of `monte_carlo`. Source: Owen (1997), Scrambled net variance for
    integrals of smooth functions.
    """
    check_whole("quasi_monte_carlo", samples=samples, replicates=replicates, seed=seed, batch=batch)
    check_progress("quasi_monte_carlo", progress)
    check_executor("quasi_monte_carlo", executor)
    ensemble = ensemble_of("quasi_monte_carlo", function, model, traced=traced)
    levels = scrambled_nets("quasi_monte_carlo", len(ensemble.places.germs), samples, replicates, seed)
    by = by_executor("quasi_monte_carlo", executor, ensemble)

    def sampled() -> RandomSample:
        began = time.perf_counter()
        values = evaluate(ensemble, levels, batch=batch, progress=progress, by=by, so_far=parts_so_far())
        return RandomSample(values, replicates, seed, time.perf_counter() - began)

    how = (samples, replicates, seed, traced, batch)
    return _journalled("quasi_monte_carlo", function, model, how, sampled)


def _journalled(
    verb: str, function: Function, model: Pytree, how: tuple[Any, ...], sampled: Callable[[], RandomSample]
) -> RandomSample:
    """A sample that the present journal has, or else a new one."""
    follows_from = function.follows_from if isinstance(function, AbstractBox) else function
    if follows_from is None:
        return sampled()
    name = name_of(function).strip("'")
    return journalled(f"{verb} {name}", {"function": follows_from, "model": model, "how": how}, sampled)


def scrambled_nets(
    verb: str, variables: int, samples: int, replicates: int, seed: int
) -> Float[np.ndarray, "samples variables"]:
    """Independently scrambled Sobol nets, one after the other, as probability levels in (0, 1)."""
    if replicates < 2 or not _is_power_of_two(replicates):
        raise ProblemError(
            f"{verb}: expected a power of two of replicates, such as 16, for a standard error; received {replicates}."
        )
    points, rest = divmod(samples, replicates)
    if rest or points < 2 or not _is_power_of_two(points):
        raise ProblemError(
            f"{verb}: expected samples that are replicates times a power of two, such as {replicates} * 1024; received "
            f"samples={samples} with replicates={replicates}."
        )
    refuse_large_sample(verb, samples, variables)
    # Up to SciPy 1.14 the generator is called `seed`; the type stubs have only the later name.
    settings = {"bits": _DIGITS, "seed": np.random.default_rng(seed)}
    nets = [scipy.stats.qmc.Sobol(variables, **settings).random(points) for _ in range(replicates)]
    # Shift to the middle of the cells, away from 0, where unbounded distributions are infinite.
    return np.concatenate(nets) + 0.5 ** (_DIGITS + 1)


def _is_power_of_two(number: int) -> bool:
    return number & (number - 1) == 0
