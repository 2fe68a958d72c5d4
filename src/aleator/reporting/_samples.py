"""Figures of spreads: densities against limits, percentiles, shares, bars; and figures and facts of what is sampled or
expanded: evidence, functions, tolerances.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import jax_array
from aleator._core.border import positive
from aleator._core.errors import ProblemError
from aleator.analysis import AbstractExpanded, ElementExpanded, Expanded, ToleranceAnalysis
from aleator.design import AbstractFunctional, functionals_of
from aleator.reporting._numbers import count, given, number, percent, share_text
from aleator.reporting._page import Table
from aleator.reporting._paths import (
    DRAWN,
    add_histories,
    add_means,
    components,
    limits_of,
    paths_of,
    timeline,
    trajectory_figure,
)
from aleator.reporting._showing import Facts, chosen, facts_of, figure
from aleator.reporting._style import (
    ALARM,
    CLOUD,
    MUTED,
    SIZE,
    Look,
    blank,
    draw,
    label,
    limit_line,
    looks,
    padded,
    plain,
)
from aleator.reporting._tables import evidence_table, violations_table
from aleator.validation import Evidence, Sampled, Share

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Bins of a histogram at most.
_BINS = 200
# Points of a density, and the sample whose range it spans.
_POINTS, _SAMPLE = 201, 4096
# Inputs whose shares are drawn: the largest of them.
_MOST = 12


# --- Figures of spreads ----------------------------------------------------------------------------------------------


def density_figure(
    values: Float[np.ndarray, " n"],
    densities: Mapping[str, Float[np.ndarray, " n"]],
    *,
    x: str,
    unit: str = "",
    limits: Sequence[float] = (),
    tails: Sequence[str] = (),
    logarithmic: bool = False,
    title: str = "",
) -> "Figure":
    """Probability densities of one quantity against its limits; the area beyond them is filled.

    `tails` are the probabilities below and above the limits. Tails too thin to be seen show on a `logarithmic` axis.
    """
    per = f"1/({unit})" if any(sign in unit for sign in "/· ") else f"1/{unit}" if unit else ""
    figure = blank(label(x, unit), label("Density", per), title=title, height=380)
    for name, look in looks(densities).items():
        draw(figure, values, densities[name], look, name=name, mode="lines")
    if densities and len(limits) == 2:
        first = next(iter(densities.values()))
        filled = {"fill": "tozeroy", "fillcolor": ALARM, "opacity": 0.5, "line_width": 0, "showlegend": False}
        for side, limit in zip((-1, 1), limits, strict=True):
            # The limits need not be among the values.
            beyond = np.sort(np.append(values[side * (values - limit) > 0], limit))
            draw(figure, beyond, np.interp(beyond, values, first), ALARM, mode="lines", hover=None, **filled)
    for limit in limits:
        limit_line(figure, limit, f"limit {given(limit, unit)}", axis="x")
    above = {"yref": "y domain", "y": 0.98, "yanchor": "top", "showarrow": False}
    for text, limit, anchor, shift in zip(tails, limits, ("right", "left"), (-18, 6), strict=False):
        font, written = {"size": SIZE - 1, "color": ALARM}, "<br>".join(map(plain, text.splitlines()))
        figure.add_annotation(x=limit, text=written, xanchor=anchor, xshift=shift, font=font, **above)
    figure.update_xaxes(range=padded([*values[[0, -1]], *limits], 0.02))
    return figure.update_yaxes({"type": "log", "dtick": 2} if logarithmic else {"rangemode": "tozero"})


def percentile_figure(sampled: Mapping[str, Sampled], *, x: str, unit: str = "") -> "Figure":
    """The sampled spread of one quantity for several designs: 5 to 95 %, 25 to 75 %, the median and the mean."""
    figure = blank(label(x, unit), "", height=120 + 64 * len(sampled))
    for name, look in looks(sampled).items():
        if (levels := sampled[name].percentiles) is not None:
            known = zip(("lowerfence", "q1", "median", "q3", "upperfence"), levels[1:6], strict=True)
            colours = {"line_color": look.colour, "fillcolor": look.fill(0.3), "showlegend": False}
            box = {end: [float(level)] for end, level in known} | {"mean": [float(sampled[name].mean)]} | colours
            figure.add_box(y=[plain(name)], name=plain(name), orientation="h", width=0.4, **box)
    return figure.update_yaxes(type="category", autorange="reversed", showgrid=False)


def shares_figure(
    places: Sequence[str], shares: Mapping[str, Sequence[Share | None]], *, x: str = "", y: str
) -> "Figure":
    """How many systems, in percent, break each limit at each place, with their intervals; nothing where it is None.

    Raises `ProblemError` where none is counted.
    """
    if not places or not shares:
        raise ProblemError("plot.violations: expected a limit that single systems can break; received none.")
    figure = blank(plain(x), label(y, "%"), height=380)
    for name, look in looks(shares).items():
        known = {plain(place): one for place, one in zip(places, shares[name], strict=True) if one is not None}
        draw_shares(figure, [*known], [*known.values()], look, name=name, mode="markers", cliponaxis=False)
    figure.update_layout(showlegend=len(shares) > 1)
    figure.update_xaxes(type="category", categoryorder="array", categoryarray=[plain(place) for place in places])
    return figure.update_yaxes(rangemode="tozero")


def draw_shares(figure: "Figure", x: Sequence[Any], shares: Sequence[Share], look: Look, **style: Any) -> None:
    """Shares in percent, with their confidence intervals as error bars."""
    bars = {
        "type": "data",
        "array": [100 * (one.upper - one.estimate) for one in shares],
        "arrayminus": [100 * (one.estimate - one.lower) for one in shares],
        **{"symmetric": False, "color": look.colour, "thickness": 1.5, "width": 4},
    }
    over = {"text": [plain(share_text(one)) for one in shares], "hover": "%{text}"}
    draw(figure, x, [100 * one.estimate for one in shares], look, error_y=bars, **over, **style)


def bars_figure(groups: Mapping[str, Mapping[str, float]], *, y: str, unit: str = "") -> "Figure":
    """Grouped bars: one colour for each group, one position for each name."""
    figure = blank("", label(y, unit), height=360)
    for name, look in looks(groups).items():
        shown = groups[name]
        texts = [number(value, 3) if value % 1 else count(int(value)) for value in shown.values()]
        written = {"text": texts, "textposition": "outside", "cliponaxis": False, "marker_color": look.colour}
        figure.add_bar(x=[plain(one) for one in shown], y=[*shown.values()], name=plain(name), **written)
    figure.update_layout(barmode="group", bargap=0.35)
    return figure.update_yaxes(rangemode="tozero", linecolor=MUTED)


# --- Evidence --------------------------------------------------------------------------------------------------------


@figure(Evidence, "")
def evidence_figure(evidence: Evidence) -> "Figure":
    """The limit that most systems break: these over time against it, or the density of the number that it limits;
    without such a limit, what there is of trajectories or densities.
    """
    paths, problem = [one.name for one in evidence.trajectories], evidence.solution.problem
    varied = {text: one for text, one in _numbers(evidence).items() if _varies(evidence.functionals[text].values)}
    densities = {name: text for text, one in varied.items() for name in limits_of(problem, one).names}
    worst = _most_broken(evidence, [*paths, *densities])
    if worst in paths or (worst is None and paths):
        return trajectories(evidence, worst)
    return sampled_density(evidence, None if worst is None else densities[worst])


@figure(Evidence)
def trajectories(evidence: Evidence, limit: str | None = None) -> "Figure":
    """Sampled systems over time against a limit, by its name, by default the one that most of them break; those that
    break it are highlighted.
    """
    nothing = "expected a limit over time, and keep > 0 in al.validate; received evidence without trajectories."
    paths = {one.name: one for one in evidence.trajectories}
    name, _ = chosen("plot.trajectories", _most_broken(evidence, paths) if limit is None else limit, paths, nothing)
    return trajectory_figure(evidence, name, every=1)


@figure(Evidence, "band")
def sampled_band(evidence: Evidence, output: str | None = None, *, sigmas: float | None = None) -> "Figure":
    """The sampled mean of a path with its band, before sampled histories, and the mean by the expansion.

    - `output`: of a path in the problem, by default the first; `sigmas`: by default as in its limits, else 2.
    """
    problem = evidence.solution.problem
    name, functional = chosen("plot.band", output, paths_of(problem))
    sampled, limits = evidence.functionals[functional.text()], limits_of(problem, functional)
    times, drawn = evidence.solution.times_of(functional), timeline(name, limits.unit, limits.texts)
    kept = [one.values for one in evidence.trajectories if one.name in limits.names]
    if kept:
        add_histories(drawn, times, kept[0][:DRAWN], CLOUD, f"{len(kept[0][:DRAWN])} systems")
    means = components(f"sampled mean of {name}", sampled.mean, sampled.std)
    means |= components(f"mean of {name} by the expansion", sampled.expanded_mean)
    return add_means(drawn, times, means, limits.sigmas if sigmas is None else positive("plot.band: sigmas", sigmas))


@figure(Evidence, "density")
def sampled_density(evidence: Evidence, functional: str | None = None) -> "Figure":
    """The sampled density of a functional, as a histogram, with the limits on it; by default of the first one.

    - `functional`: its text, such as `"rms(x)"`, or the name of its output where that tells it apart.
    """
    known = _numbers(evidence)
    of_output = [text for text, one in known.items() if one.outputs == (functional,)]
    nothing = "expected a functional that is one number of each system, such as al.rms('x'); received none."
    name, declared = chosen("plot.density", of_output[0] if len(of_output) == 1 else functional, known, nothing)
    one = evidence.functionals[name]
    (edges, heights), limits = _steps(one.values), limits_of(evidence.solution.problem, declared)
    broken = [(each, share) for each, share in evidence.violations.items() if each in limits.names]
    lines = [f"{share_text(share)} violate {plain(each)}" for each, share in broken]
    lines.append(f"mean {number(float(one.mean))}, σ {number(float(one.std))}, {count(evidence.samples)} systems")
    shown = {"unit": limits.unit, "limits": sorted(limits.texts), "title": "<br>".join(lines)}
    return density_figure(edges, {"sampled": heights}, x=name, **shown)


@figure(Evidence)
def violations(evidence: Evidence) -> "Figure":
    """How many systems break each limit, with 95 % confidence intervals."""
    shares = dict(evidence.violations)
    if len(shares) > 1:
        shares["any of them"] = evidence.joint
    return shares_figure(list(shares), {"systems": list(shares.values())}, x="Limit", y="Systems that break it")


def _most_broken(evidence: Evidence, names: Collection[str]) -> str | None:
    """The limit among these that most systems break; None if none of them is counted."""
    shares = {name: one.estimate for name, one in evidence.violations.items() if name in names}
    return max(shares, key=shares.__getitem__, default=None)


def _numbers(evidence: Evidence) -> dict[str, AbstractFunctional]:
    """The functionals that are one number of each system, by their texts."""
    every = functionals_of(evidence.solution.problem.expressions)
    return {one.text(): one for one in every if evidence.functionals[one.text()].values is not None}


def _varies(values: np.ndarray | None) -> bool:
    return values is not None and bool(values.size) and np.ptp(values) > 1e-12 * float(np.max(np.abs(values)))


def _steps(values: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """A histogram as a curve in steps, of widths by the rule of Freedman and Diaconis (1981), with 200 bins at most.

    Raises `ProblemError` for one value.
    """
    if values is None or not _varies(values):
        raise ProblemError("plot.density: expected a functional that varies; received one that is the same for all.")
    # Half of the samples may be alike, and a few far away.
    width = 2 * float(np.subtract(*np.percentile(values, (75.0, 25.0)))) / np.cbrt(values.size)
    bins = int(np.clip(np.ptp(values) / width, 1, _BINS)) if width > 0 else _BINS
    heights, edges = np.histogram(values, bins=bins, density=True)
    return np.repeat(edges, 2), np.concatenate([[0.0], np.repeat(heights, 2), [0.0]])


@facts_of.register(Evidence)
def _(evidence: Evidence) -> Facts:
    tables = [violations_table({"": evidence}), evidence_table({"": evidence})]
    heading = f"Evidence: {count(evidence.samples)} fresh systems" if evidence.alone is None else "Evidence: one system"
    return Facts(heading, "" if evidence.agrees else evidence.alarm(), [one for one in tables if one.rows])


# --- Expanded functions ----------------------------------------------------------------------------------------------


@figure(AbstractExpanded, "density")
def expanded_density(expanded: AbstractExpanded, output: str | None = None) -> "Figure":
    """The probability density of an output, by its name, by default the first; of an array, where its spread is
    largest.
    """
    name, one, where = _scalar("plot.density", expanded, output)
    mean, std = (float(np.asarray(part)[where]) for part in (one.mean, one.std))
    sample = np.asarray(one.sample(_SAMPLE, seed=0))[(slice(None), *where)]
    if not _varies(sample):
        raise ProblemError(f"plot.density: expected an output that varies; received '{name}', which does not.")
    values = np.linspace(sample.min(), sample.max(), _POINTS)
    heights = np.asarray(one.pdf(jax_array(values)))[(slice(None), *where)]
    return density_figure(values, {name: heights}, x=name, title=f"mean {number(mean)}, σ {number(std)}")


@figure(AbstractExpanded)
def sensitivities(expanded: AbstractExpanded, output: str | None = None) -> "Figure":
    """Which inputs an output's variance comes from: Sobol indices alone, and with interactions; largest first. The
    output is named as for a density.

    Correlated inputs have Shapley effects instead, which share their common part. With more than twelve inputs, the
    largest twelve are drawn.
    """
    name, one, where = _scalar("plot.sensitivities", expanded, output)
    shares = _shares(one, where)
    last = next(reversed(shares.values()))
    order = sorted(last, key=lambda key: -last[key])[:_MOST]
    groups = {kind: {key: 100 * by_input[key] for key in order} for kind, by_input in shares.items()}
    return bars_figure(groups, y=f"Share of the variance of {name}", unit="%")


def _shares(one: AbstractExpanded, where: tuple[int, ...]) -> dict[str, dict[str, float]]:
    """The shares of inputs in the variance of one number, by their kind."""

    def at(moments: Any) -> float:
        return float(np.asarray(moments)[where])

    if not any(each.dependence for each in one.distributions.values()):
        return {
            "alone (Sobol index)": {key: at(one.sobol(key)) for key in one.germs},
            "with interactions (total)": {key: at(one.total_sobol(key)) for key in one.germs},
        }
    if isinstance(one, Expanded):
        return {"Shapley effect": {key: at(one.shapley(key)) for key in one.distributions}}
    raise ProblemError(
        "plot.sensitivities: expected independent inputs of a piecewise expansion; received correlated ones."
    )


def _scalar(what: str, expanded: AbstractExpanded, output: str | None) -> tuple[str, AbstractExpanded, tuple[int, ...]]:
    """One number of an expansion: its name, the output that it belongs to, and its place there."""
    name, one = "output", expanded
    if isinstance(expanded.mean, Mapping):
        name, _ = chosen(what, output, expanded.mean)
        one = expanded[name]
    elif output is not None:
        raise ProblemError(f"{what}: expected no name, for a function with one output; received '{output}'.")
    stds = np.asarray(one.std)
    where = tuple(int(i) for i in np.unravel_index(int(np.argmax(stds)), stds.shape))
    return f"{name}[{', '.join(map(str, where))}]" if where else name, one, where


@facts_of.register(AbstractExpanded)
def _(expanded: AbstractExpanded) -> Facts:
    paths, means = zip(*jax.tree_util.tree_leaves_with_path(expanded.mean), strict=True)
    names = [jax.tree_util.keystr(path, simple=True, separator=".") or "output" for path in paths]
    moments = zip(names, means, jax.tree.leaves(expanded.std), strict=True)
    rows = [[name, _moment(mean, std), _moment(std, std)] for name, mean, std in moments]
    inputs = [[name, str(one)] for name, one in expanded.distributions.items()]
    tables = [Table("", ["output", "mean", "σ"], rows), Table("", ["input", "distribution"], inputs)]
    kind = "Piecewise expansion" if isinstance(expanded, ElementExpanded) else "Expansion"
    return Facts(f"{kind} in {len(expanded.germs)} variables", "", tables)


def _moment(values: Any, stds: Any) -> str:
    """A number; of an array, that of the largest spread."""
    known, spread = np.asarray(values), np.asarray(stds)
    text = number(float(known.flat[int(np.argmax(spread))]), 6)
    return f"{text}, of {known.size} where σ is largest" if known.ndim else text


# --- Tolerances ------------------------------------------------------------------------------------------------------


@figure(ToleranceAnalysis, "density")
def tolerance_density(analysis: ToleranceAnalysis) -> "Figure":
    """The density of the output, with its limits and the rejects beyond them."""
    one, limits = analysis, [limit for limit in (analysis.lower, analysis.upper) if np.isfinite(limit)]
    low, high = (one.mean - 4.5 * one.std, one.mean + 4.5 * one.std)
    values = np.linspace(min([low, *limits]), max([high, *limits]), _POINTS)
    heights = np.asarray(one.expanded.pdf(jax_array(values)))
    tails = [f"{number(part, 3)}\nppm" for part in (one.rejects_low, one.rejects_high)] if len(limits) == 2 else []
    title = f"mean {number(one.mean)}, σ {number(one.std)}, rejects {number(one.rejects, 3)} ppm"
    return density_figure(values, {one.output: heights}, x=one.output, limits=limits, tails=tails, title=title)


@figure(ToleranceAnalysis)
def contributions(analysis: ToleranceAnalysis) -> "Figure":
    """The share of each dimension in the variance, linearly and by the expansion, largest first."""
    parts = dict(sorted(analysis.contributions.items(), key=lambda item: -item[1].linear)[:_MOST])
    groups = {
        "linearly": {name: one.linear for name, one in parts.items()},
        "by the expansion (total)": {name: one.total for name, one in parts.items() if np.isfinite(one.total)},
    }
    shown = {kind: one for kind, one in groups.items() if one}
    return bars_figure(shown, y=f"Share of the variance of {analysis.output}", unit="%")


@facts_of.register(ToleranceAnalysis)
def _(one: ToleranceAnalysis) -> Facts:
    low, high = one.worst_case
    rows = [
        ["nominal", number(one.nominal, 6)],
        ["mean", number(one.mean, 6)],
        ["3 σ", number(3 * one.std, 5)],
        ["limits", f"{given(one.lower)} to {given(one.upper)}: Cp {number(one.cp, 3)}, Cpk {number(one.cpk, 3)}"],
        ["rejects", f"{number(one.rejects_low, 3)} ppm low, {number(one.rejects_high, 3)} ppm high"],
        ["worst case", f"{number(low, 6)} to {number(high, 6)}"],
    ]
    largest = sorted(one.contributions.items(), key=lambda item: -item[1].linear)
    parts = [[name, str(part.zone), percent(part.linear / 100)] for name, part in largest]
    tables = [Table("", ["", ""], rows), Table("", ["dimension", "zone", "share of the variance, linearly"], parts)]
    return Facts(f"Tolerances of {one.output}", "", tables)
