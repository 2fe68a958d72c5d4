"""The chapters of the clutch's page: the methods against the exact value, the tolerances, their allocation."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np

from aleator.reporting import (
    Block,
    Code,
    Drawing,
    Schematic,
    Section,
    Trial,
    bars_figure,
    certificate_table,
    density_figure,
    effort_figure,
    front_figure,
    given,
    linked_front,
)
from aleator.studies.clutch import LIMITS, MEANS, NAMES, TOLERANCES, clutch
from aleator.studies.clutch._counts import CHEAPEST, GIVEN, SAFE, tolerances_of, worst_case_tolerances
from aleator.studies.clutch._drawing import clutch_drawing
from aleator.studies.clutch._facts import (
    allocation_table,
    analysis_table,
    contributions_table,
    counts_table,
    methods_table,
    rejected_tails,
)
from aleator.studies.clutch._run import ClutchResults

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

GLOSSARY = (
    ("χ", "Pressure angle between roller and ring, degrees. The clutch holds and releases between 6° and 8°."),
    ("Tolerance T", "A dimension is normal about its nominal value with standard deviation T/3."),
    ("DLM", "Direct linearisation method: standard deviations from the sensitivities at the nominal dimensions."),
    ("gPC", "Generalized polynomial chaos: the angle as a polynomial of the dimensions, by least squares."),
    (
        "Cp, Cpk",
        "Width of the limits over 6σ; distance from the mean to the nearer limit over 3σ. Usually 1.33 is required.",
    ),
    ("ppm", "Rejects per million assemblies."),
    ("Worst case", "All dimensions within their tolerances at once, in the worst combination."),
    ("Σ 1/T", "Cost of manufacture: halving a tolerance doubles its cost."),
    ("Shadow price", "The decrease in cost per unit by which the limit on rejects is relaxed."),
)
LOOP = f"""The vectors (length ∠ direction) close, (121):
  a∠90° + b∠0° + c∠90°
    + c∠(90° - χ) - e∠(90° - χ) = 0
  χ + γ = 90°

so that
  cos χ = (a + c) / (e - c)
  b = (e - c) sin χ

The clutch works between χ = {given(LIMITS[0])}° and {given(LIMITS[1])}°."""


def sections(results: ClutchResults) -> list[Section]:
    """The sections for the results available so far."""
    return [
        Section("The clutch", [_schematic()]),
        Section("Table 7.2", list(_methods(results))),
        Section("The given tolerances", list(_analyses(results))),
        Section("Allocation", list(_allocation(results))),
        Section("Certificate", list(_certificate(results))),
    ]


def cut_short(results: ClutchResults) -> Iterator[str]:
    """How much of an interrupted front is available."""
    front = results.front
    if front is not None and front.interrupted:
        yield f"Of the front {len(front.values)} of {results.effort.front_points} points are finished and shown."


def _schematic() -> Schematic:
    caption = "A quarter of the clutch, to scale. The angle follows from hub a, roller c and ring e."
    sizes = "\n".join(f"  {name} = {given(mean)} ± {given(TOLERANCES[name])} mm" for name, mean in MEANS.items())
    beside = [
        Code("As mathematics", f"{LOOP}\n\nNormal parts, σ a third of the tolerance:\n{sizes}", opened=True),
        Code("The assembly", str(clutch())),
    ]
    return Schematic([clutch_drawing()], "The vector loop", caption, "7.1", beside)


def _methods(results: ClutchResults) -> Iterator[Block]:
    if not results.methods:
        return
    yield methods_table(results)
    trials = _trials(results)
    figures = [effort_figure(trials, error="Error of 3σ", unit="°", by=by) for by in ("calls", "seconds")]
    caption = (
        "Each order of the expansion gains about one digit; sampling gains one digit for a hundred times the effort. "
        "The error of a sampled value is its standard error."
    )
    yield Drawing(figures, "Error against effort", caption)


def _trials(results: ClutchResults) -> dict[str, list[Trial]]:
    """The methods by family, with plain Monte Carlo scaled to fewer samples by the square-root law."""
    names = ("gPC", "DLM and second order", "quasi-Monte Carlo", "Monte Carlo")
    families: dict[str, list[Trial]] = {name: [] for name in names}
    for one in results.methods:
        family = "gPC" if one.name.startswith("gPC") else one.name
        family = family if family in families else "DLM and second order"
        error = one.standard_error or abs(one.variation - results.exact)
        families[family].append(Trial(one.name, one.points, one.seconds, error))
    for one in families["Monte Carlo"][:1]:
        scaled = [
            Trial(one.name, one.calls // part, one.seconds / part, one.error * float(np.sqrt(part)))
            for part in (10_000, 100)
        ]
        families["Monte Carlo"] = [*scaled, one]
    return {name: trials for name, trials in families.items() if trials}


def _analyses(results: ClutchResults) -> Iterator[Block]:
    if not results.analyses:
        return
    yield contributions_table(results)
    yield analysis_table(results)
    caption = (
        "The angle is skewed: its lower tail is longer, so the lower limit rejects more than the upper one. Shaded: "
        "counted rejects, in parts per million. Those beyond the function's limits are so few that only a logarithmic "
        "axis shows them."
    )
    figures = [_density(results, name) for name in results.analyses]
    yield Drawing(figures, "Distribution of the angle, limits and rejects", caption)


def _density(results: ClutchResults, name: str) -> "Figure":
    """The distribution against the limits of one specification, with the rejects beyond them."""
    one = results.analyses[name]
    function = name == "limits"
    reach = (6.5 if function else 5.0) * one.std
    angles = np.linspace(one.mean - reach, one.mean + reach, 401)
    normal = np.exp(-0.5 * ((angles - one.mean) / one.std) ** 2) / (one.std * np.sqrt(2 * np.pi))
    densities = {"expansion": np.asarray(one.expanded.pdf(jnp.asarray(angles))), "normal of the same μ and σ": normal}
    return density_figure(
        angles,
        densities,
        x="Pressure angle χ",
        unit="°",
        limits=(one.lower, one.upper),
        tails=rejected_tails(results, name),
        logarithmic=function,
        title="Function: 6° to 8°" if function else "Nominal ± 0.6°",
    )


def _allocation(results: ClutchResults) -> Iterator[Block]:
    if results.allocation is None:
        return
    yield allocation_table(results)
    if results.counts:
        yield counts_table(results)
    if results.allocation.ok:
        chosen = tolerances_of(results.allocation)
        sets = {GIVEN: TOLERANCES, CHEAPEST: chosen, SAFE: worst_case_tolerances()}
        bars = {name: {NAMES[part]: value for part, value in one.items()} for name, one in sets.items()}
        yield Drawing([bars_figure(bars, y="Tolerance ±T", unit="mm")], "Tolerances before and after")
    if results.front is not None:
        fronts = {"cheapest": results.front}
        figure = front_figure(fronts, x="Rejects allowed", y="Cost Σ 1/T", y_unit="1/mm")
        figure.update_xaxes(type="log", exponentformat="power", title="Rejects allowed (share)")
        yield linked_front(fronts, [figure], "The cost of fewer rejects", "Each point is an optimum.")
    yield Code("The problem as mathematics", str(results.allocation.problem))


def _certificate(results: ClutchResults) -> Iterator[Block]:
    if results.allocation is not None:
        yield certificate_table({"cheapest": results.allocation})
