"""Objectives of motion planning: time, effort, power, rate of torque (75)-(84); terminal errors (85), (86)."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.design._expression import Expression, as_expression, composed, value
from aleator.design._functionals import AbstractIntegral, path, terminal
from aleator.design._numbers import smoothing_given
from aleator.design._rules import Norm
from aleator.design._scope import AbstractAtom, AbstractComposite, AbstractScope, Units
from aleator.design._statistic import name_given, statistic
from aleator.statistics import CoefficientProduct, integrated, product, squared

Weights: TypeAlias = float | Sequence[float] | Array | None
"""One factor per term, in order; a number for a single term. `None` means ones."""


@final
class SquareIntegral(AbstractIntegral):
    """The time integral of an output's square."""

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        return now[self.output] ** 2

    @override
    def text(self) -> str:
        return f"∫{self.output}² dt"

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(squared(outputs.get(self.output, "")))


@final
class Work(AbstractIntegral):
    """The time integral of the magnitude of a product, such as torque times rate: the energy exchanged.

    With a `smoothing` `s`, the magnitude is `sqrt(x² + s²) - s`: smooth, and at most `s` below `|x|`.
    """

    smoothing: float = eqx.field(static=True, default=0.0)

    @override
    def integrand(self, now: Mapping[str, Array]) -> Array:
        force, rate = (now[name] for name in self.outputs)
        exchanged, s = force * rate, self.smoothing
        return jnp.sqrt(exchanged**2 + s**2) - s if s else jnp.abs(exchanged)

    @override
    def text(self) -> str:
        return f"∫|{' '.join(self.outputs)}| dt"

    @override
    def unit(self, outputs: Mapping[str, str]) -> str:
        return integrated(product(*(outputs.get(name, "") for name in self.outputs)))


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

    @property
    @override
    def parts(self) -> tuple[AbstractAtom, ...]:
        return self.expression.leaves

    @property
    @override
    def integrated(self) -> tuple[AbstractAtom, ...]:
        return self.parts


def time_integrals(expression: Expression) -> tuple[Expression, ...]:
    """The expressions that are integrated over time within another one, in the order of evaluation."""
    return tuple(
        found
        for atom in expression.atoms
        for one in atom.inner
        for found in ((one,) if isinstance(atom, TimeIntegral) else time_integrals(one))
    )


def beside_integrals(expression: Expression) -> Expression:
    """The sum of the statistics and values of an expression that stand outside of its time integrals."""
    found = tuple(
        part
        for atom in expression.atoms
        if not isinstance(atom, TimeIntegral)
        for part in (
            tuple(leaf for one in atom.inner for leaf in beside_integrals(one).atoms) if atom.inner else atom.parts
        )
    )
    return Expression((1.0,) * len(found), found)


def final_time() -> Expression:
    """The final time of the grid, s: `J_D1` (75), where `al.Grid(al.Decision(...), steps)` leaves it free."""
    return value("t_final")


def effort(*torques: str, weights: Weights = None) -> Expression:
    """The expected effort `sum of w_i E[∫ τ_i² dt]`: `J_D2` (76) and, under uncertainty, `J_S1` (82)."""
    return _weighted([SquareIntegral((name,)).mean for name in torques], weights, "effort")


def torque_rate(*torques: str, weights: Weights = None) -> Expression:
    """The expected rate of torques, `sum of w_i E[∫ τ̇_i² dt]`: `J_D4` (78) and `J_S3` (84), called jerk there. It uses
    the outputs `<torque>_rate`.
    """
    return _weighted([SquareIntegral((f"{name_given(name)}_rate",)).mean for name in torques], weights, "torque_rate")


def power(pairs: Mapping[str, str], *, weights: Weights = None, smoothing: float = 0.0) -> Expression:
    """The expected energy exchanged, `sum of w_i E[∫ |τ_i q̇_i| dt]`: `J_D3` (77) and `J_S2` (83).

    - `pairs`: for each torque, the rate along which it acts: `{"elbow_torque": "elbow_rate"}`.

    The magnitude is taken on each realisation. It has a kink wherever a power changes sign, where an optimiser may
    stall: `smoothing`, W, rounds the kink, and lowers the integrand by at most that much. `coefficient_power` is the
    sum printed in the dissertation.
    """
    smoothing, given = smoothing_given("power", smoothing), _pairs("power", pairs)
    return _weighted([Work(pair, smoothing).mean for pair in given], weights, "power")


def coefficient_power(pairs: Mapping[str, str], *, weights: Weights = None, smoothing: float = 0.0) -> Expression:
    """`sum of w_i ∫ Σ_j |τ_i^j q̇_i^j| <Ψ^j, Ψ^j> dt`, as printed in equation (83): coefficient by coefficient.

    It is not an expected value, but it is smooth wherever no coefficient changes sign; `smoothing`, W, as in `power`.
    Where the rates are certain, as for a prescribed joint, it is the energy exchanged by the expected torque,
    `∫ |E[τ] q̇| dt`.
    """
    kind = CoefficientProduct(smoothing_given("coefficient_power", smoothing))
    paths = ((path(torque), path(rate)) for torque, rate in _pairs("coefficient_power", pairs))
    terms = [Expression((1.0,), (TimeIntegral(statistic(kind, *pair)),)) for pair in paths]
    return _weighted(terms, weights, "coefficient_power")


def terminal_mean_error(references: Mapping[str, float], *, smoothing: float = 0.0) -> Expression:
    """The norm of the expected error at the end, `‖E[y(t_f)] - y_ref‖`: `J_S4` (85).

    It has a kink where the error vanishes, at which an optimiser may stall: `smoothing`, in the unit of the outputs,
    rounds it, and lowers the norm by at most that much.
    """
    if not isinstance(references, Mapping):
        raise ProblemError(
            "terminal_mean_error: expected the target of each output at the end, by name, such as {'reach': 1.2}; "
            f"received {type(references).__name__} {references!r}."
        )
    errors = (terminal(name).mean - reference for name, reference in references.items())
    return norm(*errors, smoothing=smoothing_given("terminal_mean_error", smoothing))


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
    return composed(Norm(smoothing_given("norm", smoothing)), *expressions)


def time_integral(expression: Expression) -> Expression:
    """The time integral of an expression of paths, such as `al.path("x").std`. Raises `ProblemError` for any other."""
    expression = as_expression(expression)
    if not expression.is_path:
        raise ProblemError(
            f"time_integral: expected statistics of a path; received '{expression}', which is one number."
        )
    return Expression((1.0,), (TimeIntegral(expression),))


def _pairs(name: str, pairs: Any) -> list[tuple[str, str]]:
    if isinstance(pairs, Mapping):
        return list(pairs.items())
    raise ProblemError(
        f"{name}: expected the rate along which each torque acts, by name, such as {{'elbow_torque': 'elbow_rate'}}; "
        f"received {type(pairs).__name__} {pairs!r}."
    )


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
