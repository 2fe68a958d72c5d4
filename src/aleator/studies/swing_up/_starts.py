"""The motions from which the searches for a swing-up start, besides those of the problems themselves."""

import numpy as np

import aleator as al
from aleator.studies.swing_up import DEGREE, ENDS, FREE

SWINGS = (
    (3.0, 6, 0.8, 5),
    (4.0, 4, -0.8, 5),
    (3.0, 4, -0.8, 2),
    (4.0, 4, -0.8, 2),
    (3.0, 3, 0.8, 2),
    (4.0, 3, -0.8, 2),
    (3.0, 5, -0.8, 2),
)
"""Duration (s), half swings, their width (rad), and lateness of the rise, for a motion to start a search from."""
FAMILY_SWINGS = ((3.0, 4, -0.8, 2), (3.0, 5, -0.8, 2), (4.0, 3, -0.8, 2), (3.0, 6, -0.8, 5))
"""The swings from which searches for the whole family start: late and wide ones spread it too far."""


def swing(lasting: float, halves: int, width: float, late: int) -> dict[str, np.ndarray | float]:
    """A motion that rises `late`, superposed with `halves` half swings of growing width."""
    fractions = np.linspace(0.0, 1.0, 80)
    angle = -np.pi * (1 - fractions**late) + width * np.sin(halves * np.pi * fractions) * fractions
    return {"motion.q1.free": al.fit_control_points(angle, FREE, degree=DEGREE, **ENDS), "t_final": lasting}
