"""A small algebraic problem whose answers are known: `x + x³ = a`, the force `a` uncertain, to a tolerance."""

from typing import Any, ClassVar

import aleator as al
import zoo

X = al.output("x")


class Hardening(zoo.Hardening):
    """The spring that hardens, with units."""

    units: ClassVar = {"x": "m", "force": "N"}


def tolerance_problem(limit: Any = None, **options: Any) -> al.Problem:
    """The cheapest tolerance on the force, around 2, that keeps the deflection below a limit."""
    return al.Problem(
        Hardening(a=al.Uniform(2.0, half_width=al.Decision(0.2, 0.01, 1.5))),
        minimize=al.cost.reciprocal("a.half_width", bias=1.0, scale=0.5),
        subject_to=[X.at_most(1.1, worst_case=True) if limit is None else limit],
        **options,
    )
