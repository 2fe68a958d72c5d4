"""Monte Carlo and randomised quasi-Monte Carlo: a function of uncertain inputs, without any expansion.

Its outputs at the whole sample are kept in memory; statistics of them are estimates with standard errors. Sobol indices
by pick and freeze tell how much of a variance comes from each input.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from typing import Any, TypeAlias, final

import jax
import numpy as np
import scipy
from jaxtyping import Float

from aleator._core.arrays import NUMBER, Pytree, refuse_beyond_memory
from aleator._core.border import Progress, check_progress, silent
from aleator._core.border import whole as whole_given
from aleator._core.errors import ProblemError
from aleator._core.executors import check_executor, each_of
from aleator._core.journalled import AbstractParts, journalled, part_by_part, parts_so_far
from aleator._core.leaves import in_order
from aleator.ensemble import (
    AbstractBox,
    AbstractEnsemble,
    Alone,
    BoxEnsemble,
    CalledEnsemble,
    Function,
    Part,
    at_levels,
    ensemble_for,
    name_of,
    parts,
    random_levels,
    uncertain_places,
)
from aleator.references._estimate import Estimate, RandomSample, estimate, group_count
from aleator.uncertainty import refuse_correlated

# Binary digits of a Sobol point. Its coordinates are multiples of 2^-30, including 0.
_DIGITS = 30

_MOST_BYTES = 2 * 2**30
# Parts of a sample at most whose points are evaluated one by one.
_MOST = 128


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
    if samples < 4:
        raise ProblemError(f"monte_carlo: expected at least 4 samples; received {samples}.")

    def levels(variables: int) -> Float[np.ndarray, "samples variables"]:
        refuse_large_sample("monte_carlo", samples, variables)
        return random_levels(np.random.default_rng(seed), samples, variables)

    how = samples, seed, traced, batch
    return _sample("monte_carlo", function, model, levels, how, None, executor=executor, progress=progress)


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

    def levels(variables: int) -> Float[np.ndarray, "samples variables"]:
        return scrambled_nets("quasi_monte_carlo", variables, samples, replicates, seed)

    how = samples, replicates, seed, traced, batch
    return _sample("quasi_monte_carlo", function, model, levels, how, replicates, executor=executor, progress=progress)


def _sample(
    verb: str,
    function: Function,
    model: Pytree,
    levels_of: Callable[[int], Float[np.ndarray, "samples variables"]],
    how: tuple[Any, ...],
    replicates: int | None,
    *,
    executor: Executor | None,
    progress: Progress,
) -> RandomSample:
    """A sample that the present journal has, or else a new one.

    - `levels_of`: the probability levels by the number of germ variables; `how`: all arguments that they follow from,
      the last of which are seed, `traced` and `batch`;
    - `replicates`: the independent parts of the sample, or None: then a box may leave out some.
    """
    check_progress(verb, progress)
    check_executor(verb, executor)
    *_, seed, traced, batch = how
    ensemble = ensemble_of(verb, function, model, traced=traced)
    levels = levels_of(len(ensemble.places.germs))
    by = by_executor(verb, executor, ensemble)

    def sampled() -> RandomSample:
        began = time.perf_counter()
        if replicates is None and isinstance(ensemble, BoxEnsemble):
            progress("Monte Carlo", 0, len(levels))
            values, _ = ensemble.kept(at_levels(ensemble.places.germs.values(), levels))
            progress("Monte Carlo", len(levels), len(levels))
        else:
            values = evaluate(ensemble, levels, batch=batch, progress=progress, by=by, so_far=parts_so_far())
        groups = replicates or group_count(len(jax.tree.leaves(values)[0]))
        return RandomSample(values, groups, seed, time.perf_counter() - began)

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


Evaluate: TypeAlias = Callable[[Sequence[Part], int], Iterator[tuple[Part, Pytree]]]
"""The outputs at the points of some parts, in order; none has more points than the number."""


def ensemble_of(verb: str, function: Function, model: Pytree, *, traced: bool) -> AbstractEnsemble:
    """The function at the realisations of a model. Raises `ProblemError` if nothing in the model is uncertain."""
    model = in_order(model)
    return ensemble_for(function, model, uncertain_places(verb, function, model), traced=traced)


def check_whole(verb: str, **numbers: Any) -> None:
    """Refuse anything but whole numbers, which must be positive except for the seed."""
    for name, number in numbers.items():
        whole_given(f"{verb}: {name}", number, least=0 if name == "seed" else 1)


def refuse_large_sample(verb: str, samples: int, variables: int) -> None:
    """Refuse a sample whose inputs, as levels and as germ values, would not fit into memory."""
    what = f"{verb}: {samples} samples of {variables} variables"
    refuse_beyond_memory(what, 2 * NUMBER * samples * variables, "Ask for fewer samples.")


def evaluate(
    ensemble: AbstractEnsemble,
    levels: Float[np.ndarray, "n variables"],
    *,
    batch: int,
    progress: Progress,
    by: Evaluate | None = None,
    so_far: AbstractParts | None = None,
) -> Pytree:
    """The outputs at points given by their probability levels: NumPy arrays of shape (n, *shape).

    - `by`: another way to evaluate parts of them (see `by_executor`); `so_far`: what an earlier run has found.

    Raises the errors of an ensemble, and `ProblemError` if the outputs would not fit into memory.
    """
    size = _together(ensemble, len(levels), batch)
    work = by or ensemble.in_parts
    results = part_by_part(list(parts(levels, size)), lambda batches: work(batches, size), so_far)
    return _gathered(len(levels), results, progress)


def by_executor(verb: str, executor: Executor | None, ensemble: AbstractEnsemble) -> Evaluate | None:
    """How an executor evaluates parts; None without one. Raises `ProblemError` for a black box: it has its own."""
    if executor is None:
        return None
    if isinstance(ensemble, BoxEnsemble):
        raise ProblemError(
            f"{verb}: executor: expected a function; received a black box, which runs its samples in its own way: give "
            "the executor to the black box."
        )
    alone = ensemble.alone()
    return lambda some, size: each_of(executor, _evaluated_there, some, {"ensemble": alone, "size": size}, verb)


def _evaluated_there(ensemble: Alone, items: Sequence[Part], size: int) -> list[Pytree]:
    return [jax.tree.map(np.asarray, values) for _, values in ensemble.again().in_parts(items, size)]


def _together(ensemble: AbstractEnsemble, samples: int, batch: int) -> int:
    """How many points are one part: a called function may take long at each, and is called point by point anyway."""
    return min(batch, -(-samples // _MOST) if isinstance(ensemble, CalledEnsemble) else samples)


def _gathered(total: int, results: Iterable[tuple[Part, Pytree]], progress: Progress) -> Pytree:
    """Outputs at all points, from those of each part."""
    outputs, done = None, 0
    progress("Monte Carlo", 0, total)
    for (first, _), values in results:
        outputs = _room(total, values) if outputs is None else outputs
        for whole, batch in zip(jax.tree.leaves(outputs), jax.tree.leaves(values), strict=True):
            whole[first : first + len(batch)] = batch
        done += len(jax.tree.leaves(values)[0])
        progress("Monte Carlo", done, total)
    return outputs


def _room(total: int, values: Pytree) -> Pytree:
    """Empty arrays for all points, of the shapes that the first batch has."""
    shapes = [(total, *leaf.shape[1:]) for leaf in jax.tree.leaves(values)]
    size = sum(8 * math.prod(shape) for shape in shapes)
    if size > _MOST_BYTES:
        raise ProblemError(
            f"Samples are kept whole: expected at most {_MOST_BYTES / 2**30:g} GiB; received outputs of shape "
            f"{', '.join(map(str, shapes))}, {size / 2**30:.3g} GiB. Ask for fewer samples, or return fewer numbers "
            "(every tenth instant, a maximum)."
        )
    return jax.tree.map(lambda leaf: np.empty((total, *leaf.shape[1:])), values)


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
    refuse_correlated(ensemble.places.distributions, names)
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
