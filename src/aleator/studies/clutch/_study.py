"""The clutch study: a drawing, the chapters of its page, its file of results, and its declaration."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, final

import jax.numpy as jnp
import numpy as np
from typing_extensions import override

import aleator as al
from aleator.reporting import (
    Block,
    Code,
    Drawing,
    Schematic,
    Section,
    Table,
    Trial,
    Verdict,
    bars_figure,
    certificate_table,
    density_figure,
    effort_figure,
    front_figure,
    given,
    linked_front,
    sketch,
)
from aleator.reporting.sketch import View
from aleator.studies._staged import AbstractStagedStudy, Stage
from aleator.studies.clutch import LIMITS, MEANS, NAMES, TOLERANCES, allocation_problem, clutch, pressure_angle
from aleator.studies.clutch._facts import (
    allocation_table,
    analysis_table,
    contributions_table,
    counts_table,
    methods_table,
    rejected_tails,
    verdict,
)
from aleator.studies.clutch._run import (
    CHEAPEST,
    FULL,
    GIVEN,
    QUICK,
    SAFE,
    ClutchResults,
    Counts,
    Effort,
    Method,
    stages,
    tolerances_of,
    worst_case_tolerances,
)

if TYPE_CHECKING:
    import xarray
    from plotly.graph_objects import Figure

WIDTH, HEIGHT = 420.0, 372.0
ACROSS = 320.0
"""Pixels from the middle of the ring to the ring."""

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


def clutch_drawing(dimensions: Mapping[str, float] = MEANS) -> str:
    """A quarter of the clutch as SVG: hub, roller and ring of the given dimensions (mm), and the angle that follows."""
    a, c, e = (dimensions[name] for name in ("a", "c", "e"))
    chi = float(pressure_angle(*np.array([a, c, e])))
    turn = math.radians(chi)
    b = (e - c) * math.sin(turn)
    at = View((56.0, 345.0), ACROSS / e)
    middle, contact = at(b, a + c), at(e * math.sin(turn), e * math.cos(turn))
    hub = [at(0, 0), at(0, a), at(0.6 * e, a), at(0.6 * e, 0)]
    slope = math.radians(32.0)
    parts = [
        sketch.arc(at(0, 0), at.scale * e, 0.0, 90.0, kind="ring", width=3.0),
        sketch.path(hub, kind="hub", closed=True),
        sketch.circle(middle, at.scale * c, kind="roller"),
        sketch.circle(at(0, 0), 3.0, filled=True),
        sketch.circle(middle, 3.0, filled=True),
        sketch.path([at(0, 0), contact], kind="line-of-centres", width=1.2),
        sketch.path([at(0, a), at(0, e)], width=1.2, dash=sketch.DASHED),
        sketch.path([at(b, a), at(b, a + 2.2 * c)], width=1.2, dash=sketch.DASHED),
    ]
    return sketch.drawing(parts + _sizes(at, (a, b, c, e), chi, slope), width=WIDTH, height=HEIGHT, title=_title(chi))


def _sizes(at: View, sizes: tuple[float, float, float, float], chi: float, slope: float) -> list[str]:
    """Dimensions and angles."""
    a, b, c, e = sizes
    left, rim = at(-3.0, 0)[0], at(e * math.cos(slope), e * math.sin(slope))
    side = at(b + c, a + c)
    reach = 0.42 * e
    wedge = at(reach * math.sin(math.radians(chi) / 2), reach * math.cos(math.radians(chi) / 2))
    return [
        sketch.dimension((left, at(0, 0)[1]), (left, at(0, a)[1]), "a", beside=(left - 14, at(0, a / 2)[1]), kind="a"),
        sketch.dimension(at(0, a - 3.0), at(b, a - 3.0), "b", beside=at(b + 2.0, a - 4.0), kind="b"),
        sketch.arrow(at(b, a + c), side, kind="c"),
        sketch.label(at(b + c / 2, a + c + 1.2), "c"),
        sketch.arrow(at(0, 0), rim, kind="e"),
        sketch.label(at(0.9 * e * math.cos(slope + 0.09), 0.9 * e * math.sin(slope + 0.09)), "e"),
        sketch.arc(at(0, 0), at.scale * reach, 90.0, 90.0 - chi, kind="chi"),
        sketch.path([wedge, at(0.2 * e, 0.36 * e)], width=1.0),
        sketch.label(at(0.21 * e, 0.34 * e), f"χ = {chi:.3f}°", anchor="start"),
        sketch.arc(at(0, 0), at.scale * 0.2 * e, 0.0, 90.0 - chi, kind="gamma"),
        sketch.label(at(0.17 * e, 0.17 * e), "γ", anchor="start"),
        sketch.label(at(0.48 * e, 0.06 * e), "hub"),
        sketch.label(at(b + 1.15 * c, a + 0.35 * c), "roller", anchor="start"),
        sketch.label(at(0.75 * e, 0.75 * e), "ring", anchor="start"),
    ]


def _title(chi: float) -> str:
    return f"Quarter of a roller clutch: hub, roller and ring, with a pressure angle of {chi:.3f} degrees"


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


def methods_dataset(methods: Sequence[Method]) -> "xarray.Dataset":
    """The rows of table 7.2 and of its extension."""
    import xarray

    errors = [np.nan if one.standard_error is None else one.standard_error for one in methods]
    return xarray.Dataset(
        {
            "three_sigma": ("row", [one.variation for one in methods], {"units": "degree"}),
            "standard_error": ("row", errors, {"units": "degree"}),
            "points": ("row", [one.points for one in methods], {"units": "1"}),
            "seconds": ("row", [one.seconds for one in methods], {"units": "s"}),
        },
        coords={"row": [one.name for one in methods]},
    )


def analysis_dataset(one: al.results.ToleranceAnalysis) -> "xarray.Dataset":
    """The tolerance analysis for one specification, and the contributions of the dimensions."""
    import xarray

    angles = ("nominal", "mean", "std", "lower", "upper", "rss", "linear_std")
    numbers = {name: ((), getattr(one, name), {"units": "degree"}) for name in angles}
    numbers |= {name: ((), getattr(one, name), {"units": "1"}) for name in ("skewness", "kurtosis", "cp", "cpk")}
    numbers |= {name: ((), getattr(one, name), {"units": "ppm"}) for name in ("rejects_low", "rejects_high")}
    parts = one.contributions.values()
    shares = {
        "linear_share": ("dimension", [part.linear for part in parts], {"units": "percent"}),
        "total_share": ("dimension", [part.total for part in parts], {"units": "percent"}),
    }
    return xarray.Dataset(numbers | shares, coords={"dimension": list(one.contributions)})


def counts_dataset(counts: Mapping[str, Counts]) -> "xarray.Dataset":
    """Rejects counted, and the exact worst case, of each set of tolerances."""
    import xarray

    every = list(counts.values())
    rejected = [[one.by_name[spec].either.count for spec in ("limits", "deviation")] for one in every]
    return xarray.Dataset(
        {
            "rejects": (("tolerances", "specification"), rejected, {"units": "1"}),
            "assemblies": ("tolerances", [one.function.low.samples for one in every], {"units": "1"}),
            "worst_case": (("tolerances", "end"), [list(one.worst_case) for one in every], {"units": "degree"}),
            "tolerance": (
                ("tolerances", "dimension"),
                [list(one.tolerances.values()) for one in every],
                {"units": "mm"},
            ),
        },
        coords={
            "tolerances": list(counts),
            "specification": ["limits", "deviation"],
            "end": ["least", "largest"],
            "dimension": list(every[0].tolerances),
        },
    )


@final
class ClutchStudy(AbstractStagedStudy):
    """Table 7.2, the tolerance analysis and the allocation of the one-way clutch."""

    title = "One-way clutch: tolerance analysis and allocation"
    subtitle = "Pressure angle of a roller clutch from its vector loop; dissertation, section 7.2"
    glossary = GLOSSARY
    full, quick = FULL, QUICK

    def __init__(self, effort: Effort):
        self.found = ClutchResults(effort)

    @property
    @override
    def problems(self) -> Mapping[str, al.Problem]:
        return {"allocation": allocation_problem()}

    @property
    @override
    def stages(self) -> Mapping[str, Stage]:
        return stages(self.found)

    @override
    def results(self) -> Mapping[str, Any]:
        found = self.found
        return {
            "methods": methods_dataset(found.methods) if found.methods else None,
            "analyses": {name: analysis_dataset(one) for name, one in found.analyses.items()},
            "counts": counts_dataset(found.counts) if found.counts else None,
            "allocation": found.allocation,
            "evidence": found.evidence,
            "front": found.front,
        }

    @override
    def verdict(self) -> Verdict:
        return verdict(self.found)

    @override
    def sections(self) -> Sequence[Section]:
        results = self.found
        return [
            Section("The clutch", [_schematic()]),
            Section("Table 7.2", list(_methods(results))),
            Section("The given tolerances", list(_analyses(results))),
            Section("Allocation", list(_allocation(results))),
            Section("Certificate", list(_certificate(results))),
        ]

    @override
    def cut_short(self) -> Iterator[str]:
        results = self.found
        front = results.front
        if front is not None and front.interrupted:
            yield f"Of the front {len(front.values)} of {results.effort.front_points} points are finished and shown."

    @override
    def tables(self) -> list[Table]:
        found = self.found
        shown = [methods_table(found)] if found.methods else []
        shown += [contributions_table(found), analysis_table(found)] if found.analyses else []
        shown += [allocation_table(found)] if found.allocation is not None else []
        return [*shown, counts_table(found)] if found.counts else shown
