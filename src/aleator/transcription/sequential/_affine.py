"""Outputs affine in features of the germ: the model is evaluated at a few points, of which all others are combinations.

The torques of a motion are sums of factors that depend on the motion times masses and moments of inertia, which depend
on the germ. So the torques at any collocation point are a combination of those at a few points, the anchors, with
weights that do not depend on the motion. Whether an output is of this kind follows from the traced equations, never
from values. (Reduced-basis methods call it affine parameter dependence: Hesthaven, Rozza, Stamm, Certified Reduced
Basis Methods for Parametrized Partial Differential Equations, 2016, section 3.3.)
"""

import enum
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float

from aleator._core.arrays import jax_array
from aleator._core.leaves import Module

# Directions below this part of the largest one are zero up to rounding: no feature varies along them.
_ROUNDING = 1e-11

# Primitives that are linear in all their operands together, and primitives linear in each operand by itself.
_LINEAR = {
    *("add", "add_any", "sub", "neg", "copy", "reduce_sum", "cumsum"),
    *("reshape", "transpose", "broadcast_in_dim", "squeeze", "slice", "split", "stack", "concatenate", "pad", "rev"),
}
_BILINEAR = {"mul", "dot_general"}
# Primitives linear in their first operands, by the number of these, if the others are certain.
_LINEAR_IN_FIRST = {"div": 1, "gather": 1, "dynamic_slice": 1, "dynamic_update_slice": 2}
# Primitives that contain other equations.
_NESTED = {"jit": "jaxpr", "pjit": "jaxpr", "custom_jvp_call": "call_jaxpr"}


@final
class Anchors(Module):
    """Collocation points at which affine outputs are evaluated, and the weights that extend them to all points.

    - `points`: shape (anchors, variables); `weights`: shape (points, anchors), each row adding up to one;
    - `affine`: whether each functional is affine.
    """

    points: Float[Array, "anchors variables"]
    weights: Float[Array, "points anchors"]
    affine: tuple[bool, ...] = eqx.field(static=True)


def anchored(
    points: Float[np.ndarray, "points variables"],
    features: Float[np.ndarray, "points features"],
    affine: Iterable[bool],
) -> Anchors | None:
    """The fewest points whose features span the features at all points, by combinations that add up to one.

    None if that takes all points, or if a feature is not finite.
    """
    if not np.isfinite(features).all():
        return None
    deviations = features - features.mean(axis=0)
    sizes = np.abs(deviations).max(axis=0, initial=0.0)
    varying = sizes > 0
    rows = np.hstack([np.ones((len(points), 1)), deviations[:, varying] / sizes[varying]])
    chosen = _spanning(rows)
    if len(chosen) == len(points):
        return None
    weights = np.linalg.lstsq(rows[chosen].T, rows.T)[0].T
    return Anchors(jax_array(points[chosen]), jax_array(weights), tuple(affine))


def _spanning(rows: Float[np.ndarray, "points features"]) -> list[int]:
    """Rows that span all, each the furthest from the span of those before: the pivots of a QR factorisation, for which
    SciPy would have to be loaded.
    """
    chosen, left = list[int](), rows.copy()
    furthest = first = np.linalg.norm(left, axis=1)
    while furthest.max() > _ROUNDING * first.max() and len(chosen) < min(rows.shape):
        chosen.append(int(furthest.argmax()))
        direction = left[chosen[-1]] / furthest[chosen[-1]]
        for _ in range(2):  # twice is enough
            left -= np.outer(left @ direction, direction)
        furthest = np.linalg.norm(left, axis=1)
        furthest[chosen] = 0.0
    return chosen


def affine_features(
    function: Callable[[Array, Array], Sequence[Array]],
    germ: Float[Array, " variables"],
    moved: Float[Array, " numbers"],
) -> tuple[Float[Array, " features"], tuple[bool, ...]]:
    """Features of the germ alone in which outputs of `function(germ, moved)` are affine, and which outputs are.

    Values that the function closes over are known, and may be traced by an outer transformation.
    """
    closed = jax.make_jaxpr(lambda *both: tuple(function(*both)))(germ, moved)
    arguments = [_Entry(_Kind.GERM, germ), _Entry(_Kind.MOVED)]
    affine = tuple(one.kind is not _Kind.OTHER for one in _walked(closed.jaxpr, closed.consts, arguments, None))
    # Equations of the others need no features.
    needed, _ = dce_jaxpr(closed.jaxpr, affine, instantiate=True)
    features: list[Array] = []
    features += [one.value for one in _walked(needed, closed.consts, arguments, features) if one.kind is _Kind.GERM]
    return jnp.concatenate([jnp.zeros(0), *(jnp.ravel(one) for one in features)]), affine


@final
class _Kind(enum.Enum):
    """The dependence of a number in the traced equations."""

    KNOWN = "nothing"
    GERM = "the germ alone"
    MOVED = "what is moved alone"
    AFFINE = "what is moved, and in an affine way on features of the germ"
    OTHER = "both in another way"


_UNCERTAIN = {_Kind.GERM, _Kind.AFFINE}
_VALUED = {_Kind.KNOWN, _Kind.GERM}


class _Entry(NamedTuple):
    """A variable of the equations; its value is known as long as it does not depend on what is moved."""

    kind: _Kind
    value: Any = None


def _walked(
    jaxpr: Any, constants: Sequence[Any], arguments: Sequence[_Entry], features: list[Array] | None
) -> list[_Entry]:
    """The entries of the results. Numbers of the germ that are combined with moved ones join `features`.

    Without these, nothing is computed.
    """
    known = [_Entry(_Kind.KNOWN, value) for value in constants]
    entries = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*known, *arguments], strict=True))

    def read(variable: Any) -> _Entry:
        return _Entry(_Kind.KNOWN, variable.val) if isinstance(variable, Literal) else entries[variable]

    for equation in jaxpr.eqns:
        results = _followed(equation, [read(variable) for variable in equation.invars], features)
        entries.update(zip(equation.outvars, results, strict=True))
    return [read(variable) for variable in jaxpr.outvars]


def _followed(equation: Any, operands: list[_Entry], features: list[Array] | None) -> list[_Entry]:
    """The entries of one equation's results."""
    kinds = [one.kind for one in operands]
    if _VALUED.issuperset(kinds):
        kind = _Kind.GERM if _Kind.GERM in kinds else _Kind.KNOWN
        values = [None] * len(equation.outvars)
        if features is not None:
            values = _computed(equation, [one.value for one in operands])
        return [_Entry(kind, value) for value in values]
    if equation.primitive.name in _NESTED and _Kind.OTHER not in kinds:
        inner = equation.params[_NESTED[equation.primitive.name]]
        return _walked(inner.jaxpr, inner.consts, operands, features)
    return [_Entry(_combined(equation, operands, features))] * len(equation.outvars)


def _combined(equation: Any, operands: list[_Entry], features: list[Array] | None) -> _Kind:
    kinds = [one.kind for one in operands]
    if _Kind.OTHER in kinds:
        return _Kind.OTHER
    uncertain = [kind in _UNCERTAIN for kind in kinds]
    if not any(uncertain):
        return _Kind.MOVED
    if not _is_affine(equation, uncertain):
        return _Kind.OTHER
    if features is not None:
        features += [one.value for one in operands if one.kind is _Kind.GERM]
    return _Kind.AFFINE


def _is_affine(equation: Any, uncertain: list[bool]) -> bool:
    """Whether an equation is jointly affine in its uncertain operands; the others are certain."""
    name = equation.primitive.name
    if name == "convert_element_type":
        return jnp.issubdtype(equation.params["new_dtype"], jnp.floating)
    if name == "select_n":
        return not uncertain[0]
    if name in _LINEAR_IN_FIRST:
        return not any(uncertain[_LINEAR_IN_FIRST[name] :])
    return name in _LINEAR or (name in _BILINEAR and sum(uncertain) == 1)


def _computed(equation: Any, values: list[Any]) -> Sequence[Any]:
    results = equation.primitive.bind(*values, **equation.primitive.get_bind_params(equation.params))
    return results if equation.primitive.multiple_results else [results]
