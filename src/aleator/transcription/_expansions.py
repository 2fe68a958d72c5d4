"""The expansions of a problem: the statistics that follow from their coefficients, and how well they are resolved."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import in_library, jax_array, quietly
from aleator._core.compilation import Use, evaluate
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_traced
from aleator.design import (
    AbstractFunctional,
    AbstractScope,
    Expression,
    Problem,
    Statistic,
    beside_integrals,
    grid_at,
    integrated_paths,
    joined,
    sampled,
    statistics_in,
)
from aleator.dynamics import Grid
from aleator.expansion import (
    ROUNDING,
    Collocation,
    error_history,
    mean_squares,
    relative_error,
)
from aleator.statistics import AbstractStatistic, AbstractTail, Constants, Mean, Std
from aleator.uncertainty import named_numbers

# A derivative that varies by less than the first part of itself, or of how its output does, does not vary: that is the
# ripple of a peak among instants. The second part is that of an integrator.
_ALIKE, _INTEGRATED = 1e-2, 1e-6
# So many outputs have each statistic by themselves.
_FEW = 4


@final
@dataclass
class ExpansionScope(AbstractScope):
    """Takes every statistic from the coefficients of expansions.

    - `coefficients`: of each functional; `numbers`: gives those of the model, by name;
    - `between`: the terms for integrals over time; `totals`: their values where these are known, in the order of
      evaluation;
    - `scenarios`: each functional on the realisations at which limits on the worst case are imposed;
    - `known`: statistics that are known, by the identity of their kinds, because the numbers in these are traced;
    - `taken`: the statistics taken so far, in that order.

    Of known coefficients NumPy takes what it can, and each other statistic is a program by itself.
    """

    coefficients: Mapping[AbstractFunctional, Float[Any, "terms ..."]]
    constants: Constants
    numbers: Callable[[], Mapping[str, Any]]
    between: "Between | None" = None
    scenarios: Mapping[AbstractFunctional, Float[Array, "scenarios ..."]] = field(default_factory=dict)
    totals: Iterator[Float[Array, ""]] | None = None
    known: "dict[_Which, Float[Any, '...']]" = field(default_factory=dict)
    taken: list[Float[Any, "..."]] = field(default_factory=list, init=False)

    def evaluated(self, expressions: tuple[Expression, ...]) -> tuple[tuple[Array, ...], tuple[tuple[Array, ...], ...]]:
        """Expressions, each flattened, and the statistics that each of them took."""
        blocks, taken = [], []
        self._take_together(expressions)
        for one in expressions:
            before = len(self.taken)
            blocks.append(jnp.ravel(one.evaluate(self)))
            taken.append(tuple(self.taken[before:]))
        return tuple(blocks), tuple(taken)

    def know(self, atoms: tuple[Statistic, ...], values: tuple[Float[Any, "..."], ...]) -> None:
        """Keep the values of some statistics, the first of these or all, for expressions that these stand in."""
        self.known.update(zip(map(_which, atoms), values, strict=False))

    def _take_together(self, expressions: tuple[Expression, ...]) -> None:
        """Take those statistics of expressions now that share an equation."""
        every = (atom for one in expressions for atom in one.atoms if isinstance(atom, Statistic))
        atoms = [atom for atom in every if _which(atom) not in self.known]
        alike: dict[Any, dict[Any, list[Statistic]]] = {}
        for atom in atoms:
            if len(atom.functionals) == 1 and atom.kind.preparation is None and not jax.tree.leaves(atom.kind):
                shape = self.coefficients[atom.functionals[0]].shape
                alike.setdefault((atom.kind, shape), {}).setdefault(atom.functionals, []).append(atom)
        for (kind, _), outputs in alike.items():
            # For few outputs stacking takes as many equations as it saves.
            if len(outputs) <= _FEW:
                continue
            values = kind.of(jnp.stack([self._terms(functionals) for functionals in outputs], axis=-1), None)
            for own, some in zip(jnp.unstack(values, axis=-1), outputs.values(), strict=True):
                self.known |= {_which(atom): own for atom in some}

    def _terms(self, functionals: tuple[AbstractFunctional, ...]) -> Float[Any, "terms ..."]:
        return joined([self.coefficients[one] for one in functionals])

    @override
    @quietly
    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> Float[Any, "..."]:
        terms, key = self._terms(functionals), (functionals, id(kind))
        if key not in self.known:
            self.known[key] = _taken(kind, terms, self.constants.of(kind))
        result = self.known[key]
        # Joint statistics take their functionals along a last axis.
        expected = terms.shape[1:] if len(functionals) == 1 else terms.shape[1:-1]
        if result.shape != expected:
            raise ProblemError(
                f"{type(kind).__name__}.of: expected shape {expected} from coefficients of shape {terms.shape}, the "
                f"first axis being that of the terms; received shape {result.shape}."
            )
        self.taken.append(result)
        return result

    @override
    def time_integral(self, expression: Expression) -> Float[Array, ""]:
        if self.totals is not None:
            return next(self.totals)
        assert self.between is not None
        nodes, weights = self.between
        inner = ExpansionScope({**self.coefficients, **nodes}, self.constants, self.numbers)
        library, *both = in_library(weights, expression.evaluate(inner))
        integral = jax_array(library.tensordot(*both, axes=1))
        # Statistics are recorded at the instants alone.
        self.taken += [one if one.ndim == 0 else one[::2] for one in in_library(*inner.taken)[1:]]
        return integral

    @override
    def realised(self, functional: AbstractFunctional) -> Float[Any, "... scenarios"]:
        library, values = in_library(self.scenarios[functional])
        return library.moveaxis(values, 0, -1)

    @override
    def value(self, name: str) -> Float[Array, ""]:
        return self.numbers()[name]


def _taken(kind: AbstractStatistic, terms: Float[Any, "terms ..."], constants: Any) -> Float[Any, "..."]:
    if kind.needs_no_compiler or is_traced((kind, terms, constants)):
        return kind.of(terms, constants)
    return evaluate(_of, kind, jax_array(terms), constants, use=Use.ONCE)


def _of(kind: AbstractStatistic, terms: Float[Array, "terms ..."], constants: Any) -> Float[Array, "..."]:
    return kind.of(terms, constants)


_Which: TypeAlias = tuple[tuple[AbstractFunctional, ...], int]


def _which(one: Statistic) -> _Which:
    return one.functionals, id(one.kind)


def tails_in(expressions: tuple[Expression, ...]) -> tuple[Statistic, ...]:
    """The statistics of tails that stand in expressions outside of integrals over time, in order of appearance."""
    beside = (beside_integrals(one) for one in expressions)
    return tuple(one for one in statistics_in(tuple(beside)) if isinstance(one.kind, AbstractTail))


class Between(NamedTuple):
    """The terms for integrals of statistics over time.

    - `coefficients`: of paths at the instants and in the middles between them; `weights`: of the quadrature there.
    """

    coefficients: Mapping[AbstractFunctional, Float[Any, "terms nodes ..."]]
    weights: Float[Array, " nodes"]


class Terms(NamedTuple):
    """The terms from which expressions are evaluated, in the order of the functionals, or a share of some points.

    - `coefficients`: of each functional; `nodes`: of each path whose statistics are integrated over time, at the
      instants and in the middles between them;
    - `realised`: each functional at the scenarios of the worst case, if there are any;
    - `tails`: the statistics of `tails_in`, where these are known.
    """

    coefficients: tuple[Float[Any, "terms ..."], ...]
    nodes: tuple[Float[Any, "terms nodes ..."], ...]
    realised: tuple[Float[Any, "scenarios ..."], ...]
    tails: tuple[Float[Array, "..."], ...] = ()


def scope_of(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    collocation: Collocation,
    constants: Constants,
    decisions: Float[Array, " n"],
) -> tuple[ExpansionScope, tuple[Float[Array, "points ..."], ...]]:
    """The scope of expressions of some functionals at given decisions, and these at the collocation points.

    Simulates once, at all collocation points and at the scenarios of the worst case together.
    """
    samples, terms = simulated(
        problem, functionals, collocation.points, collocation.pseudo_inverse, constants.scenarios, decisions
    )
    return scope_from(problem, functionals, terms, constants, decisions), samples


def simulated(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    points: Float[Array, "points variables"],
    fit: Float[Array, "terms points"],
    scenarios: Float[Array, "scenarios variables"] | None,
    decisions: Float[Array, " n"],
) -> tuple[tuple[Float[Array, "points ..."], ...], Terms]:
    """Functionals at some collocation points, and their contribution to the coefficients.

    - `fit`: the columns of the collocation's `pseudo_inverse` that belong to these points.
    """
    if not functionals:
        return (), Terms((), (), ())
    count, every = len(points), points if scenarios is None else jnp.concatenate([points, scenarios])
    sampling = sampled(problem, functionals, _integrated(problem, functionals), every, decisions)
    return tuple(values[:count] for values in sampling.values), Terms(
        coefficients=tuple(jnp.tensordot(fit, values[:count], axes=1) for values in sampling.values),
        nodes=tuple(jnp.tensordot(fit, values[:count], axes=1) for values in sampling.nodes),
        realised=() if scenarios is None else tuple(values[count:] for values in sampling.values),
    )


def scope_from(
    problem: Problem,
    functionals: tuple[AbstractFunctional, ...],
    terms: Terms,
    constants: Constants,
    decisions: Float[Array, " n"],
) -> ExpansionScope:
    """The scope of expressions whose functionals have been simulated."""
    nodes = dict(zip(_integrated(problem, functionals), terms.nodes, strict=True))
    grid = grid_at(problem, decisions) if nodes else None
    scope = ExpansionScope(
        dict(zip(functionals, terms.coefficients, strict=True)),
        constants,
        cache(partial(named_numbers, problem.simulation, decisions)),
        Between(nodes, grid.node_weights) if isinstance(grid, Grid) else None,
        dict(zip(functionals, terms.realised, strict=False)),
    )
    scope.know(tails_in(problem.expressions), terms.tails)
    return scope


def _integrated(problem: Problem, functionals: tuple[AbstractFunctional, ...]) -> tuple[AbstractFunctional, ...]:
    return tuple(one for one in integrated_paths(problem.expressions) if one in functionals)


class Resolved(NamedTuple):
    """One functional at given decisions: its moments, and how well its expansion predicts a new sample.

    - `history`: the leave-one-out error of a path at each instant (see `leave_one_out_history`); None for a number;
    - `tangents`: the leave-one-out error of its derivative by each decision that is a parameter of a distribution;
      derivatives of statistics follow from these. None if unknown.
    """

    mean: Float[np.ndarray, "*shape"]
    std: Float[np.ndarray, "*shape"]
    leave_one_out: float
    history: Float[np.ndarray, " instants"] | None
    tangents: Float[np.ndarray, " parameters"] | None


# Evenly spread instants of a path at which its derivatives are checked: enough to show how well they are resolved.
_SEEN = 50


def seen(samples: Any, is_path: bool) -> Any:
    """The samples of a functional whose derivatives are checked: of a path at some instants, including the last."""
    return samples[:, :: -max(1, samples.shape[1] // _SEEN)] if is_path else samples


Samples: TypeAlias = Float[np.ndarray, "points ..."]
Tangents: TypeAlias = Float[np.ndarray, "parameters points ..."]
"""Derivatives of samples (see `seen`) times the magnitudes of the decisions, in the functional's unit."""


def resolved(
    functional: AbstractFunctional,
    collocation: Collocation,
    samples: Samples,
    tangents: Tangents | None,
    noise: tuple[Samples, Tangents | None] | None = None,
    noised: Samples | None = None,
) -> Resolved:
    """The moments and the quality of a functional's expansion from its samples, by NumPy.

    - `noise`: the same of the variance that white noise adds. Errors are then relative to the whole spread;
    - `noised`: of such a variance, the output to whose own it is added, to which its errors are relative likewise.
    """
    known = np.asarray(samples)
    terms = collocation.coefficients(known)
    error, variance, square = mean_squares(collocation, known, terms)
    by_noise = np.zeros(known.shape[1:]) if noise is None else _mean(collocation, noise[0])
    if noised is not None:
        own = mean_squares(collocation, noised, collocation.coefficients(np.asarray(noised)))[1]
        by_noise = (_mean(collocation, known) + own.reshape(by_noise.shape)) ** 2
    squares = error, variance + by_noise.reshape(-1), square
    spread, size = (seen(part.reshape(1, *samples.shape[1:]), functional.is_path).sum() for part in squares[1:])
    moved = 0.0
    if noise is not None and noise[1] is not None:
        # Of the standard deviation by noise alone.
        std = np.sqrt(np.maximum(seen(by_noise[None], functional.is_path)[0], 0.0))
        slopes = [_mean(collocation, one) / np.where(std > 0, 2 * std, np.inf) for one in noise[1]]
        moved = np.array([np.sum(one**2) for one in slopes])
    return Resolved(
        mean=np.asarray(Mean().of(terms, ())),
        std=np.asarray(Std().of(terms, ())),
        leave_one_out=float(relative_error(*(part.sum() for part in squares))),
        history=np.asarray(error_history(squares, known.shape[1])) if functional.is_path else None,
        tangents=None if tangents is None else _errors_of(collocation, tangents, spread, size, moved),
    )


def _mean(collocation: Collocation, samples: Samples) -> Float[np.ndarray, "..."]:
    return np.asarray(collocation.coefficients(np.asarray(samples))[0])


def _errors_of(
    collocation: Collocation, tangents: Tangents, spread: Any, size: Any, moved: Any
) -> Float[np.ndarray, " parameters"]:
    """The leave-one-out error of each derivative of an output; zero where it varies by no more than the error of an
    integrator, as a part of itself or of how the output varies, or than the output's rounding.

    A fit is linear, so that the derivatives of its coefficients are the coefficients of the derivative.

    - `spread`, `size`: the variance and the mean square of the output at the same instants, in all;
    - `moved`: the square of what white noise adds to each derivative of the standard deviation.
    """
    each = (mean_squares(collocation, one, collocation.coefficients(one)) for one in map(np.asarray, tangents))
    error, variance, square = np.array([[part.sum() for part in squares] for squares in each]).T
    least = np.maximum(spread, (ROUNDING / _INTEGRATED) ** 2 * size)
    return np.asarray(relative_error(error, variance + moved, np.maximum(square, least), rounding=_ALIKE))
