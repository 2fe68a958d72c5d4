"""Executables on the disk, by lasting names: later runs need not trace, lower or compile them again.

They are in the folder of compiled programs (`kept_programs`), beside those that JAX itself keeps. JAX finds its own by
the lowered text of a program, for which it must be traced first: that takes longer than all the rest.
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


def read(name: str | None) -> bytes | None:
    """The content of the file with a name, if complete and undamaged; else None."""
    path = None if name is None else _path(name)
    if path is None:
        return None
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, rest = content[:_DIGEST], content[_DIGEST:]
    return rest if hashlib.sha256(rest).digest() == digest else None


def loaded(content: bytes, arguments: tuple[Any, ...]) -> Stored:
    """The executable that was passed to `keep`, for arguments of this structure. Raises any error of loading it."""
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
        whole = pickle.dumps((payload, found.results, given_back.num_leaves))
    except Exception:  # XLA, JAX and pickle have no common one
        return
    trial = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}")
    with contextlib.suppress(OSError):
        try:
            trial.write_bytes(hashlib.sha256(whole).digest() + whole)
            trial.replace(path)
        finally:
            trial.unlink(missing_ok=True)


@functools.cache
def _prepare_lapack() -> None:
    """Make JAX look up LAPACK's functions, which it does otherwise only when it lowers a call of one.

    A loaded program that calls one before crashes the process.
    """
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _path(name: str) -> Path | None:
    folder = kept_programs.own_folder()
    return None if folder is None else folder / f"aleator_{name}-cache"
