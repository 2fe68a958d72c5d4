"""Optimal control by direct collocation against the same programs in CasADi with IPOPT, in one run.

    python benchmarks/optimal_control.py [INTERVALS]

Both discretise by Hermite and Simpson with the states in the middle as variables, and controls that are linear between
instants, of which a value each is decided. CasADi's program is what a careful engineer writes: states and controls
alone, the dynamics mapped over all points, exact sparse derivatives of both orders. Both use IPOPT with MUMPS and its
adaptive barrier, to 1e-8.

Times are wall times and processor times, s. Ours: the declaration, the first solution (which compiles, or loads what an
earlier run has compiled), and a second one, which includes the certificate: a finer grid, fresh simulations, points
nearby. CasADi's: its construction, and its solution alone.
"""

import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table
from typing_extensions import override

import aleator as al

Result = TypeVar("Result")
TOLERANCE = 1e-8


class Times(NamedTuple):
    """Wall time and processor time, s."""

    wall: float
    processor: float

    def __str__(self) -> str:
        return f"{self.wall:.3f} ({self.processor:.3f})"


class Case(NamedTuple):
    """An optimal control problem, for both.

    - `rates(m, t, z, u)`: the states' rates, then the integrand of the cost; `m` is `jax.numpy` or `casadi`;
    - `start`, `end`: states by their places, given there; `controls`: of each its bounds and first values at both ends;
    - `duration`: its bounds and first value, s; if they differ, it is the cost itself.
    """

    name: str
    rates: Callable[[Any, Any, Any, Any], list[Any]]
    start: tuple[float, ...]
    end: Mapping[int, float]
    controls: tuple[tuple[float, float, float, float], ...]
    duration: tuple[float, float, float]

    @property
    def is_free(self) -> bool:
        """Whether the duration is decided."""
        return self.duration[0] < self.duration[1]


def _van_der_pol(m: Any, t: Any, z: Any, u: Any) -> list[Any]:
    del m, t
    return [(1 - z[1] ** 2) * z[0] - z[1] + u[0], z[0], z[0] ** 2 + z[1] ** 2 + u[0] ** 2]


def _particle(m: Any, t: Any, z: Any, u: Any) -> list[Any]:
    del t
    return [z[2], z[3], 100.0 * m.cos(u[0]), 100.0 * m.sin(u[0]), 0.0 * u[0]]


def _bead(m: Any, t: Any, z: Any, u: Any) -> list[Any]:
    del t
    return [z[2] * m.sin(u[0]), -z[2] * m.cos(u[0]), 9.80665 * m.cos(u[0]), 0.0 * u[0]]


def _quadrotor(m: Any, t: Any, z: Any, u: Any) -> list[Any]:
    """Place, velocity, roll, pitch, yaw and turning rates; thrust, N, and moments, 0.01 N m. It follows an eight."""
    mass, inertia = 0.5, (4.9e-3, 4.9e-3, 8.8e-3)
    x, y, height, vx, vy, vz, roll, pitch, yaw, p, q, r = z
    sine, cosine = [m.sin(one) for one in (roll, pitch, yaw)], [m.cos(one) for one in (roll, pitch, yaw)]
    lift, moments = u[0] / mass, [0.01 * one for one in u[1:]]
    turning = q * sine[0] + r * cosine[0]
    gyration = [inertia[1] - inertia[2], inertia[2] - inertia[0], inertia[0] - inertia[1]]
    spins = [
        (g * w + moment) / j for g, w, moment, j in zip(gyration, (q * r, p * r, p * q), moments, inertia, strict=True)
    ]
    eight = m.sin(2 * np.pi * t / 6), m.sin(4 * np.pi * t / 6), 1 + 0.2 * t
    away = sum((one - other) ** 2 for one, other in zip((x, y, height), eight, strict=True))
    return [
        vx,
        vy,
        vz,
        lift * (cosine[2] * sine[1] * cosine[0] + sine[2] * sine[0]),
        lift * (sine[2] * sine[1] * cosine[0] - cosine[2] * sine[0]),
        lift * cosine[1] * cosine[0] - 9.81,
        p + turning * sine[1] / cosine[1],
        q * cosine[0] - r * sine[0],
        turning / cosine[1],
        *spins,
        10 * away + 0.1 * (u[0] - 9.81 * mass) ** 2 + 0.01 * sum(one**2 for one in u[1:]),
    ]


CASES = (
    Case("Van der Pol", _van_der_pol, (0.0, 1.0), {}, ((-1.0, 1.0, 0.0, 0.0),), (10.0, 10.0, 10.0)),
    Case(
        "steered particle",
        _particle,
        (0.0, 0.0, 0.0, 0.0),
        {1: 5.0, 2: 45.0, 3: 0.0},
        ((-np.pi / 2, np.pi / 2, 1.0, -1.0),),
        (0.1, 5.0, 1.0),
    ),
    Case("brachistochrone", _bead, (0.0, 0.0, 0.0), {0: 10.0, 1: -5.0}, ((0.0, np.pi, 0.1, 1.7),), (0.5, 10.0, 2.0)),
    Case(
        "quadrotor",
        _quadrotor,
        (0.0, 0.0, 1.0, *(9 * (0.0,))),
        {},
        ((0.0, 15.0, 4.9, 4.9), *(3 * ((-5.0, 5.0, 0.0, 0.0),))),
        (6.0, 6.0, 6.0),
    ),
)


def moving(case: Case) -> al.System:
    """A case's dynamics as a system."""

    class Moving(al.System):
        states = tuple(f"z{i}" for i in range(len(case.start)))

        @override
        def rhs(self, t: Any, z: Any, **u: Any) -> Any:
            return tuple(case.rates(jnp, t, tuple(z), tuple(u[name] for name in sorted(u)))[:-1])

        @override
        def outputs(self, t: Any, z: Any, **u: Any) -> Any:
            cost = case.rates(jnp, t, tuple(z), tuple(u[name] for name in sorted(u)))[-1]
            return {"cost": cost, **dict(zip(self.states, z, strict=True))}

        @override
        def initial(self) -> Any:
            return dict(zip(self.states, case.start, strict=True))

    return Moving()


def declared(case: Case, intervals: int) -> al.Problem:
    """The problem in our words."""
    shortest, longest, guess = case.duration
    duration = al.Decision(guess, shortest, longest) if case.is_free else guess
    values = [(np.linspace(first, last, intervals + 1), low, high) for low, high, first, last in case.controls]
    return al.Problem(
        moving(case),
        grid=al.Grid(duration, intervals),
        inputs={f"u{i}": al.Control(*one, degree=1) for i, one in enumerate(values)},
        minimize=al.objectives.final_time() if case.is_free else al.integral("cost").mean,
        subject_to=[al.terminal(f"z{i}").mean.equals(value) for i, value in case.end.items()],
    )


def constructed(case: Case, intervals: int) -> tuple[ca.Function, dict[str, Any]]:
    """The solver in CasADi, and its arguments: the times, then states and controls, point by point."""
    count, n, controls = len(case.start), 2 * intervals + 1, len(case.controls)
    z, u, duration = ca.MX.sym("z", count, n), ca.MX.sym("u", controls, intervals + 1), ca.MX.sym("T")
    one, push, now = ca.SX.sym("z", count), ca.SX.sym("u", controls), ca.SX.sym("t")
    listed = case.rates(ca, now, ca.vertsplit(one), ca.vertsplit(push))
    rates = ca.Function("rates", [now, one, push], [ca.vertcat(*listed)]).map(n)
    nodes, middles = np.arange(0, n, 2), np.arange(1, n, 2)
    shares = np.zeros((intervals + 1, n))  # of the control's points in its values at all points
    shares[np.arange(intervals + 1), nodes] = 1.0
    shares[np.arange(intervals), middles] = shares[np.arange(1, intervals + 1), middles] = 0.5
    times = duration * ca.DM(np.linspace(0.0, 1.0, n)).T
    found, h = rates(times, z, u @ ca.DM(ca.sparsify(shares))), duration / intervals
    f = [found[:, places.tolist()] for places in (nodes[:-1], middles, nodes[1:])]
    at = [z[:, places.tolist()] for places in (nodes[:-1], middles, nodes[1:])]
    middle = at[1] - (at[0] + at[2]) / 2 - h / 8 * (f[0][:count, :] - f[2][:count, :])
    simpson = h / 6 * (f[0] + 4 * f[1] + f[2])
    last = at[2] - at[0] - simpson[:count, :]
    program = {
        "x": ca.veccat(duration, z, u),
        "f": duration if case.is_free else ca.sum2(simpson[count, :]),
        "g": ca.veccat(middle, last),
    }
    options = {"print_time": False, "expand": True, "ipopt.print_level": 0, "ipopt.sb": "yes", "ipopt.tol": TOLERANCE}
    # Else the quadrotor is not solved in 3000 iterations.
    options["ipopt.mu_strategy"] = "adaptive"
    solver = ca.nlpsol("solver", "ipopt", program, options)
    shortest, longest, first = case.duration
    states = [np.full((n, count), limit) for limit in (-np.inf, np.inf)]
    for bound in states:
        bound[0] = case.start
        bound[-1, list(case.end)] = list(case.end.values())
    bounds = np.array([[low, high] for low, high, *_ in case.controls])
    controls_there = [np.tile(limit, intervals + 1) for limit in bounds.T]
    begun = np.array([np.linspace(first, last, intervals + 1) for *_, first, last in case.controls])
    start = np.concatenate([[first], np.tile(case.start, n), begun.T.ravel()])
    lower, upper = (
        np.concatenate([[edge], some.ravel(), control])
        for edge, some, control in zip((shortest, longest), states, controls_there, strict=True)
    )
    return solver, {"x0": start, "lbx": lower, "ubx": upper, "lbg": 0.0, "ubg": 0.0}


def timed(work: Callable[[], Result]) -> tuple[Result, Times]:
    """What some work gives, and its times."""
    wall, processor = time.perf_counter(), time.process_time()
    found = work()
    return found, Times(time.perf_counter() - wall, time.process_time() - processor)


def main() -> None:
    """Print times, optima and iterations side by side."""
    intervals = int(sys.argv[1]) if len(sys.argv) > 1 else 400
    table = Table("problem", "tool", "optimum", "iterations", "declare or build", "first solve", "solve warm")
    console, ratios = Console(width=140), []
    transcription, solver = al.Simultaneous(al.schemes.HermiteSimpson()), al.solvers.Ipopt(tolerance=100 * TOLERANCE)
    for case in CASES:
        problem, declaring = timed(lambda case=case: declared(case, intervals))

        def ours(problem: al.Problem = problem) -> al.Solution:
            return al.solve(problem, solver, transcription=transcription, between=1, throw=False)

        _, first = timed(ours)
        solution, warm = timed(ours)
        (peer, arguments), building = timed(lambda case=case: constructed(case, intervals))
        answer, solving = timed(lambda peer=peer, arguments=arguments: peer(**arguments))
        table.add_row(
            f"{case.name}, {intervals} intervals",
            "aleator",
            f"{solution.objective:.8f}",
            str(solution.effort.iterations),
            *map(str, (declaring, first, warm)),
        )
        table.add_row(
            "",
            "CasADi",
            f"{float(answer['f']):.8f}",
            str(peer.stats()["iter_count"]),
            str(building),
            "",
            str(solving),
        )
        ratios.append(
            f"{case.name}: warm, ours takes {warm.processor / solving.processor:.1f} times the processor time of "
            f"CasADi's solution, {warm.processor / (solving.processor + building.processor):.1f} times that with its "
            "construction"
        )
    console.print(table)
    console.print("Times: wall (processor), s")
    console.print("\n".join(ratios))


if __name__ == "__main__":
    main()
