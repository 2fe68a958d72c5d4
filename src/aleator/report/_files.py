"""Files that are either whole or not there: written beside their place and moved into it."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from aleator._core.errors import ProblemError


def check_writable(folder: str | Path) -> Path:
    """Create a folder if it is missing and try to write in it, before work begins whose results belong there.

    Raises `ProblemError`, naming the folder, if nothing can be written.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=folder, prefix=".aleator-"):
            pass
    except OSError as error:
        raise ProblemError(
            f"The folder '{folder}' cannot be written to ({error.strerror or error}): name another folder for the"
            " results."
        ) from error
    return folder


def write_whole(path: str | Path, write: Callable[[Path], object]) -> Path:
    """Let `write` fill a temporary file in the folder of `path`, then move it to `path` in one step.

    A process killed in between leaves what was at `path` before. Raises `ProblemError` if the folder cannot be written.
    """
    path = Path(path)
    folder = check_writable(path.parent)
    if path.is_dir():
        raise ProblemError(f"'{path}' is a folder; expected the path of a file.")
    handle, name = tempfile.mkstemp(dir=folder, prefix=f".{path.name}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except OSError as error:
        raise ProblemError(f"'{path}' cannot be written ({error.strerror or error}).") from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_text(path: str | Path, text: str) -> Path:
    """Write a text file whole, in UTF-8."""
    return write_whole(path, lambda file: file.write_text(text, encoding="utf-8"))


def _umask() -> int:
    """The process's mask for new files, which `mkstemp` does not follow; it can only be read by setting it."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
