"""A large sample in stretches: which systems each has, what it finds, and how they are simulated and put together.

Each system has its own place in one stream of random numbers, so that a stretch can be simulated anywhere, and after a
crash alone. Sums over a sample are those over its stretches, in order, so that digits do not depend on who simulated
which.
"""

import itertools
from collections.abc import Iterator, Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator.ensemble import Part, drawn_from, each, fill
from aleator.validation._sampling import Batch
from aleator.validation._sums import Sums
from aleator.validation._systems import Systems

# Stretches of a sample at most: a millisecond each is spent on beginning one elsewhere, and as much on keeping one.
_MOST = 128
# Systems times instants from which a second compilation, of a program without histories, is worth while.
_MANY = 2e8
# Without histories more systems are simulated at a time, because each step of a loop has a cost of its own.
_TOGETHER = 4


@final
class Plan(NamedTuple):
    """How a sample is taken: the arguments of `validate`, and how many systems come `before` those that are folded."""

    samples: int
    seed: int
    batch: int
    keep: int
    before: int

    @classmethod
    def of(cls, systems: Systems, samples: int, seed: int, batch: int, keep: int) -> "Plan":
        """The plan for some systems. Trajectories are kept of the first ones, so these are never folded."""
        batch, keep = min(batch, samples), min(keep, samples)
        before = samples
        if systems.folds and samples * systems.instants >= _MANY:
            before = min(-(-keep // batch) * batch, samples)
        return cls(samples, seed, batch, keep, before)

    @property
    def folded_batch(self) -> int:
        """How many systems are simulated at a time where no histories are stored."""
        return min(_TOGETHER * self.batch, max(self.samples - self.before, 1))

    @property
    def stretches(self) -> tuple["Stretch", ...]:
        """The sample in stretches, the same wherever they are simulated."""
        ends = (0, self.before, self.batch), (self.before, self.samples, self.folded_batch)
        return tuple(
            Stretch(first, min(length, end - first), batch)
            for begin, end, batch in ends
            for length in [batch * max(-(-self.samples // (_MOST * batch)), 1)]
            for first in range(begin, end, length)
        )


class Stretch(NamedTuple):
    """Systems of a sample, one after another: the first one's number, how many, and how many at a time."""

    first: int
    systems: int
    batch: int

    @property
    def end(self) -> int:
        """The number of the system after the last one."""
        return self.first + self.systems


class Simulated(NamedTuple):
    """What a stretch found, with the names of `Batch`.

    - `excess`: shape (constraints, count); `scalars`: shape (count,); `paths`: moments; `values`: of the systems whose
      trajectories are kept.
    """

    excess: Float[np.ndarray, "constraints count"]
    scalars: dict[int, Float[np.ndarray, " count"]]
    paths: dict[int, Sums]
    values: dict[int, Float[np.ndarray, "kept ..."]]

    @classmethod
    def of(cls, batch: Batch, part: Part, keep: int) -> "Simulated":
        """What one batch found; `keep`: trajectories of the first so many systems of the sample."""
        count, kept = len(part.points), max(min(keep - part.first, len(part.points)), 0)
        return cls(
            np.asarray(batch.excess)[:, :count],
            {i: np.asarray(values)[:count] for i, values in batch.scalars.items()},
            {i: Sums(count, *map(np.asarray, sums)) for i, sums in batch.paths.items()},
            {i: np.array(np.asarray(values)[:kept]) for i, values in batch.values.items()} if kept else {},
        )

    @classmethod
    def joined(cls, some: "Sequence[Simulated]") -> "Simulated":
        """Several, in the order of their systems."""
        first, *rest = some
        paths = dict(first.paths)
        for one in rest:
            paths = {i: sums.merged(one.paths[i]) for i, sums in paths.items()}
        return cls(
            np.concatenate([one.excess for one in some], axis=1),
            {i: np.concatenate([one.scalars[i] for one in some]) for i in first.scalars},
            paths,
            {i: np.concatenate([one.values[i] for one in some if i in one.values]) for i in first.values},
        )


def simulated(systems: Systems, plan: Plan, stretches: Sequence[Stretch]) -> Iterator[tuple[Stretch, Simulated]]:
    """What each of some stretches finds, in order, on all cores.

    Raises `SimulationError` if a system's results are not finite, naming its parameter values.
    """
    for is_folded in sorted({one.first >= plan.before for one in stretches}):
        systems.prepare(plan.folded_batch if is_folded else plan.batch, is_folded=is_folded)

    def parts() -> Iterator[Part]:
        for one in stretches:
            for first in range(one.first, one.end, one.batch):
                count = min(one.batch, one.end - first)
                yield Part(first, drawn_from(systems.germs, plan.seed, first, count))

    def batch(part: Part) -> Simulated:
        is_folded = part.first >= plan.before
        points = fill(part.points, plan.folded_batch if is_folded else plan.batch)
        return Simulated.of(systems.simulate(points, len(part.points), is_folded=is_folded), part, plan.keep)

    found = each(batch, parts())
    for one in stretches:
        some = [done for _, done in itertools.islice(found, -(-one.systems // one.batch))]
        yield one, Simulated.joined(some)
