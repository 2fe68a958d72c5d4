"""Traced equations followed number by number: on which variables each depends, and what NumPy makes of known ones.

Which variables each row depends on, and which pairs of them bend it, follows from traced equations, never from values:
few derivatives of a larger model's rates by its states and signals can differ from zero. Equations that are not known
below count as bent by all that they are given, so that patterns may be too wide, but never too narrow. A few values are
computed by NumPy, one equation after the other, in less time than a compiler takes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax.core import Tracer
from jax.extend.core import ClosedJaxpr, Literal
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Bool, Int

from aleator._core.arrays import quietly
from aleator._core.equations import equations_in

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
    names = ("update_window_dims", "inserted_window_dims", "scatter_dims_to_operand_dims")
    names = ("offset_dims", "collapsed_slice_dims", "start_index_map") if takes else names
    within, without, axes = (getattr(params, name) for name in names)
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


# Linear in all operands together.
_LINEAR = {
    *("add", "add_any", "sub", "neg", "copy", "name", "real"),
    *("convert_element_type", "reduce_precision", "select_n"),
}
BY_NUMBER = {
    *(*_BY_NUMBER, *_LINEAR, "integer_pow", "rsqrt", "clamp", "round", "stop_gradient"),
    *("logistic", "erf", "erfc", "erf_inv", "lgamma", "digamma"),
}
"""Equations of one number each, of arrays of one shape."""
# Numbers that move beside those of `MOVING`, by JAX.
_MOVING_BY_JAX = {"pad", "dynamic_slice"}
# No table of dependences is larger than this: blocks of more numbers are full.
_MOST = 10_000_000
# Tables of more variables are multiplied as sparse ones.
_FEW = 100

_Table: TypeAlias = Bool[np.ndarray, "numbers variables"]
_Known: TypeAlias = _Table | None
"""On which variables each number of an array depends, one after another; None for what depends on no variable."""


class Dependence(NamedTuple):
    """Where a block's derivatives may differ from zero.

    - `first`: of each row by each variable; `second`: by each pair of variables, of any row;
    - `affine`: the equations of the rows if derivatives are the same everywhere: no pair of variables bends these, and
      none decides something, as by a comparison.
    """

    first: Bool[np.ndarray, "rows variables"]
    second: Bool[np.ndarray, "variables variables"]
    affine: ClosedJaxpr | None


def dependence(function: Callable[..., Array], data: Sequence[Any], variables: Sequence[Any]) -> Dependence:
    """That of the rows of `function(*data, *variables)` on the variables, side by side. Nothing is computed.

    - `data`: trees of arrays, or of their shapes; `variables`: arrays or their shapes.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*data, *variables)
    sizes = [int(np.prod(one.shape)) for one in variables]
    count, rows = sum(sizes), int(np.prod(shape.shape))
    largest = max((one.aval.size for equation in equations_in(closed.jaxpr) for one in equation.outvars), default=0)
    if max(largest, count) * count > _MOST:
        return Dependence(np.ones((rows, count), dtype=bool), np.ones((count, count), dtype=bool), None)
    jaxpr, _ = dce_jaxpr(closed.jaxpr, [True], instantiate=True)
    certain = len(jaxpr.invars) - len(variables)
    alone = np.split(np.eye(count, dtype=bool), np.cumsum(sizes)[:-1])
    following = _Following(count)
    known = dict(zip(jaxpr.constvars, closed.consts, strict=True))
    (first,) = following.results(jaxpr, [*[None] * certain, *alone], known)
    first = np.zeros((rows, count), dtype=bool) if first is None else first
    is_affine = not (following.bent.any() or following.decides)
    return Dependence(first, following.bent, ClosedJaxpr(jaxpr, closed.consts) if is_affine else None)


@final
class _Following:
    """Follows dependences through equations, and notes the pairs of variables that bend some number, in `bent`, and
    whether one `decides` something.
    """

    def __init__(self, count: int):
        self.bent = np.zeros((count, count), dtype=bool)
        self.decides = False

    def results(self, jaxpr: Any, arguments: Sequence[_Known], constants: Mapping[Any, Any]) -> list[_Known]:
        """The dependences of the results of some equations, with the values of their constants."""
        tables: dict[Any, _Known] = dict(zip(jaxpr.invars, arguments, strict=True))
        counted = {one: np.asarray(value) for one, value in constants.items() if _is_counted(one, value)}

        def read(variable: Any) -> _Known:
            return None if isinstance(variable, Literal) else tables.get(variable)

        for equation in jaxpr.eqns:
            operands = [read(one) for one in equation.invars]
            depends, is_smooth = any(one is not None for one in operands), any(map(_is_smooth, equation.outvars))
            if depends and is_smooth:
                pairs = zip(equation.outvars, self._followed(equation, operands, counted), strict=True)
                tables.update((variable, table if _is_smooth(variable) else None) for variable, table in pairs)
            elif depends:
                self.decides = True
            elif not is_smooth:
                # The numbers of places, such as those of `x.at[0]` and `x[-indices]`.
                values = [one.val if isinstance(one, Literal) else counted.get(one) for one in equation.invars]
                if all(one is not None for one in values) and (results := by_numpy(equation, values)) is not None:
                    counted.update(zip(equation.outvars, results, strict=True))
        return [read(one) for one in jaxpr.outvars]

    def _followed(self, equation: Any, operands: list[_Known], counted: dict[Any, np.ndarray]) -> Sequence[_Known]:
        name = equation.primitive.name
        if name == GATHERS or name in SCATTERS:
            places = counted.get(equation.invars[1])
            if places is not None and (landed := landed_at(equation, places)) is not None:
                return [_brought(equation, landed, operands)]
        if name in NESTED:
            inner = equation.params[NESTED[name]]
            return self.results(inner.jaxpr, operands, dict(zip(inner.jaxpr.constvars, inner.consts, strict=True)))
        if (name in MOVING or name in _MOVING_BY_JAX) and _moves_by_known_places(equation):
            return _moved(equation, operands)
        if name == "reduce_sum" or name == "cumsum":
            assert operands[0] is not None
            return [_summed(equation, operands[0])]
        if name == "dot_general":
            return [self._contracted(equation, *operands)]
        if name in BY_NUMBER:
            return [self._by_number(name, _spread(equation, operands))]
        every = np.logical_or.reduce(np.concatenate([one for one in operands if one is not None]))[None]
        self._bend(every, every)
        return [np.repeat(every, one.aval.size, axis=0) for one in equation.outvars]

    def _by_number(self, name: str, operands: list[_Known]) -> _Table:
        """Of an equation of one number each, for all numbers of an array."""
        united = reduce(np.logical_or, [one for one in operands if one is not None])
        if name == "mul":
            self._bend(*operands)
        elif name == "div":
            self._bend(united, operands[1])
        elif name not in _LINEAR:
            self._bend(united, united)
        return united

    def _contracted(self, equation: Any, one: _Known, other: _Known) -> _Table:
        """Of a product of matrices: batch by batch, rows of one by rows of the other."""
        summed, kept = equation.params["dimension_numbers"]
        count = len(self.bent)
        each = zip((one, other), equation.invars, summed, kept, strict=True)
        left, right = (_arranged(table, count, operand.aval.shape, *axes) for table, operand, *axes in each)
        self._bend(*(_one_after_another(np.logical_or.reduce(side, axis=1)) for side in (left, right)))
        before, after = (np.logical_or.reduce(side, axis=2) for side in (left, right))
        return _one_after_another(np.logical_or(before[:, :, None], after[:, None]))

    def _bend(self, one: _Known, other: _Known) -> None:
        """Numbers of one are multiplied by those of the other."""
        if one is None or other is None:
            return
        if len(self.bent) > _FEW:
            crossed = (scipy.sparse.csr_array(one).T @ scipy.sparse.csr_array(other)).nonzero()
        else:
            crossed = np.nonzero(one.T.astype(np.float32) @ other)
        self.bent[crossed] = self.bent[crossed[::-1]] = True


def _spread(equation: Any, operands: list[_Known]) -> list[_Known]:
    """Of all numbers of the result, as arrays are broadcast."""
    shape = equation.outvars[0].aval.shape
    shapes = [one.aval.shape for one in equation.invars]
    return [
        one
        if one is None or own == shape
        else _one_after_another(np.broadcast_to(one.reshape(*own, one.shape[1]), (*shape, one.shape[1])))
        for one, own in zip(operands, shapes, strict=True)
    ]


def _one_after_another(table: Bool[np.ndarray, "... variables"]) -> _Table:
    """An array's numbers along one axis. There may be none of them."""
    return table.reshape(math.prod(table.shape[:-1]), table.shape[-1])


def _is_smooth(variable: Any) -> bool:
    """Whether an array may have derivatives: complex numbers do, and keys of random numbers do not."""
    return jnp.issubdtype(variable.aval.dtype, jnp.inexact)


def _is_counted(variable: Any, value: Any) -> bool:
    """Whether an array is the numbers of places, and known."""
    return not (isinstance(value, Tracer) or _is_smooth(variable))


def _brought(equation: Any, landed: Int[np.ndarray, " numbers"], operands: list[_Known]) -> _Known:
    """Of numbers taken from their places, or with others brought there, beside what was there before."""
    into, _, *others = operands
    if equation.primitive.name == GATHERS:
        return None if into is None else into[landed]
    (brought,) = others
    if brought is None:
        return into
    table = np.zeros((equation.outvars[0].aval.size, brought.shape[1]), dtype=bool) if into is None else into.copy()
    np.logical_or.at(table, landed, brought)
    return table


def _moves_by_known_places(equation: Any) -> bool:
    return all(_is_smooth(one) or isinstance(one, Literal) for one in equation.invars)


def _moved(equation: Any, operands: list[_Known]) -> list[_Known]:
    """What has moved where follows from moving numbers of places. 0 is that of nothing, such as what is padded with."""
    sizes = [one.aval.size if _is_smooth(one) else 0 for one in equation.invars]
    places = [
        np.arange(last - size, last, dtype=float).reshape(one.aval.shape) if _is_smooth(one) else one.val
        for one, size, last in zip(equation.invars, sizes, 1 + np.cumsum(sizes), strict=True)
    ]
    if move := MOVING.get(equation.primitive.name):
        moved = move(*places, **equation.params)
    else:
        # Now, where some other function is being traced too.
        with jax.ensure_compile_time_eval():
            moved = equation.primitive.bind(*places, **equation.primitive.get_bind_params(equation.params))
    nothing = np.zeros((1, next(one for one in operands if one is not None).shape[1]), dtype=bool)
    tables = [
        np.repeat(nothing, size, axis=0) if one is None else one for one, size in zip(operands, sizes, strict=True)
    ]
    every = np.concatenate([nothing, *tables])
    # What lies outside of an array may be told as no number at all.
    results = moved if equation.primitive.multiple_results else [moved]
    return [every[np.nan_to_num(np.asarray(one)).astype(int).ravel()] for one in results]


def _summed(equation: Any, operand: _Table) -> _Table:
    table = operand.reshape(*equation.invars[0].aval.shape, operand.shape[1])
    return _one_after_another(_BY_ARRAY[equation.primitive.name](table, **equation.params).astype(bool))


def _arranged(
    table: _Known, count: int, shape: tuple[int, ...], summed: Any, kept: Any
) -> Bool[np.ndarray, "kept own summed variables"]:
    """A factor's table by three axes of its array: those kept, those of its own, those summed."""
    own = [axis for axis in range(len(shape)) if axis not in (*summed, *kept)]
    sizes = [int(np.prod([shape[axis] for axis in axes])) for axes in (kept, own, summed)]
    if table is None:
        return np.zeros((*sizes, count), dtype=bool)
    return table.reshape(*shape, count).transpose(*kept, *own, *summed, -1).reshape(*sizes, count)
