"""Optimal design of uncertain dynamical systems.

Write ordinary physics; put a distribution in the place of any number that is uncertain and a `Decision` in the place of
any number to choose; declare what to minimise subject to what; `solve`, `validate`, `report`.

What this package shows is listed in `__init__.pyi`. Its modules are loaded at their first use: a script waits for those
that it needs.
"""

import sys as _sys
from time import perf_counter as _now
from typing import Any as _Any

import lazy_loader as _lazy

_started = _now()

# Configures JAX, before a script makes its first array.
from aleator import _core  # noqa: E402
from aleator._core import uncollected as _uncollected  # noqa: E402

_load, _, _names = _lazy.attach_stub(__name__, __file__)

__all__ = _names  # pyright: ignore[reportUnsupportedDunderAll]
__version__ = "0.1.0"
_core.import_seconds = _now() - _started


def __getattr__(name: str) -> _Any:
    if name not in _names:
        message = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(message, name=name, obj=_sys.modules[__name__])  # With these, Python suggests names.
    started = _now()
    try:
        with _uncollected():
            return _load(name)
    finally:
        _core.import_seconds += _now() - started


def __dir__() -> list[str]:
    """What is meant to be used: Python makes attributes of all packages that are imported."""
    return ["__version__", *_names]
