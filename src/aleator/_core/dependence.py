"""Which derivatives of a function may differ from zero, and how few tangents tell all of these.

Which variables each row depends on, and which pairs of them bend it, follows from traced equations, never from values:
few derivatives of a larger model's rates by its states and signals can differ from zero. Equations that are not known
below count as bent by all that they are given, so that patterns may be too wide, but never too narrow.
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
from jaxtyping import Array, Bool, Float, Int

from aleator._core.interpreted import GATHERS, MOVING, NESTED, SCATTERS, by_numpy, landed_at

# Of one number each: linear in all operands together; bent.
_LINEAR = {
    *("add", "add_any", "sub", "neg", "copy", "name", "real"),
    *("convert_element_type", "reduce_precision", "select_n"),
}
_BENT = {
    *("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "atan2"),
    *("exp", "exp2", "expm1", "log", "log1p", "logistic", "erf", "erfc", "erf_inv", "lgamma", "digamma"),
    *("mul", "div", "pow", "integer_pow", "square", "sqrt", "rsqrt", "cbrt", "abs", "max", "min", "clamp"),
}
BY_NUMBER = {
    *(*_LINEAR, *_BENT, "sign", "floor", "ceil", "round", "is_finite", "stop_gradient", "rem"),
    *("lt", "le", "gt", "ge", "eq", "ne", "and", "or", "not", "xor"),
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


def column_groups(pattern: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, " columns"]:
    """A group for each column, such that none of a group have a row in common: one tangent along all of them tells
    their entries apart (Curtis, Powell and Reid, IMA Journal of Applied Mathematics 13, 1974).
    """
    groups = np.full(pattern.shape[1], -1)
    if len(groups) > _FEW:
        sparse = scipy.sparse.csc_array(pattern.astype(np.int32))
        table = (sparse.T @ sparse).tocsr()
        met = np.split(table.indices, table.indptr[1:-1])
    else:
        met = map(np.flatnonzero, pattern.T.astype(np.float32) @ pattern)
    for column, others in enumerate(met):
        taken = groups[others]
        groups[column] = np.setdiff1d(np.arange(len(taken) + 1), taken)[0]
    return groups


def seeds_of(groups: Int[np.ndarray, " columns"]) -> Float[np.ndarray, "groups columns"]:
    """A tangent for each group of columns; one at least."""
    return (np.arange(groups.max(initial=0) + 1)[:, None] == groups).astype(float)


def dependence(function: Callable[..., Array], data: Sequence[Any], variables: Sequence[Any]) -> Dependence:
    """That of the rows of `function(*data, *variables)` on the variables, side by side. Nothing is computed.

    - `data`: trees of arrays, or of their shapes; `variables`: arrays or their shapes.
    """
    closed, shape = jax.make_jaxpr(function, return_shape=True)(*data, *variables)
    sizes = [int(np.prod(one.shape)) for one in variables]
    count, rows = sum(sizes), int(np.prod(shape.shape))
    if max(_largest(closed.jaxpr), count) * count > _MOST:
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


def _largest(jaxpr: Any) -> int:
    """The size of the largest array in some equations."""
    size = 0
    for equation in jaxpr.eqns:
        inner = equation.params.get(NESTED.get(equation.primitive.name, ""))
        size = max(size, *(one.aval.size for one in equation.outvars), _largest(inner.jaxpr) if inner else 0)
    return size


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
            return [_summed(equation, operands[0])]
        if name == "dot_general":
            return [self._contracted(equation, *operands)]
        if name in _LINEAR or name in _BENT:
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
        elif name in _BENT:
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


def _summed(equation: Any, operand: _Known) -> _Known:
    if operand is None:
        return None
    count, params = operand.shape[1], equation.params
    table = operand.reshape(*equation.invars[0].aval.shape, count)
    if equation.primitive.name == "reduce_sum":
        united = np.logical_or.reduce(table, axis=tuple(params["axes"]))
    else:
        axis, turn = params["axis"], np.flip if params["reverse"] else lambda one, _: one
        united = turn(np.logical_or.accumulate(turn(table, axis), axis=axis), axis)
    return _one_after_another(united)


def _arranged(
    table: _Known, count: int, shape: tuple[int, ...], summed: Any, kept: Any
) -> Bool[np.ndarray, "kept own summed variables"]:
    """A factor's table by three axes of its array: those kept, those of its own, those summed."""
    own = [axis for axis in range(len(shape)) if axis not in (*summed, *kept)]
    sizes = [int(np.prod([shape[axis] for axis in axes])) for axes in (kept, own, summed)]
    if table is None:
        return np.zeros((*sizes, count), dtype=bool)
    return table.reshape(*shape, count).transpose(*kept, *own, *summed, -1).reshape(*sizes, count)
