"""The run-time checker of the tests: beartype on array shapes alone.

Other types stay unchecked here (pyright sees them): much of what is tested is how wrong types are refused in words, and
a decorator of single methods cannot resolve `Self` nor names that are imported for type checkers only.
"""

import inspect
from typing import Any, get_args

from beartype import beartype
from jaxtyping import AbstractArray


def check(function):
    annotations = getattr(function, "__annotations__", {})
    function.__annotations__ = {name: hint for name, hint in annotations.items() if _is_shape(hint)}
    return beartype(function)


def _is_shape(hint: Any) -> bool:
    if inspect.isclass(hint) and not get_args(hint):
        return issubclass(hint, AbstractArray)
    parts = [part for part in get_args(hint) if part is not ...]
    return bool(parts) and all(_is_shape(part) for part in parts)
