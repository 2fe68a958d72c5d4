"""Problems whose evidence needs paths, integrals and numbers, in a module that processes can import."""

from typing import Any

import aleator as al
from zoo import Decay

GRID = al.Grid(1.0, 10)


def decaying_problem(*further: al.Constraint, **options: Any) -> al.Problem:
    """The least to begin with of which most systems have enough left: a sixth of them has less."""
    x = al.path("x")
    limits = [
        (x.mean - x.std >= 0.5).named("low"),
        (x.mean + x.std - 0.1 * al.value("start") <= 1.9).named("high"),
        al.rms("x").at_most(1.0, sigmas=1).named("rms"),
        *further,
    ]
    decay = Decay(al.Normal(1.0, 0.05), al.Decision(2.0, 1.0, 3.0))
    return al.Problem(decay, **({"grid": GRID, "minimize": al.integral("x").mean, "subject_to": limits} | options))
