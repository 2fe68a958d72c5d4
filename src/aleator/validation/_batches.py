"""Systems of a design, simulated batch by batch and reduced to what evidence needs.

Large batches of long histories are folded: at each instant the systems of a batch are summed at once, so that what is
left of a path are its moments, and of a limit over time the largest excess so far. None is stored, since memory is
where such batches spend their time.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple, Self, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from aleator._core.compilation import Compiled
from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    OneSystem,
    Path,
    Problem,
    Statistic,
    Value,
    asked_for,
    functionals_of,
    numbers_of,
    step_at,
    taken_from,
)
from aleator.uncertainty import named_numbers, realise

# What varies by less than this part of its mean does not vary.
_ROUNDING = 1e-12


@final
class Sums(NamedTuple):
    """The number of samples, their mean, and the sums of the powers 2 to 4 of deviations from it.

    Numbers, or arrays of one shape: of JAX in a program, of NumPy outside. They are merged as by Pébay (Formulas for
    robust, one-pass parallel computation, 2008).
    """

    number: Any
    mean: Any
    second: Any
    third: Any
    fourth: Any

    @classmethod
    def of(cls, values: Float[np.ndarray, "samples *shape"]) -> Self:
        """The sums of one batch."""
        mean = values.mean(axis=0)
        away = values - mean
        return cls(len(values), mean, *(np.sum(away**power, axis=0) for power in (2, 3, 4)))

    def merged(self, other: Self) -> Self:
        """The sums of both batches together."""
        (n, mean, second, third, fourth), (m, *_) = self, other
        total, shift = n + m, other.mean - mean
        return type(self)(
            total,
            mean + shift * m / total,
            second + other.second + shift**2 * n * m / total,
            third
            + other.third
            + shift**3 * n * m * (n - m) / total**2
            + 3 * shift * (n * other.second - m * second) / total,
            fourth
            + other.fourth
            + shift**4 * n * m * (n**2 - n * m + m**2) / total**3
            + 6 * shift**2 * (n**2 * other.second + m**2 * second) / total**2
            + 4 * shift * (n * other.third - m * third) / total,
        )

    @property
    def std(self) -> Float[np.ndarray, "*shape"]:
        """The standard deviation; zero of a single sample, and of what varies by rounding alone."""
        std = np.sqrt(self.second / max(self.number - 1, 1))
        return np.where(std <= _ROUNDING * np.abs(self.mean), 0.0, std)

    @property
    def std_error(self) -> Float[np.ndarray, "*shape"]:
        """The standard error of the standard deviation, from the fourth moment; zero where nothing varies."""
        n, variance = self.number, self.std**2
        spread = np.maximum(self.fourth / n - variance**2 * (n - 3) / max(n - 1, 1), 0.0) / n
        return np.asarray(np.sqrt(spread) / (2 * np.sqrt(np.where(variance > 0, variance, np.inf))))


class Batch(NamedTuple):
    """What some systems give: arrays of JAX, of one batch with padding, or of NumPy, of all systems of a stretch.

    - `scalars`: by functional (those that are numbers), shape (systems,); `paths`: by functional (those that are
      paths), their moments at each instant;
    - `excess`: by constraint, the largest excess over its bounds, shape (constraints, systems);
    - `values`: by path constraint, its expression, shape (systems, instants), of those systems of which it is kept.
    """

    scalars: dict[int, Any]
    paths: dict[int, Sums]
    excess: Any
    values: dict[int, Any]

    def first(self, count: int, keep: int) -> "Batch":
        """As arrays of NumPy, without the padding after `count` systems, and with values of the first `keep`."""
        return Batch(
            {i: np.asarray(values)[:count] for i, values in self.scalars.items()},
            {i: Sums(count, *map(np.asarray, sums[1:])) for i, sums in self.paths.items()},
            np.asarray(self.excess)[:, :count],
            {i: np.array(np.asarray(values)[:keep]) for i, values in self.values.items()} if keep else {},
        )

    @classmethod
    def joined(cls, some: "Sequence[Batch]") -> "Batch":
        """Several, in the order of their systems. Moments are merged in that order, so that digits are the same."""
        head = some[0]
        return cls(
            {i: np.concatenate([one.scalars[i] for one in some]) for i in head.scalars},
            {i: reduce(Sums.merged, [one.paths[i] for one in some]) for i in head.paths},
            np.concatenate([one.excess for one in some], axis=1),
            {i: np.concatenate([one.values[i] for one in some if i in one.values]) for i in head.values},
        )


def folds(problem: Problem) -> bool:
    """Whether all that evidence needs of a problem's histories can be told instant by instant.

    That is so for integrals, and for sums of statistics of paths and of the model's numbers.
    """
    known = all(isinstance(one, AbstractIntegral | Path) for one in functionals_of(problem.expressions))
    atoms = [atom for one in problem.constraints if one.is_path for atom in one.expression.atoms]
    at_instants = all(
        isinstance(atom, Value)
        or (isinstance(atom, Statistic) and all(isinstance(one, Path) for one in atom.functionals))
        for atom in atoms
    )
    return known and at_instants and problem.simulation.folds


# The name of the axis over which batches are summed.
_SYSTEMS = "systems"


def _simulate(
    problem: Problem,
    germ: Float[Array, "systems variables"],
    decisions: Float[Array, " n"],
    count: Int[Array, ""],
    finer: int,
    is_folded: bool,
) -> tuple[Batch, Bool[Array, " systems"]]:
    """Simulate one system per germ point, and tell whether all its functionals are finite.

    Systems after the first `count` are padding and do not count. Of paths, every `finer`th instant is kept, where the
    grid is that many times finer than the design's. With `is_folded`, for a problem that `folds`, paths are summed and
    judged inside the integrator's loop, and values of path constraints are not kept.
    """
    functionals, limits = functionals_of(problem.expressions), problem.constraints
    integrals = tuple(one for one in functionals if isinstance(one, AbstractIntegral))
    others = tuple(one for one in functionals if not isinstance(one, AbstractIntegral))
    over_time = [i for i, one in enumerate(limits) if one.is_path]
    numbers, step = named_numbers(problem.simulation, decisions), step_at(problem, decisions)

    def evaluated(values: Mapping[AbstractFunctional, Array], some: Iterable[int]) -> dict[int, Array]:
        scope = OneSystem(values, numbers, step)
        return {i: jnp.asarray(limits[i].expression.evaluate(scope)) for i in some}

    def excess(values: Mapping[int, Array]) -> dict[int, Array]:
        return {i: jnp.max(jnp.maximum(one - limits[i].upper, limits[i].lower - one)) for i, one in values.items()}

    def spoilt(values: Iterable[Array]) -> Array:
        """Zero, or NaN if some number is not finite."""
        return sum((jnp.sum(0.0 * one) for one in values), start=jnp.zeros(()))

    def simulated(point: Float[Array, " variables"], is_wanted: Bool[Array, ""]) -> Any:
        def fold(carried: Any, outputs: dict[str, Array]) -> tuple[Any, Any]:
            values = {one: outputs[one.output] for one in others}
            now = excess(evaluated(values, over_time)), spoilt(values.values())
            if carried is not None:
                now = jax.tree.map(jnp.maximum, carried[0], now[0]), carried[1] + now[1]
            return now, {functionals.index(one): _moments(value, is_wanted, count) for one, value in values.items()}

        asked = asked_for(functionals)._replace(fold=fold if is_folded else None)
        record = realise(problem.simulation, point, decisions).record(asked)
        known = integrals if is_folded else functionals
        values = dict(zip(known, numbers_of(known, taken_from(record, functionals), record.grid), strict=True))
        (worst, broken), moments = (record.folded, record.history) if is_folded else (({}, 0.0), {})
        expressions = evaluated(values, [i for i in range(len(limits)) if i not in worst])
        worst = worst | excess(expressions)
        places = {functionals.index(one): value for one, value in values.items()}
        moments = moments | {i: _moments(value, is_wanted, count) for i, value in places.items() if value.ndim}
        own = (
            {i: value for i, value in places.items() if not value.ndim},
            jnp.array([worst[i] for i in range(len(limits))]),
            {i: value[::finer] for i, value in expressions.items() if limits[i].is_path},
            jnp.isfinite(broken + spoilt(values.values())),
        )
        return own, {
            i: [one[::finer] if functionals[i].is_path else one for one in parts] for i, parts in moments.items()
        }

    wanted = jnp.arange(len(germ)) < count
    own, moments = jax.vmap(simulated, axis_name=_SYSTEMS, out_axes=(0, None))(germ, wanted)
    scalars, worst, values, is_finite = own
    return Batch(scalars, {i: Sums(count, *parts) for i, parts in moments.items()}, worst.T, values), is_finite


def _moments(value: Array, is_wanted: Bool[Array, ""], count: Int[Array, ""]) -> list[Array]:
    """Over the wanted systems of a batch, the mean and the sums of the powers 2 to 4 of deviations from it.

    Deviations are those from the first system, from which those from the mean follow: one pass, and products
    with a vector of ones, because XLA adds up numbers one by one.
    """
    every, wanted = (jax.lax.all_gather(one, _SYSTEMS) for one in (value, is_wanted))
    away = jnp.where(wanted.reshape(-1, *[1] * value.ndim), every - every[:1], 0.0)
    square, ones = away**2, jnp.ones(len(every))
    first, second, third, fourth = (
        jnp.tensordot(ones, powers, 1) for powers in (away, square, away * square, square**2)
    )
    d = first / count
    return [
        every[0] + d,
        jnp.maximum(second - count * d**2, 0.0),  # where nothing varies, rounding may leave less
        third - 3 * d * second + 2 * count * d**3,
        jnp.maximum(fourth - 4 * d * third + 6 * d**2 * second - 3 * count * d**4, 0.0),
    ]


SIMULATE = Compiled(_simulate)
