"""Terms chosen by a model's outputs: `Adaptive` sets, which grow, and `Sparse` fits, which keep few of many."""

import itertools
import math
import warnings
from collections.abc import Iterator, Mapping
from typing import final

import equinox as eqx
import jax
import numpy as np
import scipy
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core import border
from aleator._core.errors import ExpansionWarning, ProblemError
from aleator._core.leaves import Module
from aleator.ensemble import listed, refuse_nonfinite
from aleator.expansion._basis import Basis, TotalDegree, sorted_terms
from aleator.expansion._collocation import LEAST_REMAINDER, ROUNDING, Collocation
from aleator.expansion._fit import WORST_CONDITION, AbstractFit, LeastSquares, Respond
from aleator.expansion._points import AbstractCountedPoints, AbstractPoints, Nodes
from aleator.uncertainty import AbstractGerm

# Points per term, as the dissertation advises after equation (29).
_PER_TERM = 3

# A set grows by this part at a time, so that the model is evaluated a few times, each for many points.
_GROWTH = 0.3

# Candidates whose polynomials are held in memory at a time.
_CHUNK = 2000

# At most one term per this many points: with more terms the corrected error rises.
_FEWEST_PER_TERM = 2

# A column is dependent if less than this part of its squares is left after projecting out those before it.
_DEPENDENT = 1e-10

# Terms after which a sparse fit is first judged, and columns whose inner products with all are computed at a time.
_FIRST, _AHEAD = 64, 32


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
    samples = _Samples(points, respond, basis)
    count = _PER_TERM * basis.terms
    best, least = basis, np.inf
    while True:
        samples.extend(count)
        state = _State(basis, samples)
        if state.error > least and count < settings.budget:
            # A larger set with a larger error has too few points.
            count = min(settings.budget, math.ceil((1 + _GROWTH) * count))
            samples.extend(count)
            state = _State(basis, samples)
        if state.error < least:
            best, least = basis, state.error
        if least <= settings.error:
            return best, samples.nodes
        larger = state.enlarged(order, settings)
        if larger is None:
            is_order_spent = len(_candidates(basis.indices, order)) == 0
            limit = f"order {order}" if is_order_spent else f"budget of {settings.budget} points"
            _warn(best, samples.nodes, least, settings, limit)
            return best, samples.nodes
        basis = larger
        count = max(count, _PER_TERM * basis.terms)


@final
class _Samples:
    """A model evaluated at the first points of a sequence."""

    def __init__(self, points: AbstractPoints, respond: Respond, basis: Basis):
        self._points, self._respond, self._basis = points, respond, basis
        self.nodes = Nodes(np.zeros((0, basis.variables)), np.zeros(0))
        self.outputs: tuple[Float[np.ndarray, "points entries"], ...] = ()

    def extend(self, count: int) -> None:
        """Evaluate the model at further points of the sequence, up to `count`."""
        known = len(self.nodes.points)
        if count == known:
            return
        self.nodes = self._points.nodes(self._basis, count)
        new = responses(self._respond, self._basis.names, self.nodes.points[known:], known)
        self.outputs = tuple(map(np.concatenate, zip(self.outputs, new, strict=True))) if known else new


@final
class _State:
    """The least-squares fit of all outputs in one basis, with its error and residuals."""

    def __init__(self, basis: Basis, samples: _Samples):
        self._basis, self._points = basis, samples.nodes.points
        outputs = components(samples.outputs, samples.nodes.weights)
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


@final
class Sparse(AbstractFit):
    """Least squares on few terms, chosen from the candidates of a large index set: for many variables, few points.

    Terms are added one by one, each the one that reduces the squared residuals of all outputs together the most
    (orthogonal least squares, a form of orthogonal matching pursuit); their number minimises the corrected
    leave-one-out error, and the search ends where a quarter more terms have no smaller one. The constant is always
    kept. All outputs, and all entries of a path, share one choice of terms, and so one map to coefficients; each output
    is weighted by its total variance.

    Give the number of points: `Expansion(8, points=300, index_set=HyperbolicCross(0.75), fit=Sparse())`. Terms are
    chosen once, by the outputs at the initial decisions.
    Source: Chen, Billings and Luo (1989), Orthogonal least squares methods and their application to non-linear system
    identification; Blatman and Sudret (2011), Adaptive sparse polynomial chaos expansion, for the error.
    """

    @override
    def select(self, basis: Basis, nodes: Nodes, respond: Respond | None) -> Basis:
        """Raises `ProblemError` without outputs or for negative weights."""
        if respond is None:
            raise ProblemError(
                "Sparse chooses terms by the model's outputs, which are not known here. Take al.fits.LeastSquares()."
            )
        if not np.all(nodes.weights > 0):
            raise ProblemError(
                "Sparse: some points have weights that are not positive, so that squares cannot be weighted by them. "
                "Take al.points.SobolPoints() or al.points.LatinHypercubePoints()."
            )
        outputs = components(responses(respond, basis.names, nodes.points), nodes.weights)
        if not outputs:
            return Basis(basis.germs, basis.indices[:1])
        matrix = basis.matrix(nodes.points)
        matrix *= np.sqrt(len(nodes.weights) * nodes.weights)[:, None]
        return Basis(
            basis.germs, basis.indices[np.sort(sparse_terms(matrix, principal(np.concatenate(outputs, axis=1))))]
        )

    @override
    def collocation(self, basis: Basis, nodes: Nodes) -> Collocation:
        """Least squares on the terms that were kept."""
        return LeastSquares().collocation(basis, nodes)


def sparse_terms(matrix: Float[np.ndarray, "points terms"], outputs: Float[np.ndarray, "points entries"]) -> list[int]:
    """The columns, in the order of `_entering`, with the least corrected error, which a quarter more do not lower."""
    entering, terms = _entering(matrix, outputs), []
    while True:
        wanted = max(3 * len(terms) // 2, _FIRST)
        terms += itertools.islice(entering, wanted - len(terms))
        best = 1 + int(np.argmin(corrected_errors(matrix[:, terms], outputs)))
        if len(terms) < wanted or 5 * best <= 4 * wanted:
            return terms[:best]


def _entering(matrix: Float[np.ndarray, "points terms"], outputs: Float[np.ndarray, "points entries"]) -> Iterator[int]:
    """Columns in the order of orthogonal least squares, the first one first, until the outputs are met or dependent.

    A pivoted Cholesky factorisation of the columns' inner products, with the outputs beside it. Inner products are
    computed for the most promising columns at a time, because each pass through a large matrix takes long.
    """
    sizes = np.einsum("ij,ij->j", matrix, matrix)
    least, left, products = ROUNDING**2 * np.sum(outputs**2), sizes.copy(), outputs.T @ matrix
    factor = np.empty((min(len(matrix) // _FEWEST_PER_TERM, len(sizes)), len(sizes)))
    known: dict[int, Float[np.ndarray, " terms"]] = {}
    for k in range(len(factor)):
        usable = left > _DEPENDENT * sizes
        gains = np.sum(products**2, axis=0) / np.where(usable, left, np.inf)
        chosen = int(np.argmax(gains)) if k else 0
        if k and not gains[chosen] > least:
            return
        yield chosen
        if chosen not in known:
            gains[[chosen, *known]] = np.inf, *(len(known) * [-1.0])
            some = np.argpartition(-gains, min(_AHEAD, len(gains) - 1))[:_AHEAD]
            known |= zip(some.tolist(), (matrix[:, some].T @ matrix), strict=True)
        row = known.pop(chosen) - factor[:k, chosen] @ factor[:k]
        factor[k] = row = row / np.sqrt(left[chosen])
        products -= np.outer(products[:, chosen] / row[chosen], row)
        left -= row**2
        left[chosen] = 0.0


def corrected_errors(
    matrix: Float[np.ndarray, "points terms"], outputs: Float[np.ndarray, "points entries"]
) -> Float[np.ndarray, " counts"]:
    """The corrected leave-one-out error of least squares on the first 1, 2, ... columns, summed over the outputs.

    The error is multiplied by `n / (n - P) (1 + trace of (A^T A)^-1)` for `P` terms at `n` points, against overfitting.
    The columns are independent and fewer than the points.
    Source: Chapelle, Vapnik and Bengio (2002), Model selection for small sample regression.
    """
    points, counts = len(matrix), np.arange(1, matrix.shape[1] + 1)
    # By Cholesky's factor, whose products are several times as fast as reflections: an error needs no more digits.
    triangular = np.linalg.cholesky(matrix.T @ matrix)
    orthogonal, inverse = (
        scipy.linalg.solve_triangular(triangular, right, lower=True) for right in (matrix.T, np.eye(len(counts)))
    )
    correction = points / (points - counts) * (1 + np.cumsum(np.sum(inverse**2, axis=1)))
    remainder, residual, errors = np.ones(points), outputs.copy(), np.empty(len(counts))
    for k, (column, terms) in enumerate(zip(np.ascontiguousarray(orthogonal), orthogonal @ outputs, strict=True)):
        remainder -= column**2
        residual -= np.outer(column, terms)
        sound = remainder.min() > LEAST_REMAINDER
        errors[k] = np.sum((residual / remainder[:, None]) ** 2) / points if sound else np.inf
    return errors * correction


def responses(
    respond: Respond, names: tuple[str, ...], points: Float[np.ndarray, "points variables"], before: int = 0
) -> tuple[Float[np.ndarray, "points entries"], ...]:
    """The outputs of a model at germ points, each as a matrix with a column for each of its entries.

    `before` is the number of earlier points, from which messages count on.

    Raises `ProblemError` if an output lacks the leading axis for the points, `SimulationError` if one is not finite.
    """
    answer = respond(points)
    leaves = jax.tree_util.tree_leaves_with_path(answer)
    if not leaves:
        raise ProblemError("Expansion: the model has no output to choose terms by; give it at least one.")
    outputs = []
    for path, leaf in leaves:
        name = f"'{jax.tree_util.keystr(path, simple=True, separator='.')}'" if path else "of the model"
        values = np.asarray(leaf, dtype=float)
        if values.shape[:1] != (len(points),):
            raise ProblemError(
                f"Expansion: expected the output {name} to have a leading axis of {len(points)} points; received "
                f"shape {values.shape}."
            )
        outputs.append(values.reshape(len(points), -1))

    def germ(index: int) -> str:
        return f"germ {listed(dict(zip(names, points[index], strict=True)))}"

    refuse_nonfinite("The model", answer, germ, before)
    return tuple(outputs)


def components(
    outputs: tuple[Float[np.ndarray, "points entries"], ...], weights: Float[np.ndarray, " points"]
) -> tuple[Float[np.ndarray, "points components"], ...]:
    """Each output that varies, in principal components, scaled so that its squares add up to the number of points.

    Means are subtracted and rows weighted by the roots of the weights. In principal components an output of thousands
    of entries has no more columns than there are points, with the same sums of squares over its entries.
    """
    roots = np.sqrt(weights)[:, None]
    varying = []
    for values in outputs:
        deviation = roots * (values - (weights @ values)[None, :])
        size = np.linalg.norm(deviation)
        if size > ROUNDING * np.linalg.norm(roots * values):
            varying.append(principal(deviation) * (np.sqrt(len(weights)) / size))
    return tuple(varying)


def principal(values: Float[np.ndarray, "points entries"]) -> Float[np.ndarray, "points components"]:
    """The principal components of a matrix beyond rounding, the largest first."""
    left, sizes, _ = np.linalg.svd(values, full_matrices=False)
    return (left * sizes[None, :])[:, sizes > ROUNDING * sizes[0]]
