"""A model's outputs at germ points, for choosing terms: checked, and scaled for comparison."""

from collections.abc import Callable
from typing import TypeAlias

import jax
import numpy as np
from jaxtyping import Float

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError
from aleator.ensemble import listed, refuse_nonfinite

Respond: TypeAlias = Callable[[Float[np.ndarray, "points variables"]], Pytree]
"""A model's outputs at germ points: an array with a leading axis for the points, or a pytree of such arrays."""

# Outputs that vary by less than this part of their size are constant up to rounding.
_ROUNDING = 1e-12


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
        if size > _ROUNDING * np.linalg.norm(roots * values):
            varying.append(principal(deviation) * (np.sqrt(len(weights)) / size))
    return tuple(varying)


def principal(values: Float[np.ndarray, "points entries"]) -> Float[np.ndarray, "points components"]:
    """The principal components of a matrix, the largest first."""
    left, sizes, _ = np.linalg.svd(values, full_matrices=False)
    return left * sizes[None, :]
