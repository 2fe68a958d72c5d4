"""A small algebraic problem whose answers are known: `x + x³ = a`, the force `a` uncertain, to a tolerance."""

from typing import Any, ClassVar

import numpy as np

import aleator as al
from aleator.dynamics import AlgebraicSystem

SPREAD = al.value("a.half_width")
X = al.output("x")


class Hardening(AlgebraicSystem):
    """A spring that hardens: the deflection `x` under a force `a`."""

    unknowns = ("x",)
    units: ClassVar = {"x": "m", "force": "N"}

    a: Any = al.parameter("N")
    k: Any = 1.0

    def guess(self):
        return {"x": 0.5}

    def residual(self, rho):
        return (self.k * rho.x + rho.x**3 - self.a,)

    def outputs(self, rho):
        return {"x": rho.x, "force": self.k * rho.x}


def deflection(a):
    """The real root of `x + x³ = a`, by Cardano."""
    root = np.sqrt(a**2 / 4 + 1 / 27)
    return np.cbrt(a / 2 + root) + np.cbrt(a / 2 - root)


def tolerance_problem(limit: Any = None, **options: Any) -> al.Problem:
    """The cheapest tolerance on the force, around 2, that keeps the deflection below a limit."""
    force = al.Uniform(2.0, half_width=al.Decision(0.2, 0.01, 1.5))
    return al.Problem(
        Hardening(a=force),
        minimize=al.cost.reciprocal("a.half_width", bias=1.0, scale=0.5),
        subject_to=[X.at_most(1.1, worst_case=True) if limit is None else limit],
        **options,
    )
