"""`calibrate`: the multiple of the standard deviation that meets a target for violations (sections 5.6 and 6.5)."""

import warnings
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import final

import numpy as np

from aleator._core.border import Progress, members, one_of, positive, refusal, silent, whole
from aleator._core.errors import CalibrationWarning, ProblemError, SolveError
from aleator._core.leaves import Drawn
from aleator.design import Problem
from aleator.nlp import AbstractSolver
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._margins import COUNTED, MarginSearch, Trial, margins_of
from aleator.sweep._runner import finished, running
from aleator.transcription import DEFAULT, AbstractTranscription
from aleator.validation import Evidence, Proportion, Share, reason_uncounted

# Samples that importance sampling needs.
_FEWEST_WEIGHTED = 1000


@final
@dataclass(frozen=True)
class Calibration(Drawn):
    """The margin whose design is violated no more often than the target. `print(calibration)` shows it.

    - `names`: the limits; a system that breaks any of them counts; `target`: how often that may happen;
    - `trials`: all trials, on the same random sample; `chosen`: the recommended one;
    - `confirmation`: how often fresh systems, not used in the search, violate the chosen design; None where none were
      drawn. Its interval is wide enough that at most one calibration in forty confirms a design that is violated more
      often than the target, however many looks at fresh systems were needed;
    - `evidence`: the chosen design on fresh systems; for rare violations a second sample, besides `confirmation`;
    - `missing`: what is needed to confirm it, empty if it is confirmed; `interrupted`: whether it was stopped early.
    """

    names: tuple[str, ...]
    target: float
    trials: tuple[Trial, ...]
    chosen: Trial
    confirmation: Share | None
    evidence: Evidence | None
    missing: str = ""
    interrupted: bool = False

    @property
    def confirmed(self) -> bool:
        """Whether the upper end of the interval on fresh systems is at or below the target."""
        return self.confirmation is not None and self.confirmation.upper <= self.target

    @property
    def name(self) -> str:
        """The limits' names as text."""
        return " or ".join(self.names)

    @property
    def sigmas(self) -> float:
        """The calibrated multiple of the standard deviation; the largest of several limits: see `margins`."""
        return self.chosen.sigmas

    @property
    def margins(self) -> dict[str, float]:
        """The calibrated multiples of the limits, by their names."""
        return margins_of(self.solution.problem, self.names)

    @property
    def solution(self) -> Solution:
        """The design with this margin."""
        return self.chosen.solution

    def sentence(self, who: str = "systems") -> str:
        """The target, whether it is confirmed, and with which confidence, in one sentence."""
        share, said = self.confirmation, [] if self.confirmed else [self.missing]
        if share is not None:
            is_counted = isinstance(share, Proportion)
            how = "" if is_counted else f", weighted, with {share.effective:.0f} effective violations"
            said.insert(0, f"{share} of {share.samples} fresh {who}{how}, at {100 * share.confidence:g} % confidence")
        confirmed = "confirmed" if self.confirmed else "not confirmed"
        return f"{confirmed} for the target of {100 * self.target:g} %: {'; '.join(filter(None, said))}"

    def __str__(self) -> str:
        rows = [f"{'sigmas':>8} {'objective':>12}  violates {self.name}"]
        rows += [str(one) for one in self.trials]
        return "\n".join([*rows, f"chosen: {self.sigmas:.4f}, {self.sentence()}"])


def calibrate(
    problem: Problem,
    names: str | Sequence[str],
    target: float = 0.01,
    *,
    samples: int = 20_000,
    seed: int = 0,
    precision: float = 0.1,
    max_trials: int = 12,
    solver: AbstractSolver | None = None,
    transcription: AbstractTranscription = DEFAULT,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Find the `sigmas` at which systems violate the constraints called `names` no more often than `target`.

    With several names, a system that violates any of them counts once, and the ratios between their multiples are
    kept (for each name the largest multiple in it, set as by `Problem.with_sigmas`); `sigmas` is the largest. Each
    trial solves the problem, warm-started and compiled once, and counts violations of its design on the same
    `samples` random systems. So it stays near the local optimum of its first trial; whether another one is better,
    `al.portfolio` tells of the problem with the multiple found. The search is a bracketed secant method on the normal
    quantile of the probability, which is nearly linear. It ends within `precision` (relative) below an aim, which
    lies far enough below the target that fresh systems are likely to confirm the design.

    Then twice as many fresh systems are drawn: the design is confirmed if the upper end of their confidence interval
    lies below the target. If it does not, up to four times as many again are drawn where that is likely to suffice, or
    the margin is widened, until a design is confirmed. Each look at fresh systems is given half the error of the one
    before, so that at most 2.5 % of all calibrations confirm a design that is violated more often than the target.

    Where fewer than 20 violations are expected among the samples at the target, they are estimated by importance
    sampling (`al.rare_violation`) or, where that fails, counted on 20 / `target` systems.

    An unconfirmed result is returned too, with a `CalibrationWarning` that says what is missing: see
    `Calibration.confirmed`. So is the result when Ctrl-C is pressed after the first trial. A later solve that fails
    bounds the search. `solver` and `transcription` are those of `al.solve`. An `executor` (see `al.pareto`) shares the
    systems that are counted, with the same result; trials follow from one another, and importance sampling stays here.

    Raises `ProblemError`, before anything is solved, for invalid arguments, and whatever the first solve raises.
    """
    one_of("calibrate: problem", problem, Problem)
    target = positive("calibrate: target", target, below=1)
    precision = positive("calibrate: precision", precision, below=1)
    seed, max_trials = whole("calibrate: seed", seed, least=0), whole("calibrate: max_trials", max_trials)
    fewest = min(int(np.ceil(COUNTED / target)), _FEWEST_WEIGHTED)
    if whole("calibrate: samples", samples, least=2) < fewest:
        raise ProblemError(
            f"calibrate: expected at least {fewest} samples to resolve a violation of {target:g}; received {samples}."
        )
    names = _counted_names(problem, names)

    def solved(one: Problem, warm_start: Solution | None = None) -> Solution:
        try:
            return solve(one, solver=solver, transcription=transcription, warm_start=warm_start)
        except SolveError as error:
            finished(error.solution)
            raise

    search = MarginSearch(problem, names, target, samples, seed, precision, max_trials, solved, executor)
    with running("calibrate", lambda: search.trials, progress, executor) as run:
        search.find(run)
    found = Calibration(
        names=names,
        target=target,
        trials=tuple(search.trials),
        chosen=search.chosen or search.best,
        confirmation=search.fresh,
        evidence=search.evidence,
        missing="it was interrupted" if run.interrupted else search.missing,
        interrupted=run.interrupted,
    )
    if not (found.confirmed or run.interrupted):
        said = f"calibrate: sigmas = {found.sigmas:.4g} is {found.sentence()}."
        warnings.warn(said, CalibrationWarning, stacklevel=2)
    return found


def _counted_names(problem: Problem, names: str | Sequence[str]) -> tuple[str, ...]:
    """The names, each once. Raises `ProblemError` for those of limits for which no margin can be found."""
    every = tuple(dict.fromkeys((names,) if isinstance(names, str) else members("calibrate: names", names, str)))
    if not every:
        raise refusal("calibrate: names", "a constraint's name, or several in a tuple", names)
    for name in every:
        constraints = problem.named(name)
        reasons = [reason_uncounted(problem, one) for one in constraints]
        if all(reasons):
            raise ProblemError(
                f"calibrate: no single system is counted against '{name}' ({constraints[0]}): it is {reasons[0]}."
            )
        if not any(one.expression.sigmas for one in constraints):
            raise ProblemError(
                f"calibrate: the constraints called '{name}' contain no standard deviation; set sigmas=1 in them."
            )
    if not problem.placements.germs:
        raise ProblemError(
            "calibrate: expected a problem with distributions; received one without (al.deterministic holds them at "
            "their means)."
        )
    return every
