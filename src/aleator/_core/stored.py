"""Executables on the disk, by lasting names: a later run traces, lowers and compiles nothing that an earlier one has.

They stand in the folder of compiled programs (`kept_programs`), beside those that JAX keeps by itself. JAX finds its
own by the text that a program is lowered to, for which it must be traced first: that takes longer than all the rest.
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

# The functions outside of XLA that a program calls, as they are written in its text.
_CALLED, _LAPACK = re.compile(r"custom_call @([^(]+)"), "lapack_"
_DIGEST = hashlib.sha256().digest_size


class Stored(NamedTuple):
    """An executable and what its results are to be read by.

    - `executable`: takes the arguments that it was compiled for, gives the list of the results' arrays;
    - `results`: how results follow from these arrays, anything that can be pickled.
    """

    executable: jax.stages.Compiled
    results: Any


def read(name: str | None) -> bytes | None:
    """The file of a name, whole and undamaged; None if there is none."""
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
    """What `keep` was given, to be called with arguments of this structure. Raises whatever may be wrong with it."""
    _prepare_lapack()
    payload, results, count = pickle.loads(content)
    given, given_back = jax.tree.structure((arguments, {})), jax.tree.structure([0] * count)
    return Stored(serialize_executable.deserialize_and_load(payload, given, given_back), results)


def keep(name: str, lowered: jax.stages.Lowered, found: Stored) -> None:
    """Keep an executable for later runs. What cannot be written is not kept: that is no news to a user.

    Neither is what calls anything outside of XLA but LAPACK: what that may be, and whether it is there in another run,
    nobody knows. Python code is called so as well.
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
    """JAX looks LAPACK's functions up when it lowers a call of one; a program that calls before goes nowhere, and ends
    the process.
    """
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _path(name: str) -> Path | None:
    folder = kept_programs.own_folder()
    return None if folder is None else folder / f"aleator_{name}-cache"
