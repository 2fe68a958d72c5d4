"""What certifies a solution: its constraints one by one, its expansion, and what a finer grid shows."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator.expansion import ILL_CONDITIONED, UNRESOLVED, Unseen
from aleator.nlp import HELD

TOLERATED = 1e-3
"""Between instants, a limit that is exceeded by more than this part of it makes a design no solution."""


@final
@dataclass(frozen=True)
class ConstraintResult:
    """One constraint at a solution, in user units.

    - `values`: its expression, a number or one number an instant; `times`: the instants (s), None for a number;
    - `multipliers`: the price of the bound, `-d objective / d bound`, in the shape of `values`: positive where the
      upper bound is active, negative where the lower one is;
    - `active`: where it is active, in the shape of `values`;
    - `scale`: its magnitude, in its own unit: that of its bound and of its values around the answer, as
      `constraint_size` of the transcription says. It holds where it misses its bound by no more than a millionth of it.
    """

    name: str
    text: str
    lower: float
    upper: float
    values: Float[np.ndarray, "*shape"]
    times: Float[np.ndarray, " instants"] | None
    multipliers: Float[np.ndarray, "*shape"]
    active: np.ndarray
    scale: float

    @property
    def excess(self) -> Float[np.ndarray, "*shape"]:
        """By how much the nearer bound is exceeded; negative inside."""
        return np.maximum(self.values - self.upper, self.lower - self.values)

    @property
    def violation(self) -> float:
        """Largest excess over a bound, zero if it holds everywhere."""
        return max(0.0, float(np.max(self.excess)))

    @property
    def holds(self) -> bool:
        """Whether it holds everywhere, to a millionth of its magnitude."""
        return self.violation <= HELD * self.scale

    @property
    def worst_time(self) -> float | None:
        """The instant (s) at which the constraint is closest to, or furthest beyond, its bound."""
        return None if self.times is None else float(self.times[np.argmax(_by_instant(self.excess))])

    @property
    def price(self) -> float:
        """How much the objective falls for each unit by which the bound is relaxed, summed over its active instants.

        An equality is not relaxed but moved: there it is how much the objective falls for each unit by which the number
        is raised, which may be negative.
        """
        if self.lower == self.upper:
            return float(np.sum(self.multipliers))
        return float(np.sum(np.abs(self.multipliers)))

    @property
    def worst(self) -> float:
        """The value that is closest to, or furthest beyond, its bound."""
        return float(self.values.flat[int(np.argmax(self.excess))])

    def sentence(self) -> str:
        """What is violated, when and by how much, and how it is written."""
        when = "" if self.worst_time is None else f" at t = {self.worst_time:.4g} s"
        worst = self.worst
        bound, relation = (self.upper, "≤") if worst > self.upper else (self.lower, "≥")
        relation = "=" if self.lower == self.upper else relation
        asked = f"{worst:.6g} where {relation} {bound:.6g} is asked ({self.text})"
        return f"'{self.name}' is violated by {self.violation:.4g}{when}: {asked}"


def _by_instant(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1).max(axis=1)


@final
@dataclass(frozen=True)
class Times:
    """Wall times in seconds. `compile_` is zero if a problem of the same structure was compiled before."""

    import_: float
    compile_: float
    solve: float


class Tangent(NamedTuple):
    """The derivative of a functional by a parameter of a distribution, and the leave-one-out error of its expansion."""

    functional: str
    parameter: str
    error: float


@final
@dataclass(frozen=True)
class ExpansionQuality:
    """How far the expansion can be trusted at the solution.

    - `order`, `terms`, `points`: those of the expansion, as far as they were reached where it adapts to the problem;
    - `condition_number`: that of the collocation matrix;
    - `leave_one_out`: for each functional, the rms error of predicting a collocation point from all others, relative
      to the standard deviation; zero where it spreads by no more than rounding;
    - `unresolved_from`: for each path that is followed only so far, the instant (s) from which on that error is too
      large: polynomials of one order do not follow a long simulation for ever;
    - `tolerance`: the relative error up to which a functional counts as resolved, that of the `Expansion`;
    - `tangents`: for each functional, the leave-one-out error of its derivative by each decision that is a parameter of
      a distribution: how far the derivatives of its statistics by them, and prices that follow from these, are those
      of the model;
    - `unseen`: the largest corner of the uncertainty that holds no point, so that nothing is known of it; None where
      nothing is uncertain.
    """

    order: int
    terms: int
    points: int
    condition_number: float
    leave_one_out: Mapping[str, float] = field(default_factory=dict)
    unresolved_from: Mapping[str, float] = field(default_factory=dict)
    tolerance: float = UNRESOLVED
    tangents: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    unseen: Unseen | None = None

    @property
    def worst(self) -> float:
        """The largest leave-one-out error."""
        return max(self.leave_one_out.values(), default=0.0)

    @property
    def worst_tangent(self) -> "Tangent | None":
        """The derivative by a distribution's parameter that is resolved worst; None where there is none."""
        every = [Tangent(text, name, error) for text, one in self.tangents.items() for name, error in one.items()]
        return max(every, key=lambda one: np.inf if np.isnan(one.error) else one.error, default=None)

    @property
    def unresolved(self) -> tuple[str, ...]:
        """The functionals whose statistics cannot be trusted, because their error is too large, at least at the end."""
        errors = self.leave_one_out.items()
        return tuple(text for text, error in errors if not error <= self.tolerance or text in self.unresolved_from)

    @property
    def can_be_checked(self) -> bool:
        """Whether points are left to check it by: interpolation and sparse quadrature have none."""
        return not any(np.isposinf(error) for error in self.leave_one_out.values())

    @property
    def is_conditioned(self) -> bool:
        """Whether the collocation matrix leaves the coefficients enough digits."""
        return self.condition_number <= ILL_CONDITIONED

    def since(self, text: str) -> str:
        """From when on a path is not resolved, in words; nothing for other functionals."""
        return f" from t = {self.unresolved_from[text]:.4g} s on" if text in self.unresolved_from else ""


@final
@dataclass(frozen=True)
class Between:
    """What a finer grid shows of a solution: how far limits over time are exceeded between the instants, at worst.

    - `factor`: how many times as many steps that grid has;
    - `worst`: relative to the bound, or to the constraint's scale where that is zero; zero where all hold;
    - `name`: of the constraint; `time`: when, s, not-a-number for a peak;
    - `is_strict`: whether what happens between instants shapes the design: where bounds had to be tightened for it, and
      where a system follows trajectories. Its systems are counted there too.
    """

    factor: int
    worst: float
    name: str
    time: float
    is_strict: bool = False

    @property
    def holds(self) -> bool:
        """Whether all limits hold there, to tolerance."""
        return self.worst <= HELD

    def sentence(self) -> str:
        """Whether limits hold there, or which does not, and by how much."""
        if self.holds:
            return f"limits over time hold on {self.factor} times as many steps too"
        when = "" if np.isnan(self.time) else f" after t = {self.time:.4g} s"
        if np.isinf(self.worst):
            return f"between the instants of the grid '{self.name}' is not a number{when}: use more steps"
        return (
            f"between the instants of the grid '{self.name}' exceeds its bound by {self.worst:.2g} of it{when}: "
            "use more steps"
        )


@final
@dataclass(frozen=True)
class Moments:
    """Mean and standard deviation of one functional by the expansion: numbers, or one number an instant."""

    mean: Float[np.ndarray, "*shape"]
    std: Float[np.ndarray, "*shape"]
