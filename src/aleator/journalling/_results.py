"""Results as files: objects by Python's pickle, and beside them labelled arrays for any program that reads netCDF.

What takes long is kept part by part until its whole result is.

Reading an object runs code, as importing a module does: a model's own classes are in it. So objects are read only from
files that belong to this user, that nobody else can write to, and whose content is what was written for their key.
"""

import hashlib
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.journalled import AbstractParts
from aleator._core.programs import is_private
from aleator.reporting import KINDS, tree, write_whole

FINISHED = "finished"
"""The folder of results in a run's folder."""

_OTHERS = 0o022  # may write
_DIGEST = hashlib.sha256().digest_size
_NAMED = 24  # characters of a key in the name of a file


def write(folder: Path, what: str, key: str, result: Any) -> str:
    """Write a result into a run's folder and return its file, which takes the place of an earlier one of its key.

    Raises `ProblemError` if it cannot be written, or holds what no other process could read.
    """
    path = folder / FINISHED / f"{what.split()[0]}-{key[:_NAMED]}.pickle"
    try:
        content = pickle.dumps(result)
    except Exception as error:  # of whatever kind a user's object raises
        raise ProblemError(f"it holds an object that no other process could read ({error}).") from error
    if isinstance(result, KINDS):
        arrays = bytes(tree({"result": result}).to_netcdf(engine="h5netcdf"))
        write_whole(path.with_suffix(".nc"), lambda file: file.write_bytes(arrays))
    _write(path, key, content)
    return str(path.relative_to(folder))


def read(path: Path, key: str) -> Any:
    """The result of a key in a file. Raises `ProblemError` if it is not there, or cannot be read here."""
    content = content_of(path, key)
    try:
        return pickle.loads(content)
    except ModuleNotFoundError as error:
        raise ProblemError(
            f"'{path}' needs the module '{error.name}', in which its model is written: import it first."
        ) from error
    except Exception as error:  # pickle has no common one
        raise ProblemError(f"'{path}' cannot be read ({type(error).__name__}: {error}).") from error


def content_of(path: Path, key: str) -> bytes:
    """The content of a file, unless it is another than was written for its key, or others could have written it.

    Raises `ProblemError` then.
    """
    try:
        with path.open("rb") as file:
            private, digest, content = is_private(os.fstat(file.fileno())), file.read(_DIGEST), file.read()
    except OSError as error:
        raise ProblemError(f"'{path}' cannot be read ({error.strerror}).") from error
    if not private:
        raise ProblemError(
            f"'{path}' could have been changed by others: expected a file that only its owner can write."
        )
    if digest != _digest(key, content):
        raise ProblemError(f"'{path}' is not what was written there.")
    return content


def _write(path: Path, key: str, content: bytes) -> None:
    """Write a file atomically that its owner alone may change. Raises `ProblemError` if it cannot be written."""
    written = write_whole(path, lambda file: file.write_bytes(_digest(key, content) + content))
    written.chmod(written.stat().st_mode & ~_OTHERS)


def _digest(key: str, content: bytes) -> bytes:
    return hashlib.sha256(f"{key}\0".encode() + content).digest()


@final
class Parts(AbstractParts):
    """One file a part, beside the results.

    - `key`: that of the result; `warn`: is told why a part could not be kept.
    """

    def __init__(self, folder: Path, key: str, warn: Callable[[str], None]):
        self._folder, self._key, self._warn = folder / FINISHED, key, warn

    @override
    def recall(self, number: int) -> Any:
        try:
            return read(self._place(number), f"{self._key} {number}")
        except ProblemError:  # what is missing, or was cut off by a crash, is computed again
            return None

    @override
    def keep(self, number: int, part: Any) -> None:
        try:
            _write(self._place(number), f"{self._key} {number}", pickle.dumps(part))
        except (ProblemError, OSError) as error:
            self._warn(f"a part of a result is not kept: {error}")

    def drop(self) -> None:
        """Delete all parts: the whole result is kept, or is to be computed afresh."""
        for path in self._folder.glob(f"{self._key[:_NAMED]}-*.part"):
            path.unlink(missing_ok=True)

    def _place(self, number: int) -> Path:
        return self._folder / f"{self._key[:_NAMED]}-{number}.part"
