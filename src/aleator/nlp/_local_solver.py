"""The stages of a local solve, the same for every library: scale, run, judge, report."""

import abc
import dataclasses
import time
from dataclasses import dataclass

import numpy as np
from typing_extensions import override

from aleator._core import border
from aleator.nlp._certificate import kinks_at
from aleator.nlp._evaluations import HaltedError, NotFiniteError, NowhereFiniteError
from aleator.nlp._program import Evaluation, NonlinearProgram
from aleator.nlp._scaling import ScaledProgram
from aleator.nlp._solver import AbstractSolver, Outcome, Searched, Status
from aleator.nlp._verdict import Answer, Verdict, has_run_away, judge, settle

# Rounds from a steep start, each of which lowers the slope of the objective by many orders of magnitude.
_MOST_ROUNDS = 4
# Curvature from a steep start can make a solver very slow, and so can approximated curvature anywhere. So rounds leave
# this part of the iterations, if there are enough of them, to later rounds in a better scale, or with differences.
_LEFT_OVER, _WORTH_SHARING = 4, 50
# Solvers aim at this part of the tolerance, because they run in another scale than that of the verdict.
_AIM = 1e-2
# No solver gets closer than this.
_LEAST_AIM = 1e-13


@dataclass(frozen=True)
class AbstractLocalSolver(AbstractSolver):
    """Finds a local optimum by derivatives. Implementations only run their library on the scaled program.

    - `tolerance`: see `AbstractSolver`; the library itself aims at a hundredth of it (`aim`);
    - `max_iterations`: the limit of iterations, restarts included.

    If the library ends at a point that is not within the tolerance in scales taken there, or from which the objective
    still falls noticeably, it is restarted from that point in those scales; more restarts follow only with second
    derivatives by differences where an approximation got no further.
    """

    max_iterations: int = 500

    def __post_init__(self) -> None:
        super().__post_init__()
        border.whole(f"{type(self).__name__}: max_iterations", self.max_iterations)

    @property
    def aim(self) -> float:
        """The tolerance for the library, in the scales in which it runs."""
        return max(_AIM * self.tolerance, _LEAST_AIM)

    @override
    def solve(
        self,
        program: NonlinearProgram,
        *,
        multipliers: np.ndarray | None = None,
        start: np.ndarray | None = None,
    ) -> Outcome:
        began = time.perf_counter()
        self.require()
        scaled = ScaledProgram(program, program.start if start is None else start)
        with scaled.evaluations.noting_interrupts():
            verdict = self._judged(scaled, multipliers)
            if verdict.answer.claim is Status.FAILED:
                verdict = self._with_kinks_held(program, scaled, verdict)
        seconds = time.perf_counter() - began
        answer, user = verdict.answer, verdict.user
        rows, bounds = scaled.to_user(verdict.multipliers, user)
        active, active_bounds = scaled.active(answer.point, user, verdict.multipliers)
        objectives, violations = np.array(scaled.evaluations.visited).reshape(-1, 2).T
        return Outcome(
            status=answer.claim,
            point=scaled.unscaled(answer.point),
            evaluation=user,
            multipliers=rows,
            bound_multipliers=bounds,
            **dataclasses.asdict(verdict.certificate),
            iterations=answer.iterations,
            evaluations=len(objectives),
            seconds=seconds,
            solver=self.name,
            message=f"{verdict.reason} (the solver said: {answer.message})" if verdict.reason else answer.message,
            active=active,
            active_bounds=active_bounds,
            sizes=scaled.every_scale,
            failed_at=scaled.evaluations.failed_at if answer.claim is Status.EVALUATION_FAILED else None,
            strayed=verdict.strayed,
            visited=Searched(self.name, objectives, violations, answer.message, seconds),
        )

    @abc.abstractmethod
    def minimise(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        """Run the library from `scaled.start`.

        `multipliers` are scaled, shape (m_useful,), or None for a cold start. May raise
        `HaltedError` and `KeyboardInterrupt`.
        """

    def _judged(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Verdict:
        """The verdict for every way in which a run ends, or the model's exception."""
        answer = Answer(Status.FAILED, scaled.start, message="stopped by the model")
        try:
            answer = self._rounds(scaled, multipliers)
            if scaled.evaluations.halt is None:
                return judge(scaled, answer, self.tolerance)
        except HaltedError:
            pass
        except KeyboardInterrupt as interrupt:
            scaled.evaluations.halt = interrupt
        halt = scaled.evaluations.halt
        if isinstance(halt, KeyboardInterrupt):
            answer = answer._replace(claim=Status.INTERRUPTED, multipliers=None, message="interrupted by the user")
        elif isinstance(halt, NowhereFiniteError):
            message = f"the model is {halt}, {answer.message}"
            answer = Answer(Status.EVALUATION_FAILED, scaled.start, iterations=answer.iterations, message=message)
        elif halt is not None:
            raise halt
        return judge(scaled, answer, self.tolerance)

    def _with_kinks_held(self, program: NonlinearProgram, scaled: ScaledProgram, verdict: Verdict) -> Verdict:
        """The optimum along the kinks at an answer, if that is one in all; else the verdict unchanged.

        A function may have a kink, as a standard deviation has where it becomes zero: at a bound, or in a limit.
        Derivatives there say nothing of those beside it, and the library makes no more progress. So the variables at a
        bound stay there, and none moves across a kink of a row.
        """
        answer, point = verdict.answer, scaled.unscaled(verdict.answer.point)
        if not isinstance(scaled.sparsity, np.ndarray):
            return verdict
        kinks = kinks_at(scaled, answer.point)
        at_bound = ((point == program.lower) | (point == program.upper)) & (program.lower < program.upper)
        normals = np.eye(point.size)[at_bound] if kinks is None else kinks.normals
        if not len(normals):
            return verdict
        held = ScaledProgram(_along(program, normals, point), point)
        further = self._judged(held, None).answer
        scaled.evaluations.visited += held.evaluations.visited
        further = further._replace(multipliers=None, iterations=answer.iterations + further.iterations)
        again = judge(scaled, further, self.tolerance)
        return again if again.answer.claim is Status.SOLVED else verdict

    def _rounds(self, scaled: ScaledProgram, multipliers: np.ndarray | None) -> Answer:
        """Minimise, and repeat from the answer in the scales taken there, until it is accepted in them."""
        try:
            scaled.begin()
        except NotFiniteError:
            return Answer(Status.EVALUATION_FAILED, scaled.start, message="the model is not finite at the start")
        if scaled.size == 0:
            return Answer(Status.SOLVED, scaled.start, message="every variable is fixed")
        if multipliers is not None:
            multipliers = scaled.to_scaled(multipliers)
        spent, rounds, tried = 0, 0, False
        while True:
            rounds += 1
            left = self.max_iterations - spent
            shared = left >= _WORTH_SHARING and (rounds == 1 or scaled.can_take_differences)
            share = left - left // _LEFT_OVER if shared else left
            pattern = scaled.sparsity
            try:
                answer = dataclasses.replace(self, max_iterations=share).minimise(scaled, multipliers)
            except NotFiniteError:
                message = "the model cannot be evaluated there"
                answer = Answer(Status.EVALUATION_FAILED, scaled.start, message=message)
            spent += answer.iterations
            answer = answer._replace(point=np.array(answer.point, dtype=float), iterations=spent)
            if scaled.evaluations.halt is not None:
                return answer
            if not scaled.user(answer.point).is_finite:
                return answer._replace(claim=Status.EVALUATION_FAILED)
            answer, stands = settle(scaled, answer, self.tolerance)
            if stands or rounds == _MOST_ROUNDS or spent >= self.max_iterations:
                return answer
            is_straight = scaled.evaluations.is_straight
            in_vain = bool(answer.unfinished) or answer.claim is Status.ITERATION_LIMIT or is_straight
            is_near = is_straight or not has_run_away(scaled, answer.point)
            sharper = (in_vain or tried) and is_near and scaled.take_differences()
            # A pattern that was outgrown says nothing of the scales.
            if not in_vain and scaled.sparsity is pattern:
                if tried and not sharper:
                    return answer
                tried = True
            multipliers = None if answer.multipliers is None else answer.multipliers.rows


def _along(program: NonlinearProgram, normals: np.ndarray, point: np.ndarray) -> NonlinearProgram:
    """The program of which no point leaves the planes through `point` with some normals, shape (k, n)."""

    def evaluate(x: np.ndarray) -> Evaluation:
        there = program.evaluate(x)
        constraints = np.append(there.constraints, normals @ (x - point))
        return there._replace(constraints=constraints, jacobian=np.concatenate([there.jacobian, normals]))

    zeros, sizes = np.zeros(len(normals)), np.abs(normals) @ program.variable_scale
    own = program.sizes or (lambda *_: program.constraint_scale)
    return dataclasses.replace(
        program,
        evaluate=evaluate,
        constraint_lower=np.append(program.constraint_lower, zeros),
        constraint_upper=np.append(program.constraint_upper, zeros),
        constraint_scale=np.append(program.constraint_scale, sizes),
        sizes=lambda x, there: np.append(own(x, there), sizes),
        sparsity=None,
        hessian=None,
    )
