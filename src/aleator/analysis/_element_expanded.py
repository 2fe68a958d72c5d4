"""`ElementExpanded`: a piecewise expansion with its statistics."""

from collections import Counter
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator.analysis._abstract_expanded import (
    AbstractExpanded,
    as_lines,
    distribution_rows,
    nothing,
    output_rows,
    paired,
)
from aleator.ensemble import inputs_at, part
from aleator.expansion import AbstractBasis, PiecewiseBasis
from aleator.uncertainty import AbstractDistribution, Placements


@final
class ElementExpanded(AbstractExpanded):
    """Outputs as polynomials of the germ in each element of its domain; `print(expanded)` shows a summary.

    - `distributions`: that of each uncertain input, by name; `basis`: the elements, with the polynomials in each;
    - `coefficients`: of each output in the basis, shape (elements x terms, *shape);
    - `splits`: the variable of each split, in order; `calls`: how often the function was called;
    - `error`: estimated relative rms error of the piecewise expansion, the largest over the outputs.
    """

    distributions: dict[str, AbstractDistribution]
    basis: AbstractBasis = eqx.field(static=True)
    coefficients: Pytree
    splits: tuple[str, ...] = eqx.field(static=True)
    calls: int = eqx.field(static=True)
    error: float = eqx.field(static=True)

    @override
    def __getitem__(self, name: str) -> "ElementExpanded":
        return self._with(part(self.coefficients, name))

    def _both(self, first: str, second: str) -> "ElementExpanded":
        return self._with(paired(self.coefficients, first, second))

    def _with(self, coefficients: Pytree) -> "ElementExpanded":
        return ElementExpanded(self.distributions, self.basis, coefficients, self.splits, self.calls, self.error)

    @property
    def partition(self) -> PiecewiseBasis:
        """The elements, with the polynomials in each."""
        assert isinstance(self.basis, PiecewiseBasis)
        return self.basis

    def __str__(self) -> str:
        count, basis = len(self.partition.cells), self.partition.pieces[0]
        how = f"{count} element{'s' * (count != 1)} of order {basis.order}, {self.calls} calls"
        rows = [
            ("expansion", how),
            ("split", self._split_text()),
            ("error", f"{self.error:.1e} of the standard deviation, estimated by leaving one sample out"),
        ]
        remarks = jax.tree.map(lambda _: nothing, self.coefficients)
        return as_lines([*rows, *distribution_rows(self.distributions), *output_rows(self.mean, self.std, remarks)])

    def _split_text(self) -> str:
        """How often each variable was split, and where the smallest element lies."""
        if not self.splits:
            return "nothing: one element is enough"
        times = ", ".join(f"{name} {count} times" for name, count in Counter(self.splits).most_common())
        smallest = min(range(len(self.partition.cells)), key=lambda k: self.partition.cells[k].probability)
        cell, germs = self.partition.cells[smallest], self.partition.pieces[smallest].germs
        ends = np.array([germ.support() for germ in germs.values()]).T
        places = Placements(dict(self.distributions), {})
        low, high = (inputs_at(places, end, jnp.zeros(0)) for end in ends)
        where = ", ".join(f"{name} from {low[name]:.6g} to {high[name]:.6g}" for name in self.distributions)
        return f"{times}; the smallest element: {where}, probability {cell.probability:.2g}"
