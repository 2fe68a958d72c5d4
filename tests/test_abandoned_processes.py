"""Processes of a run that is killed by a signal that nothing can answer: they end too, with those that they started."""

import contextlib
import os
import select
import signal
import subprocess
import sys
from pathlib import Path

import pytest

# Says into the pipe named by its argument that it has begun, and later that nobody has ended it.
PROGRAM = """
import sys, time
with open(sys.argv[1], "w") as pipe:
    print("begun", file=pipe, flush=True)
    time.sleep(100)
    print("survived", file=pipe)
"""

# Workers: one without work, one in the middle of a computation, one that waits for a program, and one that waits for a
# function of its own process, which has started a program.
SCRIPT = f"""
import subprocess
import sys
import time

PROGRAM = {PROGRAM!r}


def spin():
    print("busy", flush=True)
    end = time.monotonic() + 100
    while time.monotonic() < end:
        pass


def wait_for_program(pipe):
    import aleator as al

    al.foreign.Command([sys.executable, "-I", "-S", "-c", PROGRAM, pipe, "{{x}}"])({{"x": 1.0}})


def hang(at):
    subprocess.Popen([sys.executable, "-I", "-S", "-c", PROGRAM, at["pipe"]])
    time.sleep(100)


def wait_for_function(pipe):
    import aleator as al

    al.foreign.Isolated(hang)({{"pipe": pipe}})


if __name__ == "__main__":
    import aleator as al

    with al.workers(4) as executor:
        executor.submit(wait_for_program, sys.argv[1])
        executor.submit(wait_for_function, sys.argv[1])
        executor.submit(abs, -1).result()
        executor.submit(spin).result()
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed by a signal, pipes have names")
def test_processes_end_with_a_run_that_is_killed(tmp_path: Path):
    (tmp_path / "script.py").write_text(SCRIPT)
    os.mkfifo(tmp_path / "pipe")
    pipe = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "pipe")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True) as run:
        try:
            assert run.stdout is not None
            assert run.stdout.readline() == "busy\n"
            said = b""
            while said.count(b"begun") < 2:
                assert select.select([pipe], [], [], 60.0)[0], "a program has not begun"
                said += os.read(pipe, 100)
            run.kill()
            # Each process holds the run's standard output: its end is read when the last of them is gone.
            run.communicate(timeout=60.0)
            os.set_blocking(pipe, True)
            assert os.read(pipe, 100) == b"", "no program has survived"
        finally:
            os.close(pipe)
            with contextlib.suppress(ProcessLookupError):  # nothing is left
                os.killpg(run.pid, signal.SIGKILL)
