"""One writer at a time in a folder of results, among processes and threads."""

import contextlib
import errno
import os
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from aleator._core.errors import ProblemError

NAME = ".aleator-lock"
"""The file in a folder that is locked while results are written. It stays there, empty."""

# Longer than moving a set of results into place takes.
_PATIENCE, _PAUSE = 2.0, 0.05

# Error numbers for a file locked by another process, and for file systems without locks.
_TAKEN = {errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK, errno.EDEADLK}
_IMPOSSIBLE = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}


@dataclass
class _Place:
    """A folder that this process may be writing into: its nesting depth, and the locked file."""

    turn: threading.RLock = field(default_factory=threading.RLock)
    depth: int = 0
    handle: int = -1


_places: dict[Path, _Place] = {}
_list = threading.Lock()


@contextlib.contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Keep others from writing results into a folder. May be nested; threads of this process take turns.

    The operating system releases the lock however the process ends. Raises `ProblemError` if another process holds it
    for more than a moment.
    """
    with _list:
        place = _places.setdefault(folder.resolve(), _Place())
    with place.turn:
        if place.depth == 0:
            place.handle = _locked(folder)
        place.depth += 1
        try:
            yield
        finally:
            place.depth -= 1
            if place.depth == 0:
                os.close(place.handle)


def has_writer(folder: Path) -> bool:
    """Whether a process is writing results into a folder, as far as can be told; nothing is written to find out."""
    try:
        handle = os.open(folder / NAME, os.O_RDWR)
    except FileNotFoundError:
        return False
    except OSError:  # a folder of somebody else
        return True
    try:
        _lock(handle)
    except OSError:
        return True
    finally:
        os.close(handle)
    return False


def _locked(folder: Path) -> int:
    """The lock's file, opened and locked; only opened where the file system has no locks."""
    try:
        handle = os.open(folder / NAME, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise ProblemError(
            f"The folder '{folder}' cannot be written to ({error.strerror}): name another folder for the results."
        ) from error
    patient_until = time.monotonic() + _PATIENCE
    while True:
        try:
            _lock(handle)
        except OSError as error:
            if error.errno in _TAKEN and time.monotonic() < patient_until:
                time.sleep(_PAUSE)
                continue
            if error.errno in _IMPOSSIBLE:
                return handle
            os.close(handle)
            raise ProblemError(
                f"Another process is writing its results into '{folder}': name another folder, or wait until it ends."
            ) from error
        return handle


if sys.platform == "win32":
    import msvcrt

    def _lock(handle: int) -> None:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _lock(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
