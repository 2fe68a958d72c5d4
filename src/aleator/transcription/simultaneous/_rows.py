"""The rows of a simultaneous program: the problem's own, then those that tie lifted variables to what they stand for.

Each row is a sum of variables and of rows of blocks: constant matrices.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from jaxtyping import Float, Int

from aleator.nlp import SparseMatrix, Ties
from aleator.transcription.simultaneous._assembly import matrix
from aleator.transcription.simultaneous._layout import Layout
from aleator.transcription.simultaneous._pointwise import Pointwise
from aleator.uncertainty import placements


@final
class Numbering:
    """Hands out consecutive numbers, in arrays of a shape."""

    def __init__(self) -> None:
        self.count = 0

    def take(self, shape: tuple[int, ...]) -> Int[np.ndarray, "..."]:
        """The next numbers."""
        first, self.count = self.count, self.count + int(np.prod(shape))
        return np.arange(first, self.count).reshape(shape)


class Given(NamedTuple):
    """What is the same at all decisions, and so no variables of the program: the signals, the duration."""

    signals: bool
    duration: bool

    @classmethod
    def of(cls, asked: Pointwise) -> "Given":
        """That of a problem. Conditions on derivatives of signals depend on the duration."""
        return cls(not asked.decides_signals, not placements(asked.problem.grid).decisions)


@final
@dataclass(frozen=True)
class Rows:
    """The constraints `L z + C r(z)` of a program: `linear`, `combined`.

    - `own`: the rows of each of the problem's constraints; `ties`: the others, each with the variable that stands for
      something else (of the two states of an interval, the later one; of the equations of algebraic variables, each
      one in turn).
    """

    linear: SparseMatrix
    combined: SparseMatrix
    own: tuple[slice, ...]
    ties: Ties


def rows_of(
    layout: Layout,
    blocks: list[Int[np.ndarray, "..."]],
    fit: Float[np.ndarray, "terms points"],
    slopes: SparseMatrix,
    given: Given,
) -> Rows:
    """The rows of a program.

    - `blocks`: the number of each row of each family's blocks, in the order of `Families.every`;
    - `fit`: see `Collocation.pseudo_inverse`;
    - `slopes`: how the decisions act on signals and duration beside their blocks.
    """
    known, initial, rates, equations, paths, ends, composed, nodes, _, *others = blocks
    constraints = len(layout.asked.problem.constraints)
    limits, integrands = others[:constraints], others[constraints:]
    variables, mesh = layout.numbers, layout.plan.mesh
    numbers, linear, combined, stands_for = Numbering(), [], [], []
    own = []
    for one in limits:
        rows = numbers.take((one.size,))
        combined.append((rows, one.ravel(), 1.0))
        own.append(slice(int(rows[0]), int(rows[-1]) + 1) if one.size else slice(numbers.count, numbers.count))

    def tied(these: Any, to: Any) -> None:
        """Variables that are rows of blocks."""
        rows = numbers.take(np.shape(these))
        linear.append((rows, these, 1.0))
        combined.append((rows, np.reshape(to, np.shape(these)), -1.0))
        stands_for.append(np.ravel(these))

    decided = np.append(np.full(variables.signals.size, not given.signals), not given.duration)
    acting, first = slopes[decided].tocoo(), numbers.count
    tied(np.append(variables.signals.ravel(), variables.duration)[decided], known.ravel()[decided])
    linear.append((first + acting.row, variables.decisions[acting.col], -acting.data))
    tied(variables.states[:, 0], initial[:, 0])
    states = variables.states.shape[2]
    lengths, scheme = mesh.lengths, mesh.scheme
    ends_of = variables.states[:, mesh.points]
    rows = numbers.take(ends_of[:, :, 1:].shape)
    linear += [(rows, ends_of[:, :, 1:], 1.0), (rows, ends_of[:, :, :1], -1.0)]
    stands_for.append(ends_of[:, :, 1:].ravel())
    stages = rates[:, mesh.stages]
    for i in range(stages.shape[2]):
        shares = lengths[:, None] * scheme.weights[:, i]
        combined.append((rows, stages[:, :, i : i + 1, :states], -shares[None, :, :, None]))
    rows = numbers.take(variables.algebraic.shape)
    combined.append((rows, equations, 1.0))
    stands_for.append(variables.algebraic.ravel())
    rows = numbers.take(variables.integrals.shape)
    linear += [(rows, variables.integrals, 1.0), (rows[:, 1:], variables.integrals[:, :-1], -1.0)]
    shares = lengths[:, None] * scheme.weights[-1]
    combined.append((rows[:, :, None], stages[..., states:], -shares[None, :, :, None]))
    stands_for.append(variables.integrals.ravel())
    tied(variables.paths, paths)
    tied(variables.ends, ends)
    tied(variables.composed, composed)
    tied(variables.nodes, nodes)
    samples, between = layout.samples(variables), layout.integrated(variables)
    expanded = [(samples[one], terms) for one, terms in layout.coefficients(variables).items()]
    expanded += [(between[one], terms) for one, terms in layout.between(variables).items()]
    for every, terms in expanded:
        rows = numbers.take(terms.shape)
        at = every[: layout.plan.points]
        linear.append((rows, terms, 1.0))
        shares = -fit.reshape(*fit.shape, *(1,) * (at.ndim - 1))
        linear.append((rows[:, None], at[None], shares))
        stands_for.append(terms.ravel())
    rows = numbers.take(variables.totals.shape)
    linear.append((rows, variables.totals, 1.0))
    for row, integrand in zip(rows, integrands, strict=True):
        combined.append((row, integrand.ravel(), -layout.asked.grid.fraction_weights))
    stands_for.append(variables.totals)
    shape = numbers.count, layout.count
    count = sum(one.size for one in blocks)
    first = own[-1].stop if own else 0
    tied_variables = np.concatenate(stands_for).astype(int)
    ties = Ties(np.arange(first, numbers.count), tied_variables, layout.owners[tied_variables])
    return Rows(matrix(linear, shape), matrix(combined, (shape[0], count)), tuple(own), ties)
