"""Figures and facts of what is sampled or expanded: evidence on one design and on many, functions, tolerances."""

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from aleator._core.arrays import jax_array
from aleator._core.border import positive
from aleator._core.errors import ProblemError
from aleator.analysis import AbstractExpanded, ElementExpanded, Expanded, ToleranceAnalysis
from aleator.design import AbstractFunctional, functionals_of
from aleator.reporting._numbers import count, given, number, percent, share_text, unit_of_functional
from aleator.reporting._page import Table
from aleator.reporting._paths import cloud, components, limits_of, path_figure, paths_of, trajectory_figure
from aleator.reporting._showing import AbstractPlots, Facts, chosen, facts_of, plots_of
from aleator.reporting._spreads import bars_figure, density_figure, percentile_figure, shares_figure
from aleator.reporting._style import plain
from aleator.reporting._tables import evidence_table, violations_table
from aleator.sweep import EvidenceOfAll
from aleator.validation import Evidence

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Bins of a histogram at most.
_BINS = 200
_NO_NUMBER = "expected a functional that is one number of each system, such as al.rms('x'); received none."


@plots_of.register(Evidence)
class EvidencePlots(AbstractPlots[Evidence]):
    """Figures of evidence."""

    def __call__(self) -> "Figure":
        """The limit that most systems break: these over time against it, or the density of the number that it limits;
        without such a limit, what there is of trajectories or densities.
        """
        paths, densities = [one.name for one in self._result.trajectories], self._limited()
        worst = self._most_broken([*paths, *densities])
        if worst in paths or (worst is None and paths):
            return self.trajectories(worst)
        return self.density(None if worst is None else densities[worst])

    def trajectories(self, limit: str | None = None) -> "Figure":
        """Sampled systems over time against a limit, by its name, by default the one that most of them break; those
        that break it are highlighted.
        """
        nothing = "expected a limit over time, and keep > 0 in al.validate; received evidence without trajectories."
        paths = {one.name: one for one in self._result.trajectories}
        name, _ = chosen("plot.trajectories", self._most_broken(paths) if limit is None else limit, paths, nothing)
        return trajectory_figure(self._result, name, every=1)

    def band(self, output: str | None = None, *, sigmas: float | None = None) -> "Figure":
        """The sampled mean of a path with its band, before sampled histories, and the mean by the expansion.

        - `output`: of a path in the problem, by default the first; `sigmas`: by default as in its limits, else 2.
        """
        problem = self._result.solution.problem
        nothing = "expected a path in the problem, such as al.path('x'); received one without."
        name, functional = chosen("plot.band", output, paths_of(problem), nothing)
        sampled, limits = self._result.functionals[functional.text()], limits_of(problem, functional)
        histories = [one.values for one in self._result.trajectories if one.name in limits.names]
        return path_figure(
            self._result.solution.times_of(functional),
            components(f"sampled mean of {name}", sampled.mean, sampled.std)
            | components(f"mean of {name} by the expansion", sampled.expanded_mean, np.zeros_like(sampled.std)),
            sigmas=limits.sigmas if sigmas is None else positive("plot.band: sigmas", sigmas),
            y=name,
            unit=limits.unit,
            limits=limits.texts,
            histories=cloud(histories[0]) if histories else {},
        )

    def density(self, functional: str | None = None) -> "Figure":
        """The sampled density of a functional, as a histogram, with the limits on it; by default of the first one.

        - `functional`: its text, such as `"rms(x)"`, or the name of its output where that tells it apart.
        """
        problem, declared = self._result.solution.problem, self._number("plot.density", functional)
        name, one = declared.text(), self._result.functionals[declared.text()]
        (edges, heights), limits = _steps(one.values), limits_of(problem, declared)
        broken = [(each, share) for each, share in self._result.violations.items() if each in limits.names]
        lines = [f"{share_text(share)} violate {plain(each)}" for each, share in broken]
        moments = f"mean {number(float(one.mean))}, σ {number(float(one.std))}"
        lines.append(f"{moments}, {count(self._result.samples)} systems")
        shown = {"unit": limits.unit, "limits": sorted(limits.texts), "title": "<br>".join(lines)}
        return density_figure(edges, {"sampled": heights}, x=name, **shown)

    def percentiles(self, functional: str | None = None) -> "Figure":
        """The sampled spread of a functional: 1 to 99 %, 5 to 95 % and 25 to 75 % of the systems, median and mean."""
        declared = self._number("plot.percentiles", functional)
        unit, name = unit_of_functional(declared, self._result.solution.problem), declared.text()
        return percentile_figure({"design": self._result.functionals[name]}, x=name, unit=unit)

    def violations(self) -> "Figure":
        """How many systems break each limit, with 95 % confidence intervals."""
        shares = dict(self._result.violations)
        if len(shares) > 1:
            shares["any of them"] = self._result.joint
        return shares_figure(list(shares), {"systems": list(shares.values())}, x="Limit", y="Systems that break it")

    def _most_broken(self, names: Collection[str]) -> str | None:
        """The limit among these that most systems break; None if none of them is counted."""
        violations = self._result.violations
        shares = {name: violations[name].estimate for name in names if name in violations}
        return max(shares, key=lambda name: shares[name], default=None)

    def _numbers(self) -> dict[str, AbstractFunctional]:
        """The functionals that are one number of each system, by their texts."""
        every = functionals_of(self._result.solution.problem.expressions)
        return {one.text(): one for one in every if self._result.functionals[one.text()].values is not None}

    def _limited(self) -> dict[str, str]:
        """The text of such a functional that varies by the limit that is on it alone."""
        problem, sampled = self._result.solution.problem, self._result.functionals
        varied = {text: one for text, one in self._numbers().items() if _varies(sampled[text].values)}
        return {name: text for text, one in varied.items() for name in limits_of(problem, one).names}

    def _number(self, what: str, functional: str | None) -> AbstractFunctional:
        known = self._numbers()
        of_output = [text for text, one in known.items() if one.outputs == (functional,)]
        return chosen(what, of_output[0] if len(of_output) == 1 else functional, known, _NO_NUMBER)[1]


@plots_of.register(EvidenceOfAll)
class EvidenceOfAllPlots(AbstractPlots[EvidenceOfAll]):
    """The figure of evidence on several designs."""

    def violations(self) -> "Figure":
        """How many systems of each design break each limit, with 95 % confidence intervals."""
        every, names = self._result.evidence, _counted(self._result)
        shares = {name: [one.violations.get(name) if one else None for one in every] for name in names}
        return shares_figure(self._result.places, shares, x="Design", y="Systems that break the limit")


def _counted(evidence: EvidenceOfAll) -> list[str]:
    """The limits that are counted on any design."""
    return list(dict.fromkeys(name for one in evidence.evidence if one for name in one.violations))


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


@facts_of.register(EvidenceOfAll)
def _(evidence: EvidenceOfAll) -> Facts:
    names = _counted(evidence)
    rows = [
        [place, *(share_text(one.violations.get(name)) if one else evidence.refused[i] for name in names)]
        for i, (place, one) in enumerate(zip(evidence.places, evidence.evidence, strict=True))
    ]
    heading = f"Evidence on {len(evidence.designs)} designs{', interrupted' * evidence.interrupted}"
    sentence = "" if evidence.agrees else "Samples contradict some of the designs, or these could not be simulated."
    return Facts(heading, sentence, [Table("Systems that break limits, with 95 % intervals", ["design", *names], rows)])


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
        heights = np.asarray(one.pdf(jax_array(values)))[(slice(None), *where)]
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
        heights = np.asarray(one.expanded.pdf(jax_array(values)))
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
