"""The numbers that the suspension study must reach, computed and printed beside their targets.

    python benchmarks/accuracy.py

Optima by three solvers; means and spreads against tensor Gauss quadrature; derivatives against central differences.
"""

from collections.abc import Callable
from itertools import product

import jax.numpy as jnp
import numpy as np

import aleator as al
from aleator._core.arrays import numbers_to_arrays
from aleator.design import responses, value_at
from aleator.studies.suspension import COST, RIDE, apportionment_problem, deterministic_problem, robust_problem
from aleator.transcription import transcribe
from aleator.uncertainty import LegendreGerm

SOLVERS = (al.solvers.FilterSQP(), al.solvers.Ipopt(), al.solvers.Slsqp())
PROBLEMS: dict[str, Callable[..., al.Problem]] = {
    "dOpt": deterministic_problem,
    "uOpt": robust_problem,
    "aOpt": apportionment_problem,
}


def compare_solvers() -> None:
    """Optimum of every design by every solver, and what holds it."""
    print("Optima at R = 0.203 m (and 0.152 m), H = 0.034 m; target: the solvers agree to 1e-5")
    cases = [(name, make, 0.203) for name, make in PROBLEMS.items()]
    for name, make, travel in [*cases, ("dOpt", deterministic_problem, 0.152), ("uOpt", robust_problem, 0.152)]:
        found = [al.solve(make(travel=travel), solver) for solver in SOLVERS]
        values = np.array([one.objective for one in found])
        spread = np.ptp(values) / abs(values[0])
        listed = "  ".join(
            f"{type(solver).__name__} {value:.7f}" for solver, value in zip(SOLVERS, values, strict=True)
        )
        print(f"  {name}, R = {travel}: {listed}  spread {spread:.1e}  active {', '.join(found[0].active)}")


def apportion() -> None:
    """Cost before and after."""
    problem = apportionment_problem()
    initial = value_at(COST, problem, problem.placements.vector("initial"))
    print(f"Cost of the initial spreads ${initial:.2f}; target: $17.71")
    for travel in (0.203, 0.215, 0.25):
        best = al.solve(apportionment_problem(travel=travel)).objective
        print(f"  apportioned at R = {travel}: ${best:.2f}, saving {100 * (1 - best / initial):.1f} %")


def compare_quadrature(nodes: int = 6, batch: int = 972) -> None:
    """Mean and spread of ride at the start by the expansion and by tensor Gauss quadrature in all five variables."""
    problem = robust_problem()
    places = problem.placements
    start = jnp.asarray(places.vector("initial"))
    node, weight = LegendreGerm().gauss(nodes)
    grid = np.array(list(product(node, repeat=len(places.distributions))))
    weights = np.prod(list(product(weight, repeat=len(places.distributions))), axis=1)
    traced = numbers_to_arrays(problem)
    ride = np.concatenate(
        [
            np.asarray(responses(traced, (RIDE,), jnp.asarray(part), start)[0])
            for part in np.split(grid, len(grid) // batch)
        ]
    )
    mean = weights @ ride
    std = np.sqrt(weights @ (ride - mean) ** 2)
    ours = transcribe(problem).resolve(np.asarray(start))[RIDE.text()]
    print(f"Ride at k_s = 30 000, b_s = 2000 against {len(grid)} Gauss points; targets: 1e-4 and 1e-3")
    print(f"  mean {float(ours.mean):.6f} and {mean:.6f}, relative difference {abs(float(ours.mean) / mean - 1):.1e}")
    print(f"  std  {float(ours.std):.6f} and {std:.6f}, relative difference {abs(float(ours.std) / std - 1):.1e}")


def compare_derivatives() -> None:
    """The Jacobian of objective and all constraints against central differences, at the best of several steps."""
    print("Derivatives against a sweep of central differences, largest difference over largest entry; target: 1e-6")
    for name, make in PROBLEMS.items():
        transcription = transcribe(make())
        program, point = transcription.program, transcription.program.start
        exact = program.evaluate(point)
        exact_rows = np.vstack([exact.gradient, exact.jacobian])
        for i, entry in enumerate(transcription.places.entry_names()):
            errors = {}
            for step in 10.0 ** np.arange(-2, -8, -1):
                shift = np.zeros_like(point)
                shift[i] = step * point[i]
                ends = [program.evaluate(point + sign * shift) for sign in (1, -1)]
                values = [np.append(one.objective, one.constraints) for one in ends]
                slope = (values[0] - values[1]) / (2 * shift[i])
                rows = _blocks(transcription)
                errors[step] = max(_relative(slope[row], exact_rows[row, i]) for row in rows)
            best = min(errors, key=lambda step: errors[step])
            print(f"  {name}, by {entry}: {errors[best]:.1e} at relative step {best:.0e}")


def _blocks(transcription) -> list[slice]:
    """The objective's row and those of each constraint."""
    return [slice(0, 1), *(slice(row.start + 1, row.stop + 1) for row in transcription.rows)]


def _relative(ours: np.ndarray, exact: np.ndarray) -> float:
    size = np.max(np.abs(exact))
    return float(np.max(np.abs(ours - exact)) / size) if size > 0 else float(np.max(np.abs(ours)))


if __name__ == "__main__":
    compare_solvers()
    apportion()
    compare_quadrature()
    compare_derivatives()
