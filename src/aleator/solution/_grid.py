"""An answer over time: the error of its grid, limits between instants, its mesh with errors, states and costates."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import refusal
from aleator._core.leaves import Drawn, Printed
from aleator.dynamics import AbstractScheme, phase_of
from aleator.nlp import HELD

MOST_NUMBERS = 5
"""Messages list at most this many numbers."""


def system_text(numbers: Mapping[str, float], most: int = MOST_NUMBERS) -> str:
    """A system by its uncertain numbers, the first few if there are many."""
    shown = [f"{name} = {number:.6g}" for name, number in numbers.items()]
    left = len(shown) - most
    return ", ".join(shown[:most]) + (f" and {left} more" if left > 0 else "")


def lines(rows: list[tuple[str, str]]) -> str:
    """Labels and texts as text, one pair a line."""
    return "\n".join(f"{label:<12} {text}" for label, text in rows)


# Limits on the factor of steps from one grid to the next, since the error of a very coarse grid predicts no number of
# steps; and the safety factor on the number that the order of convergence predicts.
_LEAST, _MOST, _AHEAD = 2, 8, 1.2


@final
@dataclass(frozen=True)
class Deviation(Printed):
    """How far a quantity differs from its value on a finer grid, in its own unit.

    - `error`: for a functional the largest change of its mean or its standard deviation, plus a quarter for the error
      of the finer grid itself; `tolerated`: the error that is accepted;
    - `time`: when a path differs most (s); NaN for other functionals;
    - `order`: the order of convergence: by which power of the step the error falls.
    """

    error: float
    tolerated: float
    time: float = float("nan")
    order: int = 4

    @property
    def ratio(self) -> float:
        """The error over the tolerated error; infinite if the error is NaN."""
        return np.inf if np.isnan(self.error) else self.error / self.tolerated

    def __str__(self) -> str:
        when = "" if np.isnan(self.time) else f" at t = {self.time:.4g} s"
        return f"off by {self.error:.2g}{when}, where {self.tolerated:.2g} is tolerated"


@final
@dataclass(frozen=True)
class GridError(Printed):
    """The error of the time grid at a solution, estimated by a finer grid and an integrator of another order.

    - `steps`: of the solution's grid, 0 where the model itself simulates; `factor`: how many times as many the finer
      one has;
    - `objective`: its deviation; `functionals`: those of functionals, by their texts;
    - `broken`: a sentence on the constraint that does not hold on the finer grid, or that differs so much there that
      this grid does not tell whether it holds; empty if there is none;
    - `pieces`: the number of polynomial pieces of the splines that the system follows, whose ends should be instants;
    - `by_tolerances`: whether the integrator has tolerances of its own, besides the steps of the grid;
    - `inside`: whether the model itself simulates on a grid of its own, which then is finer too.
    """

    steps: int
    factor: int
    objective: Deviation
    functionals: Mapping[str, Deviation]
    broken: str = ""
    pieces: int = 1
    by_tolerances: bool = False
    inside: bool = False

    @property
    def ratio(self) -> float:
        """The largest deviation of a functional or of the objective over its tolerance."""
        return max(one.ratio for one in (self.objective, *self.functionals.values()))

    @property
    def is_met(self) -> bool:
        """Whether all deviations are tolerated, and all limits hold."""
        return self.ratio <= 1 and not self.broken

    @property
    def is_usable(self) -> bool:
        """Whether the solution holds on the finer grid: all limits, the objective to tolerance, and no NaN."""
        finite = all(np.isfinite(one.error) for one in self.functionals.values())
        return self.objective.ratio <= 1 and not self.broken and finite

    @property
    def _times(self) -> float:
        """The factor of steps that meets the tolerance by the orders of convergence."""
        return _AHEAD * max(one.ratio ** (1 / one.order) for one in (self.objective, *self.functionals.values()))

    @property
    def next_steps(self) -> int:
        """The number of steps that `solve(refine=True)` takes next: at least twice the present one, at most eight times
        as many, and a multiple of the pieces of splines, so that steps end where these do and no order is lost.
        """
        return self.pieces * int(np.ceil(min(max(_LEAST, self._times), _MOST) * self.steps / self.pieces))

    def __str__(self) -> str:
        where = f"seen on {self.factor} times as many steps{'' if self.steps else ' of what the model simulates'}"
        name, worst = max(self.functionals.items(), key=lambda one: one[1].ratio, default=("", self.objective))
        if self.is_met:
            other = f"'{name}' by {worst.error:.1e}" if name else "nothing else"
            return f"objective off by {self.objective.error:.1e}, {other}; {where}"
        off = f"the objective is {self.objective}" if self.objective.ratio > 1 or not name else f"'{name}' is {worst}"
        told = "about" if self.ratio > 1 and self._times <= _MOST else "at least"
        remedies = []
        if self.steps:
            also = " and smaller tolerances of the integrator" if self.by_tolerances else ""
            remedies = [f"use {told} {self.next_steps} steps{also}, or refine=True, or declare jumps"]
        if self.inside:
            remedies.append(f"give the grids inside the model {told} {min(self._times, _MOST):.2g} times as many")
        return f"{self.broken or off}; {where}: {'; '.join(remedies)}"


TOLERATED = 1e-3
"""Largest relative excess of a limit between instants with which a design still counts as a solution."""

# What tightened bounds may cost at most without a word.
_TOLD = 0.01
COSTLY = 0.05
"""The largest cost of margins that is accepted without a warning."""


@final
@dataclass(frozen=True)
class Between(Printed):
    """The worst excess of a limit over time between the instants, found on a finer grid.

    - `factor`: how many times as many steps that grid has;
    - `worst`: the excess relative to the bound, or to the constraint's scale if the bound is zero; zero if all hold;
    - `name`: the constraint that is exceeded most; `time`: when (s), NaN for a peak;
    - `is_strict`: whether the design depends on what happens between instants: because bounds were tightened for it, or
      because the system follows trajectories. Evidence then counts violations on the finer grid too;
    - `cost`: how much worse the objective is than the optimum that holds at the instants alone, relative to the larger
      of both: what tightening costs at most, since the best design lies between; zero where no bound is tightened;
    - `is_coarse`: whether an output jumps and exceeds its limit there beside a single instant, which limits nothing but
      its own value.
    """

    factor: int
    worst: float
    name: str
    time: float
    is_strict: bool = False
    cost: float = 0.0
    is_coarse: bool = False

    @property
    def holds(self) -> bool:
        """Whether all limits hold there, to the tolerance with which a design counts as a solution."""
        return self.worst <= TOLERATED

    @property
    def is_costly(self) -> bool:
        """Whether bounds were tightened at instants so much that a finer grid may have a considerably better design."""
        return self.cost > COSTLY

    @property
    def is_enough(self) -> bool:
        """Whether no finer grid would help."""
        return np.isinf(self.worst) or (self.holds and not self.is_costly and not self.is_coarse)

    def __str__(self) -> str:
        if self.holds:
            cost = f"may cost up to {self.cost:.2g} of the objective: use more steps"
            tightened = f", by bounds tightened at the instants, which {cost}" if self.cost > _TOLD else ""
            nearly = f" to {self.worst:.1g} of their bounds" if self.worst > HELD else ""
            return f"limits over time hold{nearly} on {self.factor} times as many steps too{tightened}"
        when = "" if np.isnan(self.time) else f" after t = {self.time:.4g} s"
        seen = "is not a number" if np.isinf(self.worst) else f"exceeds its bound by {self.worst:.2g} of it"
        return f"between the instants of the grid '{self.name}' {seen}{when}: use more steps"


@final
@dataclass(frozen=True)
class MeshError(Drawn):
    """The error of one mesh, interval by interval; the meshes of phases stand one after the other.

    - `nodes`: the ends of the intervals, s, shape (intervals + 1,), their means where each realisation has its own;
      `scheme`: what holds states to their equations;
    - `drifts`: how far the states of each realisation drift from their equations within each interval, relative to the
      largest magnitude of each state: of the state that drifts most, shape (realisations, intervals). Realisations are
      those of `solution.mesh_states`;
    - `asked`: the error that was asked for; infinite if none was;
    - `numbers`: the uncertain numbers of the realisation that drifts most, by name.
    """

    nodes: Float[np.ndarray, " nodes"]
    scheme: AbstractScheme
    drifts: Float[np.ndarray, "realisations intervals"]
    asked: float
    numbers: Mapping[str, float]

    @property
    def intervals(self) -> int:
        """How many intervals the mesh has."""
        return self.drifts.shape[1]

    @property
    def errors(self) -> Float[np.ndarray, " intervals"]:
        """The drift of the worst realisation of each interval."""
        return self.drifts.max(axis=0)

    @property
    def worst(self) -> float:
        """The largest error; zero where there are no states."""
        return float(self.drifts.max())

    @property
    def is_met(self) -> bool:
        """Whether every interval is as accurate as asked."""
        return self.worst <= self.asked

    def __str__(self) -> str:
        k = int(np.argmax(self.errors))
        place = f" from t = {self.nodes[k]:.4g} to {self.nodes[k + 1]:.4g} s"
        system = f" with {system_text(self.numbers)}" if self.numbers else ""
        asked = "" if np.isinf(self.asked) else f", where {self.asked:.2g} is asked"
        drift = f"states drift by {self.worst:.2g} of their magnitude at worst"
        return f"{self.intervals} intervals of {self.scheme}: {drift}{place}{system}{asked}"


class AbstractOverTime(Drawn):
    """Arrays over time, by name.

    - `times`: s; `values`: each with an axis along these; `phases`: which of the times are those of each phase, if
      there are phases.
    """

    times: np.ndarray
    values: Mapping[str, np.ndarray]
    phases: Mapping[str, slice]

    def where(self, name: str) -> slice:
        """Which of the times are those of an array: those of its phase, where there are phases."""
        return self.phases.get(phase_of(name), slice(None))

    def times_of(self, name: str) -> np.ndarray:
        """The times of an array, s."""
        return self.times[self.where(name)]

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.values:
            raise refusal("name", f"one of {list(self.values)}", name)
        return self.values[name]

    @property
    def ranges(self) -> str:
        """From where to where each of them goes."""
        return ", ".join(f"{name} from {np.min(one):.4g} to {np.max(one):.4g}" for name, one in self.values.items())


@final
@dataclass(frozen=True)
class States(AbstractOverTime):
    """The states of some realisations over time.

    - `times`: the points of the mesh, s, shape (points,), their means where each realisation has its own;
    - `germs`: the germ points of the realisations, shape (realisations, variables);
    - `values`: by the name of the state, shape (realisations, points, ...);
    - `durations`: how long each realisation of a phase lasts, s, where an event ends it, shape (realisations, 1).
    """

    times: Float[np.ndarray, " points"]
    germs: Float[np.ndarray, "realisations variables"]
    values: Mapping[str, Float[np.ndarray, "realisations points ..."]]
    phases: Mapping[str, slice] = field(default_factory=dict)
    durations: Mapping[str, Float[np.ndarray, "realisations 1"]] = field(default_factory=dict)

    def fractions(self, phase: str = "") -> Float[np.ndarray, " points"]:
        """The points of the mesh of a phase as fractions of its duration."""
        times = self.times_of(phase)
        return (times - times[0]) / (times[-1] - times[0])

    def rows(self, phase: str = "") -> Float[np.ndarray, "realisations points states"]:
        """All states of a phase side by side."""
        own = [one for name, one in self.values.items() if not phase or phase_of(name) == phase]
        shape = len(self.germs), len(self.times_of(phase))
        return np.concatenate([np.zeros((*shape, 0)), *(one.reshape(*shape, -1) for one in own)], axis=2)

    def __str__(self) -> str:
        count, span = len(self.germs), f"from t = {self.times[0]:.4g} to {self.times[-1]:.4g} s"
        return f"{count} realisation{'s'[: count > 1]} at {len(self.times)} points {span}: {self.ranges}"


@final
@dataclass(frozen=True)
class Costates(AbstractOverTime):
    """The derivative of the optimal objective by each state at each node: by an extra push of it at that instant.

    Their sign is that of the objective: a negative costate says that more of the state would lower it. A realisation is
    pushed by itself, so that the sum over realisations belongs to a push of all of them.

    - `times`: the nodes of the mesh, s, shape (nodes,);
    - `germs`: the germ points of the realisations, shape (realisations, variables);
    - `values`: by the name of the state, shape (realisations, nodes, ...).
    """

    times: Float[np.ndarray, " nodes"]
    germs: Float[np.ndarray, "realisations variables"]
    values: Mapping[str, Float[np.ndarray, "realisations nodes ..."]]
    phases: Mapping[str, slice] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"costates of {self.ranges}, {len(self.germs)} realisations at {len(self.times)} nodes"


@final
@dataclass(frozen=True)
class Switching(AbstractOverTime):
    """The derivative of the Hamiltonian by each input: by how much the objective changes for each unit of the input and
    each second that it is raised there. Where it is positive, an input at its lower bound is optimal; where it is
    negative, one at its upper bound; a control that is between its bounds makes it zero.

    The Hamiltonian holds the costates times the rates, and the integrands in the objective and in limits, summed over
    realisations. Limits on outputs at instants are not in it, and it is empty where inputs are uncertain, realisations
    end by an event or a statistic is integrated over time.

    - `times`: where the scheme asks for rates, s, shape (points,); where inputs jump, nodes may be there twice, as seen
      from before and from after;
    - `values`: by the name of the input, shape (points, ...).
    """

    times: Float[np.ndarray, " points"]
    values: Mapping[str, Float[np.ndarray, "points ..."]]
    phases: Mapping[str, slice] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"switching function of {self.ranges}, at {len(self.times)} points"


class Smoothing(NamedTuple):
    """The same design at half the widths of `al.smooth`.

    - `objective`, `narrower`: the objective at the stated widths and at half of them, both on the grid of the check;
    - `moved`: by how much each limit moves, at most; `broken`: the limits that it breaks by more than a thousandth.
    """

    objective: float
    narrower: float
    moved: Mapping[str, float]
    broken: tuple[str, ...]

    def __str__(self) -> str:
        broken = f"; this breaks {', '.join(map(repr, self.broken))}: state smaller widths" if self.broken else ""
        limits = "".join(f", '{name}' moves by {by:.2g}" for name, by in self.moved.items() if by > 0)
        return f"at half the widths the objective is {self.narrower:.7g} for {self.objective:.7g}{limits}{broken}"
