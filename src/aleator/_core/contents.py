"""What arrays of other kinds than NumPy's own, and objects of `ctypes`, hold besides their class."""

import ctypes
from typing import Any

import numpy as np

# What a masked array keeps of these changes as it is used; what they mean is read by `getmaskarray` and `fill_value`.
_OF_MASKS = {"_mask", "_fill_value", "_sharedmask", "_isfield", "_baseclass", "_basedict"}
_SIMPLE = ctypes.c_double.__mro__[1]
_OF_C: Any = ctypes.Array.__mro__[1]
# Codes of simple types that hold addresses: `char *`, `wchar_t *`, `void *`, `PyObject *`.
_ADDRESSES = "zZPO"


def array_parts(array: Any) -> tuple[list[np.ndarray], dict[str, Any]]:
    """The numbers of an array, with its mask if it has one, and its attributes."""
    numbers, attributes = [np.asarray(array)], dict(getattr(array, "__dict__", {}))
    if isinstance(array, np.ma.MaskedArray):
        numbers = [np.asarray(array.data), np.ma.getmaskarray(array), np.asarray(array.fill_value)]
        attributes = {name: value for name, value in attributes.items() if name not in _OF_MASKS}
    return numbers, attributes


def is_of_c(it: Any) -> bool:
    """Whether something is an object of `ctypes`."""
    return isinstance(it, _OF_C)


def memory(it: Any) -> bytes | None:
    """The bytes of an object of `ctypes`; None if they are addresses, where a change cannot be seen."""
    return bytes(it) if _holds_values(type(it)) else None


def _holds_values(kind: Any) -> bool:
    if issubclass(kind, _SIMPLE):
        return kind._type_ not in _ADDRESSES
    if issubclass(kind, ctypes.Array):
        return _holds_values(kind._type_)
    if issubclass(kind, ctypes.Structure | ctypes.Union):
        fields = [field for one in kind.__mro__ for field in vars(one).get("_fields_", ())]
        return all(_holds_values(field[1]) for field in fields)
    return False
