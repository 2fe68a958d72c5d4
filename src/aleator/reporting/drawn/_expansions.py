"""Figures and facts of expanded functions and of tolerance analyses."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from aleator._core.errors import ProblemError
from aleator.analysis import AbstractExpanded, ElementExpanded, Expanded, ToleranceAnalysis
from aleator.reporting._blocks import Table
from aleator.reporting._methods import bars_figure, density_figure
from aleator.reporting._numbers import given, number, percent
from aleator.reporting.drawn._facts import AbstractPlots, Facts, chosen, facts_of, plots_of

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Points of a density, and the sample whose range it spans.
_POINTS, _SAMPLE = 201, 4096
# Inputs whose shares are drawn: the largest of them.
_MOST = 12


@plots_of.register(AbstractExpanded)
class ExpandedPlots(AbstractPlots[AbstractExpanded]):
    """Figures of an expanded function."""

    def density(self, output: str | None = None, *, entry: int | tuple[int, ...] | None = None) -> "Figure":
        """The probability density of an output, with its mean and standard deviation.

        - `output`: by its name, by default the first;
        - `entry`: of an array, by its indices; by default where its spread is largest.
        """
        name, one, where = _scalar("plot.density", self._result, output, entry)
        mean, std = (float(np.asarray(part)[where]) for part in (one.mean, one.std))
        sample = np.asarray(one.sample(_SAMPLE, seed=0))[(slice(None), *where)]
        if not np.ptp(sample) > 1e-12 * float(np.max(np.abs(sample))):
            raise ProblemError(f"plot.density: expected an output that varies; received '{name}', which does not.")
        values = np.linspace(sample.min(), sample.max(), _POINTS)
        heights = np.asarray(one.pdf(jax.numpy.asarray(values)))[(slice(None), *where)]
        title = f"mean {number(mean)}, σ {number(std)}"
        return density_figure(values, {name: heights}, x=name, title=title)

    def sensitivities(self, output: str | None = None, *, entry: int | tuple[int, ...] | None = None) -> "Figure":
        """Which inputs an output's variance comes from: Sobol indices alone, and with interactions; largest first.

        Correlated inputs have Shapley effects instead, which share their common part. With more than twelve inputs, the
        largest twelve are drawn.

        - `output`: by its name, by default the first;
        - `entry`: of an array, by its indices; by default where its spread is largest.
        """
        name, one, where = _scalar("plot.sensitivities", self._result, output, entry)
        shares = _shares(one, where)
        last = next(reversed(shares.values()))
        order = sorted(last, key=lambda key: -last[key])[:_MOST]
        groups = {kind: {key: 100 * by_input[key] for key in order} for kind, by_input in shares.items()}
        return bars_figure(groups, y=f"Share of the variance of {name}", unit="%")


def _shares(one: AbstractExpanded, where: tuple[int, ...]) -> dict[str, dict[str, float]]:
    """The shares of inputs in the variance of one number, by their kind."""

    def number_of(moments: Any) -> float:
        return float(np.asarray(moments)[where])

    if any(each.dependence for each in one.distributions.values()):
        if not isinstance(one, Expanded):
            raise ProblemError(
                "plot.sensitivities: expected independent inputs of a piecewise expansion; received correlated ones."
            )
        return {"Shapley effect": {key: number_of(one.shapley(key)) for key in one.distributions}}
    return {
        "alone (Sobol index)": {key: number_of(one.sobol(key)) for key in one.germs},
        "with interactions (total)": {key: number_of(one.total_sobol(key)) for key in one.germs},
    }


def _scalar(
    what: str, expanded: AbstractExpanded, output: str | None, entry: int | tuple[int, ...] | None
) -> tuple[str, AbstractExpanded, tuple[int, ...]]:
    """One number of an expansion: its name, the output that it belongs to, and its place there."""
    means = expanded.mean
    name, one = "output", expanded
    if isinstance(means, Mapping):
        name, _ = chosen(what, output, means, "expected an output; received none.")
        one = expanded[name]
    elif output is not None:
        raise ProblemError(f"{what}: expected no name, for a function with one output; received '{output}'.")
    stds = np.asarray(one.std)
    if entry is None:
        entry = tuple(int(i) for i in np.unravel_index(int(np.argmax(stds)), stds.shape))
    where = entry if isinstance(entry, tuple) else (entry,)
    pairs = zip(where, stds.shape, strict=False)
    if len(where) != stds.ndim or not all(isinstance(i, int) and -n <= i < n for i, n in pairs):
        raise ProblemError(
            f"{what}: expected entry=..., a place in '{name}' of shape {stds.shape}; received {entry!r}."
        )
    return f"{name}[{', '.join(map(str, where))}]" if where else name, one, where


@plots_of.register(ToleranceAnalysis)
class TolerancePlots(AbstractPlots[ToleranceAnalysis]):
    """Figures of a tolerance analysis."""

    def density(self) -> "Figure":
        """The density of the output, with its limits and the rejects beyond them."""
        one = self._result
        limits = [limit for limit in (one.lower, one.upper) if np.isfinite(limit)]
        low, high = (one.mean - 4.5 * one.std, one.mean + 4.5 * one.std)
        values = np.linspace(min([low, *limits]), max([high, *limits]), _POINTS)
        heights = np.asarray(one.expanded.pdf(jax.numpy.asarray(values)))
        tails = [f"{number(part, 3)}\nppm" for part in (one.rejects_low, one.rejects_high)] if len(limits) == 2 else []
        title = f"mean {number(one.mean)}, σ {number(one.std)}, rejects {number(one.rejects, 3)} ppm"
        return density_figure(values, {one.output: heights}, x=one.output, limits=limits, tails=tails, title=title)

    def contributions(self) -> "Figure":
        """The share of each dimension in the variance, linearly and by the expansion, largest first."""
        parts = dict(sorted(self._result.contributions.items(), key=lambda item: -item[1].linear)[:_MOST])
        groups = {
            "linearly": {name: one.linear for name, one in parts.items()},
            "by the expansion (total)": {name: one.total for name, one in parts.items() if np.isfinite(one.total)},
        }
        shown = {kind: one for kind, one in groups.items() if one}
        return bars_figure(shown, y=f"Share of the variance of {self._result.output}", unit="%")


@facts_of.register(AbstractExpanded)
def _(expanded: AbstractExpanded) -> Facts:
    means, stds = expanded.mean, expanded.std
    rows = [
        [name, _moment(mean, std), _moment(std, std)]
        for name, mean, std in zip(_names(means), jax.tree.leaves(means), jax.tree.leaves(stds), strict=True)
    ]
    inputs = [[name, str(one)] for name, one in expanded.distributions.items()]
    tables = [Table("", ["output", "mean", "σ"], rows), Table("", ["input", "distribution"], inputs)]
    kind = "Piecewise expansion" if isinstance(expanded, ElementExpanded) else "Expansion"
    return Facts(f"{kind} in {len(expanded.germs)} variables", "", tables)


def _names(tree: Any) -> list[str]:
    paths = [path for path, _ in jax.tree_util.tree_leaves_with_path(tree)]
    return [jax.tree_util.keystr(path, simple=True, separator=".") or "output" for path in paths]


def _moment(values: Any, stds: Any) -> str:
    """A number; of an array, that of the largest spread."""
    known, spread = np.asarray(values), np.asarray(stds)
    if known.ndim == 0:
        return number(float(known), 6)
    return f"{number(float(known.flat[int(np.argmax(spread))]), 6)}, of {known.size} where σ is largest"


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
