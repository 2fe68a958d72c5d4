"""Executables on the disk, by lasting names: later runs need not trace, lower or compile them again.

They are in the folder of compiled programs (`kept_programs`), beside those that JAX itself keeps. JAX finds its own by
the lowered text of a program, for which it must be traced first: that takes longer than all the rest.

Reading a file runs what it holds: machine code, and a pickle, because JAX has no other form of an executable. So only
files are opened that belong to this user, that nobody else can write to, and whose digest is that of their name and
content. What cannot be read, loaded or run is deleted, and the program is traced and compiled as if it had never been
kept. Nobody is told, since nothing is lost but time.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import re
import threading
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.experimental import serialize_executable

from aleator._core import kept_programs

# Calls of functions outside XLA in the text of a program.
_CALLED, _LAPACK = re.compile(r"custom_call @([^(]+)"), "lapack_"
_DIGEST = hashlib.sha256().digest_size
_BINARY = getattr(os, "O_BINARY", 0)  # on Windows


class Stored(NamedTuple):
    """An executable and the layout of its results.

    - `executable`: takes the arguments that it was compiled for and returns the list of the results' arrays;
    - `results`: how results follow from these arrays; it must be picklable.
    """

    executable: jax.stages.Compiled
    results: Any


def is_kept(name: str | None) -> bool:
    """Whether programs of a name are kept at all."""
    return name is not None and _path(name) is not None


def found(name: str | None, arguments: tuple[Any, ...]) -> Stored | None:
    """The executable that an earlier run has kept under a name, for arguments of this structure; None if there is none.

    A file that is damaged or cannot be loaded is deleted.
    """
    path = None if name is None else _path(name)
    if name is None or path is None:
        return None
    try:
        return _loaded(_content(path, name), arguments)
    except FileNotFoundError:
        return None
    except Exception:  # XLA, JAX and pickle have no common one
        forget(name)
        return None


def forget(name: str) -> None:
    """Delete an executable, if it is there, so that no later run tries it."""
    path = _path(name)
    if path is not None:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def _content(path: Path, name: str) -> bytes:
    """The content of a file. Raises `OSError` if it is not this user's own, `ValueError` if it is not what was kept."""
    with path.open("rb") as file:
        if not kept_programs.is_private(os.fstat(file.fileno())):
            raise PermissionError(path)
        digest, content = file.read(_DIGEST), file.read()
    if _digest(name, content) != digest:
        raise ValueError(path)
    return content


def _digest(name: str, content: bytes) -> bytes:
    """Of the name too: under another one, an executable would compute something else."""
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


def _loaded(content: bytes, arguments: tuple[Any, ...]) -> Stored:
    _prepare_lapack()
    payload, results, count = pickle.loads(content)
    given, given_back = jax.tree.structure((arguments, {})), jax.tree.structure([0] * count)
    return Stored(serialize_executable.deserialize_and_load(payload, given, given_back), results)


_heard = threading.local()


def _hear(event: str, **_: Any) -> None:
    if event.endswith("/cache_hits"):
        _heard.hits = found_by_jax() + 1


jax.monitoring.register_event_listener(_hear)


def found_by_jax() -> int:
    """How many programs this thread has found in JAX's own cache. Written again, such a program has lost its code."""
    return getattr(_heard, "hits", 0)


def keep(name: str, lowered: jax.stages.Lowered, found: Stored) -> None:
    """Keep an executable for later runs; silently skipped if it cannot be written.

    It is skipped too if it calls anything outside XLA other than LAPACK, such as Python code: such a function may not
    exist in another run.
    """
    path = _path(name)
    if path is None or not all(one.startswith(_LAPACK) for one in _CALLED.findall(lowered.as_text())):
        return
    try:
        payload, _, given_back = serialize_executable.serialize(found.executable)
        content = pickle.dumps((payload, found.results, given_back.num_leaves))
    except Exception:  # XLA, JAX and pickle have no common one
        return
    # Of a run that is ended here, the name lets it be counted and deleted as the others are.
    trial = path.with_name(f".{os.getpid()}.{threading.get_ident()}.{path.name}")
    with contextlib.suppress(OSError):
        try:
            # Private whatever the user's mask is; a new file, because its name could be a link.
            with os.fdopen(os.open(trial, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o600), "wb") as file:
                file.write(_digest(name, content) + content)
            trial.replace(path)
            _forget_copies(path, name)
        finally:
            trial.unlink(missing_ok=True)


def _forget_copies(path: Path, name: str) -> None:
    """Delete what JAX has kept of the same program, which nobody needs while this file is there.

    If the file is lost, JAX's copy must be gone too: found there, the program could never be written again.
    """
    for copy in path.parent.glob(f"jit_*{name}-*"):
        copy.unlink(missing_ok=True)


@functools.cache
def _prepare_lapack() -> None:
    """Make JAX look up LAPACK's functions, which it does otherwise only when it lowers a call of one.

    A loaded program that calls one before crashes the process.
    """
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _path(name: str) -> Path | None:
    folder = kept_programs.own_folder()
    return None if folder is None else folder / f"aleator_{name}-cache"
