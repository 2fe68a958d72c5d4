"""`MultiElement`: settings of a multi-element expansion."""

from typing import final

import equinox as eqx

from aleator._core import given
from aleator._core.module import Module


@final
class MultiElement(Module):
    """Settings of a multi-element expansion, for outputs that no single polynomial fits: jumps, kinks, long times.

    The element of the germ's domain with the largest error is split in two until the error is small enough.

    - `order`: the total degree in each element;
    - `error`: the relative root mean square error of the piecewise expansion at which splitting stops, estimated by
      leaving one sample out and at fresh points;
    - `budget`: the largest number of calls of the function.

    Sources: Wan and Karniadakis (2005), An adaptive multi-element generalized polynomial chaos method for stochastic
    differential equations; by collocation: Foo, Wan and Karniadakis (2008), The multi-element probabilistic collocation
    method.
    """

    order: int = eqx.field(static=True)
    error: float = eqx.field(static=True)
    budget: int = eqx.field(static=True)

    def __init__(self, order: int = 4, *, error: float = 1e-3, budget: int = 10_000):
        self.order = given.whole("MultiElement: order", order)
        self.error = given.positive("MultiElement: error", error, below=1.0)
        self.budget = given.whole("MultiElement: budget, the number of calls,", budget)
