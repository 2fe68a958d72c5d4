"""Files of results: one writer at a time in a folder, and atomic writing, alone or several that belong together."""

import contextlib
import errno
import os
import tempfile
import threading
import uuid
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from aleator._core.errors import ProblemError

NAME = ".aleator-lock"
"""The file in a folder that is locked while results are written. It stays there, empty."""

# Longer than moving a set of results into place takes, s.
_PATIENCE = 2.0
# Error numbers of file systems without locks.
_IMPOSSIBLE = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL}

_turns: defaultdict[Path, threading.RLock] = defaultdict(threading.RLock)


@contextlib.contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Keep others from writing results into a folder. May be nested; threads of this process take turns.

    The operating system releases the lock however the process ends. Raises `ProblemError` if another process holds it
    for more than a moment.
    """
    from filelock import FileLock, Timeout

    place = folder.resolve()
    with _turns[place]:
        # The same lock within itself, which is released at the outer end.
        lock = FileLock(place / NAME, _PATIENCE, mode=0o666, thread_local=False, is_singleton=True)
        try:
            lock.acquire()
        except Timeout as error:
            raise ProblemError(
                f"Another process is writing its results into '{folder}': name another folder, or wait until it ends."
            ) from error
        except OSError as error:
            if error.errno not in _IMPOSSIBLE:
                raise _refused(folder, error) from error
        try:
            yield
        finally:
            lock.release()


def has_writer(folder: Path) -> bool:
    """Whether a process is writing results into a folder, as far as can be told; nothing is written to find out."""
    from filelock import FileLock

    try:
        if not (folder / NAME).exists():
            return False
        with FileLock(folder / NAME, timeout=0):
            return False
    except OSError:  # it is locked, or in a folder of somebody else
        return True


# Names of temporary files on their way into a folder, or out of it: of several that belong together, whose remains are
# removed by the next writer, and of one.
_STAGED, _ALONE = ".aleator-staged-", ".aleator-file-"

_ADVICE = "the files last written there are kept. Free some space, or name another place."


def as_path(path: Any) -> Path:
    """The path of a file or a folder. Raises `ProblemError` for anything else."""
    try:
        return Path(path)
    except TypeError:
        raise ProblemError(f"Expected the path of a file or a folder. Received {path!r}.") from None


def check_writable(folder: str | Path) -> Path:
    """Create a folder if it is missing and test that it can be written to, before the work whose results go there.

    Raises `ProblemError`, naming the folder, if nothing can be written.
    """
    folder = as_path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".aleator-try-"):
            pass
    except (OSError, ValueError) as error:
        raise _refused(folder, error) from error
    return folder


def write_whole(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Let `write` fill a temporary file in the folder of `path`, then move it to `path` atomically.

    If the process is killed in between, the earlier file stays. Raises `ProblemError` if the file cannot be written.
    """
    path = as_path(path)
    folder, temporary = check_writable(path.parent), None
    try:
        temporary = _temporary(folder, _ALONE, path.suffix)
        write(temporary)
        _finish(temporary)
        temporary.replace(path)
        _sync(folder)
    except (OSError, ValueError) as error:
        raise ProblemError(f"'{path}' cannot be written ({_reason(error)}): {_ADVICE}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
    return path


def write_text(path: str | Path, text: str) -> Path:
    """Write a text file atomically, in UTF-8."""
    return write_whole(path, lambda file: file.write_bytes(text.encode("utf-8")))


def write_together(folder: str | Path, files: Mapping[str, bytes | None]) -> tuple[Path, ...]:
    """Replace files of a folder that belong together by new ones, by name; None removes one. Returns the new paths.

    The folder never holds files of two calls, whatever ends the process and whoever else writes: all files are written
    before the first is moved, the old ones except the first are removed before it is replaced, and the new ones follow
    it. A process killed between these moves leaves the first file, complete, without the others. If anything cannot be
    written, nothing changes.

    Raises `ProblemError` if the folder cannot be written to, or if another process keeps writing into it.
    """
    folder = check_writable(folder)
    staged = dict[str, Path]()
    with only_writer(folder):
        _clear(folder)
        try:
            for name, content in files.items():
                if (folder / name).is_dir():
                    raise IsADirectoryError(errno.EISDIR, f"'{name}' is a folder")
                if content is not None:
                    staged[name] = _temporary(folder, _STAGED, "")
                    staged[name].write_bytes(content)
                    _finish(staged[name])
            _exchange(folder, list(files), staged)
        except OSError as error:
            raise ProblemError(f"No results can be written into '{folder}' ({_reason(error)}): {_ADVICE}") from error
        finally:
            _clear(folder)
    return tuple(folder / name for name in staged)


def _exchange(folder: Path, names: list[str], staged: Mapping[str, Path]) -> None:
    """Move the old files except the first out of the way, then the new ones into their places, the first one first."""
    first, *others = names
    aside: dict[str, Path] = {}
    try:
        for name in others:
            if (folder / name).exists():
                aside[name] = (folder / name).replace(folder / f"{_STAGED}{uuid.uuid4().hex}")
        _sync(folder)
        staged[first].replace(folder / first)
    except BaseException:
        for name, place in aside.items():
            place.replace(folder / name)
        raise
    _sync(folder)
    for name in others:
        if name in staged:
            staged[name].replace(folder / name)
    _sync(folder)


def _temporary(folder: Path, prefix: str, suffix: str) -> Path:
    handle, name = tempfile.mkstemp(dir=folder, prefix=prefix, suffix=suffix)
    os.close(handle)
    return Path(name)


def _finish(file: Path) -> None:
    """Give a temporary file ordinary permissions, and flush it to disk before it gets its final name."""
    mask = os.umask(0o022)  # `mkstemp` does not follow it, and it can only be read by setting it
    os.umask(mask)
    file.chmod(0o666 & ~mask)
    with file.open("r+b") as opened:
        os.fsync(opened)


def _sync(folder: Path) -> None:
    """Flush a folder's names to disk before anything that follows."""
    if os.name == "posix":  # elsewhere a folder cannot be opened
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _clear(folder: Path) -> None:
    """Remove temporary files. They are nobody else's, since only one process writes at a time."""
    for file in folder.glob(f"{_STAGED}*"):
        with contextlib.suppress(OSError):
            file.unlink()


def _refused(folder: Path, error: Exception) -> ProblemError:
    return ProblemError(
        f"The folder '{folder}' cannot be written to ({_reason(error)}): name another folder for the results."
    )


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
