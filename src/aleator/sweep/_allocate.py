"""`allocate`: the cheapest tolerances of a stack that keep a limit, statistically and in the worst case."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.border import one_of, positive, real_array, refusal
from aleator._core.leaves import Printed
from aleator.analysis import ToleranceAnalysis, check_limits, tolerance_analysis, zones_of
from aleator.design import Expression, Problem, value, value_at
from aleator.design import output as output_of
from aleator.dynamics import AlgebraicSystem
from aleator.solution import Solution
from aleator.solving import solve
from aleator.uncertainty import (
    AbstractDistribution,
    Decision,
    Toleranced,
    Uniform,
    placements,
    with_decisions,
    with_distributions,
)

# Zones are sought from a twentieth of today's width to twenty times this.
_RANGE = 20.0
_SIDES = "tolerance", "plus", "minus"


@final
@dataclass(frozen=True)
class Tolerances(Printed):
    """The tolerances of one way to allocate: `zones` (minus, plus) by dimension, their `cost`, and what they achieve.

    - `decisions`: the other numbers that the stack leaves to be decided, such as a nominal value;
    - `solution`: that of the problem behind them; None for those that the stack has today.
    """

    zones: Mapping[str, tuple[float, float]]
    decisions: Mapping[str, Float[np.ndarray, "..."]]
    cost: float
    analysis: ToleranceAnalysis
    solution: Solution | None = None

    def __str__(self) -> str:
        return f"cost {self.cost:.4g}; {', '.join(f'{name} {_text(zone)}' for name, zone in self.zones.items())}"


@final
@dataclass(frozen=True)
class Allocation(Printed):
    """Tolerances of a stack: those of `today`, the cheapest for a capability, and the cheapest for every assembly.

    - `statistical`: the mean of the output keeps `3 cpk` standard deviations from its limits;
    - `worst_case`: every assembly of parts within their zones keeps them, see `tolerance_analysis`;
    - `failed`: why one of them is missing, by its name.

    `print(allocation)` shows them side by side.
    """

    output: str
    lower: float
    upper: float
    cpk: float
    today: Tolerances
    statistical: Tolerances | None
    worst_case: Tolerances | None
    failed: Mapping[str, str]

    def __str__(self) -> str:
        columns = {"today": self.today, f"statistical, Cpk {self.cpk:.3g}": self.statistical}
        columns |= {"worst case": self.worst_case}
        known = {name: tolerances for name, tolerances in columns.items() if tolerances is not None}
        rows = [[f"{self.output}, {self.lower:g} to {self.upper:g}", *known]]
        rows += [[name, *(_text(each.zones[name]) for each in known.values())] for name in self.today.zones]
        for name in self.today.decisions:
            rows.append([name, *(", ".join(f"{x:.4g}" for x in each.decisions[name].flat) for each in known.values())])
        of_analysis = {
            "Cp": lambda one: f"{one.cp:.3g}",
            "Cpk": lambda one: f"{one.cpk:.3g}",
            "rejects": lambda one: f"{one.rejects:.3g} ppm",
            "worst case": lambda one: f"{one.worst_case[0]:.4g} to {one.worst_case[1]:.4g}",
        }
        rows.append(["cost", *(f"{each.cost:.4g}" for each in known.values())])
        rows += [[name, *(text(each.analysis) for each in known.values())] for name, text in of_analysis.items()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
        ]
        return "\n".join([*lines, *(f"{name}: {why}" for name, why in self.failed.items())])


def allocate(
    stack: AlgebraicSystem,
    costs: Mapping[str, tuple[float, float]],
    output: str,
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    cpk: float = 1.0,
) -> Allocation:
    """The cheapest tolerances of a stack that keep an output within limits (section 7.2).

        stack = al.Assembly(
            {"housing": al.toleranced("40.0 ±0.1"), "plate": al.toleranced("13.2 +0.1/-0", cp=1.33)},
            features={"gap": "housing - 3*plate"},
        )
        print(al.allocate(stack, {"housing": (1.0, 0.05), "plate": (0.5, 0.02)}, "gap", lower=0.0, upper=0.6))

    - `stack`: an `Assembly` or another `AlgebraicSystem` whose dimensions are `Toleranced`, as they are today. Its
      decisions, such as nominal values, are chosen with the tolerances;
    - `costs`: by dimension, `(fixed, slope)`: a part costs `fixed + slope / half-width of its zone`. Dimensions without
      a cost keep their tolerances. The middle of a zone stays where it is; of a zone on one side of its nominal value,
      such as +0.1/-0, the limit near this stays. So does the capability of each process (`cp`, `cpk`);
    - `output`: the output that is limited; `lower`, `upper`: its limits, in its unit;
    - `cpk`: the capability that the output needs for the statistical answer.

    Zones are between a twentieth of today's width and twenty times this. Other costs, several outputs or limits on
    probabilities are a `Problem`: `al.Toleranced(40.0, tolerance=al.Decision(0.1, 0.01, 1.0))`, `al.cost`.

    Returns an `Allocation`. Raises `ProblemError` for dimensions that the stack does not have, costs that are not
    positive, and limits in the wrong order.
    """
    one_of("allocate: stack", stack, AlgebraicSystem, "an al.Assembly of al.Toleranced dimensions")
    cpk, functional = positive("allocate: cpk", cpk), output_of(output)
    dimensions = placements(stack).distributions
    expected = f"(fixed, slope) of some of the dimensions {list(dimensions)}, slope above 0"
    if not isinstance(costs, Mapping) or not costs or not set(costs) <= set(dimensions):
        raise refusal("allocate: costs", expected, costs)
    for name, pair in costs.items():
        numbers = real_array(f"allocate: costs of '{name}'", pair)
        if numbers.shape != (2,) or not np.isfinite(numbers).all() or numbers[1] <= 0:
            raise refusal(f"allocate: costs of '{name}'", expected, pair)
    for name, dimension in dimensions.items():
        is_toleranced, at_start = isinstance(dimension, Toleranced), dimension.initial()
        if name in costs and not (is_toleranced and _is_known(dimension, at_start)):
            expected = "an al.Toleranced dimension of which at most the nominal value of a ± tolerance is decided"
            raise refusal(f"allocate: '{name}'", expected, dimension)
        if not is_toleranced and dimension != at_start:
            expected = "an al.Toleranced dimension where something is decided, al.Toleranced(al.Decision(...), ...)"
            raise refusal(f"allocate: '{name}'", expected, dimension)
    check_limits("allocate", lower, upper)
    toleranced = {name: each for name, each in dimensions.items() if isinstance(each, Toleranced)}
    sought = {name: _decided(toleranced[name]) for name in costs}
    decided = with_distributions(stack, lambda name, leaf: sought.get(name, leaf))
    (first, *others) = (fixed + slope / _half_width(name, sought[name]) for name, (fixed, slope) in costs.items())
    cost = sum(others, start=first)
    costed = Problem(decided, minimize=cost)
    # A zone is told about its nominal value of today, unless that is decided.
    nominals = {name: toleranced[name].parameters["nominal"] for name in toleranced}
    chosen = {f"{name}.{side}" for name in costs for side in _SIDES}

    def tolerances(vector: Float[np.ndarray, " n"], solution: Solution | None = None) -> Tolerances:
        at = costed.placements.named(vector)
        made = with_decisions(decided, lambda name, _: at[name])
        zones = {name: _zone(placements(made).distributions[name], nominal) for name, nominal in nominals.items()}
        others = {name: np.asarray(number) for name, number in at.items() if name not in chosen}
        analysis = tolerance_analysis(made, output, lower=lower, upper=upper)
        return Tolerances(zones, others, value_at(cost, costed, vector), analysis, solution)

    answers = dict[str, Tolerances | None]()
    failed = dict[str, str]()
    # Within their zones parts are of any sizes, correlated or not.
    bounds = zones_of(placements(stack), {})

    def in_zone(name: str, leaf: AbstractDistribution) -> AbstractDistribution:
        is_toleranced = isinstance(leaf, Toleranced)
        return leaf.with_fields(dependence=None) if is_toleranced else Uniform.bounds(*bounds[name])

    in_zones = with_distributions(decided, in_zone)
    kinds: dict[str, tuple[AlgebraicSystem, dict[str, Any]]] = {
        "statistical": (decided, {"sigmas": 3 * cpk}),
        "worst case": (in_zones, {"worst_case": True}),
    }
    for kind, (model, margin) in kinds.items():
        sides = [functional.at_most(upper, **margin)] if np.isfinite(upper) else []
        sides += [functional.at_least(lower, **margin)] if np.isfinite(lower) else []
        solution = solve(Problem(model, minimize=cost, subject_to=sides), throw=False)
        if solution.ok:
            answers[kind] = tolerances(solution.vector, solution)
        else:
            answers[kind], failed[kind] = None, solution.why()
    today = tolerances(costed.placements.vector("initial"))
    return Allocation(output, float(lower), float(upper), cpk, today, *answers.values(), failed=failed)


def _is_known(dimension: Toleranced, at_start: AbstractDistribution) -> bool:
    """Whether nothing is decided, or the nominal value alone of a zone about it."""
    moved = dimension.with_fields(parameters=dimension.parameters | {"nominal": at_start.parameters["nominal"]})
    return dimension == at_start or ("tolerance" in dimension.parameters and moved == at_start)


def _decided(dimension: Toleranced) -> Toleranced:
    """The dimension with the width of its zone to be chosen: about its middle, or from a limit that does not lie beyond
    the nominal value.
    """
    nominal = dimension.parameters["nominal"]
    sides = {name: float(width) for name, width in dimension.parameters.items() if name in _SIDES}
    capability = {name: each for name, each in dimension.parameters.items() if name not in (*_SIDES, "nominal")}
    low, high = map(float, dimension.initial().limits())
    width, still = high - low, [name for name, distance in sides.items() if distance <= 0]
    if not still:
        middle = nominal if "tolerance" in sides else (low + high) / 2
        chosen = {"nominal": middle, "tolerance": _sought(width / 2)}
    else:
        chosen = {"nominal": nominal, **sides}
        moved = "plus" if still == ["minus"] else "minus"
        chosen[moved] = _sought(width, -sides[still[0]])
    return dimension.with_fields(parameters=Toleranced(**chosen, **capability).parameters)


def _sought(width: float, beyond: float = 0.0) -> Decision:
    return Decision(width + beyond, width / _RANGE + beyond, width * _RANGE + beyond)


def _half_width(name: str, dimension: Toleranced) -> Expression:
    """Half the width of a dimension's zone, in terms of what is chosen."""
    if "tolerance" in dimension.parameters:
        return value(f"{name}.tolerance")
    return 0.5 * (value(f"{name}.plus") + value(f"{name}.minus"))


def _zone(dimension: AbstractDistribution, nominal: Any) -> tuple[float, float]:
    """The distances of both limits of a zone from the nominal value, that of the drawing or one that was decided."""
    assert isinstance(dimension, Toleranced)
    low, high = map(float, dimension.limits())
    nominal = float(dimension.parameters["nominal"] if isinstance(nominal, Decision) else nominal)
    return nominal - low, high - nominal


def _text(zone: tuple[float, float]) -> str:
    minus, plus = zone
    return f"± {plus:.4g}" if np.isclose(minus, plus, rtol=1e-9) else f"{plus:+.4g} / {-minus:+.4g}"
