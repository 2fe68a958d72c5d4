"""Programs: traced once, compiled by the first thread that needs them, kept while there is room, and kept on the disk.

Later runs need not trace, lower or compile them again. They are in the user's own folder, in a part for each kind of
machine, because they are machine code, under lasting names (`identity`): JAX's persistent compilation cache finds
programs by their lowered text, and tracing and lowering take longer than all the rest. Beside them are the digests of
equations that two traces have given, as names of empty files: see `mark`.

Reading a file runs what it holds: machine code, and a pickle, because JAX has no other form of an executable. So only
files are opened that belong to this user, that nobody else can write to, and whose digest is that of their name and
content. What cannot be read or loaded is deleted, and the program is compiled as if it had never been kept. Nobody is
told, since nothing is lost but time.
"""

import contextlib
import functools
import gc
import hashlib
import os
import pickle
import platform
import re
import sys
import threading
import warnings
from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from typing import Any, final

import jax
import jax.numpy as jnp
import platformdirs
from jax.experimental import serialize_executable

from aleator._core import uncollected
from aleator._core.border import refusal
from aleator._core.errors import ProblemError
from aleator._core.parallel import undisturbed

Executable = Callable[..., Any]

# Enough for a session's problems; beyond, the least recently used one is dropped, with the classes it holds.
_KEPT = 256

# Memory mappings that one program takes at most, with what JAX compiles beside it.
_MOST_OF_ONE = 1000

# Linux limits the mappings of each process, and compiled code takes hundreds: beyond, LLVM gets no memory and ends the
# process without a message.
_OWN, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")


@final
class Program:
    """A program that is traced in the thread that asks for it, and compiled by the first one that needs it.

    Other threads wait meanwhile. Nothing waits for a core: if another thread was to compile a program and has not
    begun, its caller compiles it. What fails is tried again by the next one who asks.

    - `results`: their shapes, None if they are not known.
    """

    def __init__(self) -> None:
        self.results: Any = None
        self._lock = threading.RLock()
        self._compile: Callable[[], Executable] | None = None
        self._executable: Executable | None = None

    @property
    def is_ready(self) -> bool:
        """Whether it has been compiled."""
        return self._executable is not None

    def trace(self, build: Callable[[], Callable[[], Executable]]) -> None:
        """Trace it unless this has been done: `build` returns the function that compiles it."""
        with self._lock:
            if self._compile is None and self._executable is None:
                with uncollected():
                    self._compile = build()

    def __call__(self) -> Executable:
        """The executable of a traced program, compiled now if it has not been."""
        # After Ctrl-C, XLA would go on compiling, and a process that ends meanwhile is aborted.
        return self._executable or undisturbed(self._compiled)

    def _compiled(self) -> Executable:
        with self._lock:
            if self._executable is None:
                assert self._compile is not None
                PROGRAMS.make_room()
                self._executable = self._compile()
                self._compile = None  # with what it holds
            return self._executable


@final
class Programs:
    """Programs by their keys; the least recently used are dropped if there are too many.

    `most` bounds their number. So do the memory mappings of the process: when half of those that the system allows are
    taken, the older half of the programs is dropped and, if that does not help, JAX's own caches are cleared.
    """

    def __init__(self, most: int = _KEPT):
        self._most = most
        self._programs: OrderedDict[Hashable, Program] = OrderedDict()
        self._lock = threading.Lock()
        # Mappings that cannot be released here, those that there was room for at the last count, and programs since.
        self._foreign, self._room, self._since = 0, 0.0, 0

    def __contains__(self, key: Hashable) -> bool:
        with self._lock:
            return key in self._programs

    def __getitem__(self, key: Hashable) -> Program:
        with self._lock:
            program = self._programs.setdefault(key, Program())
            self._programs.move_to_end(key)
            while len(self._programs) > self._most:
                self._programs.popitem(last=False)
        return program

    def make_room(self) -> None:
        """Ensure that another program can be mapped into memory.

        Counting takes as long as compiling a small program, and is left out while there is room for certain.
        """
        self._since += 1
        if self._since * _MOST_OF_ONE <= self._room:
            return
        crowded = self._is_crowded()
        while crowded and self._forget_older_half():
            gc.collect()
            crowded = self._is_crowded()
        if crowded:
            jax.clear_caches()
            gc.collect()
            self._foreign = mappings()

    def _is_crowded(self) -> bool:
        self._room, self._since = (self._foreign + most_mappings()) / 2 - mappings(), 0
        return self._room < 0

    def _forget_older_half(self) -> bool:
        """Drop the older half of the programs; return whether there were any."""
        with self._lock:
            ready = [key for key, program in self._programs.items() if program.is_ready]
            for key in ready[: -(-len(ready) // 2)]:
                del self._programs[key]
        return bool(ready)


def mappings() -> int:
    """How many memory mappings this process has; 0 if unknown."""
    try:
        with _OWN.open("rb") as lines:
            return sum(1 for _ in lines)
    except OSError:
        return 0


def most_mappings() -> float:
    """How many it may have; infinite if the system sets no limit."""
    try:
        return int(_MOST.read_text())
    except (OSError, ValueError):
        return float("inf")


PROGRAMS = Programs()


VARIABLE = "ALEATOR_CACHE"
"""Environment variable: a folder, or "off"."""

# Beyond this many bytes, the least recently used programs are deleted when a process starts.
_MOST_BYTES = 500 * 2**20
# Names of the folders for each kind of machine; others beside them are not ours.
_DIGITS = 16
_KIND_GLOB = "[0-9a-f]" * _DIGITS
_PROCESSOR = Path("/proc/cpuinfo")
_ON = ("on", "yes", "1", "true")
_OFF = ("off", "no", "none", "0", "false", "")

# Calls of functions outside XLA in the text of a program.
_CALLED, _LAPACK = re.compile(r"custom_call @([^(]+)"), "lapack_"
_DIGEST = hashlib.sha256().digest_size
_BINARY = getattr(os, "O_BINARY", 0)  # on Windows

_folder: Path | None = None
_WRITER = ThreadPoolExecutor(1, thread_name_prefix="aleator, writer")


def compilation_cache(folder: str | os.PathLike[str] | None) -> None:
    """Keep compiled programs in `folder` from now on, so that other runs need not compile; `None` ends this.

    By default they are kept in the user's own cache folder, at most 500 MB; the environment variable `ALEATOR_CACHE`, a
    folder or `off`, overrides this. Nothing more is kept while JAX has a folder of its own. Entries that are damaged,
    or come from another machine or version, are ignored. Anyone who can write to them can make this process run any
    code, so that they are in a part of the folder that is closed to others.

    Raises `ProblemError` if the folder cannot be created or written to, or if its part for this machine belongs to
    another user or can be written to by others.
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
    if wanted is not None and wanted.strip().lower() in _OFF:
        return
    try:
        usual = wanted is None or wanted.strip().lower() in _ON
        _folder = _made(platformdirs.user_cache_path("aleator") if usual else Path(str(wanted)))
    except (ProblemError, RuntimeError) as error:  # the latter where the user's home is unknown
        if wanted is not None:
            warnings.warn(f"{VARIABLE}: {error} Nothing is kept.", stacklevel=2)


def is_private(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to this user, and nobody else can write to it; assumed on Windows."""
    return sys.platform == "win32" or (status.st_uid == os.getuid() and not status.st_mode & 0o022)


def is_kept(name: str | None) -> bool:
    """Whether a program of this name, or the name alone, has been kept."""
    return name is not None and (path := _path(name)) is not None and path.exists()


def mark(name: str) -> None:
    """Keep a name alone, for `is_kept` in later runs; what cannot be written is skipped silently."""
    if (path := _path(name)) is not None:
        with contextlib.suppress(OSError):
            path.touch(mode=0o600)


def load(name: str | None, inputs: list[Any]) -> tuple[Any, Any] | None:
    """The executable that an earlier run has kept under a name, and how it is run; None if there is none.

    - `inputs`: arrays like those that it is called with.
    """
    if name is None or (path := _path(name)) is None:
        return None
    try:
        with path.open("rb") as file:
            if not is_private(os.fstat(file.fileno())):
                raise PermissionError(path)
            digest, content = file.read(_DIGEST), file.read()
        if _digest(name, content) != digest:
            raise ValueError(path)
        payload, layout, count, calls_lapack = pickle.loads(content)
        if calls_lapack:
            _prepare_lapack()
        trees = jax.tree.structure((tuple(inputs), {})), jax.tree.structure([0] * count)
        return serialize_executable.deserialize_and_load(payload, *trees), layout
    except FileNotFoundError:
        return None
    except Exception:  # XLA, JAX and pickle have no common one
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
        return None


def keep(name: str, lowered: jax.stages.Lowered, executable: jax.stages.Compiled, layout: Any) -> None:
    """Keep an executable, with the layout of its results and whether it runs alone; another thread writes it.

    What cannot be written is skipped silently, and so is what calls anything outside XLA other than LAPACK, such as
    Python code, for such a function may not exist in another run; and everything while JAX's own cache is on: an
    executable that it has read has lost its code.
    """
    if _folder is not None and not jax.config.jax_compilation_cache_dir:  # type: ignore[attr-defined]
        with contextlib.suppress(RuntimeError):  # while the interpreter ends, nothing more is written
            _WRITER.submit(_written, name, lowered, executable, layout)


def _written(name: str, lowered: jax.stages.Lowered, executable: jax.stages.Compiled, layout: Any) -> None:
    path = _path(name)
    called = set(_CALLED.findall(lowered.as_text()))
    if path is None or not all(one.startswith(_LAPACK) for one in called):
        return
    try:
        payload, _, results = serialize_executable.serialize(executable)
        content = pickle.dumps((payload, layout, results.num_leaves, bool(called)))
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
        finally:
            trial.unlink(missing_ok=True)
        _forget_oldest(path.parent)


def _path(name: str) -> Path | None:
    return None if _folder is None else _folder / f"aleator_{name}-cache"


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
    """The part of a folder for machines of this kind. Raises `ProblemError` if it cannot be written to."""
    try:
        # Absolute, because the working directory may change later.
        own = folder.expanduser().absolute() / _kind()
        own.mkdir(mode=0o700, parents=True, exist_ok=True)
        trial = own / f".{os.getpid()}"
        trial.touch()
        trial.unlink()
        if not is_private(own.stat()):
            raise ValueError(f"{own} belongs to another user, or others can write to it")
    except (OSError, RuntimeError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else "") or str(error).rstrip(".")
        raise ProblemError(
            f"Compiled programs cannot be kept in {str(folder)!r}: {reason}. Give a folder that can be written to, or "
            f"turn keeping off with {VARIABLE}=off."
        ) from error
    return own


def _kind() -> str:
    """A name for this kind of machine and these versions: code for one processor may crash on another."""
    about = [platform.system(), platform.machine(), platform.processor(), jax.__version__, metadata.version("jaxlib")]
    try:
        lines = _PROCESSOR.read_text().split("\n\n")[0].splitlines()
        about += [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]
    except OSError:
        about.append(platform.node())  # Nothing tells what its processor can do: a machine of its own.
    return hashlib.sha256("\n".join(about).encode()).hexdigest()[:_DIGITS]


@functools.cache
def _forget_oldest(folder: Path) -> None:
    """Delete the least recently used programs beyond the limit, also those of other versions and kinds of machines.

    Once in a process, when it has written its first. Another process may be doing the same.
    """
    found: list[tuple[float, int, Path]] = []
    for path in folder.parent.glob(f"{_KIND_GLOB}/*-cache"):
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
