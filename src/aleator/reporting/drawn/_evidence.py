"""Figures and facts of evidence, of one design and of many."""

from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from aleator._core.border import positive
from aleator._core.errors import ProblemError
from aleator.design import functionals_of
from aleator.reporting._blocks import Table
from aleator.reporting._methods import density_figure
from aleator.reporting._numbers import count, number, share_text, unit_of_functional, unit_of_limit, units_of_moments
from aleator.reporting._paths import cloud, components, limits_of, path_figure, paths_of, trajectory_figure
from aleator.reporting._samples import percentile_figure, shares_figure
from aleator.reporting._style import plain
from aleator.reporting._tables import evidence_table, violations_table
from aleator.reporting.drawn._facts import AbstractPlots, Facts, chosen, facts_of, plots_of
from aleator.sweep import EvidenceOfAll
from aleator.validation import Evidence, Sampled

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

# Bins of a histogram at most.
_BINS = 200
_NO_LIMIT = "expected a limit that single systems can break; received evidence that counts none."
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
        return trajectory_figure(self._result, name, unit=unit_of_limit(name, self._result.solution.problem), every=1)

    def band(self, output: str | None = None, *, sigmas: float | None = None) -> "Figure":
        """The sampled mean of a path with its band, before sampled histories, and the mean by the expansion.

        - `output`: of a path in the problem, by default the first; `sigmas`: by default as in its limits, else 2.
        """
        problem = self._result.solution.problem
        nothing = "expected a path in the problem, such as al.path('x'); received one without."
        name, functional = chosen("plot.band", output, paths_of(problem), nothing)
        unit = unit_of_functional(functional, problem)
        sampled, limits = self._result.functionals[functional.text()], limits_of(problem, functional, unit)
        histories = [one.values for one in self._result.trajectories if one.name in limits.names]
        return path_figure(
            self._result.solution.times_of(functional),
            components(f"sampled mean of {name}", sampled.mean, sampled.std)
            | components(f"mean of {name} by the expansion", sampled.expanded_mean, np.zeros_like(sampled.std)),
            sigmas=limits.sigmas if sigmas is None else positive("plot.band: sigmas", sigmas),
            y=name,
            unit=unit,
            limits=limits.texts,
            histories=cloud(histories[0]) if histories else {},
        )

    def density(self, functional: str | None = None) -> "Figure":
        """The sampled density of a functional, as a histogram, with the limits on it; by default of the first one.

        - `functional`: its text, such as `"rms(x)"`, or the name of its output where that tells it apart.
        """
        name, one = self._number("plot.density", functional)
        problem = self._result.solution.problem
        unit = units_of_moments(problem).get(name, "")
        (declared,) = [each for each in functionals_of(problem.expressions) if each.text() == name]
        edges, heights = _steps(one.values)
        limits = limits_of(problem, declared, unit)
        broken = {each: share for each, share in self._result.violations.items() if each in limits.names}
        title = f"mean {number(float(one.mean))}, σ {number(float(one.std))}, {count(self._result.samples)} systems"
        title = "<br>".join([*(f"{share_text(share)} violate {plain(each)}" for each, share in broken.items()), title])
        shown = {"unit": unit, "limits": sorted(limits.texts), "title": title}
        return density_figure(edges, {"sampled": heights}, x=name, **shown)

    def percentiles(self, functional: str | None = None) -> "Figure":
        """The sampled spread of a functional: 1 to 99 %, 5 to 95 % and 25 to 75 % of the systems, median and mean."""
        name, one = self._number("plot.percentiles", functional)
        unit = units_of_moments(self._result.solution.problem).get(name, "")
        return percentile_figure({"design": one}, x=name, unit=unit)

    def violations(self) -> "Figure":
        """How many systems break each limit, with 95 % confidence intervals."""
        if not self._result.violations:
            raise ProblemError(f"plot.violations: {_NO_LIMIT}")
        shares = dict(self._result.violations)
        if len(shares) > 1:
            shares["any of them"] = self._result.joint
        return shares_figure(list(shares), {"systems": list(shares.values())}, x="Limit", y="Systems that break it")

    def _most_broken(self, names: Collection[str]) -> str | None:
        """The limit among these that most systems break; None if none of them is counted."""
        violations = self._result.violations
        shares = {name: violations[name].estimate for name in names if name in violations}
        return max(shares, key=lambda name: shares[name], default=None)

    def _numbers(self) -> dict[str, Sampled]:
        """The functionals that are one number of each system, by their texts."""
        return {text: one for text, one in self._result.functionals.items() if one.values is not None}

    def _limited(self) -> dict[str, str]:
        """The text of such a functional that varies by the limit that is on it alone."""
        problem = self._result.solution.problem
        known = {text for text, one in self._numbers().items() if _varies(one.values)}
        every = [one for one in functionals_of(problem.expressions) if one.text() in known]
        return {name: one.text() for one in every for name in limits_of(problem, one, "").names}

    def _number(self, what: str, functional: str | None) -> tuple[str, Sampled]:
        known, every = self._numbers(), functionals_of(self._result.solution.problem.expressions)
        of_output = [one.text() for one in every if one.text() in known and one.outputs == (functional,)]
        return chosen(what, of_output[0] if len(of_output) == 1 else functional, known, _NO_NUMBER)


@plots_of.register(EvidenceOfAll)
class EvidenceOfAllPlots(AbstractPlots[EvidenceOfAll]):
    """The figure of evidence on several designs."""

    def violations(self) -> "Figure":
        """How many systems of each design break each limit, with 95 % confidence intervals."""
        every, names = self._result.evidence, _counted(self._result)
        if not names:
            raise ProblemError(f"plot.violations: {_NO_LIMIT}")
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
