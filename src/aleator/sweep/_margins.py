"""The search of a calibration: the margins tried, the choice of the next, and what the whole search finds."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
import scipy

from aleator._core.errors import AleatorError, SolveError
from aleator._core.leaves import Drawn, Printed
from aleator.design import Problem
from aleator.solution import Solution
from aleator.validation import Evidence, Proportion, Share


@final
@dataclass(frozen=True)
class Trial(Printed):
    """One multiple of the standard deviation that was tried: its optimal design and how often it is violated."""

    sigmas: float
    solution: Solution
    violation: Share

    def __str__(self) -> str:
        return f"{self.sigmas:8.4f} {self.solution.objective:12.6g}  {self.violation}"


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
        problem = self.solution.problem
        return {name: max(one.expression.sigmas or 0.0 for one in problem.named(name)) for name in self.names}

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


_SMALLEST, _LARGEST = 0.02, 20.0
# Margins with a smaller relative difference give the same design.
_SAME = 1e-3


@final
class MarginSearch:
    """A bracketed secant on the normal quantile of the violation probability, which falls as the multiple grows.

    - `sigmas`: the initial multiples, by the names of their constraints. Their ratios are kept, and a margin is the
      largest of them;
    - `measure`: how often a design is violated, on one random sample common to all designs;
    - `aim`: the measured rate at which fresh systems are likely to confirm a design;
    - `solve`: solves a problem, from a solution if one is given as `warm_start`.

    `following` is the multiple that is tried next. `tighten` lowers that aim after fresh systems did not confirm a
    design.
    """

    def __init__(
        self,
        problem: Problem,
        sigmas: Mapping[str, float],
        measure: Callable[[Solution], Share],
        aim: Callable[[Share], float],
        precision: float,
        solve: Callable[..., Solution],
    ):
        self._problem, self.following = problem, max(sigmas.values())
        self._shares = {name: one / self.following for name, one in sigmas.items()}
        self._measure, self._aim, self._precision, self._solve = measure, aim, precision, solve
        self._lowered = self._tightened = 1.0
        self.trials: list[Trial] = []
        self.failures: dict[float, AleatorError] = {}

    @property
    def ceiling(self) -> float:
        """The smallest multiple beyond all trials that is known to have no design; else infinite."""
        return min((sigmas for sigmas in self.failures if sigmas > self._widest), default=np.inf)

    @property
    def exhausted(self) -> bool:
        """Whether no wider margin is left to try: it is at its maximum, or wider ones have no design."""
        return self._widest >= min(_LARGEST, (1 - _SAME) * self.ceiling)

    @property
    def done(self) -> bool:
        """Whether a trial is just below the aim, or as close below it as any margin can be, or none is left to try."""
        meeting = self._meeting
        return any(map(self._settles, meeting)) or (not meeting and self.exhausted)

    @property
    def best(self) -> Trial:
        """The smallest margin that meets the aim; if none does, the one violated least often."""
        meeting = self._meeting
        return meeting[0] if meeting else min(self.trials, key=lambda one: (one.violation.estimate, -one.sigmas))

    def step(self) -> None:
        """Try one more multiple. One without a design, or whose design cannot be sampled, only bounds the search.

        Raises what the first trial raises.
        """
        sigmas = self.following
        try:
            solution = self._solved(sigmas)
            self.trials.append(Trial(sigmas, solution, self._measure(solution)))
        except AleatorError as error:
            if not self.trials:
                raise
            self.failures[sigmas] = error
        self.following = self._propose()

    def tighten(self, trial: Trial, fresh: Share) -> None:
        """Lower the aim by the factor, and a little more, by which fresh systems violated a trial too often."""
        measured = trial.violation.estimate
        self._tightened *= 0.85
        self._lowered = self._tightened * min(measured / fresh.estimate, 1.0) if fresh.estimate > 0 else self._tightened
        self.following = self._propose()

    def _solved(self, sigmas: float) -> Solution:
        problem = self._problem
        for name, share in self._shares.items():
            problem = problem.with_sigmas(name, share * sigmas)
        if self.trials:
            nearest = min(self.trials, key=lambda one: abs(one.sigmas - sigmas))
            with contextlib.suppress(SolveError):
                return self._solve(problem, warm_start=nearest.solution)
        return self._solve(problem)

    @property
    def _widest(self) -> float:
        return max((one.sigmas for one in self.trials), default=0.0)

    @property
    def _meeting(self) -> list[Trial]:
        """The trials that meet the aim, the smallest margin first."""
        meeting = [one for one in self.trials if one.violation.estimate <= self._limit(one.violation)]
        return sorted(meeting, key=lambda one: one.sigmas)

    def _limit(self, share: Share) -> float:
        return self._lowered * self._aim(share)

    def _settles(self, trial: Trial) -> bool:
        """Whether no smaller margin is worth trying than one that meets the aim."""
        share, least = trial.violation, (1 - self._precision) * self._limit(trial.violation)
        # With few systems there may be no integer count in between.
        is_counted = isinstance(share, Proportion)
        is_close = share.count >= np.floor(least * share.samples) if is_counted else share.estimate >= least
        # Where the constraints are inactive, the margin does not affect the design.
        idle = not set(self._shares) & set(trial.solution.active)
        meeting = {one.sigmas for one in self._meeting}
        too_small = [one.sigmas for one in self.trials if one.sigmas not in meeting] + list(self.failures)
        low = max((sigmas for sigmas in too_small if sigmas < trial.sigmas), default=0.0)
        return is_close or idle or trial.sigmas - low < _SAME * trial.sigmas or trial.sigmas <= _SMALLEST

    def _propose(self) -> float:
        """The secant through the two trials on either side of the aim, solved for a little below it."""
        meeting = self._meeting
        if not meeting:
            return min(self._widest * 1.5 + 0.1, _LARGEST, (self._widest + self.ceiling) / 2)
        high = meeting[0]
        low = max((one for one in self.trials if one.sigmas < high.sigmas), key=lambda one: one.sigmas, default=None)
        failed = max((sigmas for sigmas in self.failures if sigmas < high.sigmas), default=0.0)
        if low is None or failed > low.sigmas:
            return max((failed + high.sigmas) / 2, _SMALLEST)
        above, below = max(self._level(low), 0.0), min(self._level(high), 0.0)
        share = above / (above - below) if above > below else 0.5
        return low.sigmas + (high.sigmas - low.sigmas) * float(np.clip(share, 0.1, 0.9))

    def _level(self, trial: Trial) -> float:
        """The distance from the aim in normal quantiles: positive where violated too often."""
        one, aim = trial.violation, self._limit(trial.violation) * (1 - self._precision / 2)
        estimate = (one.count + 0.5) / (one.samples + 1) if isinstance(one, Proportion) else one.estimate
        return float(scipy.special.ndtri(estimate) - scipy.special.ndtri(aim))
