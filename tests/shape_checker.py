"""The run-time checker of the tests: beartype on array shapes alone.

Other types stay unchecked here (pyright sees them): much of what is tested is how wrong types are refused in words, and
a decorator of single methods cannot resolve `Self` nor names that are imported for type checkers only.
"""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Any, get_args

import jaxtyping
from beartype import beartype
from jaxtyping import AbstractArray


def check_only_shapes():
    """Let jaxtyping's hook leave alone what has no shape: its wrapper takes time at each call."""
    jaxtyping.jaxtyped = functools.partial(_decorator, jaxtyping.jaxtyped)


def _decorator(jaxtyped: Callable, *, typechecker: Callable) -> Callable:
    return lambda it: jaxtyped(it, typechecker=typechecker) if _has_shapes(it) else it


def _has_shapes(it: Any) -> bool:
    """Whether a function, a method of any kind or the fields of a class have the shape of an array."""
    if inspect.isclass(it):
        return dataclasses.is_dataclass(it) and any(_is_shape(one.type) for one in dataclasses.fields(it))
    if isinstance(it, property):
        return any(_has_shapes(one) for one in (it.fget, it.fset, it.fdel))
    function = it.__func__ if isinstance(it, classmethod | staticmethod) else it
    return any(map(_is_shape, getattr(function, "__annotations__", {}).values()))


def check(function):
    annotations = getattr(function, "__annotations__", {})
    function.__annotations__ = {name: hint for name, hint in annotations.items() if _is_shape(hint)}
    return beartype(function)


def _is_shape(hint: Any) -> bool:
    if inspect.isclass(hint) and not get_args(hint):
        return issubclass(hint, AbstractArray)
    parts = [part for part in get_args(hint) if part is not ...]
    return bool(parts) and all(_is_shape(part) for part in parts)
