"""`Evidence`: what a fresh Monte Carlo simulation of a design tells of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.leaves import Drawn, Printed
from aleator.design import Statistic, uncertain
from aleator.references._estimate import pair
from aleator.solution import Solution, ends
from aleator.validation._shares import Proportion, check_counted, reason_uncounted

_NO_LIMITS = "  no constraint is a limit on single systems, so none is counted"

# The most disagreements that a message lists.
_TOLD = 3

PERCENTILES = (1.0, 5.0, 25.0, 50.0, 75.0, 95.0, 99.0)

# Half-width of a 95 % confidence interval, in standard errors.
_CONFIDENT = 1.96


def with_error(value: float, error: float) -> str:
    """A number with its standard error, where it has any."""
    return pair(value, error) if error > 0 else f"{value:.6g}"


def _when(time: float | None) -> str:
    return "" if time is None else f" at t = {time:.4g} s"


@final
@dataclass(frozen=True)
class Sampled(Printed):
    """One functional over the samples, compared with the expansion.

    - `mean`, `std`: of the samples, a number or one number per instant; `standard_error`: of that mean;
    - `percentiles`: the sample's `PERCENTILES`, for functionals that are numbers; None for a path;
    - `expanded_mean`, `expanded_std`: by the expansion at the solution (for a deterministic design, its nominal value);
    - `std_error`: the standard error of the sampled standard deviation;
    - `values`: of all samples, for functionals that are numbers; None for a path, and where nothing is uncertain.
    """

    text: str
    mean: Float[np.ndarray, "*shape"]
    std: Float[np.ndarray, "*shape"]
    standard_error: Float[np.ndarray, "*shape"]
    percentiles: Float[np.ndarray, " levels"] | None
    expanded_mean: Float[np.ndarray, "*shape"]
    expanded_std: Float[np.ndarray, "*shape"]
    std_error: Float[np.ndarray, "*shape"]
    values: Float[np.ndarray, " samples"] | None = None

    def __str__(self) -> str:
        error = "" if np.ndim(self.mean) else f" ± {float(self.standard_error):.2g}"
        return (
            f"{self.text}: mean {ends(self.mean)}{error} (expansion {ends(self.expanded_mean)}), "
            f"std {ends(self.std)} (expansion {ends(self.expanded_std)})"
        )


@final
@dataclass(frozen=True)
class Checked(Printed):
    """One statistic of the problem, by the expansion and by the samples.

    - `expanded`: by the expansion at the solution (for a deterministic design, its nominal value);
    - `estimate`: by the samples; `standard_error`: of that estimate, by balanced half-samples. NaN for a
      supremum or infimum: that of a sample lies inside the true one, by an unknown amount.
    """

    statistic: Statistic
    expanded: float
    estimate: float
    standard_error: float

    def __str__(self) -> str:
        estimate = with_error(self.estimate, self.standard_error)
        return f"{self.statistic.text()}: {estimate} (expansion {self.expanded:.6g})"


@final
@dataclass(frozen=True)
class Disagreement(Printed):
    """A number of the solution that fresh simulations contradict.

    - `text`: the number as mathematics, such as `σ[x(t)]`; `time`: the worst instant (s), None for a number;
    - `expected`: its value by the solution, of which `source` names the part; `estimate`, `standard_error`: by the
      samples.
    """

    text: str
    expected: float
    estimate: float
    standard_error: float
    time: float | None = None
    source: str = "the expansion"

    def sentence(self) -> str:
        """The sampled and the expected value."""
        estimate = with_error(self.estimate, self.standard_error)
        return f"{self.text}{_when(self.time)} is {estimate}, not {self.expected:.6g} as by {self.source}"

    __str__ = sentence


@final
@dataclass(frozen=True)
class Compared(Printed):
    """A limit on a statistic, evaluated with the sampled statistic instead of the expansion's.

    - `value`, `standard_error`: its expression by the samples, at the `time` (s) closest to or furthest beyond the
      bound, None for a number; the error is an upper bound where it contains several statistics;
    - `bound`: the nearer, or the more exceeded, of the two bounds; `beyond`: by how much it is exceeded, negative
      inside; `tolerance`: the excess that is ignored;
    - `reach`: how many standard errors are beyond chance, given the number of its instants.
    """

    name: str
    text: str
    value: float
    standard_error: float
    time: float | None
    bound: float
    beyond: float
    tolerance: float
    reach: float

    @property
    def meets(self) -> bool | None:
        """Whether the limit is met, with 95 % confidence; None where the samples cannot decide."""
        # NaN meets no limit; an extreme has no standard error.
        if np.isnan(self.beyond) or self.beyond > self.tolerance + self.reach * self.standard_error:
            return False
        return True if self.beyond + _CONFIDENT * self.standard_error <= self.tolerance else None

    def sentence(self) -> str:
        """The sampled value, and the verdict on the limit."""
        verdict = {True: "met", False: "BROKEN", None: "within its error of the bound"}[self.meets]
        return f"{self.text}: sampled {with_error(self.value, self.standard_error)}{_when(self.time)}, {verdict}"

    __str__ = sentence


@final
@dataclass(frozen=True)
class Trajectories(Printed):
    """The expression of one path constraint on some sampled systems.

    - `values`: shape (kept, instants, *entries);
    - `violating`: shape (kept,), whether the system breaks any constraint of this name.
    """

    name: str
    lower: float
    upper: float
    values: Float[np.ndarray, "kept instants ..."]
    violating: np.ndarray

    def __str__(self) -> str:
        return f"{self.name} of {len(self.values)} systems, {int(np.sum(self.violating))} of which violate it"


@final
@dataclass(frozen=True)
class Evidence(Drawn):
    """A design re-simulated on fresh random systems, without any expansion. `print(evidence)` shows it.

    - `instants`: the number of instants at which limits over time were counted, None if there are none; more than the
      design's grid has where that is too coarse, or limits hold between its instants too;
    - `functionals`: sampled mean and standard deviation of each, with the expansion's;
    - `statistics`: each statistic in the problem by its text (`"Q0.99[rms(x)]"`), sampled, with the expansion's;
      without those of paths, and those that a sample cannot estimate (Sobol indices: see
      `al.references.sobol_indices`);
    - `trajectories`: some systems, for plots;
    - `compared`: limits on statistics of all systems together, such as a bound on a `std`, with sampled statistics;
      without those that need statistics of paths other than mean, `std` and variance;
    - `disagreements`: the numbers of the solution that the samples contradict, and broken limits that should hold for
      all systems; empty where `agrees`;
    - `alone`: where nothing is uncertain, the refinement factor of the grid on which the one system was simulated; else
      None;
    - `broken`: by constraint name, which sampled systems violate it, shape (samples,);
    - `over_intervals`: the evidence at each of `Solution.over_intervals`, if there are any. Then a proportion is the
      largest of these (see `least_violation`), `disagreements` are those of all, and everything else is that of the
      values at which most systems violate a limit.
    """

    solution: Solution
    samples: int
    seed: int
    instants: int | None
    functionals: Mapping[str, Sampled]
    statistics: Mapping[str, Checked]
    trajectories: tuple[Trajectories, ...]
    seconds: float
    broken: Mapping[str, Bool[np.ndarray, " samples"]]
    compared: tuple[Compared, ...] = ()
    disagreements: tuple[Disagreement, ...] = ()
    alone: int | None = None
    over_intervals: tuple["Evidence", ...] = ()

    @property
    def violations(self) -> dict[str, Proportion]:
        """By constraint name, the proportion of systems that violate any constraint of that name at any instant."""
        return {name: self.violation(name) for name in self.broken}

    @property
    def joint(self) -> Proportion:
        """The proportion of systems that violate at least one constraint.

        Raises `ProblemError` if no constraint applies to single systems.
        """
        return self.violation(*self.broken)

    @property
    def uncounted(self) -> dict[str, str]:
        """The constraints excluded from these, as mathematics, with the reason.

        They do not apply to a single system, like a bound on a `std`, or no single system meets them exactly, like an
        equality.
        """
        problem = uncertain(self.solution.problem)
        return {str(one): why for one in problem.constraints if (why := reason_uncounted(problem, one))}

    @property
    def agrees(self) -> bool:
        """Whether no sampled number contradicts the solution: see `disagreements`."""
        return not self.disagreements

    def alarm(self) -> str:
        """What the simulations contradict, with at most three numbers, and the remedy."""
        told = [one.sentence() for one in self.disagreements[:_TOLD]]
        more = f"; and {len(self.disagreements) - _TOLD} more" if len(self.disagreements) > _TOLD else ""
        remedy = "Use more steps." if self.alone else "Raise the order of the expansion (and check the grid)."
        return f"fresh simulations contradict the solution: {'; '.join(told)}{more}. {remedy}"

    def violation(self, *names: str) -> Proportion:
        """The proportion of systems that violate any of the constraints of these names; one that violates two counts
        once.

        Raises `ProblemError` for no names, and for names against which no system is counted.
        """
        check_counted("violation", names, self.broken)
        if self.over_intervals:
            return max((one.violation(*names) for one in self.over_intervals), key=lambda one: one.count)
        mask = np.any([self.broken[name] for name in names], axis=0)
        return Proportion(int(mask.sum()), self.samples)

    def _share(self, *names: str) -> str:
        least = f"{self.least_violation(*names)} to " if self.over_intervals else ""
        return f"{least}{self.violation(*names)}"

    def least_violation(self, *names: str) -> Proportion:
        """The same at the values of the intervals at which it is least: between both, nothing is more likely."""
        every = self.over_intervals or (self,)
        return min((one.violation(*names) for one in every), key=lambda one: one.count)

    def __str__(self) -> str:
        rows = [] if self.agrees else [f"DISAGREES: {self.alarm()}"]
        if self.alone is None:
            rows.append(f"{self.samples} fresh samples, seed {self.seed}, {self.seconds:.1f} s")
        else:
            steps = f" with {self.alone} times as many steps" if self.alone > 1 else ""
            rows.append(f"nothing is uncertain: the one system simulated again{steps}")
        rows += [f"  violates {name}: {self._share(name)}" for name in self.broken]
        rows.append(f"  violates any: {self._share(*self.broken)} (95 % confidence)" if self.broken else _NO_LIMITS)
        if self.over_intervals:
            rows.append(f"  over {len(self.over_intervals)} values of intervals; below, where most systems violate any")
        rows += [] if self.instants is None else [f"  limits over time counted at {self.instants} instants"]
        rows += [f"  compared: {one}" for one in self.compared]
        rows += [f"  not counted: {text} ({why})" for text, why in self.uncounted.items()]
        rows += [f"  {one}" for one in self.functionals.values() if np.ndim(one.mean) == 0]
        rows += [f"  {one}" for one in self.statistics.values() if not one.statistic.is_moment]
        return "\n".join(rows)
