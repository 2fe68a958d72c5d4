"""`ExpansionQuality`: how far the expansions of a solution can be trusted; `Moments`: those of a functional."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Float

from aleator._core.shown import Printed
from aleator.expansion import ILL_CONDITIONED, UNRESOLVED, Unseen


@final
@dataclass(frozen=True)
class Moments(Printed):
    """Mean and standard deviation of one functional by the expansion: one number each, or one per instant."""

    mean: Float[np.ndarray, "*shape"]
    std: Float[np.ndarray, "*shape"]

    def __str__(self) -> str:
        return f"mean {ends(self.mean)}, standard deviation {ends(self.std)}"


def ends(values: Float[np.ndarray, "*shape"]) -> str:
    """A number, or from where to where many reach."""
    least, most = float(np.min(values)), float(np.max(values))
    return f"{least:.6g}" if np.ndim(values) == 0 else f"from {least:.6g} to {most:.6g}"


class Tangent(NamedTuple):
    """The derivative of a functional by a parameter of a distribution, and the leave-one-out error of its expansion."""

    functional: str
    parameter: str
    error: float

    def __str__(self) -> str:
        return f"leave-one-out error {self.error:.2e} ({self.functional} by {self.parameter})"


@final
@dataclass(frozen=True)
class ExpansionQuality(Printed):
    """How far the expansion can be trusted at the solution.

    - `order`, `terms`, `points`: of the expansion; for an adaptive one, as reached in the end;
    - `condition_number`: of the collocation matrix;
    - `leave_one_out`: for each functional, the rms error of predicting a collocation point from all others, relative
      to the standard deviation; zero if it varies by no more than rounding;
    - `unresolved_from`: for each path that is resolved only at first, the instant (s) from which on that error is too
      large: a fixed order does not resolve an arbitrarily long simulation;
    - `tolerance`: the relative error up to which a functional counts as resolved, as set in the `Expansion`;
    - `tangents`: for each functional, the leave-one-out error of its derivative by each decision that is a parameter of
      a distribution. It bounds the trust in derivatives of its statistics, and in the shadow prices computed from them;
    - `unseen`: the largest corner of the germ space without a collocation point, about which nothing is known; None if
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
        """The worst resolved derivative by a distribution's parameter; None if there is none."""
        every = [Tangent(text, name, error) for text, one in self.tangents.items() for name, error in one.items()]
        return max(every, key=lambda one: np.inf if np.isnan(one.error) else one.error, default=None)

    @property
    def unresolved(self) -> tuple[str, ...]:
        """The functionals whose error is too large for their statistics to be trusted, at least at the end."""
        errors = self.leave_one_out.items()
        return tuple(text for text, error in errors if not error <= self.tolerance or text in self.unresolved_from)

    @property
    def can_be_checked(self) -> bool:
        """Whether there are more points than terms to check it by: not for interpolation or sparse quadrature."""
        return not any(np.isposinf(error) for error in self.leave_one_out.values())

    @property
    def is_conditioned(self) -> bool:
        """Whether the collocation matrix is conditioned well enough for accurate coefficients."""
        return self.condition_number <= ILL_CONDITIONED

    def since(self, text: str) -> str:
        """From when on a path is not resolved, in words; empty for other functionals."""
        return f" from t = {self.unresolved_from[text]:.4g} s on" if text in self.unresolved_from else ""

    def tangent_sentence(self) -> str:
        """How well the derivatives by distribution parameters are resolved, with the remedy if they are not."""
        worst = self.worst_tangent
        if worst is None:
            return ""
        said = f"by distribution parameters: worst {worst}"
        if worst.error <= self.tolerance:
            return said
        return (
            f"{said}: not resolved, so shadow prices and stationarity are those of the expansion; raise the order "
            "for the model's"
        )

    def __str__(self) -> str:
        if self.points == 1:
            return "nothing is uncertain"
        return (
            f"order {self.order}, {self.terms} terms, {self.points} points, condition number "
            f"{self.condition_number:.3g}, worst leave-one-out error {self.worst:.2e}"
        )
