"""The search of a calibration: margins tried on one sample, and looks at fresh systems until these confirm a design."""

import bisect
import contextlib
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from typing import final

import numpy as np
import scipy

from aleator._core.errors import AleatorError, SolveError
from aleator._core.leaves import Printed
from aleator.design import Problem
from aleator.solution import Solution
from aleator.sweep._runner import Runner
from aleator.validation import Evidence, Proportion, Share, rare_violation, validate

# All looks at fresh systems together wrongly confirm a design in one calibration out of this many.
_WRONG = 1 / 40
# Fresh systems, as multiples of those in a trial: more are drawn while they are likely to confirm the design.
_FRESH = (2, 4, 8)
# With fewer violations expected at the target, importance sampling replaces counting.
COUNTED = 20
_MOST_COUNTED = 2_000_000
_LIKELY = 0.84  # standard deviations: fresh systems confirm a design that meets the aim in four cases out of five
_SMALLEST, _LARGEST = 0.02, 20.0
# Margins with a smaller relative difference give the same design.
_SAME = 1e-3


@final
@dataclass(frozen=True)
class Trial(Printed):
    """One multiple of the standard deviation that was tried: its optimal design and how often it is violated."""

    sigmas: float
    solution: Solution
    violation: Share

    def __str__(self) -> str:
        return f"{self.sigmas:8.4f} {self.solution.objective:12.6g}  {self.violation}"


def margins_of(problem: Problem, names: Sequence[str]) -> dict[str, float]:
    """The largest multiple of the standard deviation in the constraints of each name."""
    return {name: max(one.expression.sigmas or 0.0 for one in problem.named(name)) for name in names}


@final
@dataclass(eq=False)
class MarginSearch:
    """A bracketed secant on the normal quantile of the violation probability, which falls as the multiple grows.

    It leads to an aim below the target, at which fresh systems are likely to confirm a design; where they do not, the
    aim is lowered. Designs are compared on one random sample, common to all trials, and confirmed on fresh ones, each
    used once. The ratios between the multiples of several names are kept: a margin is the largest of them.

    - `solve`: solves a problem, from a solution if one is given as `warm_start`; the others are those of `calibrate`;
    - `chosen`, `fresh`, `evidence`: the design last checked on fresh systems, and the results;
    - `missing`: why no design is confirmed.
    """

    problem: Problem
    names: tuple[str, ...]
    target: float
    samples: int
    seed: int
    precision: float
    max_trials: int
    solve: Callable[..., Solution]
    executor: Executor | None
    trials: list[Trial] = field(default_factory=list)
    chosen: Trial | None = None
    fresh: Share | None = None
    evidence: Evidence | None = None
    missing: str = ""

    def __post_init__(self) -> None:
        sigmas = margins_of(self.problem, self.names)
        self._following = max(sigmas.values())
        self._ratios = {name: one / self._following for name, one in sigmas.items()}
        self._lowered = self._tightened = 1.0
        self._failures: dict[float, AleatorError] = {}
        self._tried = self._looks = 0

    def find(self, run: Runner) -> None:
        """Search and confirm until a design is confirmed or there is nothing left to try."""
        while True:
            while self._tried < self.max_trials and not self._is_done:
                with self._step(run, self._following):
                    self._try(self._following)
                self._tried += 1
            best = self.best
            if best.violation.estimate > self.target:
                self.missing = f"no margin tried is violated rarely enough, {self._why_no_wider()}"
                return
            if self._confirm(best, run):
                run.progress(self._task, self.max_trials, self.max_trials)
                return
            if self._tried < self.max_trials and self.fresh is not None:
                self._tighten(best, self.fresh)
            if self._tried >= self.max_trials or (self._is_done and self.best is best):
                self.missing = "; ".join(filter(None, [self._enough_samples(), self._why_no_wider()]))
                return

    @property
    def _task(self) -> str:
        return f"calibration of {' or '.join(self.names)}"

    def _step(self, run: Runner, sigmas: float) -> contextlib.AbstractContextManager[None]:
        return run.step(self._task, self._tried, self.max_trials, f"at sigmas = {sigmas:.4g}")

    # --- Margins -----------------------------------------------------------------------------------------------------

    @property
    def best(self) -> Trial:
        """The smallest margin that meets the aim; if none does, the one violated least often."""
        meeting = self._meeting
        return meeting[0] if meeting else min(self.trials, key=lambda one: (one.violation.estimate, -one.sigmas))

    @property
    def _meeting(self) -> list[Trial]:
        """The trials that meet the aim, the smallest margin first."""
        meeting = [one for one in self.trials if one.violation.estimate <= self._aim(one.violation)]
        return sorted(meeting, key=lambda one: one.sigmas)

    @property
    def _widest(self) -> float:
        return max((one.sigmas for one in self.trials), default=0.0)

    @property
    def _ceiling(self) -> float:
        """The smallest multiple beyond all trials that is known to have no design; else infinite."""
        return min((sigmas for sigmas in self._failures if sigmas > self._widest), default=np.inf)

    @property
    def _is_exhausted(self) -> bool:
        """Whether no wider margin is left to try: it is at its maximum, or wider ones have no design."""
        return self._widest >= min(_LARGEST, (1 - _SAME) * self._ceiling)

    @property
    def _is_done(self) -> bool:
        """Whether a trial is just below the aim, or as close below it as any margin can be, or none is left to try."""
        meeting = self._meeting
        return any(map(self._settles, meeting)) or (not meeting and self._is_exhausted)

    def _settles(self, trial: Trial) -> bool:
        """Whether no smaller margin is worth trying than one that meets the aim."""
        share, least = trial.violation, (1 - self.precision) * self._aim(trial.violation)
        # With few systems there may be no integer count in between.
        is_counted = isinstance(share, Proportion)
        is_close = share.count >= np.floor(least * share.samples) if is_counted else share.estimate >= least
        # Where the constraints are inactive, the margin does not affect the design.
        idle = not set(self._ratios) & set(trial.solution.active)
        meeting = {one.sigmas for one in self._meeting}
        too_small = [one.sigmas for one in self.trials if one.sigmas not in meeting] + list(self._failures)
        low = max((sigmas for sigmas in too_small if sigmas < trial.sigmas), default=0.0)
        return is_close or idle or trial.sigmas - low < _SAME * trial.sigmas or trial.sigmas <= _SMALLEST

    def _try(self, sigmas: float) -> None:
        """Try a multiple. One without a design, or whose design cannot be sampled, only bounds the search.

        Raises what the first trial raises.
        """
        try:
            solution = self._solved(sigmas)
            share, _ = self._drawn(solution, 1, self._stream(1), keep=0)
            self.trials.append(Trial(sigmas, solution, share))
        except AleatorError as error:
            if not self.trials:
                raise
            self._failures[sigmas] = error
        self._following = self._proposed()

    def _solved(self, sigmas: float) -> Solution:
        problem = self.problem
        for name, ratio in self._ratios.items():
            problem = problem.with_sigmas(name, ratio * sigmas)
        if self.trials:
            nearest = min(self.trials, key=lambda one: abs(one.sigmas - sigmas))
            with contextlib.suppress(SolveError):
                return self.solve(problem, warm_start=nearest.solution)
        return self.solve(problem)

    def _proposed(self) -> float:
        """The secant through the two trials on either side of the aim, solved for a little below it."""
        meeting = self._meeting
        if not meeting:
            widest = max(self.trials, key=lambda one: one.sigmas)
            return min(widest.sigmas + self._reach(widest), _LARGEST, (widest.sigmas + self._ceiling) / 2)
        high = meeting[0]
        low = max((one for one in self.trials if one.sigmas < high.sigmas), key=lambda one: one.sigmas, default=None)
        failed = max((sigmas for sigmas in self._failures if sigmas < high.sigmas), default=0.0)
        if low is None or failed > low.sigmas:
            return max(high.sigmas - self._reach(high), (failed + high.sigmas) / 2, _SMALLEST)
        above, below = max(self._level(low), 0.0), min(self._level(high), 0.0)
        share = above / (above - below) if above > below else 0.5
        return low.sigmas + (high.sigmas - low.sigmas) * float(np.clip(share, 0.1, 0.9))

    def _reach(self, trial: Trial) -> float:
        """How far to go to the other side of the aim: a little more than where normal outputs have it, or half."""
        further = (1.2 * abs(self._level(trial)) + 0.02 * trial.sigmas) * 2.0 ** (len(self.trials) - 1)
        return min(further, 0.5 * trial.sigmas + 0.1)

    def _level(self, trial: Trial) -> float:
        """The distance from the aim in normal quantiles: positive where violated too often."""
        one, aim = trial.violation, self._aim(trial.violation) * (1 - self.precision / 2)
        estimate = (one.count + 0.5) / (one.samples + 1) if isinstance(one, Proportion) else one.estimate
        return float(scipy.special.ndtri(estimate) - scipy.special.ndtri(aim))

    def _tighten(self, trial: Trial, fresh: Share) -> None:
        """Lower the aim by the factor, and a little more, by which fresh systems violated a trial too often."""
        self._tightened *= 0.85
        factor = min(trial.violation.estimate / fresh.estimate, 1.0) if fresh.estimate > 0 else 1.0
        self._lowered = self._tightened * factor
        self._following = self._proposed()

    # --- Systems -----------------------------------------------------------------------------------------------------

    def _aim(self, share: Share) -> float:
        """The violation rate of a trial's sample at which the next look is likely to confirm the design.

        Both have sampling errors: a variance of `p / n` for the first, and half of that for the second, with twice as
        many systems.
        """
        confidence = _confidence(self._looks + 1)
        if not isinstance(share, Proportion):
            known = scipy.special.ndtri((1 + confidence) / 2)
            errors = known / np.sqrt(_FRESH[0]) + _LIKELY * np.sqrt(1 + 1 / _FRESH[0])
            return self._lowered * self.target * float(np.exp(-errors / np.sqrt(share.effective)))
        samples = _FRESH[0] * share.samples
        counts = range(int(self.target * samples) + 1)
        most = bisect.bisect_right(counts, self.target, key=lambda count: Proportion(count, samples, confidence).upper)
        # The expected count that stays at `most - 1` or below, allowing for its error and that of the trial.
        error = _LIKELY * np.sqrt(1 + _FRESH[0])
        return self._lowered * float((np.sqrt(error**2 + 4 * max(most - 0.5, 0.0)) - error) ** 2 / 4 / samples)

    def _confirm(self, trial: Trial, run: Runner) -> bool:
        """Whether fresh systems confirm a design; more are drawn while that is likely to confirm it."""
        self.chosen, self.fresh, self.evidence = trial, None, None
        for times in _FRESH:
            with self._step(run, trial.sigmas):
                self.fresh, self.evidence = self._fresh(trial.solution, times)
            if self.fresh.upper <= self.target:
                return True
            if self._hoped(self.fresh, 2).upper > self.target:
                break
        return False

    def _fresh(self, solution: Solution, times: int) -> tuple[Share, Evidence]:
        """On systems never drawn before, `times` as many as in a trial."""
        self._looks += 1
        seed = self._stream(1 + self._looks)
        share, evidence = self._drawn(solution, times, seed, keep=200)
        if evidence is None:
            evidence = validate(solution, self.samples, seed=seed, executor=self.executor)
        return replace(share, confidence=_confidence(self._looks)), evidence

    def _hoped(self, share: Share, times: float) -> Share:
        """The expected result of the next look, at `times` as many systems, if they violated as often."""
        samples, confidence = round(times * share.samples), _confidence(self._looks + 1)
        if isinstance(share, Proportion):
            return Proportion(round(share.estimate * samples), samples, confidence)
        variance, largest = share.variance / times, share.largest / times
        return replace(share, variance=variance, largest=largest, samples=samples, confidence=confidence)

    def _drawn(self, solution: Solution, times: int, seed: int, keep: int) -> tuple[Share, Evidence | None]:
        """How often systems violate a design, and the evidence if they were counted."""
        count = self.samples * times
        if self.target * self.samples < COUNTED:
            found = rare_violation(solution, self.names, count, seed=seed)
            if not isinstance(found, Proportion):
                return found, None
            count = min(times * int(np.ceil(COUNTED / self.target)), _MOST_COUNTED)
        evidence = validate(solution, count, seed=seed, keep=keep, executor=self.executor)
        return evidence.violation(*self.names), evidence

    def _stream(self, number: int) -> int:
        """Seeds of independent streams: evidence that a user gathers with the same seed is still fresh."""
        return int(np.random.SeedSequence([self.seed, number]).generate_state(1)[0])

    def _enough_samples(self) -> str:
        """How many fresh systems would confirm the design, if they violated it as often as those before."""
        if self.fresh is None or self.fresh.estimate >= self.target:
            return ""
        factors = (2.0**power for power in range(1, 30))
        needed = next((one for one in factors if self._hoped(self.fresh, one).upper <= self.target), None)
        return "" if needed is None else f"about {needed * self.fresh.samples:.2g} fresh systems would tell"

    def _why_no_wider(self) -> str:
        if np.isfinite(self._ceiling) and self._is_exhausted:
            return f"from sigmas = {self._ceiling:.4g} on there is no design ({self._failures[self._ceiling]})"
        if self._is_exhausted:
            return "and no wider margin is tried"
        return f"and the trials are used up: expected more than max_trials = {self.max_trials}"


def _confidence(look: int) -> float:
    """The confidence of a look at fresh systems, counted from 1: each is given half the error of the one before."""
    return 1 - 2 * _WRONG / 2**look
