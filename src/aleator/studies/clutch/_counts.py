"""Rejects of the clutch for given tolerances, counted one by one, and the exact worst case.

Everything is computed from the closed form of the angle, independently of the expansion that it verifies.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

import aleator as al
from aleator._core.border import Progress, silent
from aleator.studies.clutch import DEVIATION, LIMITS, MEANS, TOLERANCES, pressure_angle

GIVEN, CHEAPEST, SAFE = "given", "cheapest", "worst case within limits"
AT_ONCE = 1_000_000
ROUNDING = 1e-9


@final
@dataclass(frozen=True)
class Tails:
    """The proportions of counted assemblies below and above the limits of a specification."""

    low: al.results.Proportion
    high: al.results.Proportion

    @property
    def either(self) -> al.results.Proportion:
        """Both together."""
        return al.results.Proportion(self.low.count + self.high.count, self.low.samples)


@final
@dataclass(frozen=True)
class Counts:
    """The rejects of some tolerances (mm) under both specifications.

    - `function`: rejects by the limits between which the clutch works; `deviation`: by the second specification;
    - `worst_case`: smallest and largest angle with each dimension anywhere within its tolerance, degrees.
    """

    tolerances: Mapping[str, float]
    function: Tails
    deviation: Tails
    worst_case: tuple[float, float]

    @property
    def by_name(self) -> dict[str, Tails]:
        """The rejects by the names of the specifications."""
        return {"limits": self.function, "deviation": self.deviation}

    def broken(self, limits: tuple[float, float] = LIMITS) -> list[float]:
        """The limits, by default the function's, that the worst case breaks by more than rounding."""
        (least, largest), (lower, upper) = self.worst_case, limits
        return [lower] * (least < lower - ROUNDING) + [upper] * (largest > upper + ROUNDING)

    @property
    def cost(self) -> float:
        """The sum of the reciprocal tolerances, 1/mm."""
        return sum(1 / tolerance for tolerance in self.tolerances.values())


def count_rejects(
    tolerances: Mapping[str, float], samples: int, *, seed: int = 2, progress: Progress = silent
) -> Counts:
    """Assemble `samples` clutches of normal parts, standard deviation a third of the tolerance, and count rejects."""
    generator = np.random.default_rng(seed)
    found = np.zeros(4, dtype=int)
    for done in range(0, samples, AT_ONCE):
        progress("counting rejects", done, samples)
        drawn = generator.standard_normal((len(MEANS), min(AT_ONCE, samples - done)))
        parts = (MEANS[name] + tolerances[name] / 3 * row for name, row in zip(MEANS, drawn, strict=True))
        angle = pressure_angle(*parts)
        found += [np.sum(side) for lower, upper in (LIMITS, DEVIATION) for side in (angle < lower, angle > upper)]
    shares = [al.results.Proportion(int(one), samples) for one in found]
    return Counts(dict(tolerances), Tails(*shares[:2]), Tails(*shares[2:]), worst_case(tolerances))


def worst_case(tolerances: Mapping[str, float]) -> tuple[float, float]:
    """Smallest and largest pressure angle with each dimension anywhere within its tolerance, degrees.

    The angle falls with the hub and the roller and rises with the ring, so that two corners of the box bound it.
    """
    corners = [[MEANS[name] + sign * _towards_low(name) * tolerances[name] for name in MEANS] for sign in (1.0, -1.0)]
    least, largest = (float(pressure_angle(*np.array(corner))) for corner in corners)
    return least, largest


def exact_rejects(tolerances: Mapping[str, float]) -> tuple[float, float]:
    """The shares of assemblies below and above the function's limits, of normal parts.

    The angle is below a limit where `a + c > cos(limit) (e - c)`: a sum of normal parts, itself normal.
    """
    tails = []
    for limit, sign in zip(LIMITS, (1.0, -1.0), strict=True):
        weights, room = _margin(limit)
        deviation = np.sqrt(sum((weights[name] * tolerances[name] / 3) ** 2 for name in MEANS))
        tails.append(float(scipy.special.ndtr(-sign * room / deviation)))
    return tails[0], tails[1]


def worst_case_tolerances() -> dict[str, float]:
    """The cheapest tolerances, by the sum of 1/T, whose worst case stays within the function's limits, mm.

    At a limit, the worst case is linear in the tolerances: `Σ w T <= room`. Of such tolerances the cheapest are
    `T = room / (sqrt(w) Σ sqrt(w))`. The limit with less room decides, since the weights at both limits agree within
    half a percent, their rooms only within a tenth.
    """
    weights, room = min((_margin(limit) for limit in LIMITS), key=lambda one: abs(one[1]))
    roots = {name: float(np.sqrt(abs(weight))) for name, weight in weights.items()}
    return {name: abs(room) / (root * sum(roots.values())) for name, root in roots.items()}


def tolerances_of(solution: al.Solution) -> dict[str, float]:
    """The tolerances that a design chose, mm."""
    return {name: float(solution.decisions[f"{name}.tolerance"]) for name in TOLERANCES}


def _towards_low(name: str) -> float:
    return -1.0 if name == "e" else 1.0


def _margin(limit: float) -> tuple[dict[str, float], float]:
    """How `cos(limit) (e - c) - (a + c)`, mm, falls with each dimension, and its value at the nominal dimensions.

    It is positive where the angle is above the limit.
    """
    cosine = float(np.cos(np.deg2rad(limit)))
    weights = {"a": 1.0, "c": 1.0 + cosine, "e": -cosine}
    return weights, -sum(weights[name] * MEANS[name] for name in MEANS)
