"""Monte Carlo and randomised quasi-Monte Carlo: a function of uncertain inputs, without any expansion.

Its outputs at the whole sample are kept in memory; statistics of them are estimates with standard errors.
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
from typing_extensions import override

from aleator._core.arrays import NUMBER, Pytree, refuse_beyond_memory
from aleator._core.border import Progress, check_progress, silent
from aleator._core.border import whole as whole_given
from aleator._core.errors import ProblemError
from aleator._core.executors import check_executor, each_of
from aleator._core.journalled import AbstractParts, journalled, part_by_part, parts_so_far
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
    part,
    parts,
    random_levels,
    uncertain_places,
)
from aleator.references._estimate import Estimate, estimate, group_count
from aleator.statistics import AbstractMeasured, AbstractStatistic, Correlation, Covariance, a_statistic

Estimates: TypeAlias = Any
"""An `Estimate`, or a dict of them if the outputs are a dict."""

# Binary digits of a Sobol point. Its coordinates are multiples of 2^-30, including 0.
_DIGITS = 30

_MOST_BYTES = 2 * 2**30
# Parts of a sample at most whose points are evaluated one by one.
_MOST = 128


@final
class RandomSample(AbstractMeasured[Estimates]):
    """Outputs of a function at random inputs: `sample.mean` prints as `0.65923 ± 0.00030`.

    - `values`: of each output, shape (samples, *shape), in the structure that the function returns;
    - `groups`: the number of independent groups of equal size, one after the other, from which standard errors are
      computed (see `Estimate`): arbitrary for a plain Monte Carlo sample, the replicates of a quasi-random one;
    - `seed`: of the random inputs; `seconds`: how long the evaluation took, compilation included, in the process that
      finished it.

    Every statistic has the structure of the outputs, an `Estimate` or a dict of them; `sample["y"]` selects one output
    of a dict.
    """

    def __init__(self, values: Pytree, groups: int, seed: int, seconds: float):
        self.values, self.groups, self.seed, self.seconds = values, groups, seed, seconds

    def __getitem__(self, name: str) -> "RandomSample":
        """One output by name, if the outputs are a dict."""
        return RandomSample(part(self.values, name), self.groups, self.seed, self.seconds)

    @property
    def samples(self) -> int:
        """How many inputs were drawn."""
        return len(jax.tree.leaves(self.values)[0])

    def estimate(self, statistic: AbstractStatistic | Function) -> Estimates:
        """Any statistic of each output, or any function of a sample of shape (samples, *shape)."""
        of_sample = statistic.of_sample if isinstance(statistic, AbstractStatistic) else statistic
        return jax.tree.map(lambda values: estimate(of_sample, values, self.groups), self.values)

    @override
    def statistic(self, kind: AbstractStatistic) -> Estimates:
        """An estimate of each output.

        The standard error of a probability is 0, and meaningless, if all values of the sample meet the condition or
        none does.
        """
        return self.estimate(a_statistic(kind))

    def covariance(self, first: str, second: str) -> Estimate:
        """The covariance of two outputs of equal shape, by their names."""
        return self._of_both(Covariance(), first, second)

    def correlation(self, first: str, second: str) -> Estimate:
        """The correlation coefficient of two outputs of equal shape, by their names."""
        return self._of_both(Correlation(), first, second)

    def _of_both(self, statistic: AbstractStatistic, first: str, second: str) -> Estimate:
        both = part(self.values, first), part(self.values, second)
        if both[0].shape != both[1].shape:
            raise ProblemError(
                f"'{first}' and '{second}' must have one shape; received {both[0].shape[1:]} and {both[1].shape[1:]}."
            )
        return estimate(statistic.of_sample, np.stack(both, axis=-1), self.groups)

    def __str__(self) -> str:
        means, stds = self.mean, self.std
        rows = jax.tree_util.tree_leaves_with_path(means)
        names = [jax.tree_util.keystr(path, simple=True, separator=".") or "output" for path, _ in rows]
        lines = [f"{self.samples} samples, standard errors from {self.groups} independent groups"]
        for name, (_, mean), std in zip(names, rows, jax.tree.leaves(stds), strict=True):
            lines.append(f"{name}: mean {mean}, std {std}")
        return "\n".join(lines)


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


Evaluate: TypeAlias = Callable[[Sequence[Part], int], Iterator[tuple[Part, Pytree]]]
"""The outputs at the points of some parts, in order; none has more points than the number."""


def ensemble_of(verb: str, function: Function, model: Pytree, *, traced: bool) -> AbstractEnsemble:
    """The function at the realisations of a model. Raises `ProblemError` if nothing in the model is uncertain."""
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


def evaluate_kept(
    ensemble: AbstractEnsemble,
    levels: Float[np.ndarray, "n variables"],
    *,
    batch: int,
    progress: Progress,
    by: Evaluate | None,
    so_far: AbstractParts | None,
) -> Pytree:
    """The same without the samples that a box leaves out, for methods that can do without some."""
    if not isinstance(ensemble, BoxEnsemble):
        return evaluate(ensemble, levels, batch=batch, progress=progress, by=by, so_far=so_far)
    progress("Monte Carlo", 0, len(levels))
    values, _ = ensemble.kept(at_levels(ensemble.places.germs.values(), levels))
    progress("Monte Carlo", len(levels), len(levels))
    return values


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
