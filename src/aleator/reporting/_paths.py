"""Figures over time: the paths of a problem with their limits, means with bands, and histories of systems."""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.design import AbstractFunctional, Constraint, Problem, Statistic, functionals_of, is_worst_case
from aleator.reporting._numbers import given, share_text, unit_of, unit_of_limit
from aleator.reporting._style import ALARM, CLOUD, DASHES, add_band, blank, draw, label, limit_line, looks, plain, short
from aleator.solution import Moments
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# The multiple of the standard deviation in a band, where no limit says another.
_USUAL = 2.0
# Systems drawn of many, and instants of theirs.
_DRAWN, _SHOWN = 60, 350


# --- What a problem has over time ------------------------------------------------------------------------------------


class Limits(NamedTuple):
    """The limits on a path: by their values, in words; the largest multiple of the standard deviation in them; their
    names; and the unit of the path.
    """

    texts: dict[float, str]
    sigmas: float
    names: set[str]
    unit: str


def paths_of(problem: Problem) -> dict[str, AbstractFunctional]:
    """The paths in a problem, each under the name of its output, or under its text where several are of one output."""
    every = [one for one in functionals_of(problem.expressions) if one.is_path]
    outputs = [one.output for one in every]
    return {one.output if outputs.count(one.output) == 1 else one.text(): one for one in every}


def limits_of(problem: Problem, functional: AbstractFunctional) -> Limits:
    """The limits on one path alone: on its mean, with a multiple of its standard deviation or without, or on its worst
    case.
    """
    texts, names, sigmas = dict[float, str](), set[str](), 0.0
    unit = unit_of(functional, problem)
    for limit in problem.constraints:
        if functionals_of((limit.expression,)) != (functional,) or not _has_values_of_path(limit):
            continue
        multiple = limit.expression.sigmas or 0.0
        which = f" at {multiple:.3g} σ" if multiple else " in the worst case" if is_worst_case(limit) else ""
        sigmas = max(sigmas, multiple)
        names.add(limit.name)
        for bound in (float(limit.lower), float(limit.upper)):
            if np.isfinite(bound):
                texts[bound] = f"{limit.name}: {given(bound, unit)}{which}"
    return Limits(texts, sigmas or _USUAL, names, unit)


def _has_values_of_path(limit: Constraint) -> bool:
    """Whether what is limited has the path's own values: its worst case, or one statistic of it, not in proportion, and
    its spreads.
    """
    if is_worst_case(limit):
        return True
    pairs = list(zip(limit.expression.factors, limit.expression.atoms, strict=True))
    located = [float(factor) for factor, atom in pairs if not atom.is_spread]
    return located == [1.0] and all(isinstance(atom, Statistic) for _, atom in pairs)


def limits_text(bounds: Sequence[float], unit: str) -> dict[float, str]:
    """The text of each finite limit."""
    return {bound: f"limit {given(bound, unit)}" for bound in dict.fromkeys(bounds) if np.isfinite(bound)}


# --- What figures over time are made of ------------------------------------------------------------------------------


def timeline(y: str, unit: str = "", limits: Mapping[float, str] | None = None, title: str = "") -> "Figure":
    """An empty figure over time, with limits as lines."""
    figure = blank(label("Time", "s"), label(y, unit), title=plain(title), height=380)
    for bound, text in (limits or {}).items():
        limit_line(figure, bound, text)
    return figure.update_layout(showlegend=True)


def components(name: str, mean: Float[np.ndarray, "instants ..."], std: Any = 0.0) -> dict[str, Moments]:
    """A path by its name, by default without a spread; of a vector over time, each component by its own."""
    std = np.broadcast_to(std, mean.shape)
    if mean.ndim == 1:
        return {name: Moments(mean, std)}
    means, stds = (part.reshape(len(part), -1) for part in (mean, std))
    return {f"{name}[{i}]": Moments(means[:, i], stds[:, i]) for i in range(means.shape[1])}


def curves(values: np.ndarray, violating: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One row per curve, and whether its system violates; a vector over time gives one curve per component."""
    broken = np.asarray(violating, dtype=bool)
    if values.ndim == 2:
        return values, broken
    flat = values.reshape(*values.shape[:2], -1)
    return np.moveaxis(flat, 2, 1).reshape(-1, values.shape[1]), np.repeat(broken, flat.shape[2])


def add_means(figure: "Figure", times: np.ndarray, paths: Mapping[str, Moments], sigmas: float = _USUAL) -> "Figure":
    """The mean of each path as a line, with the band of `sigmas` standard deviations about it."""
    styles = looks(paths)
    for name, path in paths.items():
        if np.any(path.std):
            low, high = (path.mean + sign * sigmas * path.std for sign in (-1, 1))
            add_band(figure, times, low, high, styles[name].fill(0.25))
    for dash, (name, path) in zip(itertools.cycle(DASHES), paths.items(), strict=False):
        shown: dict[str, Any] = {"name": name, "line_dash": dash}
        if np.any(path.std):
            shown |= {
                "name": f"{name} ± {sigmas:.3g} σ",
                "customdata": short(path.std),
                "hover": "σ: %{customdata:.2~g}",
            }
        draw(figure, short(times), short(path.mean), styles[name], mode="lines", **shown)
    return figure


def add_histories(
    figure: "Figure", times: np.ndarray, values: np.ndarray, colour: str, name: str, width: float = 0.8
) -> "Figure":
    """Histories that are drawn alike, shape (systems, instants, ...): one trace with gaps."""
    rows, _ = curves(values, np.zeros(len(values), dtype=bool))
    # The entry of the legend is thick enough for the colour to be seen.
    draw(figure, [None], [None], colour, name=name, mode="lines", line_width=4)
    gap, along = np.full((len(rows), 1), np.nan), np.broadcast_to(times, rows.shape)
    x, y = (short(np.hstack([part, gap]).ravel()) for part in (along, rows))
    thin = {"line_width": width, "opacity": 0.7, "showlegend": False}
    draw(figure, x, y, colour, name=name, mode="lines", hover=None, **thin)
    return figure


def add_cloud(figure: "Figure", times: np.ndarray, values: np.ndarray) -> "Figure":
    """The first 60 of some systems, behind what follows."""
    shown = values[:_DRAWN]
    return add_histories(figure, times, shown, CLOUD, f"{len(shown)} systems")


# --- Figures ---------------------------------------------------------------------------------------------------------


def histories_figure(
    times: Float[np.ndarray, " instants"],
    histories: Float[np.ndarray, "systems instants ..."],
    *,
    y: str,
    unit: str = "",
    who: str = "systems",
    limits: Mapping[float, str] | None = None,
    title: str = "",
) -> "Figure":
    """The histories of some realisations, one line for each; of a vector, one for each component too."""
    name = f"{len(histories)} {who if len(histories) != 1 else who.removesuffix('s')}"
    figure, width = timeline(y, unit, limits, title), 0.8 if np.size(histories[:, 0]) > 1 else 2.0
    return add_histories(figure, times, histories, looks([y])[y].colour, name, width)


def bands_figure(
    times: Float[np.ndarray, " instants"],
    families: Mapping[str, Float[np.ndarray, "systems instants"]],
    *,
    y: str,
    unit: str = "",
    limits: Sequence[float] = (),
    targets: Mapping[str, float] | None = None,
    title: str = "",
) -> "Figure":
    """Histories of a family of systems: their mean, the band of one standard deviation about it, and their range.

    - `families`: each quantity on its systems, shape (systems, instants);
    - `limits`: drawn as lines; `targets`: the final value wanted of a quantity, drawn as a ring.
    """
    figure, styles = timeline(y, unit, limits_text(limits, unit), title), looks(families)
    for name, rows in families.items():
        add_band(figure, times, rows.min(axis=0), rows.max(axis=0), styles[name].fill(0.08))
    moments = {name: Moments(rows.mean(axis=0), rows.std(axis=0)) for name, rows in families.items()}
    add_means(figure, times, moments, sigmas=1.0)
    for name, target in (targets or {}).items():
        ring = {"marker_symbol": "circle-open", "marker_size": 12, "marker_line_width": 2, "cliponaxis": False}
        named = {"name": f"{name}, target", "mode": "markers", "showlegend": False}
        draw(figure, [float(times[-1])], [target], styles[name], **named, **ring)
    return figure


def trajectory_figure(
    evidence: Evidence,
    name: str,
    *,
    y: str = "",
    unit: str | None = None,
    who: str = "systems",
    every: int | None = None,
) -> "Figure":
    """Sampled systems over time against the bounds of the constraints called `name` (figures 6.9 and 6.10), in the unit
    of these.

    The first 60 are drawn; those that violate any bound are highlighted. The title gives the share of all samples.

    - `every`: so many instants are drawn as one, by default so many that at most 350 remain.
    """
    sampled, solution = [one for one in evidence.trajectories if one.name == name], evidence.solution
    unit, share = unit_of_limit(name, solution.problem) if unit is None else unit, evidence.violations.get(name)
    limits = (one for one in solution.problem.constraints if one.name == name and one.is_path)
    instants = next((solution.times_of(one) for one in limits), solution.instants)
    step = every or math.ceil(len(instants) / _SHOWN)
    bounds = limits_text([bound for one in sampled for bound in (one.upper, one.lower)], unit)
    title = "" if share is None else f"{share_text(share)} of {who} violate {name}"
    figure = timeline(y or name, unit, bounds, title)
    # Both sides of a pair of bounds measure the same quantity.
    values = {one.values.tobytes(): one for one in sampled}.values()
    pairs = [curves(one.values[:_DRAWN, ::step], one.violating[:_DRAWN]) for one in values]
    if pairs:
        rows, broken = (np.concatenate(part) for part in zip(*pairs, strict=True))
        # All quantities have the same systems, which are counted once.
        many, few = len(pairs[0][1]), int(pairs[0][1].sum())
        for said, these, colour in (("within the limits", ~broken, CLOUD), ("violating", broken, ALARM)):
            if these.any():
                counted = f"{said} ({few if colour == ALARM else many - few} of {many} drawn)"
                add_histories(figure, instants[::step], rows[these], colour, counted)
    return figure
