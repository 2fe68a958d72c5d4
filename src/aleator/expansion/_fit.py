"""Fits: the map from samples at the collocation points to coefficients, on all terms or on few of many."""

import abc
from collections.abc import Callable, Sequence
from typing import ClassVar, TypeAlias, final

import jax
import numpy as np
from jaxtyping import Bool, Float
from typing_extensions import override

from aleator._core.arrays import Pytree, jax_array
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module
from aleator.ensemble import listed, refuse_nonfinite
from aleator.expansion._basis import AbstractBasis, Basis
from aleator.expansion._collocation import ROUNDING, Collocation, components
from aleator.expansion._points import Nodes

Respond: TypeAlias = Callable[[Float[np.ndarray, "points variables"]], Pytree]
"""A model's outputs at germ points: an array with a leading axis for the points, or a pytree of such arrays."""

# Beyond this condition number, least squares loses more than half of the digits of double precision.
WORST_CONDITION = 1e8

ILL_CONDITIONED = 1e6
"""Beyond this condition number a warning is given: coefficients lose digits, and points have very uneven influence."""

# At most one term per this many points.
_FEWEST_PER_TERM = 2

# A column is dependent if less than this part of its squares is left after projecting out those before it.
_DEPENDENT = 1e-10

# Columns whose inner products with all others are computed at a time.
_AHEAD = 32

# Germ values that agree to this many decimals are one value of a grid.
_DIGITS = 10

# Largest error of orthonormality with which a rule counts as exact for products of polynomials.
_ORTHONORMAL = 1e-8

# By how much missing points may multiply the condition number: one digit.
_WORSE = 10.0


class AbstractFit(Module):
    """How coefficients follow from samples: by a linear map, which depends on the germ alone once terms are chosen.

    `points_per_term`: the default number of points per term, for point sets without a number of their own.
    """

    points_per_term: ClassVar[int] = 3

    def select(self, basis: Basis, nodes: Nodes, respond: Respond | None) -> Basis:
        """The terms of a basis to keep: all of them, unless the fit chooses by the model's outputs."""
        del nodes, respond
        return basis

    @abc.abstractmethod
    def collocation(self, basis: AbstractBasis, nodes: Nodes) -> Collocation:
        """The collocation matrix and the map from samples to coefficients."""


@final
class LeastSquares(AbstractFit):
    """Least squares through the QR factors of the collocation matrix (equation 29).

    Squares are weighted by the weights of the points. These are equal, except for points drawn from another
    distribution than the germ's (`ChristoffelPoints`, `OptimalPoints`) and for quadrature points.
    """

    @override
    def collocation(self, basis: AbstractBasis, nodes: Nodes) -> Collocation:
        """Raises `ProblemError` for fewer points than terms, a singular matrix, or a weight that is not positive."""
        _refuse_too_few(basis, len(nodes.points))
        if not np.all(nodes.weights > 0):
            raise ProblemError(
                "LeastSquares: some points have weights that are not positive, so that squares cannot be weighted by "
                "them. Take al.fits.Projection() with sparse grids."
            )
        # Relative to the largest weight, so that equal weights do not change the matrix, not even by rounding.
        scale = np.sqrt(nodes.weights / nodes.weights.max())
        matrix = basis.matrix(nodes.points)
        orthogonal, triangular = np.linalg.qr(matrix * scale[:, None])
        condition = _checked_condition(triangular, len(matrix))
        return _collocation(
            basis,
            nodes,
            matrix,
            np.linalg.solve(triangular, orthogonal.T) * scale[None, :],
            np.sum(orthogonal**2, axis=1),
            condition,
        )


@final
class Interpolation(AbstractFit):
    """The polynomial through all samples, at as many points as terms: the fewest simulations (equation 29).

    No points are left to check it, so that its leave-one-out error is infinite. Arbitrary points often give a nearly
    singular matrix; `OptimalPoints` do not.
    """

    points_per_term: ClassVar[int] = 1

    @override
    def collocation(self, basis: AbstractBasis, nodes: Nodes) -> Collocation:
        """Raises `ProblemError` unless there are as many points as terms and the matrix is regular."""
        count, terms = len(nodes.points), basis.terms
        if count != terms:
            raise ProblemError(
                f"Interpolation takes as many points as terms, {terms}; received {count}. Drop their number, or "
                "take al.fits.LeastSquares()."
            )
        return LeastSquares().collocation(basis, nodes)


@final
class Projection(AbstractFit):
    """Coefficients as integrals of output times polynomial, by the quadrature rule of `GaussPoints` or `SmolyakPoints`.

    With positive weights it equals weighted least squares, and has the leave-one-out error of that. The weights of a
    sparse grid have both signs: its leave-one-out error is infinite, because it cannot be estimated.
    Source: Xiu and Hesthaven (2005); Constantine, Eldred and Phipps (2012) on the products that a rule must integrate.
    """

    @override
    def collocation(self, basis: AbstractBasis, nodes: Nodes) -> Collocation:
        """Raises `ProblemError`, naming a suitable rule, if this one does not integrate products of the polynomials."""
        matrix = basis.matrix(nodes.points)
        weighted = matrix * nodes.weights[:, None]
        error = float(np.abs(weighted.T @ matrix - np.eye(basis.terms)).max())
        if not error < _ORTHONORMAL:
            raise ProblemError(
                f"Projection: the weights of the {len(matrix)} points do not integrate the products of the polynomials "
                f"(error {error:.1e}, limit {_ORTHONORMAL:.0e}). Take al.points.GaussPoints({max(basis.degrees) + 1}) "
                f"or al.points.SmolyakPoints({basis.order}), which do for this basis, or al.fits.LeastSquares()."
            )
        positive = np.all(nodes.weights > 0)
        leverage = np.sum(weighted * matrix, axis=1) if positive else np.ones(len(matrix))
        return _collocation(basis, nodes, matrix, weighted.T, leverage, float(np.linalg.cond(matrix)))


@final
class Sparse(AbstractFit):
    """Least squares on few terms, chosen from the candidates of a large index set: for many variables, few points.

    Terms are added one by one, each the one that reduces the squared residuals of all outputs together the most
    (orthogonal least squares, a form of orthogonal matching pursuit), as long as a term stands out from noise for some
    output (the risk inflation criterion). The constant is always kept. All outputs, and all entries of a path, share
    one choice of terms, and so one map to coefficients; each output is weighted by its total variance.

    Give the number of points: `Expansion(8, points=300, index_set=HyperbolicCross(0.75), fit=Sparse())`. Terms are
    chosen once, by the outputs at the initial decisions.
    Source: Chen, Billings and Luo (1989), Orthogonal least squares methods and their application to non-linear system
    identification; Foster and George (1994), The risk inflation criterion for multiple regression.
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
        return Basis(basis.germs, basis.indices[np.sort(sparse_terms(matrix, outputs))])

    @override
    def collocation(self, basis: AbstractBasis, nodes: Nodes) -> Collocation:
        """Least squares on the terms that were kept."""
        return LeastSquares().collocation(basis, nodes)


def sparse_terms(
    matrix: Float[np.ndarray, "points terms"], outputs: Sequence[Float[np.ndarray, "points entries"]]
) -> list[int]:
    """Columns in the order of orthogonal least squares, the first one first, as long as one stands out from noise.

    Its F statistic for some output is then larger than that of the best of as many columns of noise, `2 log(count)`.
    A pivoted Cholesky factorisation of the columns' inner products, with the outputs beside it. Inner products are
    computed for the most promising columns at a time, because each pass through a large matrix takes long.
    """
    left = sizes = np.einsum("ij,ij->j", matrix, matrix)
    rest = np.array([np.sum(output**2) for output in outputs])
    least, first = ROUNDING**2 * rest, np.cumsum([0, *(output.shape[1] for output in outputs[:-1])])
    products = np.concatenate(outputs, axis=1).T @ matrix
    factor = np.empty((min(len(matrix) // _FEWEST_PER_TERM, len(sizes)), len(sizes)))
    known: dict[int, Float[np.ndarray, " terms"]] = {}
    terms: list[int] = []
    for k in range(len(factor)):
        usable = left > _DEPENDENT * sizes
        gains = np.add.reduceat(products**2, first) / np.where(usable, left, np.inf)
        noise = 2 * np.log(len(sizes) - k + 1) / (len(matrix) - k - 1) * (rest[:, None] - gains)
        outstanding = np.any(gains > np.maximum(noise, least[:, None]), axis=0)
        promise = np.where(outstanding, gains.sum(axis=0), 0.0)
        chosen = int(np.argmax(promise)) if k else 0
        if k and not outstanding[chosen]:
            break
        terms.append(chosen)
        if chosen not in known:
            promise[[chosen, *known]] = np.inf, *(len(known) * [-1.0])
            some = np.argpartition(-promise, min(_AHEAD, len(promise) - 1))[:_AHEAD]
            known |= zip(some.tolist(), (matrix[:, some].T @ matrix), strict=True)
        row = known.pop(chosen) - factor[:k, chosen] @ factor[:k]
        factor[k] = row = row / np.sqrt(left[chosen])
        rest = rest - gains[:, chosen]
        products -= np.outer(products[:, chosen] / row[chosen], row)
        left = np.where(np.arange(len(left)) == chosen, 0.0, left - row**2)
    return terms


def _collocation(
    basis: AbstractBasis,
    nodes: Nodes,
    matrix: np.ndarray,
    pseudo_inverse: np.ndarray,
    leverage: np.ndarray,
    condition: float,
) -> Collocation:
    checked = np.ones(len(matrix)) if _is_blind(basis, nodes) else leverage
    parts = (nodes.points, nodes.weights, matrix, pseudo_inverse, checked, condition)
    return Collocation(*map(jax_array, parts))


def _is_blind(basis: AbstractBasis, nodes: Nodes) -> bool:
    """Whether some variable takes no more values than its polynomials have coefficients, as on a Gauss grid.

    Functions of that variable alone are then interpolated, so that no point checks them, whatever the leverage.
    """
    return any(
        len(np.unique(values.round(_DIGITS))) <= degree + 1 < len(values) and degree > 0
        for values, degree in zip(nodes.points.T, basis.degrees, strict=True)
    )


def _refuse_too_few(basis: AbstractBasis, count: int) -> None:
    terms = basis.terms
    if count < terms:
        raise ProblemError(
            f"Expansion: {terms} terms in {basis.variables} variables need at least as many points; "
            f"received {count}. Use 3 * {terms} = {3 * terms} points or a lower order."
        )


def _checked_condition(triangular: Float[np.ndarray, "terms terms"], count: int) -> float:
    """The condition number. Raises `ProblemError` where the matrix is singular to working precision."""
    condition = float(np.linalg.cond(triangular))
    if not condition < WORST_CONDITION:
        raise ProblemError(
            f"The collocation matrix of {count} points and {len(triangular)} terms has condition number "
            f"{condition:.1e}, too large for least squares (limit {WORST_CONDITION:.0e}). Use more points or a lower "
            "order, or al.points.OptimalPoints()."
        )
    return condition


def at_fewer_points(
    basis: AbstractBasis, collocation: Collocation, fit: AbstractFit, kept: Bool[np.ndarray, " points"]
) -> Collocation:
    """The collocation at the points that are kept, with their weights relative to one another.

    Raises `ProblemError` for a fit other than least squares, if fewer points than terms are kept, or if the condition
    number grows more than tenfold: then nothing but extrapolation tells what the outputs do where points are missing.
    """
    missing = f"{np.count_nonzero(~kept)} of {len(kept)} samples are missing"
    if not isinstance(fit, LeastSquares):
        raise ProblemError(
            f"{missing}, but {type(fit).__name__} needs all of them: take al.fits.LeastSquares(), or complete them."
        )
    terms, remaining = basis.terms, int(np.count_nonzero(kept))
    if remaining < terms:
        raise ProblemError(f"{missing}, and {remaining} do not determine {terms} terms. Complete them.")
    weights = np.asarray(collocation.weights)[kept]
    fewer = fit.collocation(basis, Nodes(np.asarray(collocation.points)[kept], weights / weights.sum()))
    before, after = float(collocation.condition_number), float(fewer.condition_number)
    if not after <= _WORSE * before:
        raise ProblemError(
            f"{missing}, which raises the condition number of least squares from {before:.3g} to {after:.3g} (limit "
            f"{_WORSE:g} times as large): the expansion would only extrapolate there. Complete them, lower the order, "
            "or narrow the distributions."
        )
    return fewer


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
