"""The paths of a problem, with their limits; and figures of them: means with bands, and histories of realisations."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.design import AbstractFunctional, Constraint, Problem, Statistic, functionals_of, is_worst_case
from aleator.reporting._numbers import given
from aleator.reporting._samples import DRAWN, add_lines, curves
from aleator.reporting._style import DASHES, add_band, blank, label, limit_line, looks, padded, plain, short
from aleator.solution import Moments

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# The multiple of the standard deviation in a band, where no limit says another.
_USUAL = 2.0


class Limits(NamedTuple):
    """The limits on a path: by their values, in words; the largest multiple of the standard deviation in them; their
    names.
    """

    texts: dict[float, str]
    sigmas: float
    names: set[str]


def paths_of(problem: Problem) -> dict[str, AbstractFunctional]:
    """The paths in a problem, each under the name of its output, or under its text where several are of one output."""
    every = [one for one in functionals_of(problem.expressions) if one.is_path]
    outputs = [one.output for one in every]
    return {one.output if outputs.count(one.output) == 1 else one.text(): one for one in every}


def limits_of(problem: Problem, functional: AbstractFunctional, unit: str) -> Limits:
    """The limits on one path alone: on its mean, with a multiple of its standard deviation or without, or on its worst
    case.
    """
    texts: dict[float, str] = {}
    sigmas, names = 0.0, set()
    for one in problem.constraints:
        if functionals_of((one.expression,)) != (functional,) or not _has_values_of_path(one):
            continue
        multiple = one.expression.sigmas or 0.0
        sigmas = max(sigmas, multiple)
        names.add(one.name)
        for bound in (float(one.lower), float(one.upper)):
            if np.isfinite(bound):
                texts[bound] = f"{one.name}: {given(bound, unit)}{_how(one, multiple)}"
    return Limits(texts, sigmas or _USUAL, names)


def _how(limit: Constraint, multiple: float) -> str:
    """For which systems a limit holds, in words."""
    if multiple:
        return f" at {multiple:.3g} σ"
    return " in the worst case" if is_worst_case(limit) else ""


def _has_values_of_path(limit: Constraint) -> bool:
    """Whether what is limited has the path's own values: its worst case, or one statistic of it, not in proportion, and
    its spreads.
    """
    if is_worst_case(limit):
        return True
    pairs = list(zip(limit.expression.factors, limit.expression.atoms, strict=True))
    located = [float(factor) for factor, atom in pairs if not atom.is_spread]
    return located == [1.0] and all(isinstance(atom, Statistic) for _, atom in pairs)


def components(
    name: str, mean: Float[np.ndarray, "instants ..."], std: Float[np.ndarray, "instants ..."]
) -> dict[str, Moments]:
    """A path by its name; of a vector over time, each component by its own."""
    if mean.ndim == 1:
        return {name: Moments(mean, std)}
    means, stds = (one.reshape(len(one), -1) for one in (mean, std))
    return {f"{name}[{i}]": Moments(means[:, i], stds[:, i]) for i in range(means.shape[1])}


_CLOUD = "#a9b4bf"


def path_figure(
    times: Float[np.ndarray, " instants"],
    paths: Mapping[str, Moments],
    *,
    sigmas: float,
    y: str,
    unit: str = "",
    histories: Float[np.ndarray, "systems instants ..."] | None = None,
    limits: Mapping[float, str] | None = None,
    title: str = "",
) -> "Figure":
    """The mean of each path, of shape (instants,), with the band of `sigmas` standard deviations about it.

    - `histories`: of some systems, of which the first 60 are drawn behind; `limits`: drawn as lines, with their names.
    """
    figure = blank(label("Time", "s"), label(y, unit), title=plain(title), height=380)
    behind = np.zeros((0, len(times))) if histories is None else histories[:DRAWN]
    rows = curves(behind, np.zeros(len(behind), dtype=bool))[0]
    add_lines(figure, times, rows, f"{len(behind)} systems", _CLOUD, 0.8, True)
    styles = looks(paths)
    for name, one in paths.items():
        if np.any(one.std):
            add_band(figure, times, one.mean - sigmas * one.std, one.mean + sigmas * one.std, styles[name].fill(0.25))
    for dash, (name, one) in zip(itertools.cycle(DASHES), paths.items(), strict=False):
        spread = f" ± {sigmas:.3g} σ" if np.any(one.std) else ""
        figure.add_scatter(
            x=short(times),
            y=short(one.mean),
            customdata=short(one.std),
            mode="lines",
            name=plain(f"{name}{spread}"),
            line={"color": styles[name].colour, "width": 2, "dash": dash},
            hovertemplate=(
                f"{plain(name)}: %{{y:.4~g}}, σ %{{customdata:.2~g}} {plain(unit)} at %{{x:.3f}} s<extra></extra>"
            ),
        )
    for bound, text in (limits or {}).items():
        limit_line(figure, bound, text, under=bound < 0)
    edges = [edge for one in paths.values() for edge in ends(one.mean - sigmas * one.std, one.mean + sigmas * one.std)]
    figure.update_layout(showlegend=True)
    figure.update_yaxes(range=padded([*edges, *ends(rows), *(limits or {})], 0.1))
    return figure


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
    figure = blank(label("Time", "s"), label(y, unit), title=plain(title), height=380)
    rows, look = curves(histories, np.zeros(len(histories), dtype=bool))[0], looks([y])[y]
    told = f"{len(histories)} {who if len(histories) != 1 else who.removesuffix('s')}"
    add_lines(figure, times, rows, plain(told), look.colour, 0.8 if len(rows) > 1 else 2.0, True)
    for bound, text in (limits or {}).items():
        limit_line(figure, bound, text, under=bound < 0)
    figure.update_layout(showlegend=True)
    figure.update_yaxes(range=padded([*ends(rows), *(limits or {})], 0.1))
    return figure


def limits_text(bounds: Sequence[float], unit: str) -> dict[float, str]:
    """The text of each finite limit."""
    return {bound: f"limit {given(bound, unit)}" for bound in dict.fromkeys(bounds) if np.isfinite(bound)}


def ends(*values: np.ndarray) -> Iterator[float]:
    """The least and the largest of the finite values."""
    for one in values:
        known = one[np.isfinite(one)]
        if known.size:
            yield float(known.min())
            yield float(known.max())
