"""Cost-uncertainty curves: the cost of a small spread (equation 125 and the curves listed in [107])."""

from collections.abc import Callable
from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator._core.border import a_name, refusal
from aleator.design._expression import Expression
from aleator.design._numbers import number_given
from aleator.design._scope import AbstractAtom, AbstractScope, Units

Curve = Callable[..., Float[Array, ""]]


@final
class CostCurve(AbstractAtom):
    """`curve(spread, *coefficients)` of the number called `name`."""

    name: str = eqx.field(static=True)
    curve: Curve = eqx.field(static=True)
    shown: str = eqx.field(static=True)
    coefficients: tuple[Scalar, ...] = ()

    @override
    def evaluate(self, scope: AbstractScope) -> Array:
        return self.curve(scope.value(self.name), *self.coefficients)

    @override
    def text(self) -> str:
        numbers = (f"{float(number):g}" for number in self.coefficients)
        return self.shown.format(*numbers, spread=self.name).replace("(0 + ", "(")

    @override
    def unit(self, units: Units) -> str:
        """Unknown: a curve has no declared unit."""
        del units
        return ""

    @property
    @override
    def subjects(self) -> tuple[str, ...]:
        return (self.name,)


def _reciprocal_power(spread: Array, bias: Array, scale: Array, power: Array) -> Array:
    return bias + scale / spread**power


def _exponential(spread: Array, bias: Array, scale: Array, rate: Array) -> Array:
    return bias + scale * jnp.exp(-rate * spread)


def _expression(name: str, curve: Curve, shown: str, *coefficients: float) -> Expression:
    numbers = tuple(number_given(number, "be a coefficient of a cost curve") for number in coefficients)
    return Expression((1.0,), (CostCurve(a_name("A cost curve", name), curve, shown, numbers),))


def reciprocal_power(name: str, *, bias: float, scale: float, power: float) -> Expression:
    """Cost `bias + scale / spread**power` of the number called `name`, such as `"k_s.half_width"` (equation 125)."""
    return _expression(name, _reciprocal_power, "({0} + {1}/{spread}^{2})", bias, scale, power)


def reciprocal(name: str, *, bias: float, scale: float) -> Expression:
    """Cost `bias + scale / spread`."""
    return _expression(name, _reciprocal_power, "({0} + {1}/{spread})", bias, scale, 1.0)


def reciprocal_squared(name: str, *, bias: float, scale: float) -> Expression:
    """Cost `bias + scale / spread**2`."""
    return _expression(name, _reciprocal_power, "({0} + {1}/{spread}²)", bias, scale, 2.0)


def exponential(name: str, *, bias: float, scale: float, rate: float) -> Expression:
    """Cost `bias + scale * exp(-rate * spread)`."""
    return _expression(name, _exponential, "({0} + {1} exp(−{2} {spread}))", bias, scale, rate)


def cost_curve(name: str, curve: Curve) -> Expression:
    """Cost `curve(spread)` by your own function, written with `jax.numpy` so that it can be differentiated."""
    if not callable(curve):
        raise refusal("cost_curve", "a function of the number", curve)
    return _expression(name, curve, f"{getattr(curve, '__name__', 'curve')}({{spread}})")
