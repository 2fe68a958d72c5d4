"""The one-way clutch of a lawn mower (section 7.2): tolerances of three parts, pressure angle of a roller.

A roller of radius `c` wedges between a hub of height `a` and a ring of radius `e`. The pressure angle `chi` between the
two contacts decides whether the clutch holds: 6° to 8°. Lengths in mm, angles in degrees.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float

import aleator as al

MEANS = {"a": 27.645, "c": 11.430, "e": 50.800}
TOLERANCES = {"a": 0.05, "c": 0.01, "e": 0.0125}
NAMES = {"a": "hub a", "c": "roller c", "e": "ring e"}

LIMITS = (6.0, 8.0)
"""The range of pressure angles in which the clutch works, degrees."""

NOMINAL = float(np.rad2deg(np.arccos((MEANS["a"] + MEANS["c"]) / (MEANS["e"] - MEANS["c"]))))
DEVIATION = (NOMINAL - 0.6, NOMINAL + 0.6)
"""A second specification: nominal ± 0.6°."""

SPECIFICATIONS = {"limits": LIMITS, "deviation": DEVIATION}

EXACT = 0.6590101411246803
"""Three standard deviations of the pressure angle, degrees: Gauss quadrature of its closed form."""

COST = "Σ 1/T"
TIGHTEST, WIDEST = 0.002, 0.2


def clutch(tolerances: Mapping[str, Any] = TOLERANCES) -> al.Assembly:
    """The clutch as a closed vector loop (121); each dimension is normal with standard deviation tolerance / 3.

    Up the hub, along it to the roller, up to its middle and on to the ring, and back to the middle of the ring.
    The roller appears twice in the loop: one part, one random variable (erratum of table 7.2). `tolerances` may be
    decisions.
    """
    return al.Assembly(
        dimensions={name: al.Toleranced(mean, tolerance=tolerances[name]) for name, mean in MEANS.items()},
        unknowns={"b": 4.8, "chi": 7.0, "gamma": 83.0},
        loops=[[("a", 90), ("b", 0), ("c", 90), ("c", "90 - chi"), ("-e", "90 - chi")]],
        equations=["chi + gamma = 90"],
        units={"b": "mm", "chi": "°", "gamma": "°"},
    )


def pressure_angle(
    a: Float[np.ndarray, " n"], c: Float[np.ndarray, " n"], e: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """The same angle in closed form, degrees: `cos chi = (a + c) / (e - c)`."""
    return np.rad2deg(np.arccos((a + c) / (e - c)))


def worst_case(tolerances: Mapping[str, float]) -> tuple[float, float]:
    """Smallest and largest pressure angle with each dimension anywhere within its tolerance, degrees.

    The angle falls with the hub and the roller and rises with the ring, so that two corners of the box bound it.
    """
    towards_low = {"a": 1.0, "c": 1.0, "e": -1.0}
    corners = [[MEANS[name] + side * sign * tolerances[name] for name, sign in towards_low.items()] for side in (1, -1)]
    least, largest = (float(pressure_angle(*np.array(corner))) for corner in corners)
    return least, largest


def exact_rejects(tolerances: Mapping[str, float], limits: tuple[float, float] = LIMITS) -> tuple[float, float]:
    """The shares of assemblies below and above the limits of a specification, of normal parts.

    The angle is below a limit where `a + c > cos(limit) (e - c)`: a sum of normal parts, itself normal.
    """
    tails = []
    for limit, sign in zip(limits, (1.0, -1.0), strict=True):
        cosine = float(np.cos(np.deg2rad(limit)))
        weights = {"a": 1.0, "c": 1.0 + cosine, "e": -cosine}
        room = -sum(weights[name] * MEANS[name] for name in MEANS)
        deviation = np.sqrt(sum((weights[name] * tolerances[name] / 3) ** 2 for name in MEANS))
        tails.append(float(scipy.special.ndtr(-sign * room / deviation)))
    return tails[0], tails[1]


def tolerances_of(solution: al.Solution) -> dict[str, float]:
    """The tolerances that a design chose, mm."""
    return {name: float(solution.decisions[f"{name}.tolerance"]) for name in TOLERANCES}


def cost(tolerances: Mapping[str, float]) -> float:
    """The sum of the reciprocal tolerances, 1/mm."""
    return sum(1 / tolerance for tolerance in tolerances.values())


def published_expansion(order: int) -> al.Expansion:
    """An expansion at the points of the dissertation, which differ from the default ones for normal distributions."""
    return al.Expansion(order, points=al.points.HammersleyPoints())


def allocation_problem(rejects: float = 0.0065) -> al.Problem:
    """Optimal uncertainty apportionment (122): the tolerances of minimum cost `Σ 1/T`, at a limit on the rejects.

    `rejects` is the share of assemblies whose angle may lie outside the second specification.
    """
    decisions = {name: al.Decision(start, TIGHTEST, WIDEST) for name, start in TOLERANCES.items()}
    chi, (lower, upper) = al.output("chi"), DEVIATION
    hub, roller, ring = (al.cost.reciprocal(f"{name}.tolerance", bias=0.0, scale=1.0) for name in MEANS)
    return al.Problem(
        clutch(decisions),
        minimize=hub + roller + ring,
        subject_to=[(chi.probability(below=lower) + chi.probability(above=upper) <= rejects).named("rejects")],
        expansion=published_expansion(3),
    )
