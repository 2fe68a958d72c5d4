"""Which modules are presumed not to change, and which modules and functions have results that differ between calls."""

import functools
import sys
import sysconfig
from typing import Any

_LIBRARIES = {"jax", "jaxlib", "equinox", "jaxtyping", "numpy", "scipy", "diffrax", "optimistix", "lineax", "aleator"}
_PYTHON = sysconfig.get_path("stdlib")
# Modules whose results differ between calls, or that find objects which no name in the code shows.
_MOODY = {"random", "time", "datetime", "os", "io", "secrets", "uuid", "socket", "subprocess", "threading"}
_MOODY |= {"_random", "_io", "posix", "nt", "numpy.random", "gc", "importlib", "inspect", "runpy"}

# Methods whose results differ between calls, or are read from a file; attributes that lead to a function's globals.
MOODY_NAMES = {"rvs", "read_text", "read_bytes", "__globals__", "f_globals", "f_locals", "f_builtins"}
# Functions of libraries that read files.
_OF_FILES = {"load", "loadtxt", "loadmat", "genfromtxt", "fromfile", "memmap", "read_csv", "read_table"} | {
    *("read_excel", "read_parquet", "read_hdf", "read_json", "open_dataset", "load_dataset"),
}
# Functions that read objects which no name in the code shows.
HIDDEN = {"eval", "exec", "compile", "globals", "locals", "vars", "getattr", "open", "input", "__import__"}
# The same in Python's modules.
_REACHING = {"_getframe", "_current_frames", "attrgetter"}


@functools.lru_cache(maxsize=4096)
def is_library(module: Any) -> bool:
    """Whether a module, by its name, is part of Python, of JAX or of related libraries; studies are not."""
    if not isinstance(module, str):
        return False
    root = module.partition(".")[0]
    if root in _LIBRARIES:
        return not module.startswith("aleator.studies")
    # A user's module may have the name of one of Python's.
    file = getattr(sys.modules.get(root), "__file__", None)
    return root in sys.stdlib_module_names and (file is None or file.startswith(_PYTHON))


@functools.lru_cache(maxsize=4096)
def is_moody(module: Any) -> bool:
    """Whether a module's results differ between calls: random numbers, clocks, files."""
    return isinstance(module, str) and (module in _MOODY or module.startswith(("numpy.random", "scipy.stats")))


def reaches(it: Any) -> bool:
    """Whether something of a library looks names up that the code does not show."""
    return is_library(it.__module__) and it.__name__ in _REACHING


def may_vary(function: Any, home: str | None) -> bool:
    """Whether a function of the library `home` may return something else although it is the same."""
    return is_moody(home) or function.__name__ in _OF_FILES | _REACHING
