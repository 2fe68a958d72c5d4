"""Functions of expressions for objectives and limits: maxima, positive parts, a user's own."""

from collections.abc import Callable
from typing import Any

from aleator._core.border import refusal
from aleator._core.errors import ProblemError
from aleator.design._expression import Expression, composed
from aleator.design._numbers import smoothing_given
from aleator.design._rules import Extremum, Own, PositivePart, Pure


def maximum(*expressions: Any, smoothing: float = 0.0) -> Expression:
    """The largest of expressions and numbers, at every instant if one is a path.

    - `smoothing`: rounds the kinks where the largest changes, in the unit of the expressions: `s log(exp(x/s) + …)`,
      which is at most `s log n` above the largest of `n`.

    Raises `ProblemError` for fewer than two.
    """
    return composed(
        Extremum(side=1, smoothing=smoothing_given("maximum", smoothing)), *_several("maximum", expressions)
    )


def minimum(*expressions: Any, smoothing: float = 0.0) -> Expression:
    """The smallest of expressions and numbers: see `maximum`; smoothed, at most `s log n` below."""
    return composed(
        Extremum(side=-1, smoothing=smoothing_given("minimum", smoothing)), *_several("minimum", expressions)
    )


def positive_part(expression: Any, *, smoothing: float = 0.0) -> Expression:
    """An expression where it is positive, else zero: what exceeds a limit, `positive_part(x.mean - limit)`.

    - `smoothing`: rounds the kink at zero, in the unit of the expression: `(x + sqrt(x² + s²)) / 2`, which is at most
      `s/2` above.
    """
    return composed(PositivePart(smoothing_given("positive_part", smoothing)), expression)


def function(of: Callable[..., Any], *expressions: Any) -> Expression:
    """Your own function of expressions and numbers, written with `jax.numpy` so that it can be differentiated.

    It is given one number of each expression and returns one number. For a path it is called for each instant by
    itself: what joins instants is an integral (`al.time_integral`), a peak or an rms. A function that differs, though
    it computes the same, is compiled again: define it once, outside of loops.

    Raises `ProblemError` if `of` is no function, or no expression is given; and, once it is used in a problem, if it
    raises, or returns anything but one real number.
    """
    if not callable(of):
        raise refusal("function", "a function of the values of expressions", of)
    if not expressions:
        raise ProblemError("function: expected the expressions that it is a function of; received none.")
    return composed(Own(of), *expressions)


def pure(expression: Any) -> Expression:
    """An expression for a sum in which its factor carries a unit, as weights of penalties and of wishes do."""
    return composed(Pure(), expression)


def _several(who: str, expressions: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(expressions) < 2:
        raise ProblemError(f"{who}: expected at least two expressions or numbers; received {len(expressions)}.")
    return expressions
