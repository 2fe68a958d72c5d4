"""Results as files: labelled arrays for any program that reads netCDF, and the objects themselves beside them.

What takes long is kept part by part until its whole result is.

Reading an object runs code, as importing a module does: a model's own classes are in it. So objects are read only from
files that belong to this user, that nobody else can write to, and whose content is what was written.
"""

import hashlib
import io
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

import numpy as np
from typing_extensions import override

from aleator._core.border import content_of
from aleator._core.errors import ProblemError
from aleator._core.journalled import AbstractParts
from aleator._core.programs import is_private
from aleator.reporting import KINDS, tree, write_whole

FINISHED = "finished"
"""The folder of results in a run's folder."""

_OBJECT, _KEY = "object", "key"
_OTHERS = 0o022  # may write
_NAMED = 24  # characters of a digest in the name of a file
_DIGEST = hashlib.sha256().digest_size


def write(folder: Path, what: str, result: Any, key: str) -> tuple[str, str]:
    """Write a result with its key into a run's folder, atomically, for its owner alone to change.

    Returns its file, named by its content so that it takes no other's place, and the digest of this. Raises
    `ProblemError` if it cannot be written, or holds what no other process could read.
    """
    import xarray

    try:
        content = pickle.dumps(result)
    except Exception as error:  # of whatever kind a user's object raises
        raise ProblemError(f"it holds an object that no other process could read ({error}).") from error
    nodes = tree({"result": result} if isinstance(result, KINDS) else {})
    about = {"long_name": "the result as Python's pickle, for al.load", _KEY: key}
    nodes[_OBJECT] = xarray.DataArray(np.frombuffer(content, dtype=np.uint8), dims=("byte of the object",), attrs=about)
    data = bytes(nodes.to_netcdf(engine="h5netcdf"))
    digest = hashlib.sha256(data).hexdigest()
    file = f"{FINISHED}/{what.split()[0]}-{digest[:_NAMED]}.nc"
    _write_private(folder / file, data)
    return file, digest


def _write_private(path: Path, data: bytes) -> None:
    """Write a file atomically that its owner alone may change. Raises `ProblemError` if it cannot be written."""
    written = write_whole(path, lambda file: file.write_bytes(data))
    written.chmod(written.stat().st_mode & ~_OTHERS)


def damage(path: Path, digest: str) -> str:
    """What is wrong with the file of a result, without reading the result; empty if it is what was written."""
    try:
        content = content_of(path)
    except OSError as error:
        return f"its file cannot be read: {error.strerror}"
    return "" if hashlib.sha256(content).hexdigest() == digest else "its file is not what was written"


def _read_private(path: Path) -> bytes:
    """The content of a file. Raises `ProblemError` if it cannot be read, or if others could have written it."""
    try:
        with path.open("rb") as file:
            private, data = is_private(os.fstat(file.fileno())), file.read()
    except OSError as error:
        raise ProblemError(f"'{path}' cannot be read ({error.strerror}).") from error
    if not private:
        raise ProblemError(
            f"'{path}' could have been changed by others: expected a file that only its owner can write."
        )
    return data


def read(path: Path, digest: str, key: str) -> Any:
    """The result in a file. Raises `ProblemError` if it is not what was written under its key, or cannot be read here.

    The object alone is read, by h5py: xarray would decode all of its arrays, which takes a hundred times as long.
    """
    import h5py

    data = _read_private(path)
    if hashlib.sha256(data).hexdigest() != digest:
        raise ProblemError(f"'{path}' is not what was written there.")
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            variable: Any = file[_OBJECT]
            if variable.attrs[_KEY] == key:
                return pickle.loads(variable[()].tobytes())
    except ModuleNotFoundError as error:
        raise ProblemError(
            f"'{path}' needs the module '{error.name}', in which its model is written: import it first."
        ) from error
    except Exception as error:  # neither pickle nor h5py has a common one
        raise ProblemError(f"'{path}' cannot be read ({type(error).__name__}: {error}).") from error
    raise ProblemError(f"'{path}' holds another result than the journal says.")


@final
class Parts(AbstractParts):
    """One file a part, beside the results: a digest of its place and content, and Python's pickle.

    - `key`: that of the result; `warn`: is told why a part could not be kept;
    - `recalls`: whether parts of an earlier run are taken.
    """

    def __init__(self, folder: Path, key: str, warn: Callable[[str], None], *, recalls: bool = True):
        self._folder, self._key, self._warn, self._recalls = folder, key[:_NAMED], warn, recalls

    @override
    def recall(self, number: int) -> Any:
        try:
            data = _read_private(self._place(number)) if self._recalls else b""
        except ProblemError:  # it is missing, or others could have written it
            return None
        digest, content = data[:_DIGEST], data[_DIGEST:]
        # What a crash has cut off is computed again.
        return pickle.loads(content) if digest == self._digest(number, content) else None

    @override
    def keep(self, number: int, part: Any) -> None:
        content = pickle.dumps(part)
        try:
            _write_private(self._place(number), self._digest(number, content) + content)
        except (ProblemError, OSError) as error:
            self._warn(f"a part of a result is not kept: {error}")

    def drop(self) -> None:
        """Delete all parts: the whole result is kept."""
        for path in self._folder.glob(f"{self._key}-*.part"):
            path.unlink(missing_ok=True)

    def _digest(self, number: int, content: bytes) -> bytes:
        """Of the result and the number too: a part in another place is another one."""
        return hashlib.sha256(f"{self._key} {number}\0".encode() + content).digest()

    def _place(self, number: int) -> Path:
        return self._folder / f"{self._key}-{number}.part"
