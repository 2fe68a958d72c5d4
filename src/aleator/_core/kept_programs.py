"""Compiled programs kept between runs, by JAX's persistent compilation cache, in a folder of the user's own.

What is compiled is machine code: it stays among machines of one kind, and in a folder that nobody else writes to.
"""

import hashlib
import os
import platform
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

# Beyond so many bytes the programs unused for longest go, when a process begins.
_MOST_BYTES = 500 * 2**20
_ON = ("on", "yes", "1", "true")
_OFF = ("off", "no", "none", "0", "false", "")
_folder: Path | None = None


def compilation_cache(folder: str | os.PathLike[str] | None) -> None:
    """Keep compiled programs in `folder` from now on, or with `None` no longer, so that another run need not compile.

    By default they are kept in the user's own cache folder, at most 500 MB, unless JAX has been given a folder; the
    environment variable `ALEATOR_CACHE`, a folder or `off`, says otherwise. Entries that are damaged, or
    come from another machine or version, are passed over. Whoever may write to the folder may have this process run
    what they like: share it with nobody.

    Raises `ProblemError` if the folder cannot be made or written to.
    """
    if folder is not None and not (isinstance(folder, str | os.PathLike) and str(folder)):
        raise refusal("compilation_cache: folder", "a folder, or None", folder)
    _keep_in(None if folder is None else _made(Path(folder)))


def keep_by_default() -> None:
    """Keep programs where the environment says, or in the user's cache folder; called once, when JAX is set up.

    A folder that JAX was given stays. One that cannot be written to is warned of where it was asked for.
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
    """Where programs are kept; None if nowhere, or in a folder that JAX was given."""
    return _folder


def _usual() -> Path:
    """The user's cache folder. Raises `ProblemError` where nobody knows the user's home."""
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
    # Small programs too: hundreds of them are compiled one by one where a model is asked for single numbers.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    # What cannot be read is compiled, what cannot be written is compiled again: neither is news to a user.
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")
    _forget_oldest(folder)


def _made(folder: Path) -> Path:
    """The part of a folder that belongs to machines of this kind. Raises `ProblemError` if it cannot be written to."""
    try:
        # Absolute, for a program may go to another folder later.
        own = folder.expanduser().absolute() / _kind()
        own.mkdir(mode=0o700, parents=True, exist_ok=True)
        trial = own / f".{os.getpid()}"
        trial.touch()
        trial.unlink()
    except (OSError, RuntimeError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else "") or str(error).rstrip(".")
        raise ProblemError(
            f"Compiled programs cannot be kept in {str(folder)!r}: {reason}. Give a folder that can be written to, or "
            f"turn keeping off with {VARIABLE}=off."
        ) from error
    return own


def _kind() -> str:
    """A name for this kind of machine and these versions: code for one processor may stop another."""
    about = [platform.system(), platform.machine(), platform.processor(), jax.__version__, metadata.version("jaxlib")]
    try:
        lines = Path("/proc/cpuinfo").read_text().split("\n\n")[0].splitlines()
        about += [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]
    except OSError:
        pass
    return hashlib.sha256("\n".join(about).encode()).hexdigest()[:16]


def _forget_oldest(folder: Path) -> None:
    """Delete the programs unused for longest beyond what may be kept. Another process may be doing the same."""
    found = []
    for path in folder.glob("*-cache"):
        try:
            status = path.stat()
        except OSError:
            continue
        found.append((max(status.st_atime, status.st_mtime), status.st_size, path))
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= _MOST_BYTES:
            return
        path.unlink(missing_ok=True)
        total -= size
