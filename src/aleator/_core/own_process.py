"""Processes that can be ended with all those that they started, and that end when nobody waits for them any more.

A process that only runs a user's function imports this module and none of the parts of the package that are slow to
import.
"""

import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from typing import Any

# The processes that threads of this one are waiting for, and how often all of them have been ended.
_RUNNING: set[int] = set()
_ended = 0


def in_group() -> dict[str, Any]:
    """What `subprocess.Popen` needs so that a process and its children form a group."""
    return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP} if os.name == "nt" else {"start_new_session": True}


def end_group(process: int) -> None:
    """End a process that leads a group and has not been waited for, with its children."""
    if os.name == "nt":
        subprocess.run(["taskkill", "/T", "/F", "/PID", str(process)], capture_output=True, check=False)
        return
    try:
        os.killpg(process, signal.SIGKILL)
    except ProcessLookupError:
        return


def endings() -> int:
    """How often `end_running` has been called: to be asked before a process is started."""
    return _ended


@contextmanager
def ended_with(process: int, is_over: Callable[[], bool], before: int) -> Iterator[None]:
    """End a process that leads a group if the block is left before it `is_over`, or if `end_running` is called.

    `before`: the `endings` before it was started; one that was called since then did not know of it.
    """
    _RUNNING.add(process)
    if endings() != before:
        end_group(process)
    try:
        yield
    finally:
        _RUNNING.discard(process)
        if not is_over():
            end_group(process)


def end_running() -> None:
    """End all processes that threads of this one are waiting for: an interrupt reaches neither of them."""
    global _ended
    _ended += 1
    for process in list(_RUNNING):
        end_group(process)


def exit_told(code: int | None) -> str:
    """How a process ended, in words: by a signal, whose number is negative, or with an exit code."""
    if code is None or code >= 0:
        return f"exit code {code}"
    try:
        return f"the signal {signal.Signals(-code).name}"
    except ValueError:
        return f"the signal {-code}"


def end_with_parent(end: Callable[[], None] = end_running) -> None:
    """In a process that `multiprocessing` has begun: end as soon as the one that began it is gone, however that ended.

    Without this it waits for work, or works for nobody, for ever after a `kill -9` there. `end` comes before.
    """
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        wait([parent.sentinel])
        try:
            end()
        finally:
            os._exit(1)  # from a thread: the main one may be within a library

    threading.Thread(target=watch, name="end with parent", daemon=True).start()


def report(sender: Connection, function: Callable[[Any], Any], argument: Any) -> None:
    """In a process of its own: call a function and send what it returns, or what it raises as text."""
    if os.name != "nt":
        os.setsid()
    end_with_parent(lambda: end_group(os.getpid()))
    try:
        sender.send((function(argument), None))
    except Exception as error:
        sender.send((None, f"{type(error).__name__}: {error}"))
