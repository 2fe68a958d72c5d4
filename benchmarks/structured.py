"""A program of a hundred thousand decisions that share one, by both interior-point solvers: time, memory, certificate.

    python benchmarks/structured.py [COUNT]

Minimise `½ Σ (x_i - t_i)² + ½ N (y - 2)²` with `x_i² = y` for all i: an arrow, as scenarios that share a design are.
The peer is the same program reduced by hand to its one free number, in SciPy.
"""

import resource
import sys
import time

import numpy as np
from scipy.optimize import brentq
from scipy.sparse import csr_array

from aleator.nlp import Evaluation, Hessian, InteriorPoint, Ipopt, NonlinearProgram


def arrow(targets: np.ndarray) -> NonlinearProgram:
    """The program, with its sparse Jacobian and Hessian."""
    count = len(targets)
    columns = np.stack([np.arange(count), np.full(count, count)], axis=1).ravel()
    rows = 2 * np.arange(count + 1)
    sparsity = csr_array((np.ones(2 * count, dtype=bool), columns, rows), shape=(count, count + 1))
    places = np.arange(count + 1)
    diagonal = csr_array((np.ones(count + 1, dtype=bool), places, np.arange(count + 2)), shape=(count + 1, count + 1))

    def evaluate(z: np.ndarray) -> Evaluation:
        x, y = z[:-1], z[-1]
        numbers = np.stack([2 * x, np.full(count, -1.0)], axis=1).ravel()
        return Evaluation(
            0.5 * float(np.sum((x - targets) ** 2) + count * (y - 2.0) ** 2),
            np.append(x - targets, count * (y - 2.0)),
            x**2 - y,
            csr_array((numbers, sparsity.indices, sparsity.indptr), shape=sparsity.shape),
        )

    def curvature(z: np.ndarray, weight: float, multipliers: np.ndarray) -> csr_array:
        del z
        numbers = np.append(weight + 2 * multipliers, weight * count)
        return csr_array((numbers, diagonal.indices, diagonal.indptr), shape=diagonal.shape)

    every = np.ones(count + 1)
    return NonlinearProgram(
        evaluate=evaluate,
        start=every,
        lower=0.05 * every,
        upper=10.0 * every,
        constraint_lower=np.zeros(count),
        constraint_upper=np.zeros(count),
        constraint_scale=np.ones(count),
        variable_scale=every,
        sparsity=sparsity,
        hessian=Hessian(curvature, diagonal),
    )


def main() -> None:
    """Print the table."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100_000
    targets = 1.0 + 0.5 * np.sin(np.arange(count))
    best = brentq(lambda y: count * (y - 2.0) + np.sum((np.sqrt(y) - targets) / (2 * np.sqrt(y))), 0.5, 5.0, xtol=1e-13)
    print(f"{count + 1} decisions, {count} rows, {2 * count} entries; the shared decision is {best:.8f} by SciPy")
    for solver in (Ipopt(), InteriorPoint()):
        started = time.perf_counter()
        outcome = solver.solve(arrow(targets))
        seconds = time.perf_counter() - started
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(
            f"{outcome.solver:<28} {seconds:6.2f} s  {outcome.iterations:3d} iterations  {outcome.point[-1]:.8f}  "
            f"violation {outcome.violation:.1e}, stationarity {outcome.stationarity:.1e}, complementarity "
            f"{outcome.complementarity:.1e}  peak {memory:.2f} GiB  {outcome.status.name}"
        )


if __name__ == "__main__":
    main()
