"""`calibrate`: the multiple of the standard deviation that makes violations as rare as asked (sections 5.6 and 6.5)."""

from dataclasses import dataclass
from typing import final

import numpy as np
from scipy import special

from aleator._core.errors import ProblemError, SolveError
from aleator._core.progress import Progress, silent
from aleator.design import Problem, Solution
from aleator.nlp import AbstractSolver
from aleator.solve import solve
from aleator.validation import Evidence, Proportion, validate

_SMALLEST, _LARGEST = 0.02, 20.0


@final
@dataclass(frozen=True)
class Trial:
    """One multiple of the standard deviation that was tried: its optimal design and how often that is violated."""

    sigmas: float
    solution: Solution
    violation: Proportion


@final
@dataclass(frozen=True)
class Calibration:
    """The smallest multiple found whose design is violated no more often than asked. `print(calibration)` shows it.

    - `trials`: all that was tried, on one and the same random sample;
    - `evidence`: the chosen design on a second, independent sample.
    """

    name: str
    target: float
    trials: tuple[Trial, ...]
    evidence: Evidence

    @property
    def chosen(self) -> Trial:
        """The trial with the smallest multiple that meets the target."""
        return min((one for one in self.trials if one.violation.estimate <= self.target), key=lambda one: one.sigmas)

    @property
    def sigmas(self) -> float:
        """The calibrated multiple of the standard deviation."""
        return self.chosen.sigmas

    @property
    def solution(self) -> Solution:
        """The design it gives."""
        return self.chosen.solution

    def __str__(self) -> str:
        rows = [f"{'sigmas':>8} {'objective':>12}  violates {self.name}"]
        rows += [f"{one.sigmas:8.4f} {one.solution.objective:12.6g}  {one.violation}" for one in self.trials]
        confirmed = self.evidence.violations[self.name]
        rows.append(f"chosen: {self.sigmas:.4f} for at most {100 * self.target:g} %; on fresh samples {confirmed}")
        return "\n".join(rows)


def calibrate(
    problem: Problem,
    name: str,
    target: float = 0.01,
    *,
    samples: int = 20_000,
    seed: int = 0,
    precision: float = 0.1,
    max_trials: int = 12,
    solver: AbstractSolver | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Find the `sigmas` of the constraints called `name` at which a system violates them with probability `target`.

    Each trial solves the problem (warm-started, compiled once) and validates the design on the same `samples` random
    systems. The search is a secant on the normal quantile of the probability, which is nearly straight, kept inside a
    bracket; it ends when the probability lies within `precision` (relative) below the target.

    Raises `ProblemError` for a target outside (0, 1), for one too small to be counted with so many samples, or if the
    constraints hold no standard deviation; `SolveError` if the target needs a design that does not exist.
    """
    if not 0 < target < 1:
        raise ProblemError(f"calibrate: the target is a probability between 0 and 1; received {target}.")
    if target * samples < 10:
        raise ProblemError(
            f"calibrate: a probability of {target:g} needs at least {int(np.ceil(10 / target))} samples to be counted; "
            f"received {samples}."
        )
    search = _Search(problem, name, target, precision, samples, seed, solver)
    for attempt in range(max_trials):
        if search.done:
            break
        progress(f"calibration of {name}", attempt, max_trials)
        search.step()
    calibrated = [one for one in search.trials if one.violation.estimate <= target]
    if not calibrated:
        last = max(search.trials, key=lambda one: one.sigmas)
        beyond = f", and from {search.ceiling:.3g} on there is no design" if np.isfinite(search.ceiling) else ""
        raise SolveError(
            f"calibrate: no multiple of the standard deviation up to {last.sigmas:.3g} brought the violation of "
            f"'{name}' down to {target:g}: that one gave {last.violation}{beyond}.",
            last.solution,
        )
    best = min(calibrated, key=lambda one: one.sigmas)
    evidence = validate(best.solution, samples, seed=seed)
    progress(f"calibration of {name}", max_trials, max_trials)
    return Calibration(name, target, tuple(search.trials), evidence)


@final
class _Search:
    """A bracketed secant on the normal quantile of the violation probability, which falls as the multiple grows."""

    def __init__(
        self,
        problem: Problem,
        name: str,
        target: float,
        precision: float,
        samples: int,
        seed: int,
        solver: AbstractSolver | None,
    ):
        self._problem, self._name, self._target, self._precision = problem, name, target, precision
        # A stream of its own: evidence that a user gathers with the same seed is fresh all the same.
        self._seed = int(np.random.SeedSequence([seed, 1]).generate_state(1)[0])
        self._samples, self._solver = samples, solver
        self.trials: list[Trial] = []
        self.ceiling = np.inf
        multiples = [one.expression.sigmas for one in problem.named(name)]
        self._next = max((multiple for multiple in multiples if multiple), default=0.0)
        if self._next == 0.0:
            raise ProblemError(f"calibrate: the constraints called '{name}' hold no standard deviation; set sigmas=1.")

    @property
    def done(self) -> bool:
        """Whether a trial is close below the target, or below it with a margin that no smaller one would change.

        Or whether there is nothing left to try: the margin is at its largest, or as large as there are designs.
        """
        widest = max((one.sigmas for one in self.trials), default=0.0)
        return widest >= min(_LARGEST, 0.999 * self.ceiling) or any(
            self._settles(one) for one in self.trials if one.violation.estimate <= self._target
        )

    def _settles(self, trial: Trial) -> bool:
        # Where the constraints are not active, the margin does not shape the design.
        idle = self._name not in trial.solution.active
        close = trial.violation.estimate >= (1 - self._precision) * self._target
        return close or idle or trial.sigmas <= _SMALLEST

    def step(self) -> None:
        """Try one more multiple. One that has no design only bounds the search, unless it is the first."""
        sigmas = self._next
        warm = min(self.trials, key=lambda one: abs(one.sigmas - sigmas)).solution if self.trials else None
        try:
            solution = solve(self._problem.with_sigmas(self._name, sigmas), self._solver, warm_start=warm)
        except SolveError:
            if warm is None:
                raise
            self.ceiling = min(self.ceiling, sigmas)
            self._next = self._propose()
            return
        evidence = validate(solution, self._samples, seed=self._seed, keep=0)
        if self._name not in evidence.violations:
            raise ProblemError(f"calibrate: '{self._name}' bounds moments alone: no single system can break it.")
        self.trials.append(Trial(sigmas, solution, evidence.violations[self._name]))
        self._next = self._propose()

    def _propose(self) -> float:
        """The secant through the two trials around the target, aimed a little below it."""
        points = sorted((one.sigmas, self._level(one)) for one in self.trials)
        above = [point for point in points if point[1] > 0]
        below = [point for point in points if point[1] <= 0]
        if not below:
            widest = above[-1][0]
            return min(widest * 1.5 + 0.1, _LARGEST, (widest + self.ceiling) / 2)
        if not above:
            return max(below[0][0] / 2, _SMALLEST)
        (low, high_level), (high, low_level) = above[-1], below[0]
        share = high_level / (high_level - low_level)
        return low + (high - low) * float(np.clip(share, 0.1, 0.9))

    def _level(self, trial: Trial) -> float:
        """Distance from the aim on the scale of the normal quantile: positive where violated too often."""
        aim = self._target * (1 - self._precision / 2)
        estimate = (trial.violation.count + 0.5) / (trial.violation.samples + 1)
        return float(special.ndtri(estimate) - special.ndtri(aim))
