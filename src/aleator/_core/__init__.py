"""Foundations for all other parts. Only this module configures JAX: 64 bit, and the folder of compiled programs."""

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """While modules are loaded and equations traced, which are all needed: the collector looks through them again and
    again, for a tenth of a first answer's time.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


with uncollected():
    import jax

    jax.config.update("jax_enable_x64", True)

    from aleator._core.programs import keep_by_default as _keep_by_default

_keep_by_default()

import_seconds = 0.0
"""The time that the import of the package took, part of every solution's times."""
