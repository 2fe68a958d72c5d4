"""What every test may rely on: nothing is left behind, no rank promotion, arrays of the shapes annotated."""

import contextlib
import gc
import os
import shutil
import signal
from pathlib import Path

if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # What one worker or an earlier run has compiled, the others read, small programs too: JAX finds them by their text.
    programs = Path(__file__).parents[1] / ".pytest_cache" / "programs"
    if sum(file.stat().st_size for file in programs.glob("*")) > 1e9:
        shutil.rmtree(programs)
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(programs)
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

# Each worker has a processor of its own: threads of NumPy that wait for one another on it take a third of some rooms.
os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

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
        shape_checker.take_the_place_of_jaxtyped()
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


def _children() -> set[str]:
    """The processes that this one has begun, but for Python's own tracker of what processes share."""
    children = set()
    for thread in Path("/proc/self/task").glob("*/children"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # of a thread or a process that has just ended
            for child in thread.read_text().split():
                if b"resource_tracker" not in Path(f"/proc/{child}/cmdline").read_bytes():
                    children.add(child)
    return children


def _left(root: Path) -> dict[str, set[str]]:
    # Some libraries set options of threads when they are imported.
    own = (pair for pair in os.environ.items() if not pair[0].startswith(("PYTEST_CURRENT_TEST", "KMP_")))
    environment = {f"{name}={value}" for name, value in own}
    files = {path.name for path in root.iterdir() if not path.name.startswith((".", "__pycache__"))}
    return {"processes": _children(), "environment": environment, "files": files, "folder": {str(Path.cwd())}}


@pytest.fixture(autouse=True)
def nothing_left_behind(pytestconfig: pytest.Config):
    """Fail a test that leaves a process, a file beside the project's own, or another environment behind."""
    before = _left(pytestconfig.rootpath)
    yield
    if not _children() <= before["processes"]:
        gc.collect()  # processes of FMUs end with their objects
    after = _left(pytestconfig.rootpath)
    left = {what: sorted(after[what] ^ before[what]) for what in before if after[what] != before[what]}
    if "processes" in left and after["processes"] <= before["processes"]:
        del left["processes"]  # of a fixture of many tests, which has ended one
    assert not left, f"left behind: {left}"
