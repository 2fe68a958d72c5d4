"""`Sparse`: few terms out of many candidates, chosen by least angle regression."""

import warnings
from typing import Any, final

import numpy as np
from jaxtyping import Float, Int
from typing_extensions import override

from aleator._core.errors import MissingExtraError, ProblemError
from aleator.expansion._basis import Basis
from aleator.expansion._collocation import Collocation
from aleator.expansion._fit import AbstractFit, LeastSquares
from aleator.expansion._points import Nodes
from aleator.expansion._respond import Respond, components, principal, responses

# Principal components are ranked until the rest holds less than this part of all squares.
_NEGLIGIBLE = 1e-6

# At most one term per this many points: with more terms the corrected error rises.
_FEWEST_PER_TERM = 2

# A column is dependent if less than this is left of it after projecting out those before it.
_DEPENDENT = 1e-7


@final
class Sparse(AbstractFit):
    """Least squares on few terms, chosen from the candidates of a large index set: for many variables, few points.

    Least angle regression ranks the candidates by the penalty at which they enter; the number of terms minimises the
    corrected leave-one-out error ("hybrid LARS"). The constant is always kept. All outputs, and all entries of a path,
    share one choice of terms, and so one map to coefficients: the principal components of all outputs are ranked, each
    output weighted by its total variance, and a term takes its best rank.

    Give the number of points: `Expansion(8, points=300, index_set=HyperbolicCross(0.75), fit=Sparse())`. Terms are
    chosen once, by the outputs at the initial decisions. Needs scikit-learn: `pip install "aleator[sparse]"`.
    Source: Blatman and Sudret (2011), Adaptive sparse polynomial chaos expansion based on least angle regression.
    """

    @override
    def select(self, basis: Basis, nodes: Nodes, respond: Respond | None) -> Basis:
        """Raises `MissingExtraError` without scikit-learn, `ProblemError` without outputs or for negative weights."""
        linear_model = _linear_model()
        if respond is None:
            raise ProblemError(
                "Sparse chooses terms by the model's outputs, which are not available here. Take "
                "al.fits.LeastSquares()."
            )
        if not np.all(nodes.weights > 0):
            raise ProblemError(
                "Sparse: some points have weights that are not positive, so that squares cannot be weighted by them. "
                "Take al.points.SobolPoints() or al.points.LatinHypercubePoints()."
            )
        outputs = components(responses(respond, basis.names, nodes.points), nodes.weights)
        if not outputs:
            return Basis(basis.germs, basis.indices[:1])
        matrix = basis.matrix(nodes.points) * np.sqrt(len(nodes.weights) * nodes.weights)[:, None]
        everything = principal(np.concatenate(outputs, axis=1))
        ranking = _ranking(linear_model, matrix, everything)
        count = 1 + int(np.argmin(corrected_errors(matrix[:, ranking], everything)))
        return Basis(basis.germs, basis.indices[np.sort(ranking[:count])])

    @override
    def collocation(self, basis: Basis, nodes: Nodes) -> Collocation:
        """Least squares on the terms that were kept."""
        return LeastSquares().collocation(basis, nodes)


def corrected_errors(
    matrix: Float[np.ndarray, "points terms"], outputs: Float[np.ndarray, "points entries"]
) -> Float[np.ndarray, " counts"]:
    """The corrected leave-one-out error of least squares on the first 1, 2, ... columns, summed over the outputs.

    The error is multiplied by `n / (n - P) (1 + trace of (A^T A)^-1)` for `P` terms at `n` points, against overfitting.
    There is one entry for each number of columns, as long as they are independent and fewer than the points.
    Source: Chapelle, Vapnik and Bengio (2002), Model selection for small sample regression.
    """
    points = len(matrix)
    orthogonal, triangular = np.linalg.qr(matrix)
    sound = np.abs(np.diag(triangular)) > _DEPENDENT * np.linalg.norm(matrix, axis=0)[: len(triangular)]
    most = min(points - 1, len(sound) if sound.all() else int(np.argmin(sound)))
    inverse = np.linalg.inv(triangular[:most, :most])
    terms = np.arange(1, most + 1)
    correction = points / (points - terms) * (1 + np.cumsum(np.sum(inverse**2, axis=0)))
    leverage, residual = np.zeros(points), outputs.copy()
    errors = np.empty(most)
    for k, column in enumerate(orthogonal[:, :most].T):
        leverage += column**2
        residual -= column[:, None] * (column @ outputs)[None, :]
        with np.errstate(divide="ignore", invalid="ignore"):
            errors[k] = np.sum((residual / (1 - leverage)[:, None]) ** 2) / points
    return np.where(np.isnan(errors), np.inf, errors) * correction


def _ranking(
    linear_model: Any, matrix: Float[np.ndarray, "points terms"], outputs: Float[np.ndarray, "points components"]
) -> Int[np.ndarray, " ranked"]:
    """Terms by the penalty at which they enter, the highest first, after the constant."""
    constant = matrix[:, 0] / np.linalg.norm(matrix[:, 0])
    columns = matrix - constant[:, None] * (constant @ matrix)[None, :]
    sizes = np.linalg.norm(columns, axis=0)
    candidates = np.flatnonzero(sizes > _DEPENDENT * np.linalg.norm(matrix, axis=0))
    columns = columns[:, candidates] / sizes[candidates]
    entry = np.zeros(matrix.shape[1])
    squares = np.sum(outputs**2, axis=0)
    left = np.cumsum(squares[::-1])[::-1]
    for component in outputs.T[left > _NEGLIGIBLE * left[0]]:
        with warnings.catch_warnings():
            # If candidates are nearly dependent, the path stops early or drops a term, but still gives a ranking.
            warnings.filterwarnings("ignore", module="sklearn")
            penalties, active, _ = linear_model.lars_path(
                columns, component, method="lar", max_iter=min(columns.shape[1], len(matrix) // _FEWEST_PER_TERM)
            )
        entered = candidates[np.array(active, dtype=int)]
        entry[entered] = np.maximum(entry[entered], penalties[: len(entered)])
    order = np.argsort(-entry, kind="stable")
    return np.concatenate([[0], order[entry[order] > 0]])


def _linear_model() -> Any:
    try:
        from sklearn import linear_model
    except ImportError as error:
        raise MissingExtraError(
            '`Sparse` needs the library scikit-learn: install it with `pip install "aleator[sparse]"`, or take '
            "al.fits.LeastSquares() or al.index_sets.Adaptive()."
        ) from error
    return linear_model
