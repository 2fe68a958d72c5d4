"""Which modules are presumed not to change, and which have results that differ between calls."""

import functools
import sys
import sysconfig
from typing import Any

_LIBRARIES = {"jax", "jaxlib", "equinox", "jaxtyping", "numpy", "scipy", "diffrax", "optimistix", "lineax", "aleator"}
_PYTHON = sysconfig.get_path("stdlib")
# Modules whose results differ between calls, or that find objects which no name in the code shows.
_MOODY = {"random", "time", "datetime", "os", "io", "secrets", "uuid", "socket", "subprocess", "threading"}
_MOODY |= {"_random", "_io", "posix", "nt", "numpy.random", "gc", "importlib", "inspect", "runpy"}


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
