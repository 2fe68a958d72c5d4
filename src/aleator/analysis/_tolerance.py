"""Tolerance analysis: how the tolerances of parts add up in an assembly, and how many assemblies are rejects."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np

from aleator._core.arrays import Pytree, jax_array
from aleator._core.border import one_of, real_array
from aleator._core.errors import ProblemError, SimulationError
from aleator._core.leaves import Drawn, Printed, in_order
from aleator.analysis._abstract_expanded import prepared
from aleator.analysis._expand import Sampler, expand
from aleator.analysis._expanded import Expanded
from aleator.dynamics import AlgebraicSystem, explain_failure, simulate
from aleator.expansion import Expansion
from aleator.references import Linearised
from aleator.references._taylor import Inputs, linear_at_means
from aleator.statistics import Probability, lines_through, points_in_tail, tail_proposal
from aleator.uncertainty import (
    AbstractDistribution,
    Placements,
    Toleranced,
    Uniform,
    at_means,
    placements,
    realise,
    refuse_intervals,
    with_distributions,
)

SIGMAS = 3.0

PARTS_PER_MILLION = 1e6

# Up to this many dimensions all corners of the zones are evaluated: 4096.
_MOST_CORNERS = 12
# Other assemblies that a search for the worst case tries at once, and how often.
_SPREAD, _ROUNDS = 256, 50

# Assemblies that are drawn in each tail, and the least probability of the expansion there that leads to a tail.
_IN_TAIL, _LEAST_CHANCE = 4096, 1e-12
_DIFFERS = 1.0  # shares of the variance, in points
_WORTH_SAYING = 0.01  # an error of rejects, as a part of them


class Zone(NamedTuple):
    """An interval of a dimension, in its unit."""

    lower: float
    upper: float

    @property
    def half_width(self) -> float:
        """Half of its width."""
        return (self.upper - self.lower) / 2

    def __str__(self) -> str:
        return f"{(self.lower + self.upper) / 2:.6g} ± {self.half_width:.4g}"


def zones_of(places: Placements, tolerances: Mapping[str, Any]) -> dict[str, Zone]:
    """The zone of each dimension: as given, or from its distribution at the initial values of its decisions."""
    unknown = sorted(set(tolerances) - set(places.distributions))
    if unknown:
        raise ProblemError(
            f"tolerance_analysis: there is no uncertain dimension {unknown}; expected some of "
            f"{list(places.distributions)}."
        )
    return {
        name: _given(one.initial(), tolerances[name]) if name in tolerances else _zone_of(one.initial())
        for name, one in places.distributions.items()
    }


def _zone_of(distribution: AbstractDistribution) -> Zone:
    if isinstance(distribution, Toleranced):
        return Zone(*map(float, distribution.limits()))
    lower, upper = map(float, distribution.support())
    if np.isfinite([lower, upper]).all():
        return Zone(lower, upper)
    return Zone(*(float(distribution.value_at_normal(jax_array(end))) for end in (-SIGMAS, SIGMAS)))


def _given(distribution: AbstractDistribution, tolerance: Any) -> Zone:
    minus, plus = tolerance if isinstance(tolerance, tuple) else (tolerance, tolerance)
    if not (np.isfinite([minus, plus]).all() and minus >= 0 and plus >= 0 and minus + plus > 0):
        raise ProblemError(f"tolerance_analysis: a tolerance is positive and finite; received {tolerance!r}.")
    middle = float(distribution.mean())
    return Zone(middle - minus, middle + plus)


@final
@dataclass(frozen=True)
class Contribution(Printed):
    """The contribution of one dimension to the spread of the assembly.

    - `zone`: the tolerance zone of the dimension;
    - `sensitivity`: derivative of the output with respect to it, at the means;
    - `linear`: its share of the variance by the direct linearisation method, percent;
    - `total`: its share alone and together with others, by the expansion (total Sobol index), percent.
    """

    zone: Zone
    sensitivity: float
    linear: float
    total: float

    @property
    def share(self) -> float:
        """Its share of the variance in percent: the total one, or the linear one of a correlated dimension."""
        return self.linear if np.isnan(self.total) else self.total

    @property
    def aside(self) -> str:
        """The linear share in words where it is another one."""
        return f" ({self.linear:.3g} % linearly)" if abs(self.share - self.linear) > _DIFFERS else ""

    @property
    def slope(self) -> str:
        """The sensitivity in words; empty where the output has no derivative at the means."""
        return f"sensitivity {self.sensitivity:.4g}" if np.isfinite(self.sensitivity) else ""

    def __str__(self) -> str:
        linear = [self.slope, f"{self.linear:.1f} % of the variance linearly"] if self.slope else []
        return ", ".join([*linear, f"{self.total:.1f} % in all"])


@final
@dataclass(frozen=True)
class ToleranceAnalysis(Drawn):
    """One output of an assembly under the tolerances of its parts. `print(analysis)` shows it as a table.

    - `nominal`: the output with every dimension at its mean; `mean`, `std`, `skewness`, `kurtosis` (3 if normal);
    - `lower`, `upper`: its limits;
    - `rejects_low`, `rejects_high`: assemblies beyond them in parts per million, by the distribution of the expansion,
      corrected by assemblies that are drawn in either tail; `rejects_error`: the 95 % half-width of both together;
    - `worst_case`: the range of the output itself over all dimensions within their zones, as far as a search finds it;
    - `rss`: half-width by root sum square; `linear_std`: standard deviation by direct linearisation;
    - `contributions`: by dimension.

    What is linear is NaN where the output has no derivative at the means, such as a distance of zero (true position).
    """

    output: str
    nominal: float
    mean: float
    std: float
    skewness: float
    kurtosis: float
    lower: float
    upper: float
    rejects_low: float
    rejects_high: float
    rejects_error: float
    worst_case: tuple[float, float]
    rss: float
    linear_std: float
    contributions: Mapping[str, Contribution]
    expanded: Expanded

    @property
    def rejects(self) -> float:
        """Assemblies beyond either limit, parts per million."""
        return self.rejects_low + self.rejects_high

    @property
    def cp(self) -> float:
        """Process capability: the width of the limits over six standard deviations. Infinite with one limit only."""
        return _capability(self.upper - self.lower, 6 * self.std)

    @property
    def cpk(self) -> float:
        """Capability of the nearer limit: its distance from the mean over three standard deviations."""
        return _capability(min(self.upper - self.mean, self.mean - self.lower), 3 * self.std)

    def __str__(self) -> str:
        low, high = self.worst_case
        error = f", ± {self.rejects_error:.2g} ppm" if self.rejects_error > _WORTH_SAYING * self.rejects else ""
        if (low < self.lower and not self.rejects_low) or (high > self.upper and not self.rejects_high):
            error += ": none was drawn, though the worst case is beyond a limit; al.references.monte_carlo draws more"
        cp = f"Cp {self.cp:.3g}, " if np.isfinite(self.cp) else ""  # of two limits, and a spread
        squares = f"; root sum square ± {self.rss:.5g}" if np.isfinite(self.rss) else ""
        rows = [
            (self.output, f"nominal {self.nominal:.6g}, mean {self.mean:.6g}, 3σ {3 * self.std:.5g}"),
            ("shape", f"skewness {self.skewness:.3g}, kurtosis {self.kurtosis:.4g} (0 and 3 if normal)"),
            ("limits", f"{self.lower:g} to {self.upper:g}: {cp}Cpk {self.cpk:.3g}"),
            ("rejects", f"{self.rejects_low:.3g} ppm low, {self.rejects_high:.3g} ppm high{error}"),
            ("worst case", f"{low:.6g} to {high:.6g}{squares}"),
        ]
        largest = sorted(self.contributions.items(), key=lambda item: -item[1].share)
        for name, one in largest:
            shares = f"{round(one.share, 6):.3g} % of the variance{one.aside}, zone {one.zone}"
            rows.append((name, f"{shares}, {one.slope}" if one.slope else shares))
        width = max(len(label) for label, _ in rows)
        return "\n".join(f"{label:<{width}}  {text}" for label, text in rows)


def _capability(distance: float, spread: float) -> float:
    return distance / spread if spread > 0 else math.copysign(math.inf, distance)


def tolerance_analysis(
    model: Pytree,
    output: str | Callable[[Any], Any],
    *,
    lower: float = -np.inf,
    upper: float = np.inf,
    tolerances: Mapping[str, float | tuple[float, float]] | None = None,
    expansion: Expansion | None = None,
) -> ToleranceAnalysis:
    """Analyse an output of an assembly: spread, contributions, capability, rejects, worst case (section 7.2).

    - `model`: an `AlgebraicSystem` (an `Assembly`), or any model if `output` is a function of it;
    - `output`: the name of an output of the system, or a function of the realised model that returns one number;
    - `lower`, `upper`: the limits of the output, in its unit;
    - `tolerances`: the zone of each dimension for the worst case, half-widths or (minus, plus), by name. By default the
      zone of a `Toleranced` distribution, the support of a bounded distribution, and of others what holds as much as
      three standard deviations of a normal distribution, 99.73 % in the middle;
    - `expansion`: default order 3.

    Returns a `ToleranceAnalysis`, which prints as a table.

    Raises `ProblemError` for limits in the wrong order, an unknown output, a tolerance of an unknown dimension.
    """
    check_limits("tolerance_analysis", lower, upper)
    if expansion is not None:
        one_of("tolerance_analysis: expansion", expansion, Expansion)
    model = in_order(model)
    function, name = _function(model, output)
    refuse_intervals("tolerance_analysis", placements(model))
    zones = zones_of(placements(model), one_of("tolerance_analysis: tolerances", tolerances or {}, Mapping))
    expanded = _expanded(function, model, expansion)
    if not isinstance(expanded.mean, jax.Array) or expanded.mean.ndim:
        raise ProblemError("tolerance_analysis: expected an output that is one number; received an array or a dict.")
    inputs = Inputs("tolerance_analysis", function, model)
    linear = linear_at_means(inputs)
    inputs.refuse_nonfinite(linear.mean)
    in_zones = with_distributions(model, lambda name, _: Uniform.bounds(*zones[name]))
    low, high = _beyond(expanded, Sampler(function, model, traced=True), lower, upper)
    return ToleranceAnalysis(
        output=name,
        nominal=float(linear.mean),
        mean=float(expanded.mean),
        std=float(expanded.std),
        skewness=float(expanded.skewness),
        kurtosis=float(expanded.kurtosis),
        lower=float(lower),
        upper=float(upper),
        rejects_low=PARTS_PER_MILLION * low[0],
        rejects_high=PARTS_PER_MILLION * high[0],
        rejects_error=PARTS_PER_MILLION * float(np.hypot(low[1], high[1])),
        worst_case=_worst_case(function, in_zones, float(linear.mean)),
        rss=float(linear.rss({name: zone.half_width for name, zone in zones.items()})),
        linear_std=float(linear.std),
        contributions=_contributions(expanded, linear, zones),
        expanded=expanded,
    )


def check_limits(who: str, lower: Any, upper: Any) -> None:
    """Raise `ProblemError` unless the limits of an output are two numbers in order, one of them finite."""
    limits = [real_array(f"{who}: {name}", limit) for name, limit in (("lower", lower), ("upper", upper))]
    if any(limit.ndim for limit in limits) or not limits[0] < limits[1] or (np.isinf(lower) and np.isinf(upper)):
        raise ProblemError(f"{who}: expected limits lower < upper, one of them finite; received {lower} and {upper}.")


def _function(model: Pytree, output: str | Callable[[Any], Any]) -> tuple[Callable[[Any], Any], str]:
    """The output as a function of the realised model, and its name."""
    if callable(output):
        return output, getattr(output, "__name__", "output")
    if not isinstance(model, AlgebraicSystem):
        raise ProblemError(
            "tolerance_analysis(model, output): expected an AlgebraicSystem, such as al.Assembly, and the name of an "
            f"output, or any model and a function of it; received {type(model).__name__} and {type(output).__name__}."
        )

    def value(realised: AlgebraicSystem) -> jax.Array:
        outputs = simulate(realised)
        if output not in outputs:
            raise ProblemError(f"There is no output '{output}'; expected one of {list(outputs)}.")
        return outputs[output][0]

    return value, output


def _expanded(function: Callable[[Any], Any], model: Pytree, expansion: Expansion | None) -> Expanded:
    """The expansion of the output; if an assembly has no solution at its means, the error says why."""
    try:
        return expand(function, model, expansion)
    except SimulationError as error:
        if not isinstance(model, AlgebraicSystem):
            raise
        nominal = realise(at_means(model), jnp.zeros(0), jnp.asarray(placements(model).vector("initial")))
        raise SimulationError(f"{error} {explain_failure(nominal)}".strip()) from error


def _worst_case(function: Callable[[Any], Any], model: Pytree, nominal: float) -> tuple[float, float]:
    """The range of the assembly itself over the zones by a search from the best of corners and random points.

    An expansion would be least accurate at the corners, where most outputs have their extremes.
    """
    sampler, generator = Sampler(function, model, traced=True), np.random.default_rng(0)
    count = len(sampler.places.germs)
    corners = np.array(list(product((-1.0, 1.0), repeat=count))) if count <= _MOST_CORNERS else np.zeros((0, count))
    fixed = np.concatenate([corners, np.zeros((1, count))])
    size = _SPREAD + max(len(fixed), 2 * count)  # of every round, for one compiled program
    points = np.concatenate([fixed, generator.uniform(-1.0, 1.0, (size - len(fixed), count))])

    def furthest(sign: float) -> float:
        """One end: each dimension is moved to its ends, and all within smaller and smaller boxes about the best."""
        tried, best, height, reach = points, np.zeros(count), sign * nominal, 1.0
        for _ in range(_ROUNDS):
            heights = sign * np.asarray(sampler.samples(jax_array(tried)))
            if not heights.max() > height:
                reach /= 2
            else:
                best, height = tried[np.argmax(heights)], float(heights.max())
            ends = np.repeat(best[None], 2 * count, axis=0)
            ends[np.arange(2 * count), np.arange(2 * count) // 2] = np.tile([-1.0, 1.0], count)
            spread = generator.uniform(-1.0, 1.0, (size - len(ends), count))
            tried = np.clip(best + reach * spread, -1.0, 1.0)
            tried = np.concatenate([tried, ends])
        return sign * height

    return furthest(-1.0), furthest(1.0)


def _beyond(
    expanded: Expanded, sampler: Sampler, lower: float, upper: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """The probabilities of less than the lower limit and of more than the upper one, with their 95 % half-widths."""
    nothing = 0.0, 0.0
    low = _in_tail(expanded, sampler, Probability(below=lower)) if np.isfinite(lower) else nothing
    high = _in_tail(expanded, sampler, Probability(above=upper)) if np.isfinite(upper) else nothing
    return low, high


def _in_tail(expanded: Expanded, sampler: Sampler, event: Probability) -> tuple[float, float]:
    """The probability of rejects: that of the expansion, corrected by the assemblies' own values in that tail."""
    basis, coefficients = expanded.basis, np.asarray(expanded.coefficients)
    lines = prepared(lines_through, basis)
    chance, half = map(float, event.estimated(coefficients, lines))
    if not basis.variables or not np.any(coefficients[1:]):
        return chance, 0.0
    is_lower, at = event.below is not None, max(chance, _LEAST_CHANCE)
    proposal = tail_proposal(basis, lines, coefficients, at, lower=is_lower)
    points, weights = points_in_tail(proposal, basis, _IN_TAIL, 0)
    values = np.asarray(sampler.samples(jax_array(points)))
    both = values, basis.matrix(points) @ coefficients
    seen, predicted = (np.asarray(event.holds(one, is_rounded=True), float) for one in both)
    missed = weights * (seen - predicted)
    error = float(np.hypot(2 * missed.std() / np.sqrt(len(missed)), half))
    return max(chance + float(missed.mean()), 0.0), error


def _contributions(expanded: Expanded, linear: Linearised, zones: Mapping[str, Zone]) -> dict[str, Contribution]:
    return {
        name: Contribution(
            zone=zone,
            sensitivity=float(linear.sensitivities[name]),
            linear=float(linear.contributions[name]),
            total=100 * float(expanded.total_sobol(name)) if name in expanded.basis.names else np.nan,
        )
        for name, zone in zones.items()
    }
