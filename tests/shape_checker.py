"""The run-time checker of the tests: whether arrays have the shapes that are annotated, and nothing else.

Other types stay unchecked here (pyright sees them): much of what is tested is how wrong types are refused in words. The
decorators of jaxtyping check arguments twice, by functions that they write, compile and bind anew: for a tenth of the
time of all tests.
"""

import collections.abc
import dataclasses
import functools
import inspect
import types
from typing import Any, Union, get_args, get_origin

import jaxtyping

_JAXTYPED, _UNIONS = jaxtyping.jaxtyped, (Union, types.UnionType)


def take_the_place_of_jaxtyped():
    """Let jaxtyping's hook decorate by `check` alone."""
    jaxtyping.jaxtyped = lambda *, typechecker: typechecker


def check(it):
    """A function, or a data class, that refuses arrays of other shapes than those annotated."""
    if inspect.isclass(it):
        if dataclasses.is_dataclass(it) and any(_is_shape(one.type) for one in dataclasses.fields(it)):
            it.__init__ = check(it.__init__)
        return it
    shapes = {name: hint for name, hint in it.__annotations__.items() if _is_shape(hint)}
    if not shapes:
        return it
    names, context = list(inspect.signature(it).parameters), _JAXTYPED("context")

    @functools.wraps(it)
    def checked(*args, **kwargs):
        if jaxtyping.config.jaxtyping_disable:
            return it(*args, **kwargs)
        with context:
            for name, value in [*zip(names, args, strict=False), *kwargs.items()]:
                _refuse(it, name, value, shapes)
            result = it(*args, **kwargs)
            _refuse(it, "return", result, shapes)
            return result

    return checked


def _refuse(function, name, value, shapes):
    if name in shapes and not _fits(value, shapes[name]):
        shape = getattr(value, "shape", None)
        raise TypeError(f"{function.__qualname__}: {name} is no {shapes[name]}, but of shape {shape}: {value!r}")


def _fits(value: Any, hint: Any) -> bool:
    kind, parts = get_origin(hint), get_args(hint)
    if kind is None:
        return isinstance(value, hint)
    if kind in _UNIONS:
        return any(_fits(value, part) for part in parts)
    if kind is tuple and ... not in parts:
        return len(value) == len(parts) and all(map(_fits, value, parts))
    return not value or _fits(value[0], parts[0])  # others may have other sizes


def _is_shape(hint: Any) -> bool:
    kind, parts = get_origin(hint), get_args(hint)
    if kind is None:
        return inspect.isclass(hint) and issubclass(hint, jaxtyping.AbstractArray)
    if kind in (*_UNIONS, tuple, list, collections.abc.Sequence):
        return all(part is ... or _is_shape(part) for part in parts) and bool(parts)
    return False
