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


def _stream(seed: int, number: int) -> int:
    """Seeds of independent streams: evidence that a user gathers with the same seed is still fresh."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1)[0])


def _confidence(look: int) -> float:
    """The confidence of a look at fresh systems, counted from 1: each is given half the error of the one before."""
    return 1 - 2 * _WRONG / 2**look


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
        self._margins = margins_of(self.problem, self.names)
        self._lowered = self._tightened = 1.0
        self._failures: dict[float, AleatorError] = {}
        self._tried = self._looks = 0

    def find(self, run: Runner) -> None:
        """Search and confirm until a design is confirmed or there is nothing left to try."""
        best = None
        while True:
            while self._tried < self.max_trials and (sigmas := self._proposed()) is not None:
                with self._step(run, sigmas):
                    self._try(sigmas)
                self._tried += 1
            before, best = best, self.best
            if best.violation.estimate > self.target:
                self.missing = f"no margin tried is violated rarely enough, {self._why_no_wider()}"
                return
            if best is before or self._confirm(best, run):
                break
            if self._tried >= self.max_trials:
                break
            self._tighten(best)
        if self.fresh is not None and self.fresh.upper <= self.target:
            run.progress(self._task, self.max_trials, self.max_trials)
        else:
            self.missing = f"more fresh systems would tell, {self._why_no_wider()}"

    @property
    def _task(self) -> str:
        return f"calibration of {' or '.join(self.names)}"

    def _step(self, run: Runner, sigmas: float) -> contextlib.AbstractContextManager[None]:
        return run.step(self._task, self._tried, self.max_trials, f"at sigmas = {sigmas:.4g}")

    # --- Margins -----------------------------------------------------------------------------------------------------

    @property
    def best(self) -> Trial:
        """The smallest margin that meets the aim; if none does, the one violated least often."""
        least = min(self.trials, key=lambda one: (one.violation.estimate, -one.sigmas))
        return min(self._meeting, key=lambda one: one.sigmas, default=least)

    @property
    def _meeting(self) -> list[Trial]:
        """The trials that meet the aim."""
        return [one for one in self.trials if one.violation.estimate <= self._aim(one.violation)]

    @property
    def _widest(self) -> Trial:
        return max(self.trials, key=lambda one: one.sigmas)

    @property
    def _ceiling(self) -> float:
        """The smallest multiple beyond all trials that is known to have no design; else infinite."""
        return min((sigmas for sigmas in self._failures if sigmas > self._widest.sigmas), default=np.inf)

    @property
    def _is_exhausted(self) -> bool:
        """Whether no wider margin is left to try: it is at its maximum, or wider ones have no design."""
        return self._widest.sigmas >= min(_LARGEST, (1 - _SAME) * self._ceiling)

    def _proposed(self) -> float | None:
        """The next margin to try; None if one is as close below the aim as any can be, or if none wider is left.

        It is that of the secant through the two trials on either side of the aim, solved for a little below it.
        """
        if not self.trials:
            return max(self._margins.values())
        meeting = self._meeting
        if not meeting:
            widest, reach = self._widest, self._reach(self._widest)
            next_one = min(widest.sigmas + reach, _LARGEST, (widest.sigmas + self._ceiling) / 2)
            return None if self._is_exhausted else next_one
        if any(self._settles(one, meeting) for one in meeting):
            return None
        high = min(meeting, key=lambda one: one.sigmas)
        low = max((one for one in self.trials if one.sigmas < high.sigmas), key=lambda one: one.sigmas, default=None)
        failed = max((sigmas for sigmas in self._failures if sigmas < high.sigmas), default=0.0)
        if low is None or failed > low.sigmas:
            return max(high.sigmas - self._reach(high), (failed + high.sigmas) / 2, _SMALLEST)
        above, below = max(self._level(low), 0.0), min(self._level(high), 0.0)
        share = above / (above - below) if above > below else 0.5
        return low.sigmas + (high.sigmas - low.sigmas) * float(np.clip(share, 0.1, 0.9))

    def _settles(self, trial: Trial, meeting: Sequence[Trial]) -> bool:
        """Whether no smaller margin is worth trying than one that meets the aim, as others do."""
        share, least = trial.violation, (1 - self.precision) * self._aim(trial.violation)
        # With few systems there may be no integer count in between.
        is_counted = isinstance(share, Proportion)
        is_close = share.count >= np.floor(least * share.samples) if is_counted else share.estimate >= least
        # Where the constraints are inactive, the margin does not affect the design.
        is_idle = not set(self.names) & set(trial.solution.active)
        too_small = [one.sigmas for one in self.trials if one not in meeting] + list(self._failures)
        low = max((sigmas for sigmas in too_small if sigmas < trial.sigmas), default=0.0)
        return is_close or is_idle or trial.sigmas - low < _SAME * trial.sigmas or trial.sigmas <= _SMALLEST

    def _reach(self, trial: Trial) -> float:
        """How far to go to the other side of the aim: a little more than where normal outputs have it, or half."""
        further = (1.2 * abs(self._level(trial)) + 0.02 * trial.sigmas) * 2.0 ** (len(self.trials) - 1)
        return min(further, 0.5 * trial.sigmas + 0.1)

    def _level(self, trial: Trial) -> float:
        """The distance from the aim in normal quantiles: positive where violated too often."""
        one, aim = trial.violation, self._aim(trial.violation) * (1 - self.precision / 2)
        estimate = (one.count + 0.5) / (one.samples + 1) if isinstance(one, Proportion) else one.estimate
        return float(scipy.special.ndtri(estimate) - scipy.special.ndtri(aim))

    def _try(self, sigmas: float) -> None:
        """Try a multiple. One without a design, or whose design cannot be sampled, only bounds the search.

        Raises what the first trial raises.
        """
        try:
            solution = self._solved(sigmas)
            share, _ = self._drawn(solution, 1, _stream(self.seed, 1), keep=0)
            self.trials.append(Trial(sigmas, solution, share))
        except AleatorError as error:
            if not self.trials:
                raise
            self._failures[sigmas] = error

    def _solved(self, sigmas: float) -> Solution:
        problem, largest = self.problem, max(self._margins.values())
        for name, one in self._margins.items():
            problem = problem.with_sigmas(name, one / largest * sigmas)
        if self.trials:
            nearest = min(self.trials, key=lambda one: abs(one.sigmas - sigmas))
            with contextlib.suppress(SolveError):
                return self.solve(problem, warm_start=nearest.solution)
        return self.solve(problem)

    def _why_no_wider(self) -> str:
        if not self._is_exhausted:
            return f"and the trials are used up: expected more than max_trials = {self.max_trials}"
        if np.isinf(self._ceiling):
            return "and no wider margin is tried"
        return f"from sigmas = {self._ceiling:.4g} on there is no design ({self._failures[self._ceiling]})"

    # --- Systems -----------------------------------------------------------------------------------------------------

    def _aim(self, share: Share) -> float:
        """The violation rate of a trial's sample to search for."""
        return self._lowered * self._confirmable(share)

    def _confirmable(self, share: Share) -> float:
        """The violation rate of a sample at which the next look, at twice as many systems, is likely to confirm it.

        Both have sampling errors: a variance of `p / n` for the first, and half of that for the second.
        """
        confidence = _confidence(self._looks + 1)
        if not isinstance(share, Proportion):
            known = scipy.special.ndtri((1 + confidence) / 2)
            errors = known / np.sqrt(_FRESH[0]) + _LIKELY * np.sqrt(1 + 1 / _FRESH[0])
            return self.target * float(np.exp(-errors / np.sqrt(share.effective)))
        samples = _FRESH[0] * share.samples
        counts = range(int(self.target * samples) + 1)
        most = bisect.bisect_right(counts, self.target, key=lambda count: Proportion(count, samples, confidence).upper)
        # The expected count that stays at `most - 1` or below, allowing for its error and that of the trial.
        error = _LIKELY * np.sqrt(1 + _FRESH[0])
        return float((np.sqrt(error**2 + 4 * max(most - 0.5, 0.0)) - error) ** 2 / 4 / samples)

    def _tighten(self, trial: Trial) -> None:
        """Lower the aim by the factor, and a little more, by which fresh systems violated a trial too often."""
        assert self.fresh is not None
        self._tightened *= 0.85
        factor = min(trial.violation.estimate / self.fresh.estimate, 1.0) if self.fresh.estimate > 0 else 1.0
        self._lowered = self._tightened * factor

    def _confirm(self, trial: Trial, run: Runner) -> bool:
        """Whether fresh systems confirm a design; more are drawn while that is likely to confirm it."""
        self.chosen, self.fresh, self.evidence = trial, None, None
        for times in _FRESH:
            with self._step(run, trial.sigmas):
                self.fresh, self.evidence = self._fresh(trial.solution, times)
            if self.fresh.upper <= self.target:
                return True
            if self.fresh.estimate > self._confirmable(self.fresh):
                break
        return False

    def _fresh(self, solution: Solution, times: int) -> tuple[Share, Evidence]:
        """On systems never drawn before, `times` as many as in a trial."""
        self._looks += 1
        seed = _stream(self.seed, 1 + self._looks)
        share, evidence = self._drawn(solution, times, seed, keep=200)
        if evidence is None:
            evidence = validate(solution, self.samples, seed=seed, executor=self.executor)
        return replace(share, confidence=_confidence(self._looks)), evidence

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
