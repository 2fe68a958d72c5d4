"""Work without Python's collector of cycles."""

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
