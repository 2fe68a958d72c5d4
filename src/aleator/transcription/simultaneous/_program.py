"""The compiled functions of a simultaneous program, and the sparse program that they make."""

from dataclasses import dataclass
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from aleator._core.compilation import Bound, Compiled, Use
from aleator.design import Problem, refuse_changed_code
from aleator.nlp import Evaluation, Hessian, SparseMatrix
from aleator.statistics import Constants
from aleator.transcription._remembered import Remembered
from aleator.transcription.simultaneous._assembly import Curvature, Jacobian, Pattern
from aleator.transcription.simultaneous._families import Families, families
from aleator.transcription.simultaneous._layout import Layout, Plan
from aleator.transcription.simultaneous._rows import Given, Rows, rows_of
from aleator.transcription.simultaneous._signals import constant_slopes


def _families(problem: Problem, constants: Constants, points: Array, plan: Plan, variables: Array) -> Families:
    layout = Layout.of(problem, plan)
    return families(layout, problem, constants, points, layout.view(variables))


def _evaluate(
    problem: Problem, constants: Constants, points: Array, plan: Plan, variables: Float[Array, " n"]
) -> tuple[Float[Array, " rows"], Float[Array, " entries"]]:
    """The rows of all blocks, and the entries of their Jacobians."""
    found = [one.differentiated() for one in _families(problem, constants, points, plan, variables).every]
    values, entries = zip(*found, strict=True)
    return jnp.concatenate([jnp.ravel(one) for one in values]), jnp.concatenate([jnp.ravel(one) for one in entries])


def _curve(
    problem: Problem, constants: Constants, points: Array, plan: Plan, at: tuple[Array, Array]
) -> Float[Array, " entries"]:
    """The entries of the Hessians of all blocks, their rows weighted, at some variables."""
    variables, weights = at
    every, first, found = _families(problem, constants, points, plan, variables).every, 0, []
    for one in every:
        shape = jax.eval_shape(one.values).shape
        size = int(np.prod(shape))
        found.append(jnp.ravel(one.curved(weights[first : first + size].reshape(shape))))
        first += size
    return jnp.concatenate(found)


EVALUATE = Compiled(_evaluate, use=Use.ROWS, unchanged=refuse_changed_code)
CURVE = Compiled(_curve, use=Use.ROWS, unchanged=refuse_changed_code)


@final
@dataclass(frozen=True)
class Assembled:
    """Evaluates a program: its blocks by compiled functions, its matrices by assembly.

    - `blocks`: gives the rows of all blocks, and the entries of their Jacobians;
    - `slopes`: how the decisions act on signals and duration, where that is constant, shape (known, decisions);
    - `objective`: its row and its entries among those of all blocks, and the variables of these; `rates`: the rows of
      the rates at the points where the scheme asks for them.
    """

    rows: Rows
    slopes: SparseMatrix
    blocks: Remembered[tuple[np.ndarray, np.ndarray]]
    curve_blocks: Bound
    jacobian: Jacobian
    curvature: Curvature
    objective: tuple[int, slice, np.ndarray]
    rates: Int[np.ndarray, "realisations asked rates"]

    @classmethod
    def of(
        cls,
        layout: Layout,
        traced: Problem,
        constants: Constants,
        points: Float[np.ndarray, "realisations germs"],
        fit: Float[np.ndarray, "terms points"],
        given: Given,
    ) -> "Assembled":
        """That of a problem."""
        fixed = traced, constants, jnp.asarray(points), layout.plan
        shapes = jax.eval_shape(lambda z: [one.values() for one in _families(*fixed, z).every], jnp.zeros(layout.count))
        with jax.ensure_compile_time_eval():
            numbered = families(layout, traced, constants, jnp.asarray(points), layout.numbers)
        first, patterns = 0, []
        for one, shape in zip(numbered.every, shapes, strict=True):
            rows = np.arange(first, first + shape.size).reshape(shape.shape)
            patterns.append(Pattern.of(np.asarray(one.shared), np.asarray(one.own), rows))
            first += shape.size
        slopes = constant_slopes(traced, layout)
        rows = rows_of(layout, [one.rows for one in patterns], fit, slopes, given)
        before = sum(one.entry_count for one in patterns[:6])
        objective = patterns[6]
        entries = slice(before, before + objective.entry_count)
        evaluate, curve = (one.bound(*fixed, packed=False) for one in (EVALUATE, CURVE))
        curve.begin((np.zeros(layout.count), np.zeros(first)))
        return cls(
            rows,
            slopes,
            Remembered(lambda variables: tuple(map(np.asarray, evaluate(variables)))),  # type: ignore[arg-type]
            curve,
            Jacobian.of(rows.linear, rows.combined, patterns),
            Curvature.of(patterns, layout.count),
            (int(objective.rows.item()), entries, objective.columns.ravel()),
            patterns[2].rows,
        )

    def known(self, variables: Float[np.ndarray, " n"]) -> Float[np.ndarray, " known"]:
        """The signals at all mesh points, then the duration, as they follow from the decisions."""
        count, decisions = self.slopes.shape
        return self.blocks(variables)[0][:count] + self.slopes @ variables[:decisions]

    def constraints(self, variables: Float[np.ndarray, " n"]) -> Float[np.ndarray, " rows"]:
        """The rows of the program."""
        return self.rows.linear @ variables + self.rows.combined @ self.blocks(variables)[0]

    def __call__(self, variables: Float[np.ndarray, " n"]) -> Evaluation:
        """The program at a point."""
        values, entries = self.blocks(variables)
        row, where, columns = self.objective
        gradient = np.zeros(variables.size)
        np.add.at(gradient, columns, entries[where])
        constraints = self.rows.linear @ variables + self.rows.combined @ values
        return Evaluation(float(values[row]), gradient, constraints, self.jacobian.at(entries))

    @property
    def hessian(self) -> Hessian:
        """The second derivatives of its Lagrangian."""
        row, *_ = self.objective
        back = self.rows.combined.T.tocsr()

        def evaluate(variables: np.ndarray, weight: float, multipliers: np.ndarray) -> SparseMatrix:
            weights = back @ multipliers
            weights[row] += weight
            return self.curvature.at(np.asarray(self.curve_blocks((variables, weights))))

        return Hessian(evaluate, self.curvature.sparsity)
