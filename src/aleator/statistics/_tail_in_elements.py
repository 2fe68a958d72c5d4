"""The distribution of an output over elements, each with lines of its own."""

from collections.abc import Callable
from typing import Any, ClassVar, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Scalar
from aleator.statistics._lines import AnyLines, LinesInElements
from aleator.statistics._output_distribution import AbstractLowerTail, Cut, Search, TailByLines
from aleator.statistics._statistic import root

# An element varies by less than this part of the spread: not at all.
_CONSTANT = 1e-9


@final
class TailInElements(AbstractLowerTail):
    """The probability below a threshold as the sum over elements, `tails` of which are stacked."""

    close: ClassVar[float] = TailByLines.close

    tails: TailByLines
    probability: Float[Array, " elements"]

    @classmethod
    def of(cls, signed: Float[Array, " terms"], lines: LinesInElements) -> "TailInElements":
        """That of an output with mean zero."""
        tails = jax.vmap(TailByLines.of)(lines.division.elements(signed), lines.lines)
        return cls(root(jnp.sum(signed**2)), tails, lines.division.probability)

    @override
    def cut(self, threshold: Float[Array, ""]) -> Cut:
        cuts = jax.vmap(TailByLines.cut, (0, None))(self.tails, threshold)
        return cuts._replace(below=self.probability @ cuts.below, density=self.probability @ cuts.density)

    @override
    def below(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        return self.probability @ self._each(TailByLines.below, threshold, at)

    @override
    def shortfall(self, threshold: Float[Array, ""], at: Cut) -> Float[Array, ""]:
        return self.probability @ self._each(TailByLines.shortfall, threshold, at)

    @override
    def error(self, at: Cut) -> Float[Array, ""]:
        each = self._each(lambda tail, _, at: tail.error(at), jnp.zeros(()), at)
        return root(jnp.sum((self.probability * each) ** 2))

    @override
    def quantile(self, level: Scalar) -> tuple[Float[Array, ""], Cut]:
        """One that many systems share, as those of a stop do, moves with their elements, which are constant."""
        quantile, cut = super().quantile(level)
        middles, rest = self.tails.signed[:, 0], root(jnp.sum(self.tails.signed[:, 1:] ** 2, axis=1))
        is_shared = jnp.maximum(jnp.abs(middles - quantile), rest) <= _CONSTANT * self.std
        shares = jax.lax.stop_gradient(jnp.where(is_shared, self.probability, 0.0))
        moved = shares @ (middles - jax.lax.stop_gradient(middles)) / jnp.maximum(jnp.sum(shares), np.finfo(float).tiny)
        return quantile + moved, cut

    @override
    def slope(self, end: Search) -> Float[Array, ""]:
        return jnp.where(jnp.abs(end.off) <= self.close, end.cut.density, 0.0)

    def _each(self, function: Callable[..., Array], threshold: Array, at: Cut) -> Float[Array, " elements"]:
        axes: Any = Cut(*[None, None], *[0] * (len(Cut._fields) - 2))  # type: ignore[arg-type]
        return jax.vmap(function, (0, None, axes))(self.tails, threshold, at)


def lower_tail(signed: Float[Array, " terms"], lines: AnyLines) -> AbstractLowerTail:
    """The lower tail of an output by its coefficients, the first of which is zero."""
    return TailInElements.of(signed, lines) if isinstance(lines, LinesInElements) else TailByLines.of(signed, lines)
