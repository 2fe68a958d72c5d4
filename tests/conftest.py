"""Array shapes checked at run time, rank promotion refused: before `aleator` is imported."""

import atexit
import gc
import os
import shutil
import signal
import tempfile

if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # What one worker compiles, the others read, small programs too; nothing of it outlives the run.
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="aleator-tests-")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)

import jax
import pytest
from jaxtyping import install_import_hook

import shape_checker

# The hook rewrites modules as they are imported: it must come first. Uncertainty, expansion and statistics are left
# out: written for JAX arrays, they rightly work on plain floats and NumPy arrays too, on which their tests call them,
# and a check of array types would refuse those.
CHECKED = [
    f"aleator.{part}"
    for part in (
        "trajectories",
        "dynamics",
        "mechanics",
        "geometry",
        "design",
        "nlp",
        "ensemble",
        "transcription",
        "solving",
        "validation",
        "sweep",
    )
]


def pytest_configure(config: pytest.Config) -> None:
    """Check shapes, but not again in the slow run, which calls the same functions for long."""
    if config.option.markexpr != "slow":
        shape_checker.check_only_shapes()
        install_import_hook(CHECKED, "shape_checker.check")


pytest_plugins = ["costs"]

jax.config.update("jax_numpy_rank_promotion", "raise")

# Compiling is most of what tests do: without what makes many runs of loops fast, and in one part where both processors
# are busy, it takes about half as long. Read by XLA when it first compiles, here and in the processes of tests.
QUICKLY = ("--xla_cpu_use_fusion_emitters=false", "--xla_cpu_parallel_codegen_split_count=1")
os.environ["XLA_FLAGS"] = " ".join(dict.fromkeys([*os.environ.get("XLA_FLAGS", "").split(), *QUICKLY]))

# Tracing makes many objects that live long: to look for cycles among them as often as Python does takes long.
gc.set_threshold(100_000, 50, 100)


@pytest.fixture
def python_interrupts():
    """Python's own handler of Ctrl-C, which a process started in the background of a shell is without."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
