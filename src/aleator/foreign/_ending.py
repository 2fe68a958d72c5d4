"""Processes that can be ended with all those that they started."""

import os
import signal
import subprocess
from typing import Any


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
