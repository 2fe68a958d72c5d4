"""The robust suspension design in CasADi with IPOPT: the same points, steps and limits, derivatives forward.

Started by `python benchmarks/casadi_suspension.py`, or by `first_answer.py --peers`.
"""

import time
from itertools import product
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.polynomial import legendre

from aleator.studies.suspension import road, robust_problem
from aleator.transcription import transcribe

STEPS, STEP, TRAVEL, HOLDING = 2800, 1e-3, 0.203, 0.034
HALF_WIDTHS = np.array([47.0, 3750.0, 250.0, 0.17375, 25e3])


class Peer(NamedTuple):
    """How long a program takes to construct and to solve, s, and its optimum."""

    constructed: float
    solved: float
    objective: float


def suspension() -> Peer:
    """Construct and solve it."""
    points = np.asarray(transcribe(robust_problem()).collocation.points)
    indices = [index for index in product(range(4), repeat=5) if sum(index) <= 3]
    single = np.stack([legendre.legval(points, np.eye(4)[n] * np.sqrt(2 * n + 1)) for n in range(4)])
    matrix = np.stack([np.prod([single[index[k], :, k] for k in range(5)], axis=0) for index in indices], axis=1)
    heights = np.asarray(road().values)
    grounds = np.stack([heights[:-1], heights[1:]])
    started = time.perf_counter()
    x, xi = ca.SX.sym("x", 2), ca.SX.sym("xi", 5)
    m_s, k_s, b_s, eta, k_u = ca.vertsplit(
        ca.vertcat(376.0, 30e3 * x[0], 2000 * x[1], 1.39, 200e3) + xi * ca.DM(HALF_WIDTHS)
    )

    def rate(z: ca.SX, ground: ca.SX) -> ca.SX:
        closing = z[1] - z[3]
        force = k_s * (z[0] - z[2]) + b_s * ca.if_else(closing >= 0, closing, eta * closing)
        return ca.vertcat(z[1], -force / m_s, z[3], (force - k_u * (z[2] - ground)) / 94.0)

    z, ends = ca.SX.sym("z", 4), ca.SX.sym("ends", 2)
    now, middle, end = ends[0], (ends[0] + ends[1]) / 2, ends[1]
    k1 = rate(z, now)
    k2 = rate(z + STEP / 2 * k1, middle)
    k3 = rate(z + STEP / 2 * k2, middle)
    k4 = rate(z + STEP * k3, end)
    after = z + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    growth = STEP / 2 * (rate(z, now)[1] ** 2 + rate(after, end)[1] ** 2)
    gap = STEP / 2 * ((z[2] - now) ** 2 + (after[2] - end) ** 2)
    step = ca.Function("step", [z, ends, x, xi], [after, ca.vertcat(after[0] - after[2], growth, gap)])
    along = step.mapaccum("along", STEPS)
    decisions, every = ca.MX.sym("decisions", 2), []
    one = ca.Function(
        "one",
        [x_mx := ca.MX.sym("x", 2), xi_mx := ca.MX.sym("xi", 5)],
        [_recorded(along(np.zeros(4), grounds, ca.repmat(x_mx, 1, STEPS), ca.repmat(xi_mx, 1, STEPS))[1])],
    )
    every = one.map(len(points))(ca.repmat(decisions, 1, len(points)), points.T)
    coefficients = ca.mtimes(every, ca.DM(np.linalg.pinv(matrix).T))
    mean, std = coefficients[:, 0], ca.sqrt(ca.sum2(coefficients[:, 1:] ** 2) + 1e-30)
    upper, lower = mean + std, mean - std
    limits = ca.vertcat(TRAVEL - upper[:STEPS], TRAVEL + lower[:STEPS], HOLDING - upper[STEPS + 1])
    program = {"x": decisions, "f": mean[STEPS] + std[STEPS], "g": limits}
    quiet = {
        "print_time": False,
        "ipopt": {"print_level": 0, "sb": "yes", "hessian_approximation": "limited-memory", "tol": 1e-8},
    }
    solver = ca.nlpsol("solver", "ipopt", program, quiet)
    constructed = time.perf_counter() - started
    started = time.perf_counter()
    found = solver(x0=[1.0, 1.0], lbx=[23_339 / 30e3, 1 / 2000], ubx=[10.0, 25.0], lbg=0.0, ubg=np.inf)
    return Peer(constructed, time.perf_counter() - started, float(found["f"]))


def _recorded(outputs: ca.MX) -> ca.MX:
    """The travel at each instant, the ride, and the root mean square of the gap to the ground."""
    return ca.vertcat(outputs[0, :].T, ca.sum2(outputs[1, :]), ca.sqrt(ca.sum2(outputs[2, :]) / (STEPS * STEP)))


if __name__ == "__main__":
    print(suspension())
