"""Compiled programs kept between runs by JAX's persistent compilation cache, in the user's own folder.

They are machine code: each kind of machine has its own part of the folder, which nobody else may write to.
"""

import contextlib
import hashlib
import os
import platform
import sys
import warnings
from importlib import metadata
from pathlib import Path

import jax
import platformdirs
from jax.experimental.compilation_cache import compilation_cache as persistent

from aleator._core.errors import ProblemError
from aleator._core.given import refusal

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
_folder: Path | None = None


def compilation_cache(folder: str | os.PathLike[str] | None) -> None:
    """Keep compiled programs in `folder` from now on, so that other runs need not compile; `None` ends this.

    By default they are kept in the user's own cache folder, at most 500 MB, unless JAX has been given a folder; the
    environment variable `ALEATOR_CACHE`, a folder or `off`, overrides this. Entries that are damaged, or come from
    another machine or version, are ignored. Anyone who can write to them can make this process run any code, so that
    they are in a part of the folder that is closed to others.

    Raises `ProblemError` if the folder cannot be created or written to, or if its part for this machine belongs to
    another user or can be written to by others.
    """
    if folder is not None and not (isinstance(folder, str | os.PathLike) and str(folder)):
        raise refusal("compilation_cache: folder", "a folder, or None", folder)
    _keep_in(None if folder is None else _made(Path(folder)))


def keep_by_default() -> None:
    """Keep programs in the folder set in the environment, or in the user's cache folder; called once, at set-up.

    A folder given to JAX is left unchanged. A warning is given if a folder set by the user cannot be written to.
    """
    wanted = os.environ.get(VARIABLE)
    if wanted is None and jax.config.jax_compilation_cache_dir is not None:  # type: ignore[attr-defined]
        return
    if wanted is not None and wanted.strip().lower() in _OFF:
        return
    try:
        _keep_in(_made(_usual() if wanted is None or wanted.strip().lower() in _ON else Path(wanted)))
    except ProblemError as error:
        if wanted is not None:
            warnings.warn(f"{VARIABLE}: {error} Nothing is kept.", stacklevel=2)


def own_folder() -> Path | None:
    """The folder of kept programs; None if they are not kept, or kept in a folder given to JAX."""
    return _folder


def is_private(status: os.stat_result) -> bool:
    """Whether a file or folder belongs to this user, and nobody else can write to it; assumed on Windows."""
    return sys.platform == "win32" or (status.st_uid == os.getuid() and not status.st_mode & 0o022)


def _usual() -> Path:
    """The user's cache folder. Raises `ProblemError` if the user's home is unknown."""
    try:
        return platformdirs.user_cache_path("aleator")
    except RuntimeError as error:
        raise ProblemError(f"There is no folder to keep compiled programs in: {error}.") from error


def _keep_in(folder: Path | None) -> None:
    global _folder
    _folder = folder
    jax.config.update("jax_compilation_cache_dir", None if folder is None else str(folder))
    persistent.reset_cache()
    if folder is None:
        return
    # Small programs too: hundreds of them are compiled one by one when single numbers of a model are evaluated.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    # Unreadable entries are compiled, unwritable ones compiled again: users need not know of either.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    _forget_oldest(folder)


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


def _forget_oldest(folder: Path) -> None:
    """Delete the least recently used programs beyond the limit, also those of other versions and kinds of machines.

    Another process may be doing the same.
    """
    found: list[tuple[float, int, Path]] = []
    for path in folder.parent.glob(f"{_KIND_GLOB}/*-cache"):
        try:
            status = path.stat()
        except OSError:
            continue
        found.append((max(status.st_atime, status.st_mtime), status.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= _MOST_BYTES:
            return
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
            total -= size
