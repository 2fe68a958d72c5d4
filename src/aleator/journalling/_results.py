"""Results as files: labelled arrays for any program that reads netCDF, and the objects themselves beside them.

Reading an object runs code, as importing a module does: a model's own classes are in it. So objects are read only from
files that belong to this user, that nobody else can write to, and whose content is what was written.
"""

import hashlib
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from aleator._core.errors import ProblemError
from aleator._core.files import content_of
from aleator._core.programs import is_private
from aleator.reporting import KINDS, tree, write_whole

_OBJECT, _KEY = "object", "key"
_OTHERS = 0o022  # may write


def write(path: Path, result: Any, key: str) -> str:
    """Write a result with its key, atomically, for its owner alone to change; returns the digest of its file.

    Raises `ProblemError` if it cannot be written, or holds what no other process could read.
    """
    try:
        content = pickle.dumps(result)
    except Exception as error:  # of whatever kind a user's object raises
        raise ProblemError(f"it holds an object that no other process could read ({error}).") from error
    nodes = tree({"result": result} if isinstance(result, KINDS) else {})
    nodes[_OBJECT] = _variable(content, key)
    data = bytes(nodes.to_netcdf(engine="h5netcdf"))

    write_whole(path, lambda file: file.write_bytes(data))
    path.chmod(path.stat().st_mode & ~_OTHERS)
    return hashlib.sha256(data).hexdigest()


def damage(path: Path, digest: str) -> str:
    """What is wrong with the file of a result, without reading the result; empty if it is what was written."""
    try:
        content = content_of(path)
    except OSError as error:
        return f"its file cannot be read: {error.strerror}"
    return "" if hashlib.sha256(content).hexdigest() == digest else "its file is not what was written"


def read(path: Path, digest: str, key: str) -> Any:
    """The result in a file. Raises `ProblemError` if it is not what was written under its key, or cannot be read here.

    Files of earlier versions have no key, and are taken at the journal's word.
    """
    try:
        with path.open("rb") as file:
            private, data = is_private(os.fstat(file.fileno())), file.read()
    except OSError as error:
        raise ProblemError(f"'{path}' cannot be read ({error.strerror}).") from error
    if not private:
        raise ProblemError(
            f"'{path}' could have been changed by others: expected a file that only its owner can write."
        )
    if hashlib.sha256(data).hexdigest() != digest:
        raise ProblemError(f"'{path}' is not what was written there.")
    try:
        content, its_key = _content(data)
    except Exception as error:  # those of xarray and h5netcdf
        raise ProblemError(f"'{path}' cannot be read ({type(error).__name__}: {error}).") from error
    if its_key not in ("", key):
        raise ProblemError(f"'{path}' holds another result than the journal says.")
    try:
        return pickle.loads(content)
    except ModuleNotFoundError as error:
        raise ProblemError(
            f"'{path}' needs the module '{error.name}', in which its model is written: import it first."
        ) from error
    except Exception as error:  # pickle has no common one
        raise ProblemError(f"'{path}' cannot be read ({type(error).__name__}: {error}).") from error


def _variable(content: bytes, key: str) -> Any:
    import xarray

    return xarray.DataArray(
        np.frombuffer(content, dtype=np.uint8),
        dims=("byte of the object",),
        attrs={"long_name": "the result as Python's pickle, for al.load", _KEY: key},
    )


def _content(data: bytes) -> tuple[bytes, str]:
    """The pickle of a result, and its key, which is empty in files of earlier versions."""
    import xarray

    with xarray.open_datatree(data, engine="h5netcdf") as nodes:  # pyright: ignore[reportArgumentType]
        return nodes[_OBJECT].to_numpy().tobytes(), str(nodes[_OBJECT].attrs.get(_KEY, ""))
