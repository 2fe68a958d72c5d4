"""The clutch study, run: the methods of table 7.2 and more, tolerance analysis, allocation and its front.

Rejects are counted in closed form, which is independent of the expansions and methods that it verifies.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any, NamedTuple, final

import numpy as np
import scipy

import aleator as al
from aleator._core.border import Progress, silent
from aleator.journalling import kept
from aleator.studies._staged import Stage, stop_if_interrupted
from aleator.studies.clutch import (
    DEVIATION,
    LIMITS,
    MEANS,
    TOLERANCES,
    allocation_problem,
    clutch,
    pressure_angle,
    published_expansion,
)
from aleator.uncertainty import HermiteGerm

GIVEN, CHEAPEST, SAFE = "given", "cheapest", "worst case within limits"
AT_ONCE = 1_000_000
ROUNDING = 1e-9
TABLE_ORDERS = (2, 3, 5)
EXACT_NODES = 24


@final
@dataclass(frozen=True)
class Tails:
    """The proportions of counted assemblies below and above the limits of a specification."""

    low: al.results.Proportion
    high: al.results.Proportion

    @property
    def either(self) -> al.results.Proportion:
        """Both together."""
        return al.results.Proportion(self.low.count + self.high.count, self.low.samples)


@final
@dataclass(frozen=True)
class Counts:
    """The rejects of some tolerances (mm) under both specifications.

    - `function`: rejects by the limits between which the clutch works; `deviation`: by the second specification;
    - `worst_case`: smallest and largest angle with each dimension anywhere within its tolerance, degrees.
    """

    tolerances: Mapping[str, float]
    function: Tails
    deviation: Tails
    worst_case: tuple[float, float]

    @property
    def by_name(self) -> dict[str, Tails]:
        """The rejects by the names of the specifications."""
        return {"limits": self.function, "deviation": self.deviation}

    def broken(self, limits: tuple[float, float] = LIMITS) -> list[float]:
        """The limits, by default the function's, that the worst case breaks by more than rounding."""
        (least, largest), (lower, upper) = self.worst_case, limits
        return [lower] * (least < lower - ROUNDING) + [upper] * (largest > upper + ROUNDING)

    @property
    def cost(self) -> float:
        """The sum of the reciprocal tolerances, 1/mm."""
        return sum(1 / tolerance for tolerance in self.tolerances.values())


def count_rejects(
    tolerances: Mapping[str, float], samples: int, *, seed: int = 2, progress: Progress = silent
) -> Counts:
    """Assemble `samples` clutches of normal parts, standard deviation a third of the tolerance, and count rejects."""
    generator = np.random.default_rng(seed)
    found = np.zeros(4, dtype=int)
    for done in range(0, samples, AT_ONCE):
        progress("counting rejects", done, samples)
        drawn = generator.standard_normal((len(MEANS), min(AT_ONCE, samples - done)))
        parts = (MEANS[name] + tolerances[name] / 3 * row for name, row in zip(MEANS, drawn, strict=True))
        angle = pressure_angle(*parts)
        found += [np.sum(side) for lower, upper in (LIMITS, DEVIATION) for side in (angle < lower, angle > upper)]
    shares = [al.results.Proportion(int(one), samples) for one in found]
    return Counts(dict(tolerances), Tails(*shares[:2]), Tails(*shares[2:]), worst_case(tolerances))


def worst_case(tolerances: Mapping[str, float]) -> tuple[float, float]:
    """Smallest and largest pressure angle with each dimension anywhere within its tolerance, degrees.

    The angle falls with the hub and the roller and rises with the ring, so that two corners of the box bound it.
    """
    corners = [[MEANS[name] + sign * _towards_low(name) * tolerances[name] for name in MEANS] for sign in (1.0, -1.0)]
    least, largest = (float(pressure_angle(*np.array(corner))) for corner in corners)
    return least, largest


def exact_rejects(tolerances: Mapping[str, float]) -> tuple[float, float]:
    """The shares of assemblies below and above the function's limits, of normal parts.

    The angle is below a limit where `a + c > cos(limit) (e - c)`: a sum of normal parts, itself normal.
    """
    tails = []
    for limit, sign in zip(LIMITS, (1.0, -1.0), strict=True):
        weights, room = _margin(limit)
        deviation = np.sqrt(sum((weights[name] * tolerances[name] / 3) ** 2 for name in MEANS))
        tails.append(float(scipy.special.ndtr(-sign * room / deviation)))
    return tails[0], tails[1]


def worst_case_tolerances() -> dict[str, float]:
    """The cheapest tolerances, by the sum of 1/T, whose worst case stays within the function's limits, mm.

    At a limit, the worst case is linear in the tolerances: `Σ w T <= room`. Of such tolerances the cheapest are
    `T = room / (sqrt(w) Σ sqrt(w))`. The limit with less room decides, since the weights at both limits agree within
    half a percent, their rooms only within a tenth.
    """
    weights, room = min((_margin(limit) for limit in LIMITS), key=lambda one: abs(one[1]))
    roots = {name: float(np.sqrt(abs(weight))) for name, weight in weights.items()}
    return {name: abs(room) / (root * sum(roots.values())) for name, root in roots.items()}


def tolerances_of(solution: al.Solution) -> dict[str, float]:
    """The tolerances that a design chose, mm."""
    return {name: float(solution.decisions[f"{name}.tolerance"]) for name in TOLERANCES}


def _towards_low(name: str) -> float:
    return -1.0 if name == "e" else 1.0


def _margin(limit: float) -> tuple[dict[str, float], float]:
    """How `cos(limit) (e - c) - (a + c)`, mm, falls with each dimension, and its value at the nominal dimensions.

    It is positive where the angle is above the limit.
    """
    cosine = float(np.cos(np.deg2rad(limit)))
    weights = {"a": 1.0, "c": 1.0 + cosine, "e": -cosine}
    return weights, -sum(weights[name] * MEANS[name] for name in MEANS)


@final
@dataclass(frozen=True)
class Effort:
    """How much is computed: Monte Carlo samples of table 7.2 and of the evidence, assemblies counted in closed form for
    each set of tolerances, points on the front, orders of the expansions compared, whether an expansion in Taylor's
    series is compared too, and how often each is timed warm.
    """

    samples: int = 2_500_000
    quasi_samples: int = 2**16
    evidence_samples: int = 1_000_000
    counted: int = 20_000_000
    front_points: int = 11
    orders: tuple[int, ...] = (1, 2, 3, 4, 5, 6, 7)
    second_order: bool = True
    repeats: int = 5


FULL = Effort()
QUICK = Effort(
    samples=250_000,
    quasi_samples=2**13,
    evidence_samples=100_000,
    counted=2_000_000,
    front_points=4,
    orders=TABLE_ORDERS,
    second_order=False,
    repeats=1,
)


class Method(NamedTuple):
    """One row of table 7.2.

    - `variation`: three standard deviations of the pressure angle, degrees; `standard_error`: of it, if sampled;
    - `points`: how often the assembly was solved; `seconds`: wall time on a warm process.
    """

    name: str
    variation: float
    standard_error: float | None
    points: int
    seconds: float


@final
@dataclass
class ClutchResults:
    """Everything the study has finished so far; what has not been reached is empty.

    - `exact`: three standard deviations by Gauss quadrature of the closed form, degrees;
    - `methods`: the rows of table 7.2 and of its extension;
    - `analyses`: the tolerance analysis for each specification, by its name;
    - `given`: the rejects of the given tolerances under the second specification, a share;
    - `counts`: what the given tolerances, the cheapest ones, and the cheapest ones whose worst case stays within the
      function's limits leave of both specifications, by these names;
    - `allocation`, `evidence`: the cheapest tolerances with no more rejects, and a count of these;
    - `front`: the cost over the rejects allowed.
    """

    effort: Effort
    exact: float = np.nan
    methods: list[Method] = field(default_factory=list)
    analyses: dict[str, al.results.ToleranceAnalysis] = field(default_factory=dict)
    counts: dict[str, Counts] = field(default_factory=dict)
    allocation: al.Solution | None = None
    evidence: al.results.Evidence | None = None
    front: al.results.Front | None = None

    @property
    def given(self) -> float:
        """The share of rejects that the given tolerances leave under the second specification."""
        return self.analyses["deviation"].rejects / 1e6


def exact_variation() -> float:
    """Three standard deviations of the pressure angle, degrees: tensor Gauss quadrature of the closed form.

    It is independent of the methods that it verifies: it uses no vector loop, Newton's method or expansion.
    """
    nodes, weights = HermiteGerm().gauss(EXACT_NODES)
    columns = [MEANS[name] + TOLERANCES[name] / 3 * nodes for name in MEANS]
    angles = pressure_angle(*np.array(list(product(*columns))).T)
    weight = np.prod(np.array(list(product(weights, repeat=len(MEANS)))), axis=1)
    return float(3 * np.sqrt(weight @ (angles - weight @ angles) ** 2))


def compare_methods(results: ClutchResults, progress: Progress) -> None:
    """Table 7.2 and its extension. The expansions are timed warm, as is Monte Carlo: each after a first small run."""
    results.exact = exact_variation()
    found, effort = results.methods, results.effort
    progress("linearisation", 0, 4)
    found.append(kept("DLM", by_linearisation, effort.repeats))
    if effort.second_order:
        found.append(kept("second order", by_second_order, effort.repeats))
    progress("expansions", 1, 4)
    found += [kept(f"gPC, order {order}", by_expansion, order, effort.repeats) for order in effort.orders]
    draws = {
        "quasi-Monte Carlo": (al.references.quasi_monte_carlo, effort.quasi_samples),
        "Monte Carlo": (al.references.monte_carlo, effort.samples),
    }
    for i, (name, (draw, samples)) in enumerate(draws.items()):
        progress(name, 2 + i, 4)
        found.append(_sampled(name, draw(_angle, clutch(), samples)))


def by_linearisation(repeats: int) -> Method:
    """The row of direct linearisation."""
    model = clutch()
    linear, seconds = _timed(lambda: al.references.linearise(_angle, model), repeats)
    return Method("DLM", 3 * float(linear.std), None, 1, seconds)


def by_second_order(repeats: int) -> Method:
    """The row of an expansion in Taylor's series."""
    model = clutch()
    second, seconds = _timed(lambda: al.references.second_order(_angle, model), repeats)
    return Method("second order", 3 * float(second.std), None, 1, seconds)


def by_expansion(order: int, repeats: int) -> Method:
    """The row of a polynomial chaos expansion."""
    model, wish = clutch(), published_expansion(order)
    expanded, seconds = _timed(lambda: al.expand(_angle, model, wish), repeats)
    return Method(f"gPC, order {order}", 3 * float(expanded.std), None, len(expanded.collocation.points), seconds)


def _angle(model: al.AlgebraicSystem) -> Any:
    return al.simulate(model)["chi"][0]


def _sampled(name: str, drawn: al.references.RandomSample) -> Method:
    std = drawn.std
    return Method(name, 3 * float(std.value), 3 * float(std.standard_error), drawn.samples, drawn.seconds)


def _timed(work: Callable[[], Any], repeats: int = 0) -> tuple[Any, float]:
    """The result of some work, and its shortest time, s, of `repeats` runs after a first one that compiles, if any."""
    result, times = None, []
    for done in range(repeats + 1):
        start = time.perf_counter()
        result = work()
        if done or not repeats:
            times.append(time.perf_counter() - start)
    return result, min(times)


def analyse_tolerances(results: ClutchResults, progress: Progress) -> None:
    """Contributions, capability and rejects under both specifications; the given and the safe tolerances counted."""
    results.analyses = {
        name: _analysed(name, *ends) for name, ends in {"limits": LIMITS, "deviation": DEVIATION}.items()
    }
    for name, tolerances in {GIVEN: TOLERANCES, SAFE: worst_case_tolerances()}.items():
        _count(results, name, tolerances, progress)


def _analysed(name: str, lower: float, upper: float) -> al.results.ToleranceAnalysis:
    wanted = {"lower": lower, "upper": upper, "expansion": published_expansion(3)}
    return kept(f"tolerances, {name}", al.tolerance_analysis, clutch(), "chi", **wanted)


def _count(results: ClutchResults, name: str, tolerances: Mapping[str, float], progress: Progress) -> None:
    samples = results.effort.counted
    results.counts[name] = kept(f"rejects, {name}", count_rejects, tolerances, samples, progress=progress)


def allocate(results: ClutchResults, progress: Progress) -> None:
    """The cheapest tolerances with no more rejects than the given ones, and a count of their rejects."""
    results.allocation = al.solve(allocation_problem(results.given))
    results.evidence = al.validate(results.allocation, results.effort.evidence_samples, seed=1, progress=progress)
    if results.allocation.ok:
        _count(results, CHEAPEST, tolerances_of(results.allocation), progress)


def sweep_rejects(results: ClutchResults, progress: Progress) -> None:
    """The minimum cost against the rejects allowed."""
    values = np.geomspace(0.05, 1e-6, results.effort.front_points)
    results.front = al.pareto(allocation_problem(), "rejects", values, progress=progress)
    stop_if_interrupted(results.front)


def stages(results: ClutchResults) -> dict[str, Stage]:
    """All stages, the most useful first."""
    return {
        "methods": Stage(partial(compare_methods, results), 0.4),
        "tolerances": Stage(partial(analyse_tolerances, results), 0.1),
        "allocation": Stage(partial(allocate, results), 0.2),
        "front": Stage(partial(sweep_rejects, results), 0.3),
    }
