"""Fields that are no part of a model's code: loaded libraries, instances, and what is found out in using them."""

import weakref
from typing import Any, Generic, TypeVar, overload

_Value = TypeVar("_Value")


class Hidden(Generic[_Value]):
    """A field of a class whose value readings of code (`_core/code.py`) leave out: it is in no object's `__dict__`.

    What changes there must not change what is computed; a reading would otherwise refuse it as changed code.
    """

    def __init__(self) -> None:
        self._values: weakref.WeakKeyDictionary[Any, _Value] = weakref.WeakKeyDictionary()

    @overload
    def __get__(self, owner: None, kind: Any = None) -> "Hidden[_Value]": ...

    @overload
    def __get__(self, owner: object, kind: Any = None) -> _Value: ...

    def __get__(self, owner: Any, kind: Any = None) -> Any:
        return self if owner is None else self._values[owner]

    def __set__(self, owner: Any, value: _Value) -> None:
        self._values[owner] = value
