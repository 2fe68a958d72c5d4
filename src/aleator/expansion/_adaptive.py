"""`Adaptive`: index sets that grow by a model's outputs."""

import math
import warnings
from collections.abc import Mapping
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from aleator._core import border
from aleator._core.errors import ExpansionWarning, ProblemError
from aleator._core.leaves import Module
from aleator.expansion._basis import Basis, TotalDegree, sorted_terms
from aleator.expansion._collocation import LEAST_REMAINDER, components
from aleator.expansion._fit import WORST_CONDITION, Respond, responses
from aleator.expansion._points import AbstractCountedPoints, AbstractPoints, Nodes
from aleator.uncertainty import AbstractGerm

# Points per term, as the dissertation advises after equation (29).
_PER_TERM = 3

# A set grows by this part at a time, so that the model is evaluated a few times, each for many points.
_GROWTH = 0.3

# Candidates whose polynomials are held in memory at a time.
_CHUNK = 2000


@final
class Adaptive(Module):
    """An index set that grows until the leave-one-out error is small, within a budget of points.

    It starts at total degree 1. Of the terms one or two degrees above the set, those that explain most of the residual
    are added, each with all its divisors; if none stands out, those of lowest degree. Points are added to keep three
    per term; earlier points are reused. Growth ends when the error of every output (a path has one error) is below
    `error`. If `budget` points or the expansion's order do not suffice, it ends with `ExpansionWarning` and keeps the
    set with the smallest error. The terms then stay fixed, whatever the decisions.

    - `error`: relative leave-one-out error to reach, an rms error over the standard deviation;
    - `budget`: the largest number of points.

    Source: Gerstner and Griebel (2003), Dimension-adaptive tensor-product quadrature, for the growth of downward closed
    sets; Blatman and Sudret (2010) for the error that drives it.
    """

    error: float = eqx.field(static=True)
    budget: int = eqx.field(static=True)

    def __init__(self, error: float = 1e-2, budget: int = 1000):
        self.error = border.positive("Adaptive: the error to reach", error, below=1.0)
        self.budget = border.whole("Adaptive: the budget of points", budget)


def grow(
    germs: Mapping[str, AbstractGerm], order: int, settings: Adaptive, points: AbstractPoints, respond: Respond | None
) -> tuple[Basis, Nodes]:
    """Grow a basis up to a total degree of `order`; return it with the points at which the model was evaluated.

    Raises `ProblemError` if the budget does not suffice for degree 1, or if the points are not nested.
    """
    if respond is None:
        raise ProblemError(
            "Adaptive grows the index set by the model's outputs, which are not available here. Take "
            "al.index_sets.TotalDegree() or al.index_sets.HyperbolicCross()."
        )
    basis = Basis(germs, TotalDegree().indices(tuple(germs), 1))
    _check(settings, points, basis)
    nodes, outputs = Nodes(np.zeros((0, basis.variables)), np.zeros(0)), ()

    def fitted(basis: Basis, count: int) -> _State:
        """The fit at the first points of the sequence, at further ones of which the model is evaluated."""
        nonlocal nodes, outputs
        if count > (known := len(nodes.points)):
            nodes = points.nodes(basis, count)
            new = responses(respond, basis.names, nodes.points[known:], known)
            outputs = tuple(map(np.concatenate, zip(outputs, new, strict=True))) if known else new
        return _State(basis, nodes, outputs)

    count = _PER_TERM * basis.terms
    best, least = basis, np.inf
    while True:
        state = fitted(basis, count)
        if state.error > least and count < settings.budget:
            # A larger set with a larger error has too few points.
            count = min(settings.budget, math.ceil((1 + _GROWTH) * count))
            state = fitted(basis, count)
        if state.error < least:
            best, least = basis, state.error
        if least <= settings.error:
            return best, nodes
        larger = state.enlarged(order, settings)
        if larger is None:
            is_order_spent = len(_candidates(basis.indices, order)) == 0
            limit = f"order {order}" if is_order_spent else f"budget of {settings.budget} points"
            _warn(best, nodes, least, settings, limit)
            return best, nodes
        basis = larger
        count = max(count, _PER_TERM * basis.terms)


@final
class _State:
    """The least-squares fit of all outputs in one basis, with its error and residuals."""

    def __init__(self, basis: Basis, nodes: Nodes, outputs: tuple[Float[np.ndarray, "points entries"], ...]):
        self._basis, self._points = basis, nodes.points
        outputs = components(outputs, nodes.weights)
        self._orthogonal, triangular = np.linalg.qr(basis.matrix(self._points))
        remainder = 1 - np.sum(self._orthogonal**2, axis=1)
        self._residuals = [output - self._orthogonal @ (self._orthogonal.T @ output) for output in outputs]
        sound = remainder.min() > LEAST_REMAINDER and np.linalg.cond(triangular) < WORST_CONDITION
        self._errors = [
            float(np.sqrt(np.sum((residual / remainder[:, None]) ** 2) / len(residual))) if sound else np.inf
            for residual in self._residuals
        ]
        self.error = max(self._errors, default=0.0)

    def enlarged(self, order: int, settings: Adaptive) -> Basis | None:
        """The basis with further terms; None if order or budget allow none."""
        present = set(map(tuple, self._basis.indices.tolist()))
        candidates = _candidates(self._basis.indices, order)
        capacity = settings.budget // _PER_TERM - self._basis.terms
        room = min(capacity, math.ceil(_GROWTH * self._basis.terms))
        added: set[tuple[int, ...]] = set()
        for k in self._ranking(candidates, settings.error).tolist() if capacity > 0 else ():
            missing = _missing_divisors(tuple(candidates[k].tolist()), present | added)
            if len(added) + len(missing) <= (room if added else capacity):
                added |= missing
            if len(added) >= room:
                break
        if not added:
            return None
        indices = np.concatenate([self._basis.indices, np.array(sorted(added), dtype=int)])
        return Basis(self._basis.germs, sorted_terms(indices))

    def _ranking(self, candidates: Int[np.ndarray, "n variables"], error: float) -> Int[np.ndarray, " ranked"]:
        """Candidates that stand out from noise, the best first; if none does, all by their degree."""
        if len(candidates) == 0:
            return np.zeros(0, dtype=int)
        pending = [residual for residual, reached in zip(self._residuals, self._errors, strict=True) if reached > error]
        chunks = np.split(candidates, range(_CHUNK, len(candidates), _CHUNK))
        statistic = np.concatenate([self._explained(chunk, pending) for chunk in chunks])
        by_statistic = np.argsort(-statistic, kind="stable")
        outstanding = statistic[by_statistic] > 2 * math.log(len(candidates) + 1)
        if outstanding.any():
            return by_statistic[outstanding]
        return np.lexsort((-statistic, candidates.sum(axis=1)))

    def _explained(self, candidates: np.ndarray, residuals: list[np.ndarray]) -> Float[np.ndarray, " n"]:
        """The F statistic of each candidate, explained over residual squares: the largest over the outputs."""
        columns = Basis(self._basis.germs, candidates).matrix(self._points)
        columns -= self._orthogonal @ (self._orthogonal.T @ columns)
        sizes = np.sum(columns**2, axis=0)
        freedom = len(columns) - self._basis.terms - 1
        statistics = []
        for residual in residuals:
            gain = np.sum((columns.T @ residual) ** 2, axis=1) / np.where(sizes > 0, sizes, np.inf)
            statistics.append(freedom * gain / np.maximum(np.sum(residual**2) - gain, np.finfo(float).tiny))
        return np.max(statistics, axis=0)


def _candidates(indices: np.ndarray, order: int) -> Int[np.ndarray, "n variables"]:
    """Terms one or two degrees above one of the set in one variable, up to a total degree.

    Two, because every other coefficient of an even or odd output is zero.
    """
    steps = np.concatenate([np.eye(indices.shape[1], dtype=int), 2 * np.eye(indices.shape[1], dtype=int)])
    above = np.unique((indices[:, None, :] + steps[None, :, :]).reshape(-1, indices.shape[1]), axis=0)
    above = above[above.sum(axis=1) <= order]
    present = set(map(tuple, indices.tolist()))
    return above[[tuple(row) not in present for row in above.tolist()]]


def _missing_divisors(term: tuple[int, ...], present: set[tuple[int, ...]]) -> set[tuple[int, ...]]:
    """The term and those of its divisors that a downward closed set lacks."""
    missing: set[tuple[int, ...]] = set()
    waiting = [term]
    while waiting:
        divisor = waiting.pop()
        if divisor in present or divisor in missing:
            continue
        missing.add(divisor)
        waiting += [(*divisor[:i], degree - 1, *divisor[i + 1 :]) for i, degree in enumerate(divisor) if degree]
    return missing


def _check(settings: Adaptive, points: AbstractPoints, basis: Basis) -> None:
    """Refuse points with which an index set cannot be grown."""
    if not points.nested:
        raise ProblemError(
            f"Adaptive adds points to existing ones, which {type(points).__name__} do not allow. Take "
            "al.points.SobolPoints(), al.points.HaltonPoints() or al.points.RandomPoints()."
        )
    if isinstance(points, AbstractCountedPoints) and points.count is not None:
        raise ProblemError(
            f"Adaptive takes its number of points from its budget; received {points.count} points. Drop that number "
            f"and write al.index_sets.Adaptive(budget={points.count})."
        )
    if settings.budget < _PER_TERM * basis.terms:
        raise ProblemError(
            f"Adaptive: {basis.variables} variables need a budget of at least {_PER_TERM * basis.terms} points for "
            f"the {basis.terms} terms of degree 1; received {settings.budget}."
        )


def _warn(basis: Basis, nodes: Nodes, error: float, settings: Adaptive, limit: str) -> None:
    warnings.warn(
        f"Adaptive: {basis.terms} terms of order {basis.order} at {len(nodes.points)} points leave a leave-one-out "
        f"error of {error:.1e} where {settings.error:.1e} is asked, at the limit of its {limit}. Raise that limit, ask "
        "for less, or narrow the distributions.",
        ExpansionWarning,
        stacklevel=4,
    )
