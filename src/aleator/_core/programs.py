"""Where compiled programs are kept: those used last in memory, and all for later runs on the disk.

Later runs need not trace, lower or compile them again: JAX's persistent compilation cache finds programs by their
lowered text, and tracing and lowering take longer than all the rest. They are in the user's own folder, under lasting
names (`identity`), with marks of the code that two traces have shown to be steady.

Reading a file runs what it holds: machine code, and a pickle, because JAX has no other form of an executable. So files
are in a folder that belongs to this user, to which nobody else can write, and begin with the digest of their name and
content. What cannot be read or loaded is deleted, and the program is compiled as if it had never been kept. Nobody is
told, since nothing is lost but time.
"""

import contextlib
import functools
import gc
import hashlib
import os
import pickle
import re
import sys
import tempfile
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, final

import jax
import jax.numpy as jnp
import platformdirs
from jax.experimental import serialize_executable

from aleator._core.border import refusal
from aleator._core.errors import ProblemError

# Enough for a session's problems; beyond, the least recently used one is dropped, with the classes it holds.
_KEPT = 256

# Linux limits the memory mappings of each process, and compiled code takes hundreds for each program: beyond, LLVM gets
# no memory and ends the process without a message. Counting them takes as long as compiling a small program.
_OWN, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
_COUNTED_EVERY = 16


@final
class Programs:
    """Programs by their keys; the least recently used are dropped if there are too many.

    `most` bounds their number. So do the memory mappings of the process: when half of those that the system allows are
    taken, the older half of the programs is dropped and, if that does not help, JAX's own caches are cleared.
    """

    def __init__(self, most: int = _KEPT):
        self._most = most
        self._programs: OrderedDict[Hashable, Any] = OrderedDict()
        self._lock = threading.Lock()
        self._compiled = 0

    def __contains__(self, key: Hashable) -> bool:
        with self._lock:
            return key in self._programs

    def get(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The program of a key, made if there is none."""
        with self._lock:
            program = self._programs[key] = self._programs.pop(key, None) or make()
            while len(self._programs) > self._most:
                self._programs.popitem(last=False)
        return program

    def make_room(self) -> None:
        """Ensure that another program can be mapped into memory."""
        self._compiled += 1
        if self._compiled % _COUNTED_EVERY:
            return
        while _is_crowded() and self._programs:
            with self._lock:
                for key in list(self._programs)[: -(-len(self._programs) // 2)]:
                    del self._programs[key]
            gc.collect()
        if _is_crowded():
            jax.clear_caches()
            gc.collect()


def _is_crowded() -> bool:
    """Whether this process has more than half of the memory mappings that it may have, if that is known."""
    try:
        return _OWN.read_bytes().count(b"\n") > int(_MOST.read_text()) / 2
    except (OSError, ValueError):
        return False


PROGRAMS = Programs()


VARIABLE = "ALEATOR_CACHE"
"""Environment variable: a folder, or "off"."""

# Beyond this many bytes, the least recently used programs are deleted when a process has written its first.
_MOST_BYTES = 500 * 2**20

# Calls of functions outside XLA in the text of a program.
_CALLED, _LAPACK = re.compile(r"custom_call @([^(]+)"), "lapack_"
_DIGEST = hashlib.sha256().digest_size

_folder: Path | None = None
_WRITER = ThreadPoolExecutor(1, thread_name_prefix="aleator, writer")


def compilation_cache(folder: str | os.PathLike[str] | None) -> None:
    """Keep compiled programs in `folder` from now on, so that other runs need not compile; `None` ends this.

    By default they are kept in the user's own cache folder, at most 500 MB; the environment variable `ALEATOR_CACHE`, a
    folder or `off`, overrides this. Nothing more is kept while JAX has a folder of its own. Entries that are damaged,
    or come from another machine or version, are ignored. Anyone who can write to them can make this process run any
    code, so that they are in a part of the folder that is closed to others.

    Raises `ProblemError` if the folder cannot be created or written to, or if its part for programs belongs to another
    user or can be written to by others.
    """
    if folder is not None and not (isinstance(folder, str | os.PathLike) and str(folder)):
        raise refusal("compilation_cache: folder", "a folder, or None", folder)
    global _folder
    _folder = None if folder is None else _made(Path(folder))


def keep_by_default() -> None:
    """Keep programs in the folder set in the environment, or in the user's cache folder; called once, at set-up.

    Nowhere if JAX has been given a folder. A warning is given if a folder set by the user cannot be written to.
    """
    global _folder
    wanted = os.environ.get(VARIABLE)
    if wanted is None and jax.config.jax_compilation_cache_dir is not None:  # type: ignore[attr-defined]
        return
    if wanted is not None and wanted.strip().lower() in ("off", ""):
        return
    try:
        _folder = _made(platformdirs.user_cache_path("aleator") if wanted is None else Path(wanted))
    except (ProblemError, RuntimeError) as error:  # the latter where the user's home is unknown
        if wanted is not None:
            warnings.warn(f"{VARIABLE}: {error} Nothing is kept.", stacklevel=2)


def is_private(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to this user, and nobody else can write to it; assumed on Windows."""
    return sys.platform == "win32" or (status.st_uid == os.getuid() and not status.st_mode & 0o022)


def functions_outside(lowered: jax.stages.Lowered) -> set[str]:
    """The functions outside XLA that a program calls."""
    return set(_CALLED.findall(lowered.as_text()))


def is_lapack(functions: set[str]) -> bool:
    """Whether all of some functions are LAPACK's."""
    return all(one.startswith(_LAPACK) for one in functions)


def load(name: str | None, inputs: list[Any]) -> tuple[Any, Any, bool] | None:
    """The executable that an earlier run has kept under a name, the layout of its results, and whether it calls LAPACK;
    None if there is none.

    - `inputs`: arrays like those that it is called with.
    """
    if name is None or _folder is None:
        return None
    path = _path(_folder, name)
    try:
        content = path.read_bytes()
        digest, content = content[:_DIGEST], content[_DIGEST:]
        if _digest(name, content) != digest:
            raise ValueError(path)
        payload, layout, count, calls_lapack = pickle.loads(content)
        if calls_lapack:
            _prepare_lapack()
        trees = jax.tree.structure((tuple(inputs), {})), jax.tree.structure([0] * count)
        return serialize_executable.deserialize_and_load(payload, *trees), layout, calls_lapack
    except FileNotFoundError:
        return None
    except Exception:  # XLA, JAX and pickle have no common one
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        return None


def keep(name: str | None, executable: jax.stages.Compiled, layout: Any, outside: set[str]) -> None:
    """Keep an executable, with the layout of its results; another thread writes it.

    What cannot be written is skipped silently, and so is what calls functions `outside` XLA other than LAPACK's, such
    as Python code, for these may not exist in another run; and everything while JAX's own cache is on: an executable
    that it has read has lost its code.
    """
    if name is None or _folder is None or jax.config.jax_compilation_cache_dir:  # type: ignore[attr-defined]
        return
    if is_lapack(outside):
        with contextlib.suppress(RuntimeError):  # while the interpreter ends, nothing more is written
            _WRITER.submit(_written, _folder, name, executable, layout, bool(outside))


def _written(folder: Path, name: str, executable: jax.stages.Compiled, layout: Any, calls_lapack: bool) -> None:
    try:
        payload, _, results = serialize_executable.serialize(executable)
        content = pickle.dumps((payload, layout, results.num_leaves, calls_lapack))
    except Exception:  # XLA, JAX and pickle have no common one
        return
    with contextlib.suppress(OSError):
        # Its name lets it be counted and deleted as the others are, should this run be ended here.
        descriptor, trial = tempfile.mkstemp("-cache", ".", folder)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(_digest(name, content) + content)
            Path(trial).replace(_path(folder, name))
        finally:
            Path(trial).unlink(missing_ok=True)
        _forget_oldest(folder)


def is_marked(name: str) -> bool:
    """Whether an earlier run has marked a name."""
    return _folder is not None and _path(_folder, name).exists()


def mark(name: str) -> None:
    """Mark a name for later runs; what cannot be written is skipped silently."""
    if _folder is not None:
        with contextlib.suppress(OSError):
            _path(_folder, name).touch(mode=0o600)


def _path(folder: Path, name: str) -> Path:
    return folder / f"{name}-cache"


def _digest(name: str, content: bytes) -> bytes:
    """Of the name too: under another one, an executable would compute something else."""
    return hashlib.sha256(name.encode() + b"\0" + content).digest()


@functools.cache
def _prepare_lapack() -> None:
    """Make JAX look up LAPACK's functions, which it does otherwise only when it lowers a call of one.

    A loaded program that calls one before crashes the process; SciPy's, which it takes, cost half an import of JAX.
    """
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), float))


def _made(folder: Path) -> Path:
    """The part of a folder for programs. Raises `ProblemError` if it cannot be written to."""
    try:
        # Absolute, because the working directory may change later.
        own = folder.expanduser().absolute() / "programs"
        own.mkdir(mode=0o700, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=own).close()
        if not is_private(own.stat()):
            raise ValueError(f"{own} belongs to another user, or others can write to it")
    except (OSError, RuntimeError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else "") or str(error).rstrip(".")
        raise ProblemError(
            f"Compiled programs cannot be kept in {str(folder)!r}: {reason}. Give a folder that can be written to, or "
            f"turn keeping off with {VARIABLE}=off."
        ) from error
    return own


@functools.cache
def _forget_oldest(folder: Path) -> None:
    """Delete the least recently used programs beyond the limit, also those of other versions and kinds of machines.

    Once in a process, when it has written its first. Another process may be doing the same.
    """
    found: list[tuple[float, int, Path]] = []
    for path in folder.glob("*-cache"):
        with contextlib.suppress(OSError):
            status = path.stat()
            found.append((max(status.st_atime, status.st_mtime), status.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= _MOST_BYTES:
            return
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
            total -= size
