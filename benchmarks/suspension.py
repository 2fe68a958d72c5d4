"""Time and memory of the robust suspension design, beside the same design in plain NumPy and SciPy.

    python benchmarks/suspension.py [--without-peer]

Everything runs in this one process, after the other, on the machine's own cores. The peer is what a careful engineer
would
write without this library: Runge-Kutta vectorised over the 168 collocation points, finite differences, SciPy's SLSQP.
"""

import argparse
import os
import resource
import sys
import time
from collections.abc import Callable
from itertools import product

import numpy as np
from numpy.polynomial import legendre
from scipy.optimize import minimize

import aleator as al
from aleator.studies.suspension import road, robust_problem
from aleator.transcription import transcribe

STEPS, STEP, TRAVEL, HOLDING = 2800, 1e-3, 0.203, 0.034
HALF_WIDTHS = np.array([47.0, 3750.0, 250.0, 0.17375, 25e3])


def peak_memory() -> float:
    """Largest resident memory of this process so far, GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 2**30


def timed(work: Callable[[], object], repeats: int = 1) -> tuple[float, object]:
    """The median wall time of `work`, s, and its last result."""
    seconds, result = [], None
    for _ in range(repeats):
        started = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds)), result


class Peer:
    """The robust design in NumPy and SciPy, on the same points, steps and constraints."""

    def __init__(self) -> None:
        signal = road()
        self.road = np.asarray(signal.values)
        self.points = np.asarray(transcribe(robust_problem()).collocation.points)
        indices = [index for index in product(range(4), repeat=5) if sum(index) <= 3]
        single = np.stack([legendre.legval(self.points, np.eye(4)[n] * np.sqrt(2 * n + 1)) for n in range(4)])
        matrix = np.stack([np.prod([single[index[k], :, k] for k in range(5)], axis=0) for index in indices], axis=1)
        self.pseudo_inverse = np.linalg.pinv(matrix)
        self.simulations = 0

    def simulate(self, k_s: float, b_s: float) -> tuple[np.ndarray, ...]:
        """Ride, holding and the two positions at all points: (168,), (168,), (2801, 168) twice."""
        self.simulations += 1
        m_s, k_s, b_s, eta, k_u = (np.array([376.0, k_s, b_s, 1.39, 200e3]) + self.points * HALF_WIDTHS).T

        def rate(z: np.ndarray, ground: float) -> np.ndarray:
            z_s, v_s, z_u, v_u = z
            closing = v_s - v_u
            force = k_s * (z_s - z_u) + b_s * np.where(closing >= 0, closing, eta * closing)
            return np.stack([v_s, -force / m_s, v_u, (force - k_u * (z_u - ground)) / 94.0])

        history = np.zeros((STEPS + 1, 4, len(self.points)))
        acceleration = np.empty((STEPS + 1, len(self.points)))
        acceleration[0] = rate(history[0], self.road[0])[1]
        for i in range(STEPS):
            z, now, end = history[i], self.road[i], self.road[i + 1]
            k1 = rate(z, now)
            k2 = rate(z + STEP / 2 * k1, (now + end) / 2)
            k3 = rate(z + STEP / 2 * k2, (now + end) / 2)
            k4 = rate(z + STEP * k3, end)
            history[i + 1] = z + STEP / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            acceleration[i + 1] = rate(history[i + 1], end)[1]
        ride = np.trapezoid(acceleration**2, dx=STEP, axis=0)
        holding = np.sqrt(np.trapezoid((history[:, 2] - self.road[:, None]) ** 2, dx=STEP, axis=0) / (STEPS * STEP))
        return ride, holding, history[:, 0], history[:, 2]

    def values(self, x: np.ndarray) -> np.ndarray:
        """The objective and the 5603 constraint values (at least zero where they hold) at scaled decisions."""
        ride, holding, z_s, z_u = (self.moments(one) for one in self.simulate(30e3 * x[0], 2000 * x[1]))
        travel, spread = z_s[0] - z_u[0], z_s[1] + z_u[1]
        limits = [TRAVEL - (travel + spread), TRAVEL + (travel - spread), [HOLDING - holding[0] - holding[1]]]
        return np.concatenate([[ride[0] + ride[1]], *limits])

    def moments(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation by the expansion; the points are the last axis."""
        coefficients = samples @ self.pseudo_inverse.T
        return coefficients[..., 0], np.sqrt(np.sum(coefficients[..., 1:] ** 2, axis=-1))

    def solve(self) -> float:
        """The optimal ride, mean plus standard deviation."""
        seen: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

        def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            if x.tobytes() not in seen:
                value, h = self.values(x), 1e-6
                slopes = [(self.values(x + h * unit) - value) / h for unit in np.eye(2)]
                seen[x.tobytes()] = value, np.stack(slopes, axis=1)
            return seen[x.tobytes()]

        constraint = {"type": "ineq", "fun": lambda x: at(x)[0][1:], "jac": lambda x: at(x)[1][1:]}
        bounds = [(23_339 / 30e3, 10.0), (1 / 2000, 25.0)]
        options = {"ftol": 1e-9, "maxiter": 50}
        found = minimize(
            lambda x: at(x)[0][0], [1.0, 1.0], jac=lambda x: at(x)[1][0], bounds=bounds, constraints=[constraint],
            method="SLSQP", options=options,
        )  # fmt: skip
        return float(found.fun)


def checks_cost(repeats: int = 15) -> float:
    """What a solution costs beyond its nonlinear program, as a part of that: the median of pairs, in turns."""

    def program() -> None:
        transcription = transcribe(robust_problem())
        transcription.resolve(al.solvers.FilterSQP().solve(transcription.program).point)

    pairs = [(timed(lambda: al.solve(robust_problem()))[0], timed(program)[0]) for _ in range(repeats)]
    return float(np.median([whole / alone - 1 for whole, alone in pairs]))


def row(what: str, figure: str, target: str = "") -> None:
    """One line of the table."""
    print(f"{what:<58} {figure:>14}   {target}", flush=True)


def main() -> None:
    """Print the table."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument(
        "--without-peer", action="store_true", help="leave the NumPy and SciPy design out (about a minute)"
    )
    arguments = options.parse_args()
    print(f"{os.cpu_count()} cores, Python {sys.version.split()[0]}")
    first, solution = timed(lambda: al.solve(robust_problem()))
    assert isinstance(solution, al.Solution)
    row("robust design, first call", f"{first:.2f} s")
    row("  of which compilation", f"{solution.effort.times.compile_:.2f} s", "target: under 2 s")
    warm, solution = timed(lambda: al.solve(robust_problem()), repeats=9)
    assert isinstance(solution, al.Solution)
    row("robust design, warm process (median of 9)", f"{warm:.3f} s", "target: under 0.6 s")
    row("  of which optimisation", f"{solution.effort.times.solve:.3f} s, {solution.effort.evaluations} points")
    row("  objective, μ + σ of ride", f"{solution.objective:.4f}")
    row("  checks beside the optimisation (median of 15 pairs)", f"{checks_cost():.0%}", "target: at most 30 %")
    row("peak memory after the designs", f"{peak_memory():.2f} GiB", "target: under 1.5 GiB")
    sampling, evidence = timed(lambda: al.validate(solution, 100_000))
    assert isinstance(evidence, al.results.Evidence)
    row("Monte Carlo of 100 000 systems", f"{sampling:.1f} s", "target: under 15 s")
    row("peak memory after Monte Carlo", f"{peak_memory():.2f} GiB")
    if not arguments.without_peer:
        peer = Peer()
        seconds, objective = timed(peer.solve)
        row("the same design in NumPy and SciPy", f"{seconds:.1f} s", f"{peer.simulations} simulations of 168 systems")
        row("  objective, μ + σ of ride", f"{objective:.4f}")
        row("ratio of the two", f"{seconds / warm:.0f} times")


if __name__ == "__main__":
    main()
