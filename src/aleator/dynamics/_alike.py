"""Equations of one number each that are alike, evaluated together: models that name many states are as few equations as
those with an array of them.

A system of fifty named states has hundreds of equations of one number, each of which takes as long to compile as one of
an array. Here every number is followed through the equations: arrays that are cut, stacked and joined move numbers to
other places and compute nothing. Equations that do the same, with numbers that are known equally early, become one of
an array, whose operands are brought together from where these numbers are.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Literal
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Int

from aleator._core.arrays import Pytree
from aleator._core.dependence import BY_NUMBER, MOVING, NESTED

# Functions of fewer names are not worth a second trace; so many equations are worth bringing their operands together.
_MANY, _ALIKE = 16, 8
# Numbers from more stretches of arrays are gathered one by one, in the place of cut out and joined.
_STRETCHES = 4
# By the numbers of one dimension.
_ONE_BY_ONE = jax.lax.GatherDimensionNumbers(offset_dims=(), collapsed_slice_dims=(0,), start_index_map=(0,))

_Places: TypeAlias = Int[np.ndarray, "..."]
"""The place of each number of an array among all numbers of some equations."""


def together(names: int, function: Callable[..., Pytree], *arguments: Pytree) -> Pytree:
    """`function(*arguments)`; where the function names many numbers, by as few equations as possible.

    - `names`: how many numbers it names one by one, such as scalar states.
    """
    if names < _MANY:
        return function(*arguments)
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*arguments)
    jaxpr, _ = dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
    plan = _Plan(jaxpr, closed.consts, jax.tree.leaves(arguments))
    return jax.tree.unflatten(jax.tree.structure(shapes), plan.results(jaxpr))


class _Step(NamedTuple):
    """Some equations of one number that are alike, or one equation of arrays: the places of what they are given, one
    after another, and of what they give.
    """

    equation: Any
    operands: list[_Places]
    results: list[_Places]


@final
class _Plan:
    """In which order some equations are evaluated, and from which numbers.

    - `tables`: the places of each variable's numbers; `levels`: after how many equations a number is known;
    - `given`: arrays that are known from the start, with their places; `known`: the places of numbers that stand in the
      equations, and of what equations of one number give;
    - `steps`: those of each level; `alike`: equations of one number of each level and kind.
    """

    def __init__(self, jaxpr: Any, constants: Sequence[Any], arguments: Sequence[Any]):
        self._tables: dict[Any, _Places] = {}
        self._levels: list[int] = []
        self._given: list[tuple[_Places, Any]] = []
        self._known: dict[Any, _Places] = {}
        self._steps: dict[int, list[_Step]] = defaultdict(list)
        self._alike: dict[int, dict[Any, tuple[Any, list[tuple[int, ...]], list[int]]]] = defaultdict(dict)
        self._begin((*jaxpr.constvars, *jaxpr.invars), (*constants, *arguments))
        self._follow(jaxpr)

    def _begin(self, variables: Sequence[Any], values: Sequence[Any]) -> None:
        for variable, value in zip(variables, values, strict=True):
            self._tables[variable] = self._new(variable.aval.shape, 0)
            self._given.append((self._tables[variable], value))

    def _new(self, shape: tuple[int, ...], level: int) -> _Places:
        first, size = len(self._levels), int(np.prod(shape, dtype=int))
        self._levels += [level] * size
        return np.arange(first, first + size).reshape(shape)

    def places(self, variable: Any) -> _Places:
        """Those of a variable, or of a number in the equations."""
        if not isinstance(variable, Literal):
            return self._tables[variable]
        value = np.asarray(variable.val)
        key = value.dtype, value.shape, value.tobytes()
        if key not in self._known:
            self._known[key] = self._new(value.shape, 0)
            self._given.append((self._known[key], value))
        return self._known[key]

    def _follow(self, jaxpr: Any) -> None:
        for equation in jaxpr.eqns:
            name, operands = equation.primitive.name, [self.places(one) for one in equation.invars]
            if name in NESTED:
                inner = equation.params[NESTED[name]]
                self._begin(inner.jaxpr.constvars, inner.consts)
                self._tables.update(zip(inner.jaxpr.invars, operands, strict=True))
                self._follow(inner.jaxpr)
                results = [self.places(one) for one in inner.jaxpr.outvars]
            elif name in MOVING:
                moved = MOVING[name](*operands, **equation.params)
                results = moved if equation.primitive.multiple_results else [moved]
            else:
                results = self._computed(equation, operands)
            self._tables.update(zip(equation.outvars, results, strict=True))

    def _computed(self, equation: Any, operands: list[_Places]) -> list[_Places]:
        """The places of what an equation computes, which joins those that are alike."""
        level = 1 + max((self._levels[place] for one in operands for place in one.flat), default=0)
        results = [one.aval for one in equation.outvars]
        if equation.primitive.name not in BY_NUMBER or any(one.size != 1 for one in (*operands, *results)):
            every = [self._new(one.shape, level) for one in results]
            self._steps[level].append(_Step(equation, operands, every))
            return every
        types = tuple(one.aval.dtype for one in equation.invars)
        kind = equation.primitive, tuple((name, str(one)) for name, one in equation.params.items()), types
        numbers = tuple(one.item() for one in operands)
        if (kind, numbers) not in self._known:
            self._known[kind, numbers] = self._new((), level)
            _, given, found = self._alike[level].setdefault(kind, (equation, [], []))
            given.append(numbers)
            found.append(self._known[kind, numbers].item())
        return [self._known[kind, numbers].reshape(results[0].shape)]

    def results(self, jaxpr: Any) -> list[Array]:
        """The values of the equations."""
        store = _Store(len(self._levels))
        for places, value in self._given:
            store.add(places, value)
        for level in sorted({*self._steps, *self._alike}):
            for step in (*self._steps[level], *self._joined(level)):
                values = [
                    store.read(places, one.aval.dtype)
                    for places, one in zip(step.operands, step.equation.invars, strict=True)
                ]
                primitive = step.equation.primitive
                with step.equation.ctx.manager:
                    found = primitive.bind(*values, **primitive.get_bind_params(step.equation.params))
                for places, value in zip(step.results, found if primitive.multiple_results else [found], strict=True):
                    store.add(places, value)
        return [jnp.asarray(store.read(self.places(one), one.aval.dtype)) for one in jaxpr.outvars]

    def _joined(self, level: int) -> list[_Step]:
        """The equations of one number of a level, those that are alike together."""
        steps = []
        for equation, operands, results in self._alike[level].values():
            given, found = np.array(operands), np.array(results)
            if len(found) >= _ALIKE:
                steps.append(_Step(equation, [*given.T], [found]))
            else:
                steps += [
                    _Step(equation, [*row], [one]) for row, one in zip(given[..., None], found[:, None], strict=True)
                ]
        return steps


@final
class _Store:
    """The arrays that are known so far; the array in which each number is, and where."""

    def __init__(self, count: int):
        self._arrays: list[Any] = []
        self._source, self._offset = np.zeros((2, count), dtype=int)
        self._read: dict[Any, Any] = {}

    def add(self, places: _Places, value: Any) -> None:
        """An array, whose numbers have these places."""
        self._source[places.ravel()], self._offset[places.ravel()] = len(self._arrays), np.arange(places.size)
        self._arrays.append(value)

    def read(self, places: _Places, dtype: Any) -> Any:
        """The array whose numbers have these places."""
        key = places.shape, places.tobytes(), dtype
        if key not in self._read:
            self._read[key] = self._brought(places, dtype)
        return self._read[key]

    def _brought(self, places: _Places, dtype: Any) -> Any:
        if not places.size:
            return jnp.zeros(places.shape, dtype)
        each = places.ravel()
        source, offset = self._source[each], self._offset[each]
        sources = np.unique(source)
        if all(isinstance(self._arrays[one], np.ndarray) for one in sources):
            numbers = [self._arrays[one].flat[at] for one, at in zip(source, offset, strict=True)]
            return np.array(numbers, dtype).reshape(places.shape)
        if len(sources) == 1 and np.array_equal(offset, np.arange(np.size(self._arrays[source[0]]))):
            return jnp.reshape(self._arrays[source[0]], places.shape)
        if len(stretches := _stretches(source, offset)) <= _STRETCHES:
            parts = [self._stretch(source[one.start], offset[one]) for one in stretches]
            return _joined(parts).reshape(places.shape)
        # From the part of each array that has any of them.
        within = [offset[source == one] for one in sources]
        first, lengths = (np.array([one(some) for some in within]) for one in (np.min, np.ptp))
        before = np.cumsum([0, *(lengths + 1)])[:-1] - first
        pool = _joined([self._cut(*one) for one in zip(sources, first, lengths + 1, strict=True)])
        index = (offset + before[np.searchsorted(sources, source)])[:, None].astype(np.int32)
        found = jax.lax.gather(pool, index, _ONE_BY_ONE, (1,), mode="promise_in_bounds")
        return found.reshape(places.shape)

    def _stretch(self, source: Any, offsets: Int[np.ndarray, " n"]) -> Any:
        """Numbers of an array one after another, or one of them again and again."""
        if offsets.size > 1 and offsets[1] == offsets[0]:
            return jnp.broadcast_to(self._cut(source, offsets[0], 1), offsets.shape)
        return self._cut(source, offsets[0], offsets.size)

    def _cut(self, source: int, first: int, length: int) -> Any:
        array = self._arrays[source]
        if np.size(array) > length:
            return jnp.ravel(array)[int(first) : int(first + length)]
        return jnp.reshape(array, length)


def _joined(parts: list[Any]) -> Any:
    return parts[0] if len(parts) == 1 else jnp.concatenate(parts)


def _stretches(source: Int[np.ndarray, " n"], offset: Int[np.ndarray, " n"]) -> list[slice]:
    """Parts of some numbers that are one after another in one array, or the same number."""
    same, by = np.diff(source) == 0, np.diff(offset)
    begins = [0]
    for i in range(1, source.size):
        is_next = same[i - 1] and by[i - 1] in (0, 1)
        if not is_next or (i - 1 > begins[-1] and by[i - 1] != by[i - 2]):
            begins.append(i)
    return [slice(*one) for one in zip(begins, [*begins[1:], source.size], strict=True)]
