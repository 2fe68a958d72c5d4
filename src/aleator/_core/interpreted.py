"""Equations computed by NumPy, one after the other: for a few values, which take less time than a compiler does."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jaxtyping import Int

from aleator._core.arrays import quietly

# Results that are operands' numbers in other places, or fixed ones: by NumPy, for JAX would compile a program for each.
MOVING: dict[str, Callable[..., Any]] = {
    "reshape": lambda one, new_sizes, **_: one.reshape(new_sizes),
    "transpose": lambda one, permutation: one.transpose(permutation),
    "squeeze": lambda one, dimensions: one.squeeze(dimensions),
    "slice": lambda one, start_indices, limit_indices, strides: one[
        tuple(map(slice, start_indices, limit_indices, strides or [None] * one.ndim))
    ],
    "split": lambda one, sizes, axis: np.split(one, np.cumsum(sizes)[:-1], axis),
    "concatenate": lambda *every, dimension: np.concatenate(every, dimension),
    "stack": lambda *every, axis: np.stack(every, axis),
    "rev": lambda one, dimensions: np.flip(one, dimensions),
    "broadcast_in_dim": lambda one, shape, broadcast_dimensions, **_: np.broadcast_to(
        np.expand_dims(one, [axis for axis in range(len(shape)) if axis not in broadcast_dimensions]), shape
    ),
}
# Numbers are taken from some places, or brought there.
GATHERS, SCATTERS = "gather", ("scatter", "scatter-add")
# Primitives that contain other equations.
NESTED = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "core_call": "call_jaxpr"}


def _product(one: Any, other: Any, dimension_numbers: Any, **_: Any) -> Any:
    (summed, others_summed), (kept, others_kept) = dimension_numbers

    def free(array: Any, *used: Sequence[int]) -> list[int]:
        return [axis for axis in range(array.ndim) if not any(axis in some for some in used)]

    own, others = free(one, summed, kept), free(other, others_summed, others_kept)
    batch, inner = [one.shape[axis] for axis in kept], math.prod(one.shape[axis] for axis in summed)
    shape, others_shape = [one.shape[axis] for axis in own], [other.shape[axis] for axis in others]
    left = one.transpose((*kept, *own, *summed)).reshape((*batch, math.prod(shape), inner))
    right = other.transpose((*others_kept, *others_summed, *others)).reshape((*batch, inner, math.prod(others_shape)))
    return (left @ right).reshape((*batch, *shape, *others_shape))


def _summed_up(one: Any, axis: int, reverse: bool) -> Any:
    turned = np.flip(one, axis) if reverse else one
    total = np.cumsum(turned, axis, dtype=one.dtype)
    return np.flip(total, axis) if reverse else total


_BY_NUMBER: dict[str, np.ufunc] = {
    **{name: getattr(np, name) for name in ("sign", "floor", "ceil", "square", "sqrt", "cbrt", "exp", "exp2", "expm1")},
    **{name: getattr(np, name) for name in ("log", "log1p", "sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{"asin": np.arcsin, "acos": np.arccos, "atan": np.arctan, "atan2": np.arctan2},
    **{"asinh": np.arcsinh, "acosh": np.arccosh, "atanh": np.arctanh, "is_finite": np.isfinite},
    **{"add": np.add, "add_any": np.add, "sub": np.subtract, "neg": np.negative, "abs": np.abs},
    **{"mul": np.multiply, "div": np.divide, "rem": np.fmod, "pow": np.power, "max": np.maximum, "min": np.minimum},
    **{"lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal},
    **{"eq": np.equal, "ne": np.not_equal},
    **{"and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert},
}
_BY_ARRAY: dict[str, Callable[..., Any]] = MOVING | {
    "copy": lambda one: one,
    "name": lambda one, **_: one,
    "integer_pow": lambda one, y, **_: one**y,
    "rsqrt": lambda one, **_: 1 / np.sqrt(one),
    "clamp": lambda least, one, most: np.clip(one, least, most),
    "select_n": lambda which, *cases: np.choose(which, cases),
    "convert_element_type": lambda one, new_dtype, **_: one.astype(new_dtype),
    "iota": lambda shape, dimension, **_: np.indices(shape)[dimension],
    "reduce_sum": lambda one, axes, **_: one.sum(axis=tuple(axes)),
    "reduce_max": lambda one, axes, **_: one.max(axis=tuple(axes)),
    "reduce_min": lambda one, axes, **_: one.min(axis=tuple(axes)),
    "cumsum": _summed_up,
    "dot_general": _product,
}


@quietly
def interpreted(jaxpr: Any, constants: Sequence[Any], arguments: Sequence[Any]) -> list[np.ndarray]:
    """The results of some equations. What NumPy has no function for is a program of JAX by itself."""
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))

    def read(variable: Any) -> Any:
        return np.asarray(variable.val) if isinstance(variable, Literal) else values[variable]

    for equation in jaxpr.eqns:
        results = _results(equation, [read(one) for one in equation.invars])
        values.update(zip(equation.outvars, results, strict=True))
    return [np.asarray(read(one)) for one in jaxpr.outvars]


def _results(equation: Any, operands: list[Any]) -> Sequence[Any]:
    name, params = equation.primitive.name, equation.params
    if name in NESTED or name == "custom_jvp_call":
        inner = params[NESTED.get(name, "call_jaxpr")]
        return interpreted(inner.jaxpr, inner.consts, operands)
    if (results := by_numpy(equation, operands)) is not None:
        return results
    with equation.ctx.manager:
        results = equation.primitive.bind(*operands, **equation.primitive.get_bind_params(params))
    return results if equation.primitive.multiple_results else [results]


def by_numpy(equation: Any, operands: Sequence[Any]) -> Sequence[np.ndarray] | None:
    """The results of one equation by NumPy; None if that has no function for it."""
    name, types = equation.primitive.name, [one.aval.dtype for one in equation.outvars]
    if name == GATHERS or name in SCATTERS:
        return _taken_or_brought(equation, operands)
    if name == "div" and not jnp.issubdtype(types[0], jnp.inexact):  # rounds towards zero
        return None
    if name in _BY_NUMBER:
        results = _BY_NUMBER[name](*map(np.asarray, operands))
    elif name in _BY_ARRAY:
        results = _BY_ARRAY[name](*map(np.asarray, operands), **equation.params)
    else:
        return None
    results = results if equation.primitive.multiple_results else [results]
    return [np.asarray(one, dtype) for one, dtype in zip(results, types, strict=True)]


def _taken_or_brought(equation: Any, operands: Sequence[Any]) -> Sequence[np.ndarray] | None:
    into, places, *brought = map(np.asarray, operands)
    if (landed := landed_at(equation, places)) is None:
        return None
    if not brought:
        return [into.ravel()[landed].reshape(equation.outvars[0].aval.shape)]
    result = into.flatten()
    if equation.primitive.name == "scatter":
        result[landed] = brought[0].ravel()
    else:
        np.add.at(result, landed, brought[0].ravel())
    return [result.reshape(into.shape)]


def landed_at(equation: Any, places: Int[np.ndarray, "... axes"]) -> Int[np.ndarray, " numbers"] | None:
    """Where in its operand each number stands that an equation takes or brings; None if some are outside, and for
    batches.
    """
    params, takes = equation.params["dimension_numbers"], equation.primitive.name == GATHERS
    shape, moved = equation.invars[0].aval.shape, (equation.outvars[0] if takes else equation.invars[2]).aval.shape
    if takes:
        within, without, axes = params.offset_dims, params.collapsed_slice_dims, params.start_index_map
    else:
        within, without, axes = (
            params.update_window_dims,
            params.inserted_window_dims,
            params.scatter_dims_to_operand_dims,
        )
    if params.operand_batching_dims:
        return None
    numbers = np.indices(moved)
    first = places[tuple(numbers[axis] for axis in range(len(moved)) if axis not in within)]
    at = np.zeros((len(shape), *moved), dtype=int)
    at[[axis for axis in range(len(shape)) if axis not in without]] = numbers[list(within)]
    at[list(axes)] += np.moveaxis(np.broadcast_to(first, (*moved, len(axes))), -1, 0)
    if any(one.size and not 0 <= one.min() <= one.max() < size for one, size in zip(at, shape, strict=True)):
        return None
    return np.ravel_multi_index(tuple(at), shape).ravel() if shape else np.zeros(math.prod(moved), dtype=int)
