"""Every family of solvers on programs with known optima and on two designs, from many seeds; populations at once.

    python benchmarks/solvers.py [programs] [designs] [seeds] [optima] [population] [fronts] [starts] [curvature]

Prints a table for each part that is named, all by default: distance from the known optimum after polishing, evaluations
and seconds. Solvers by derivatives start where the searches do. Peers in the same run: one design after the other for
the population, SciPy's own polishing for the programs, forty random starts for the portfolio, approximated curvature
for exact second derivatives.
"""

import sys
import time
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import scipy

import aleator as al
from aleator.extending import Evaluation, NonlinearProgram
from aleator.nlp import AbstractSolver
from aleator.studies import clutch, pick_and_place_time, suspension, swing_up
from aleator.transcription import transcribe

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from six_axis_arm import robust_problem as six_axis_problem  # pyright: ignore[reportMissingImports]

SEARCHES = {
    "NelderMead": al.solvers.NelderMead(),
    "Direct": al.solvers.Direct(),
    "DifferentialEvolution": al.solvers.DifferentialEvolution(),
    "DualAnnealing": al.solvers.DualAnnealing(),
    "CmaEs": al.solvers.CmaEs(),
}
BY_DERIVATIVES = {
    "FilterSQP": al.solvers.FilterSQP(),
    "Ipopt": al.solvers.Ipopt(),
    "Slsqp": al.solvers.Slsqp(),
    "InteriorPoint": al.solvers.InteriorPoint(),
}
SEEDS, DESIGNS = 20, 64
ENOUGH = 1e-4


def program(
    evaluate: Callable[[np.ndarray], tuple],
    lower: Iterable[float],
    upper: Iterable[float],
    rows: Iterable[tuple[float, float]] = (),
) -> NonlinearProgram:
    """A program between bounds, started a third of the way up, from a function of its values and derivatives."""
    low, high = np.array(list(lower), dtype=float), np.array(list(upper), dtype=float)
    bounds = np.array(list(rows), dtype=float).reshape(-1, 2)

    def evaluated(x: np.ndarray) -> Evaluation:
        value, slope, *more = evaluate(x)
        values, slopes = more or ((), ())
        return Evaluation(
            float(value), np.array(slope), np.array(values, dtype=float), np.array(slopes).reshape(-1, x.size)
        )

    return NonlinearProgram(
        evaluate=evaluated,
        start=low + (high - low) / 3,
        lower=low,
        upper=high,
        constraint_lower=bounds[:, 0],
        constraint_upper=bounds[:, 1],
        constraint_scale=np.ones(len(bounds)),
        variable_scale=(high - low) / 10,
    )


def rosenbrock(x: np.ndarray) -> tuple:
    """Smooth: a curved valley (Rosenbrock 1960)."""
    gap = x[1] - x[0] ** 2
    return 100 * gap**2 + (1 - x[0]) ** 2, [-400 * x[0] * gap - 2 * (1 - x[0]), 200 * gap]


def rippled(x: np.ndarray) -> tuple:
    """Noisy: a bowl with ripples that are far steeper than itself."""
    off = x - 0.3
    return (off**2 + 1e-2 * np.sin(60 * off) ** 2).sum(), 2 * off + 0.6 * np.sin(120 * off)


def rastrigin(x: np.ndarray) -> tuple:
    """Multimodal: a thousand minima on a grid (Rastrigin 1974)."""
    wave = 2 * np.pi * x
    return (10 + x**2 - 10 * np.cos(wave)).sum(), 2 * x + 20 * np.pi * np.sin(wave)


def branin(x: np.ndarray) -> tuple:
    """Multimodal: three equal minima (Branin 1972)."""
    a, b = x
    inner = b - 5.1 / (4 * np.pi**2) * a**2 + 5 / np.pi * a - 6
    factor = 10 * (1 - 1 / (8 * np.pi))
    slope = 2 * inner * (5 / np.pi - 10.2 / (4 * np.pi**2) * a) - factor * np.sin(a)
    return inner**2 + factor * np.cos(a) + 10, [slope, 2 * inner]


def camel(x: np.ndarray) -> tuple:
    """Multimodal: six minima, two of them global (Dixon and Szegő 1978)."""
    a, b = x
    value = (4 - 2.1 * a**2 + a**4 / 3) * a**2 + a * b + (-4 + 4 * b**2) * b**2
    return value, [8 * a - 8.4 * a**3 + 2 * a**5 + b, a - 8 * b + 16 * b**3]


def gomez_levy(x: np.ndarray) -> tuple:
    """Constrained: within a disconnected region (Gómez and Levy 1982)."""
    a, b = x
    row = -np.sin(4 * np.pi * a) + 2 * np.sin(2 * np.pi * b) ** 2
    slope = [-4 * np.pi * np.cos(4 * np.pi * a), 4 * np.pi * np.sin(4 * np.pi * b)]
    return *camel(x), [row], [slope]


def hs71(x: np.ndarray) -> tuple:
    """Constrained, with an equality (Hock and Schittkowski 1981, problem 71)."""
    total = x[0] + x[1] + x[2]
    gradient = [x[3] * (total + x[0]), x[0] * x[3], x[0] * x[3] + 1, x[0] * total]
    return x[0] * x[3] * total + x[2], gradient, [np.prod(x), x @ x], [np.prod(x) / x, 2 * x]


PROGRAMS: Mapping[str, tuple[NonlinearProgram, float]] = {
    "smooth (Rosenbrock)": (program(rosenbrock, [-2, -2], [2, 2]), 0.0),
    "noisy (ripples)": (program(rippled, [-1, -1], [1, 1.1]), 0.0),
    "multimodal (Rastrigin)": (program(rastrigin, [-5.12, -4.1, -5.3], [5.5, 5.12, 5.12]), 0.0),
    "multimodal (Branin)": (program(branin, [-5, 0], [10, 15]), 0.39788735772973816),
    "multimodal (camel)": (program(camel, [-3, -2], [3, 2]), -1.0316284534898774),
    "constrained (Gómez)": (program(gomez_levy, [-1, -1], [0.75, 1], [(-np.inf, 1.5)]), -1.0316284534898774),
    "constrained (HS 71)": (program(hs71, [1] * 4, [5] * 4, [(25, np.inf), (40, 40)]), 17.01401728916),
}
MULTIMODAL = tuple(name for name in PROGRAMS if name.startswith(("multimodal", "constrained")))


def programs() -> None:
    """Each family on each program."""
    print("\nprograms with known optima: distance from the optimum, evaluations, seconds")
    for name, (one, least) in PROGRAMS.items():
        print(f"  {name}")
        for label, solver in (SEARCHES | BY_DERIVATIVES).items():
            _row(label, lambda solver=solver, one=one: solver.solve(one), least)
        _row("SciPy's own (differential evolution)", lambda one=one: _scipys(one), least)


def _row(label: str, solve: Callable, least: float) -> None:
    began = time.perf_counter()
    found = solve()
    seconds = time.perf_counter() - began
    off = found.evaluation.objective - least
    away = abs(off) / max(abs(least), 1.0)
    missed = "" if away <= ENOUGH else "  a local optimum" if found.ok else f"  {found.status.name.lower()}"
    print(f"    {label:38} {away:9.1e} {found.evaluations:8} {seconds:8.2f}{missed}")


def _scipys(one: NonlinearProgram):
    """SciPy's differential evolution with its own constraints and polishing, by the same number of points."""
    rows = scipy.optimize.NonlinearConstraint(
        lambda x: one.evaluate(x).constraints, one.constraint_lower, one.constraint_upper
    )
    counted = [0]

    def value(x: np.ndarray) -> float:
        counted[0] += 1
        return one.evaluate(x).objective

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = scipy.optimize.differential_evolution(
            value,
            scipy.optimize.Bounds(one.lower, one.upper),
            constraints=(rows,) if len(one.constraint_lower) else (),
            x0=one.start,
            rng=np.random.default_rng(0),
            maxiter=60,
        )
    outcome = al.solvers.FilterSQP(max_iterations=1).solve(one)
    evaluation = one.evaluate(found.x)
    return replace(outcome, evaluation=evaluation, evaluations=counted[0], status=al.Status.SOLVED)


def seeds() -> None:
    """How often each search finds the global optimum."""
    print(f"\nglobal optimum found to {ENOUGH:g}, of {SEEDS} seeds")
    for name in MULTIMODAL:
        one, least = PROGRAMS[name]
        for label, solver in SEARCHES.items():
            if label == "NelderMead":
                continue
            found = [replace(solver, seed=seed).solve(one) for seed in range(SEEDS)]
            right = sum(each.ok and each.evaluation.objective <= least + ENOUGH * max(abs(least), 1) for each in found)
            print(f"  {name:24} {label:24} {right:3} of {SEEDS}")


def designs() -> None:
    """Each family on the clutch's allocation and the robust suspension, against filterSQP's certified answer."""
    print("\ndesigns: objective, distance from the certified one, evaluations, seconds, status")
    for name, problem in {
        "clutch allocation": clutch.allocation_problem(),
        "suspension uOpt": suspension.robust_problem(),
    }.items():
        known = al.solve(problem).objective
        print(f"  {name}: {known:.8g}")
        for label, solver in (SEARCHES | BY_DERIVATIVES).items():
            _design(label, problem, _within(solver), known)


def _within(solver: AbstractSolver) -> AbstractSolver:
    return replace(solver, evaluations=1000) if label_of(solver) in SEARCHES else solver


def label_of(solver: AbstractSolver) -> str:
    """The name of a family."""
    return type(solver).__name__


def _design(label: str, problem: al.Problem, solver: AbstractSolver, known: float) -> None:
    began = time.perf_counter()
    found = al.solve(problem, solver, throw=False)
    seconds = time.perf_counter() - began
    away = abs(found.objective - known) / abs(known)
    said = "" if found.ok else f"  {found.status.name.lower()}"
    print(f"    {label:24} {found.objective:14.8g} {away:9.1e} {found.effort.evaluations:6} {seconds:8.2f}{said}")


def population() -> None:
    """A generation of robust suspensions in one call, against one after the other."""
    program = transcribe(suspension.robust_problem()).program
    generator = np.random.default_rng(0)
    drawn = generator.uniform(program.lower, program.upper, (DESIGNS, program.start.size))
    assert program.values is not None
    values = program.values
    values(drawn), values(drawn[:1])
    times: dict[str, list[float]] = {"in one call": [], "one by one": [], "one by one, with derivatives": []}
    ways: dict[str, Callable[[], object]] = {
        "in one call": lambda: values(drawn),
        "one by one": lambda: [values(one[None]) for one in drawn],
        "one by one, with derivatives": lambda: [program.evaluate(one + 0.0) for one in drawn],
    }
    for _ in range(5):
        for name, way in ways.items():
            began = time.perf_counter()
            way()
            times[name].append(time.perf_counter() - began)
    print(f"\n{DESIGNS} robust suspensions, s, and how many times as long as in one call")
    base = float(np.median(times["in one call"]))
    for name, each in times.items():
        print(f"  {name:30} {np.median(each):8.3f} {np.median(each) / base:6.2f}")


class Places(al.AlgebraicSystem):
    """Three decided coordinates, and a wave of the first."""

    a: al.Number
    b: al.Number
    c: al.Number
    off: al.Number

    def outputs(self) -> dict[str, jax.Array]:
        """The coordinates and the wave."""
        wave = 1.0 - jnp.sqrt(self.a) - self.a * jnp.sin(10 * jnp.pi * self.a) + self.b**2
        square = {name: x + self.off for name, x in zip("xyz", (self.a, self.b, self.c), strict=True)}
        return {**square, "wave": wave * (1.0 + self.off)}


def places(lower: float, upper: float) -> al.Problem:
    """A problem in three decisions whose outputs are disturbed by up to a tenth."""
    decisions = (al.Decision(0.4, lower, upper) for _ in "abc")
    return al.Problem(Places(*decisions, al.Uniform(0.0, half_width=0.1)), minimize=al.output("x").mean)


def squares(sign: float) -> al.Expression:
    """The squared distance of the means from a place on the diagonal."""
    means = (al.output(name).mean for name in "xyz")
    return sum(((one - sign / np.sqrt(3)) ** 2 for one in means), start=0.0 * al.value("a"))


def fronts() -> None:
    """The hypervolume of fronts by `al.trade_off` beside that of their closed forms."""
    t, a = np.linspace(-1.0, 1.0, 200001), np.linspace(1e-3, 1.0, 200001)
    near, far = (t - 1) ** 2, (t + 1) ** 2
    wave = 1 - np.sqrt(a) - a * np.sin(10 * np.pi * a) + 1e-6
    bells = [al.expressions.function(lambda s: 1.0 - jnp.exp(-s), squares(sign)) for sign in (1.0, -1.0)]
    cases = {
        "convex": (places(-4.0, 4.0), [squares(1.0), squares(-1.0)], (near, far), 1),
        "concave": (places(-4.0, 4.0), bells, (1 - np.exp(-near), 1 - np.exp(-far)), 1),
        "five parts": (places(1e-3, 1.0), [al.value("a"), al.output("wave").mean], (a, wave), 12),
    }
    print("\nfronts: points, hypervolume over that of the closed form, seconds")
    for name, (problem, (one, other), exact, starts) in cases.items():
        for points in (20, 60, 180):
            began = time.perf_counter()
            found = al.trade_off(problem, {"one": one, "other": other}, points, starts=starts)
            seconds = time.perf_counter() - began
            corner = np.max(exact, axis=1) if name != "five parts" else np.ones(2)
            share = found.hypervolume(corner) / _dominated(*exact, corner)
            print(f"  {name:12} {len(found.values):4} {share:8.4f} {seconds:7.1f}")


def _dominated(first: np.ndarray, second: np.ndarray, corner: np.ndarray) -> float:
    """The area that a densely known curve dominates, up to a corner."""
    order = np.argsort(first)
    first, best = first[order], np.minimum.accumulate(second[order])
    inside = first <= corner[0]
    widths = np.diff(np.append(first[inside], corner[0]))
    return float(np.sum(widths * np.maximum(corner[1] - best[inside], 0.0)))


class Waves(al.AlgebraicSystem):
    """Two decisions whose load comes in waves, with many local optima (after Rastrigin) or few (after Branin)."""

    a: al.Number
    b: al.Number
    off: al.Number

    def outputs(self) -> dict[str, jax.Array]:
        """A thousand minima, three, and six of which two are global; all disturbed."""
        a, b = self.a, self.b
        many = 20 + a**2 - 10 * jnp.cos(2 * jnp.pi * a) + b**2 - 10 * jnp.cos(2 * jnp.pi * b)
        inner = (b + 5) * 1.5 - 5.1 / (4 * jnp.pi**2) * (a + 2.5) ** 2 + 5 / jnp.pi * (a + 2.5) - 6
        three = inner**2 + 10 * (1 - 1 / (8 * jnp.pi)) * jnp.cos(a + 2.5) + 10
        six = (4 - 2.1 * a**2 + a**4 / 3) * a**2 + a * b + (-4 + 4 * b**2) * b**2
        return {"many": many + self.off, "three": three + self.off, "six": six + self.off}


def designs_of_many_optima() -> None:
    """How often the portfolio ends at the global optimum of robust designs with several, and how often one solve does.

    The optima are those of the undisturbed functions, and the standard deviation of the disturbance, which is constant.
    """
    spread = 0.1 / np.sqrt(3)
    known = {"many": 0.0, "three": 0.39788735772973816, "six": -1.0316284534898774}
    print(f"\nrobust designs with several optima: global one found, of {SEEDS} seeds (starts)")
    for name, least in known.items():
        output = al.output(name)
        decisions = (al.Decision(start, -5.0, 5.0) for start in (1.7, -2.3))
        problem = al.Problem(Waves(*decisions, al.Uniform(0.0, half_width=0.1)), minimize=output.mean + output.std)
        best = least + spread + ENOUGH
        right = {"portfolio": 0, "one solve": 0}
        for seed in range(SEEDS):
            right["portfolio"] += al.portfolio(problem, 6, seed=seed).best.objective <= best
            start = dict(zip("ab", np.random.default_rng(seed).uniform(-5.0, 5.0, 2).tolist(), strict=True))
            right["one solve"] += al.solve(problem, start=start, throw=False).objective <= best
        print(f"  {name:8} {', '.join(f'{way} {count}' for way, count in right.items())}")


def starts() -> None:
    """The portfolio beside forty random starts, all of the same local solver, which is compiled before."""
    cases = {
        "time-optimal arm": (pick_and_place_time.robust_problem(1.0), 20, 500),
        "six-axis arm": (six_axis_problem(1.0), 20, 500),
        "swing-up": (swing_up.robust_problem(), 12, 120),
    }
    print("\nmotions: best of, objective, status, seconds, local optima with the number of starts")
    for name, (problem, count, iterations) in cases.items():
        local = al.solvers.FilterSQP(max_iterations=iterations)
        al.solve(problem, local, throw=False)
        for seed in range(2):
            search = al.solvers.DifferentialEvolution(evaluations=1000, seed=seed)
            ways = {f"portfolio of {count}": (count, search), "40 starts": (40, None)}
            for label, (several, one) in ways.items():
                began = time.perf_counter()
                found = al.portfolio(problem, several, search=one, solver=local, seed=seed)
                seconds = time.perf_counter() - began
                best, status = found.best.objective, found.best.status.name.lower()
                optima = ", ".join(f"{each.objective:.4g} ({each.starts})" for each in found.optima[:4])
                print(f"  {name:18} seed {seed} {label:16} {best:12.8g} {status:10} {seconds:8.1f}  {optima}")


class Cart(al.System):
    """A mass that is pushed; the objective is linear in the push, so that an arc of it is singular."""

    states = ("x", "v")
    mass: al.Number

    def initial(self) -> dict[str, float]:
        """At rest in the middle, moving."""
        return {"x": 0.0, "v": 1.0}

    def rhs(self, _t: jax.Array, z: al.Instant, force: jax.Array) -> tuple:
        """Newton."""
        return z.v, force / self.mass

    def outputs(self, _t: jax.Array, z: al.Instant) -> dict[str, jax.Array]:
        """The loss."""
        return {"loss": 0.5 * (z.x**2 + z.v**2)}


def singular(points: int) -> al.Problem:
    """The push of an uncertain mass that brings it to rest with the least loss."""
    push = al.Tabulated(np.linspace(0.0, 5.0, points), al.Decision(np.zeros(points), -1.0, 1.0))
    return al.Problem(
        Cart(al.Uniform(1.0, half_width=0.1)),
        grid=al.Grid(5.0, 200),
        inputs={"force": push},
        minimize=al.integral("loss").mean,
        expansion=al.Expansion(order=3),
    )


def curvature() -> None:
    """Exact second derivatives beside approximated ones: where an arc is singular, and where it is not."""
    cases = {
        "suspension, 2 decisions": suspension.robust_problem(),
        "clutch, 6 decisions": clutch.allocation_problem(),
        "time-optimal arm, 17 decisions": pick_and_place_time.robust_problem(1.0),
        "singular arc, 11 decisions": singular(11),
        "singular arc, 41 decisions": singular(41),
    }
    print("\nsecond derivatives: exact or not, objective, iterations, seconds when warm")
    for name, problem in cases.items():
        for solver in (al.solvers.FilterSQP(max_iterations=3000), al.solvers.Ipopt(max_iterations=3000)):
            for exact in (False, True):
                way = al.Sequential(second_derivatives=exact)
                seconds = []
                for _ in range(4):
                    began = time.perf_counter()
                    found = al.solve(problem, solver, transcription=way, throw=False, between=1)
                    seconds.append(time.perf_counter() - began)
                said = f"{found.objective:14.8g} {found.effort.iterations:5} {np.median(seconds[1:]):8.3f}"
                print(f"  {name:32} {label_of(solver):10} {'exact' if exact else 'L-BFGS':8} {said}")


PARTS = {
    "programs": programs,
    "designs": designs,
    "seeds": seeds,
    "optima": designs_of_many_optima,
    "population": population,
    "fronts": fronts,
    "starts": starts,
    "curvature": curvature,
}

if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
