"""The one-way clutch of a lawn mower (section 7.2): tolerances of three parts, pressure angle of a roller.

A roller of radius `c` wedges between a hub of height `a` and a ring of radius `e`. The pressure angle `chi` between the
two contacts decides whether the clutch holds: 6° to 8°. Lengths in mm, angles in degrees.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
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
