"""One evaluation of the model per point, whatever a solver requests, with its failures recorded."""

import contextlib
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, final

import numpy as np

from aleator._core.errors import ProblemError
from aleator._core.parallel import noting
from aleator.nlp._matrices import checked_sparse, entries, with_entries
from aleator.nlp._program import Evaluation, NonlinearProgram


@final
class NotFiniteError(ArithmeticError):
    """The model cannot be evaluated at this point; the solver should step back."""


@final
class HaltedError(RuntimeError):
    """The solve must end: `Evaluations.halt` holds the reason."""


@final
class NowhereFiniteError(ArithmeticError):
    """Too many points in a row could not be evaluated for stepping back to help."""


# A step halved this often is below rounding.
_MOST_FAILURES = 60
# A solver that gives up within this many points after a failed one is presumed to do so because of it.
_RECENT = 20
# Finite points that are remembered.
_REMEMBERED = 16
# So many points, one of them so many typical magnitudes away from the first, show that nothing curves; slopes that
# differ by less than this part of themselves, or of the largest, are the same.
_POINTS, _AWAY, _SAME, _NOTHING = 10, 1e-2, 1e-12, 1e-13


@final
class Evaluations:
    """Evaluates points of a program, remembering the last few, and keeps the exception that ended the solve.

    Solvers in C++ swallow exceptions of their callbacks. So the first one is kept in `halt` and every later call
    raises: the solver then ends quickly, and the caller of `solve` gets the original exception.

    - `visited`: objective, and largest violation over the program's scales, of every point evaluated, shape (2,) each;
    - `halt`: the exception that ends the solve; None if there is none;
    - `last`: the latest evaluation; NaN before the first;
    - `failed_at`: the latest point that could not be evaluated, shape (n,); None if there is none.
    """

    def __init__(self, program: NonlinearProgram):
        variables, constraints = program.start.size, program.constraint_lower.size
        self._program = program
        self._shapes = ((variables,), (constraints,), (constraints, variables))
        self._sparsity: Any = None if isinstance(program.sparsity, np.ndarray) else program.sparsity
        self._points: OrderedDict[bytes, Evaluation] = OrderedDict()
        self._failed = b""
        self._first: tuple[np.ndarray, np.ndarray] | None = None
        self._is_curved = self._went_far = False
        self.visited: list[tuple[float, float]] = []
        self.halt: BaseException | None = None
        self.failed_at: np.ndarray | None = None
        sparsity, (gradient, rows, whole) = self._sparsity, self._shapes
        unknown = np.full(whole, np.nan) if sparsity is None else with_entries(sparsity, np.full(sparsity.nnz, np.nan))
        self.last = Evaluation(np.nan, np.full(gradient, np.nan), np.full(rows, np.nan), unknown)

    def at(self, x: np.ndarray) -> Evaluation:
        """Evaluate `x`; the result may be non-finite.

        Raises `HaltedError` if an exception ended the solve, now or before.
        """
        key = x.tobytes()
        if self.halt is not None or key not in self._points:
            self.asked(lambda: self._compute(key, x))
        self.last = self._points[key]
        return self.last

    def asked(self, question: Callable[[], Any]) -> Any:
        """Call the model for something else, such as second derivatives. Raises `HaltedError` as `at` does."""
        if self.halt is not None:
            raise HaltedError from self.halt
        try:
            return question()
        except BaseException as error:
            self.halt = error
            raise HaltedError from error

    @property
    def failed_recently(self) -> bool:
        """Whether one of the latest points could not be evaluated."""
        return any(np.isnan(objective) for objective, _ in self.visited[-_RECENT:])

    @property
    def is_straight(self) -> bool:
        """Whether enough points were seen, and all of them had the same slopes, as those of a linear program.

        Approximations of second derivatives learn from changes of slopes: where there are none, every step remains as
        short as the first.
        """
        return self._went_far and not self._is_curved and len(self.visited) >= _POINTS

    def finite_at(self, x: np.ndarray) -> Evaluation:
        """Evaluate `x` where the model is finite.

        Raises `NotFiniteError` if some of its numbers are not finite, `HaltedError` if an exception ended the solve,
        now or before.
        """
        evaluation = self.at(x)
        if x.tobytes() == self._failed:
            raise NotFiniteError
        return evaluation

    def noting_interrupts(self) -> contextlib.AbstractContextManager[None]:
        """Keep a Ctrl-C that arrives inside a solver's own code, where the exception itself would be swallowed."""

        def note() -> None:
            self.halt = self.halt or KeyboardInterrupt()

        return noting(note)

    def _compute(self, key: bytes, x: np.ndarray) -> None:
        program = self._program
        self.visited.append((np.nan, np.nan))
        evaluation = self._checked(program.evaluate(x.copy()))
        if evaluation.is_finite:
            excess = program.limits.excess(evaluation.constraints) / program.constraint_scale
            self.visited[-1] = evaluation.objective, float(excess.max(initial=0.0))
            self._note_slopes(x, evaluation)
        else:
            # One failure at most is remembered: they must not displace points to which a solver steps back.
            self._points.pop(self._failed, None)
            self._failed, self.failed_at = key, x.copy()
        self._points[key] = evaluation
        if len(self._points) > _REMEMBERED:
            self._points.popitem(last=False)
        latest = self.visited[-_MOST_FAILURES:]
        if len(latest) == _MOST_FAILURES and np.isnan(latest).all():
            raise NowhereFiniteError(f"not finite at {_MOST_FAILURES} points in a row")

    def _note_slopes(self, x: np.ndarray, evaluation: Evaluation) -> None:
        if self._is_curved:
            return
        slopes = np.append(evaluation.gradient, entries(evaluation.jacobian))
        start, first = self._first = self._first or (x.copy(), slopes)
        allowed = _SAME * np.abs(first) + _NOTHING * np.abs(first).max(initial=0.0)
        self._is_curved = bool(np.any(np.abs(slopes - first) > allowed))
        self._went_far |= bool(np.any(np.abs(x - start) > _AWAY * self._program.variable_scale))

    def _checked(self, evaluation: Evaluation) -> Evaluation:
        # Copies, because a model may reuse its arrays.
        dense = evaluation[1:] if self._sparsity is None else evaluation[1:3]
        arrays: list[Any] = [np.array(part, dtype=float) for part in dense]
        if self._sparsity is not None:
            arrays.append(checked_sparse("Jacobian", evaluation.jacobian, self._sparsity))
        shapes = tuple(array.shape for array in arrays)
        if shapes != self._shapes:
            raise ProblemError(
                f"Expected gradient, constraints and jacobian of shapes {self._shapes}. Received {shapes}."
            )
        return Evaluation(float(evaluation[0]), *arrays)
