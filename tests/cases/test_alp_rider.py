"""The alp rider: stiff and unstable at once, with four narrow peaks that the states have to pass over.

Betts, Practical Methods for Optimal Control Using Nonlinear Programming (2020), problem 10.1: J = 2030.85609.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import aleator as al

PEAKS = ((3, 3, 12), (3, 6, 10), (3, 10, 6), (8, 15, 4))
END = {"y1": 2.0, "y2": 3.0, "y3": 1.0, "y4": -2.0}


def least(t):
    return sum(height * jnp.exp(-rate * (t - at) ** 2) for height, at, rate in PEAKS) + 0.01


class Rider(al.System):
    states = tuple(END)

    def initial(self):
        return {"y1": 2.0, "y2": 1.0, "y3": 2.0, "y4": 1.0}

    def rhs(self, t, z, u1, u2):
        return (
            -10 * z.y1 + u1 + u2,
            -2 * z.y2 + u1 + 2 * u2,
            -3 * z.y3 + 5 * z.y4 + u1 - u2,
            5 * z.y3 - 3 * z.y4 + u1 + 3 * u2,
        )

    def outputs(self, t, z, u1, u2):
        square = sum(one**2 for one in z)
        cost = 100 * square + 0.01 * (u1**2 + u2**2)
        return {**z._asdict(), "slack": square - least(t), "cost": cost}


@pytest.mark.slow
def test_the_alp_rider_passes_over_all_peaks():
    problem = al.Problem(
        Rider(),
        grid=al.Grid(20.0, 200),
        inputs={name: al.Control(0.0, -500.0, 500.0, degree=1) for name in ("u1", "u2")},
        minimize=al.integral("cost").mean,
        subject_to=[
            *(al.terminal(name).mean.equals(value) for name, value in END.items()),
            al.path("slack").at_least(0.0),
        ],
    )

    def guess(t):
        return dict.fromkeys(END, float(np.sqrt(least(t) / 4)))

    way = al.Simultaneous(al.schemes.Radau(3), error=1e-5, guess=guess)
    solution = al.solve(problem, transcription=way)
    assert solution.objective == pytest.approx(2030.85609, rel=1e-4)
    assert solution.certificate.between is not None
    assert solution.certificate.between.holds
    assert solution.certificate.departed
