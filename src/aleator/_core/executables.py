"""Executables as they are called: results in their own layout; NaN where a check stops one; an earlier run's tried.

On several devices, one has a copy for each.
"""

import functools
import threading
from collections.abc import Callable
from typing import Any, final

import jax
import jax.numpy as jnp

from aleator._core import stored
from aleator._core.devices import Device, elsewhere
from aleator._core.layouts import is_real
from aleator._core.programs import Executable

# This name marks the run-time checks of Equinox, and of libraries built on it, among the errors of XLA.
_CHECKED = "_EquinoxRuntimeError"


@final
class Tried:
    """An executable of an earlier run, replaced by one compiled anew if its first run fails, for whatever reason."""

    def __init__(self, earlier: Executable, anew: Callable[[], Executable]):
        self._executable = earlier
        self._anew: Callable[[], Executable] | None = anew
        self._lock = threading.Lock()

    def __call__(self, *given: Any) -> Any:
        if self._anew is None:
            return self._executable(*given)
        try:
            result = self._executable(*given)
        except Exception:  # XLA and JAX have no common one
            with self._lock:
                if self._anew is not None:
                    self._executable, self._anew = self._anew(), None
            return self._executable(*given)
        self._anew = None  # with what it holds: it can run
        return result


@final
class OnEach:
    """An executable of one device, and its copies for others, each compiled when it is first called there."""

    def __init__(self, at_home: Executable, compiled_here: Callable[[], Executable]):
        self._at_home, self._compiled_here = at_home, compiled_here
        self._copies: dict[Device, Executable] = {}
        self._lock = threading.Lock()

    def __call__(self, *given: Any) -> Any:
        device = elsewhere()
        if device is None:
            return self._at_home(*given)
        # One after the other: XLA compiles on all cores, and may find the second one in JAX's cache.
        with self._lock:
            if device not in self._copies:
                self._copies[device] = self._compiled_here()
        return self._copies[device](*given)


def ready(found: stored.Stored) -> Executable:
    """An executable that returns results in their own layout."""
    executable, read = functools.partial(_run, found.executable), found.results.read
    return lambda *given: read(executable(*given))


def _run(executable: Executable, *arguments: Any) -> Any:
    """The results of an executable; NaN if run-time checks of a library inside stop it.

    The linear solvers of stiff integrators do so for derivatives that are not finite. Called with NaN throughout, the
    same executable returns NaN in the right shapes.
    """
    try:
        return jax.block_until_ready(executable(*arguments))
    except jax.errors.JaxRuntimeError as error:
        if _CHECKED not in str(error):
            raise
    nothing = jax.tree.map(lambda leaf: jnp.full_like(leaf, jnp.nan) if is_real(leaf) else leaf, arguments)
    return executable(*nothing)
