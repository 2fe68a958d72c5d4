"""The terms of objectives beside statistics: functions of expressions, integrals over time, costs of small spreads.

Motion planning: time, effort, power, rate of torque (75)-(84); terminal errors (85), (86). Cost-uncertainty curves:
equation (125) and the curves listed in [107].
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, final

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.border import a_name, one_of, real, refusal
from aleator._core.errors import ProblemError
from aleator.design._expression import Expression, as_expression, composed, value
from aleator.design._functionals import SquareIntegral, Work, path, terminal
from aleator.design._rules import Extremum, Norm, Own, PositivePart, Pure
from aleator.design._scope import AbstractComposite, AbstractScope, Units
from aleator.design._statistic import AbstractFunctional, an_output, statistic, statistics_in
from aleator.statistics import CoefficientProduct, integrated

Weights: TypeAlias = float | Sequence[float] | Array | None
"""One factor per term, in order; a number for a single term. `None` means ones."""


@final
class TimeIntegral(AbstractComposite):
    """The time integral of an expression of paths, from statistics at instants and at midpoints of steps."""

    expression: Expression

    @override
    def evaluate(self, scope: AbstractScope) -> Array:
        return scope.time_integral(self.expression)

    @override
    def text(self) -> str:
        return f"∫{self.expression} dt"

    @override
    def unit(self, units: Units) -> str:
        return integrated(self.expression.unit(units))

    @property
    @override
    def inner(self) -> tuple[Expression, ...]:
        return (self.expression,)


def time_integrals(expression: Expression) -> tuple[Expression, ...]:
    """The expressions that are integrated over time within another one, in the order of evaluation."""
    return tuple(
        inner
        for atom in expression.atoms
        for one in atom.inner
        for inner in ((one,) if isinstance(atom, TimeIntegral) else time_integrals(one))
    )


def integrated_paths(expressions: tuple[Expression, ...]) -> tuple[AbstractFunctional, ...]:
    """The paths whose statistics the expressions integrate over time, each once."""
    inside = tuple(inner for one in expressions for inner in time_integrals(one))
    return tuple(dict.fromkeys(one for atom in statistics_in(inside) for one in atom.functionals if one.is_path))


def beside_integrals(expression: Expression) -> Expression:
    """The sum of the statistics and values of an expression that stand outside of its time integrals."""
    outside = tuple(
        part
        for atom in expression.atoms
        if not isinstance(atom, TimeIntegral)
        for part in (
            tuple(leaf for one in atom.inner for leaf in beside_integrals(one).atoms) if atom.inner else atom.parts
        )
    )
    return Expression((1.0,) * len(outside), outside)


def final_time(phase: str | None = None) -> Expression:
    """The final time of the grid, or of that of a phase, s: `J_D1` (75), where `al.Grid(al.Decision(...), steps)`
    leaves it free.
    """
    return value("t_final" if phase is None else f"{a_name('final_time: phase', phase)}.t_final")


def effort(*torques: str, weights: Weights = None) -> Expression:
    """The expected effort `sum of w_i E[∫ τ_i² dt]`: `J_D2` (76) and, under uncertainty, `J_S1` (82)."""
    return _weighted([SquareIntegral((name,)).mean for name in torques], weights, "effort")


def torque_rate(*torques: str, weights: Weights = None) -> Expression:
    """The expected rate of torques, `sum of w_i E[∫ τ̇_i² dt]`: `J_D4` (78) and `J_S3` (84), called jerk there. It uses
    the outputs `<torque>_rate`.
    """
    return _weighted([SquareIntegral((f"{an_output(name)}_rate",)).mean for name in torques], weights, "torque_rate")


def power(pairs: Mapping[str, str], *, weights: Weights = None, smoothing: float = 0.0) -> Expression:
    """The expected energy exchanged, `sum of w_i E[∫ |τ_i q̇_i| dt]`: `J_D3` (77) and `J_S2` (83).

    - `pairs`: for each torque, the rate along which it acts: `{"elbow_torque": "elbow_rate"}`.

    The magnitude is taken on each realisation. It has a kink wherever a power changes sign, where an optimiser may
    stall: `smoothing`, W, rounds the kink, and lowers the integrand by at most that much. `coefficient_power` is the
    sum printed in the dissertation.
    """
    smoothing, products = real("power: smoothing", smoothing, least=0.0), _pairs("power", pairs)
    return _weighted([Work(pair, smoothing).mean for pair in products], weights, "power")


def coefficient_power(pairs: Mapping[str, str], *, weights: Weights = None, smoothing: float = 0.0) -> Expression:
    """`sum of w_i ∫ Σ_j |τ_i^j q̇_i^j| <Ψ^j, Ψ^j> dt`, as printed in equation (83): coefficient by coefficient.

    It is not an expected value, but it is smooth wherever no coefficient changes sign; `smoothing`, W, as in `power`.
    Where the rates are certain, as for a prescribed joint, it is the energy exchanged by the expected torque,
    `∫ |E[τ] q̇| dt`.
    """
    kind = CoefficientProduct(real("coefficient_power: smoothing", smoothing, least=0.0))
    paths = ((path(torque), path(rate)) for torque, rate in _pairs("coefficient_power", pairs))
    terms = [Expression((1.0,), (TimeIntegral(statistic(kind, *pair)),)) for pair in paths]
    return _weighted(terms, weights, "coefficient_power")


def terminal_mean_error(references: Mapping[str, float], *, smoothing: float = 0.0) -> Expression:
    """The norm of the expected error at the end, `‖E[y(t_f)] - y_ref‖`: `J_S4` (85).

    It has a kink where the error vanishes, at which an optimiser may stall: `smoothing`, in the unit of the outputs,
    rounds it, and lowers the norm by at most that much.
    """
    what = "terminal_mean_error: the target of each output at the end, by name"
    references = one_of(what, references, Mapping, "{'reach': 1.2}")
    errors = (terminal(name).mean - reference for name, reference in references.items())
    return norm(*errors, smoothing=real("terminal_mean_error: smoothing", smoothing, least=0.0))


def terminal_variance(*outputs: str) -> Expression:
    """The norm of the variances at the end, `‖Var[y(t_f)]‖`: `J_S5` (86)."""
    return norm(*(terminal(name).variance for name in outputs))


def norm(*expressions: Expression, smoothing: float = 0.0) -> Expression:
    """The Euclidean norm of expressions, with derivative zero where all of them are zero.

    - `smoothing`: rounds the kink there: `sqrt(x² + s²) - s` in the place of `‖x‖`.

    Raises `ProblemError` if there are none.
    """
    if not expressions:
        raise ProblemError("norm: expected at least one expression, such as al.terminal('x').variance; received none.")
    return composed(Norm(real("norm: smoothing", smoothing, least=0.0)), *expressions)


def time_integral(expression: Expression) -> Expression:
    """The time integral of an expression of paths, such as `al.path("x").std`. Raises `ProblemError` for any other."""
    expression = as_expression(expression)
    if not expression.is_path:
        raise ProblemError(
            f"time_integral: expected statistics of a path; received '{expression}', which is one number."
        )
    return Expression((1.0,), (TimeIntegral(expression),))


def _pairs(name: str, pairs: Any) -> list[tuple[str, str]]:
    what = f"{name}: the rate along which each torque acts, by name"
    return list(one_of(what, pairs, Mapping, "{'elbow_torque': 'elbow_rate'}").items())


def _weighted(terms: Sequence[Expression], weights: Any, name: str) -> Expression:
    if not terms:
        raise ProblemError(f"{name}: expected at least one output by name; received none.")
    if isinstance(weights, Mapping | str):
        raise ProblemError(f"{name}: weights are numbers in the order of the outputs; received {weights!r}.")
    factors = [1.0] * len(terms) if weights is None else list(weights) if np.ndim(weights) else [weights]
    if len(factors) != len(terms):
        raise ProblemError(f"{name}: expected {len(terms)} weights, one per term; received {len(factors)}.")
    first, *rest = (factor * term for factor, term in zip(factors, terms, strict=True))
    return sum(rest, start=first)


def maximum(*expressions: Any, smoothing: float = 0.0) -> Expression:
    """The largest of expressions and numbers, at every instant if one is a path.

    - `smoothing`: rounds the kinks where the largest changes, in the unit of the expressions: `s log(exp(x/s) + …)`,
      which is at most `s log n` above the largest of `n`.

    Raises `ProblemError` for fewer than two.
    """
    return _extremum("maximum", 1, expressions, smoothing)


def minimum(*expressions: Any, smoothing: float = 0.0) -> Expression:
    """The smallest of expressions and numbers: see `maximum`; smoothed, at most `s log n` below."""
    return _extremum("minimum", -1, expressions, smoothing)


def positive_part(expression: Any, *, smoothing: float = 0.0) -> Expression:
    """An expression where it is positive, else zero: what exceeds a limit, `positive_part(x.mean - limit)`.

    - `smoothing`: rounds the kink at zero, in the unit of the expression: `(x + sqrt(x² + s²)) / 2`, which is at most
      `s/2` above.
    """
    return composed(PositivePart(real("positive_part: smoothing", smoothing, least=0.0)), expression)


def function(of: Callable[..., Any], *expressions: Any) -> Expression:
    """Your own function of expressions and numbers, written with `jax.numpy` so that it can be differentiated.

    It is given one number of each expression and returns one number. A path is a number of each instant by itself: what
    joins instants is an integral (`al.time_integral`), a peak or an rms. The function is traced here, once: to change
    its code, write the expression again.

    Raises `ProblemError` if `of` is no function, or no expression is given; if it raises, or returns anything but one
    real number.
    """
    if not callable(of):
        raise refusal("function", "a function of the values of expressions", of)
    if not expressions:
        raise ProblemError("function: expected the expressions that it is a function of; received none.")
    return composed(Own(of, len(expressions)), *expressions)


def pure(expression: Any) -> Expression:
    """An expression for a sum in which its factor carries a unit, as weights of penalties and of wishes do."""
    return composed(Pure(), expression)


def _extremum(who: str, side: int, expressions: tuple[Any, ...], smoothing: float) -> Expression:
    rule = Extremum(side=side, smoothing=real(f"{who}: smoothing", smoothing, least=0.0))
    if len(expressions) < 2:
        raise ProblemError(f"{who}: expected at least two expressions or numbers; received {len(expressions)}.")
    return composed(rule, *expressions)


def reciprocal_power(name: str, *, bias: float, scale: float, power: float) -> Expression:
    """Cost `bias + scale / spread**power` of the number called `name`, such as `"k_s.half_width"` (equation 125)."""
    return pure(scale / value(name) ** power + bias)


def reciprocal(name: str, *, bias: float, scale: float) -> Expression:
    """Cost `bias + scale / spread`."""
    return pure(scale / value(name) + bias)


def reciprocal_squared(name: str, *, bias: float, scale: float) -> Expression:
    """Cost `bias + scale / spread**2`."""
    return reciprocal_power(name, bias=bias, scale=scale, power=2.0)


def exponential(name: str, *, bias: float, scale: float, rate: float) -> Expression:
    """Cost `bias + scale * exp(-rate * spread)`."""
    return pure(scale * function(jnp.exp, -(rate * value(name))) + bias)


def cost_curve(name: str, curve: Callable[..., Any]) -> Expression:
    """Cost `curve(spread)` by your own function, written with `jax.numpy` so that it can be differentiated."""
    if not callable(curve):
        raise refusal("cost_curve", "a function of the number", curve)
    return function(curve, value(name))
