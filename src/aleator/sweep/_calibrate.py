"""`calibrate`: the multiple of the standard deviation that meets a target for violations (sections 5.6 and 6.5)."""

import bisect
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import final

import numpy as np
import scipy

from aleator._core.border import Progress, members, one_of, positive, refusal, silent, whole
from aleator._core.errors import CalibrationWarning, ProblemError, SolveError
from aleator.design import Problem, uncertain
from aleator.nlp import AbstractSolver
from aleator.solution import Solution
from aleator.solving import solve
from aleator.sweep._margins import Calibration, MarginSearch, Trial
from aleator.sweep._runner import Runner, finished, running
from aleator.transcription import DEFAULT, AbstractTranscription
from aleator.validation import Evidence, Proportion, Share, rare_violation, validate, why_uncounted

# All looks at fresh systems together wrongly confirm a design in one calibration out of this many.
_WRONG = 1 / 40
# Fresh systems, as multiples of those in a trial: more are drawn while they are likely to confirm the design.
_FRESH = (2, 4, 8)
# With fewer violations expected at the target, importance sampling replaces counting.
_COUNTED = 20
_FEWEST_WEIGHTED = 1000
_MOST_COUNTED = 2_000_000
_LIKELY = 0.84  # standard deviations: fresh systems confirm a design that meets the aim in four cases out of five


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
    fewest = min(int(np.ceil(_COUNTED / target)), _FEWEST_WEIGHTED)
    if whole("calibrate: samples", samples, least=2) < fewest:
        raise ProblemError(
            f"calibrate: expected at least {fewest} samples to resolve a violation of {target:g}; received {samples}."
        )
    names = _counted_names(problem, names)
    multiples = {name: max(one.expression.sigmas or 0.0 for one in problem.named(name)) for name in names}

    def solved(one: Problem, warm_start: Solution | None = None) -> Solution:
        try:
            return solve(one, solver=solver, transcription=transcription, warm_start=warm_start)
        except SolveError as error:
            finished(error.solution)
            raise

    course = _Course(names, target, samples, seed, max_trials, executor)
    search = MarginSearch(problem, multiples, course.common_share, course.aim, precision, solved)
    with running("calibrate", lambda: search.trials, progress, executor) as run:
        course.finish(search, run)
    found = Calibration(
        names=names,
        target=target,
        trials=tuple(search.trials),
        chosen=course.chosen or search.best,
        confirmation=course.fresh,
        evidence=course.evidence,
        missing="it was interrupted" if run.interrupted else course.missing,
        interrupted=run.interrupted,
    )
    if not (found.confirmed or run.interrupted):
        said = f"calibrate: sigmas = {found.sigmas:.4g} is {found.sentence()}."
        warnings.warn(said, CalibrationWarning, stacklevel=2)
    return found


@final
@dataclass
class _Course:
    """Alternating search and confirmation, until a design is confirmed or `missing` says why not.

    Designs are compared on one random sample, common to all trials, and confirmed on fresh ones, each used once.

    - `chosen`, `fresh`, `evidence`: the design last checked on fresh systems, and the results.
    """

    _names: tuple[str, ...]
    _target: float
    _samples: int
    _seed: int
    _max_trials: int
    _executor: Executor | None
    _tried: int = 0
    _looks: int = 0
    chosen: Trial | None = None
    fresh: Share | None = None
    evidence: Evidence | None = None
    missing: str = ""

    def finish(self, search: MarginSearch, run: Runner) -> None:
        """Search and confirm until a design is confirmed or there is nothing left to try."""
        task = f"calibration of {' or '.join(self._names)}"

        def step(sigmas: float) -> AbstractContextManager[None]:
            return run.step(task, self._tried, self._max_trials, f"at sigmas = {sigmas:.4g}")

        while True:
            while self._tried < self._max_trials and not search.done:
                with step(search.following):
                    search.step()
                self._tried += 1
            best = search.best
            if best.violation.estimate > self._target:
                self.missing = f"no margin tried is violated rarely enough, {self._why_no_wider(search)}"
                return
            if self._confirm(best, step):
                run.progress(task, self._max_trials, self._max_trials)
                return
            if self._tried < self._max_trials and self.fresh is not None:
                search.tighten(best, self.fresh)
            if self._tried >= self._max_trials or (search.done and search.best is best):
                self.missing = "; ".join(filter(None, [self._enough_samples(), self._why_no_wider(search)]))
                return

    def common_share(self, solution: Solution) -> Share:
        """How often a design is violated on the common sample of all trials."""
        return self._drawn(solution, 1, self._stream(1), keep=0)[0]

    def aim(self, share: Share) -> float:
        """The violation rate of a trial's sample at which the next look is likely to confirm the design.

        Both have sampling errors: a variance of `p / n` for the first, and half of that for the second, with twice as
        many systems.
        """
        confidence = _confidence(self._looks + 1)
        if not isinstance(share, Proportion):
            known = scipy.special.ndtri((1 + confidence) / 2)
            errors = known / np.sqrt(_FRESH[0]) + _LIKELY * np.sqrt(1 + 1 / _FRESH[0])
            return self._target * float(np.exp(-errors / np.sqrt(share.effective)))
        samples = _FRESH[0] * share.samples
        counts = range(int(self._target * samples) + 1)
        most = bisect.bisect_right(counts, self._target, key=lambda count: Proportion(count, samples, confidence).upper)
        # The expected count that stays at `most - 1` or below, allowing for its error and that of the trial.
        error = _LIKELY * np.sqrt(1 + _FRESH[0])
        return float((np.sqrt(error**2 + 4 * max(most - 0.5, 0.0)) - error) ** 2 / 4 / samples)

    def _confirm(self, trial: Trial, step: Callable[[float], AbstractContextManager[None]]) -> bool:
        """Whether fresh systems confirm a design; more are drawn while that is likely to confirm it."""
        self.chosen, self.fresh, self.evidence = trial, None, None
        for times in _FRESH:
            with step(trial.sigmas):
                self.fresh, self.evidence = self._fresh(trial.solution, times)
            if self.fresh.upper <= self._target:
                return True
            if self._hoped(self.fresh, 2).upper > self._target:
                break
        return False

    def _fresh(self, solution: Solution, times: int) -> tuple[Share, Evidence]:
        """On systems never drawn before, `times` as many as in a trial."""
        self._looks += 1
        seed = self._stream(1 + self._looks)
        share, evidence = self._drawn(solution, times, seed, keep=200)
        if evidence is None:
            evidence = validate(solution, self._samples, seed=seed, executor=self._executor)
        return replace(share, confidence=_confidence(self._looks)), evidence

    def _hoped(self, share: Share, times: float) -> Share:
        """The expected result of the next look, at `times` as many systems, if they violated as often."""
        samples, confidence = round(times * share.samples), _confidence(self._looks + 1)
        if isinstance(share, Proportion):
            return Proportion(round(share.estimate * samples), samples, confidence)
        variance, largest = share.variance / times, share.largest / times
        return replace(share, variance=variance, largest=largest, samples=samples, confidence=confidence)

    def _drawn(self, solution: Solution, times: int, seed: int, keep: int) -> tuple[Share, Evidence | None]:
        count = self._samples * times
        if self._target * self._samples < _COUNTED:
            found = rare_violation(solution, self._names, count, seed=seed)
            if not isinstance(found, Proportion):
                return found, None
            count = min(times * int(np.ceil(_COUNTED / self._target)), _MOST_COUNTED)
        evidence = validate(solution, count, seed=seed, keep=keep, executor=self._executor)
        return evidence.violation(*self._names), evidence

    def _stream(self, number: int) -> int:
        """Seeds of independent streams: evidence that a user gathers with the same seed is still fresh."""
        return int(np.random.SeedSequence([self._seed, number]).generate_state(1)[0])

    def _enough_samples(self) -> str:
        """How many fresh systems would confirm the design, if they violated it as often as those before."""
        if self.fresh is None or self.fresh.estimate >= self._target:
            return ""
        factors = (2.0**power for power in range(1, 30))
        needed = next((one for one in factors if self._hoped(self.fresh, one).upper <= self._target), None)
        return "" if needed is None else f"about {needed * self.fresh.samples:.2g} fresh systems would tell"

    def _why_no_wider(self, search: MarginSearch) -> str:
        if np.isfinite(search.ceiling) and search.exhausted:
            return f"from sigmas = {search.ceiling:.4g} on there is no design ({search.failures[search.ceiling]})"
        if search.exhausted:
            return "and no wider margin is tried"
        return f"and the trials are used up: expected more than max_trials = {self._max_trials}"


def _confidence(look: int) -> float:
    """The confidence of a look at fresh systems, counted from 1: each is given half the error of the one before."""
    return 1 - 2 * _WRONG / 2**look


def _counted_names(problem: Problem, names: str | Sequence[str]) -> tuple[str, ...]:
    """The names, each once. Raises `ProblemError` for those of limits for which no margin can be found."""
    every = tuple(dict.fromkeys((names,) if isinstance(names, str) else members("calibrate: names", names, str)))
    if not every:
        raise refusal("calibrate: names", "a constraint's name, or several in a tuple", names)
    for name in every:
        constraints = problem.named(name)
        if reason := why_uncounted(problem, name):
            raise ProblemError(
                f"calibrate: no single system is counted against '{name}' ({constraints[0]}): it is {reason}."
            )
        if not any(one.expression.sigmas for one in constraints):
            raise ProblemError(
                f"calibrate: the constraints called '{name}' contain no standard deviation; set sigmas=1 in them."
            )
    if not problem.placements.germs:
        held = " (al.deterministic holds them at their means)" if uncertain(problem).placements.germs else ""
        raise ProblemError(f"calibrate: expected a problem with distributions{held}; received one without a spread.")
    return every
