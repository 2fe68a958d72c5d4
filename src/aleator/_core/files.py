"""What a user's files hold: content that ends, and JSON of any depth."""

import errno
import json
import stat
from pathlib import Path
from typing import Any

from aleator._core.arrays import may_hold


def content_of(path: str | Path) -> bytes:
    """The content of a regular file that fits into memory; a pipe or a device may never end.

    Raises `OSError`.
    """
    path = Path(path)
    found = path.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise OSError(errno.EINVAL, "it is a pipe or a device, not a file", str(path))
    if not may_hold(found.st_size):
        raise OSError(errno.EFBIG, "it is larger than half of this machine's memory", str(path))
    return path.read_bytes()


def json_of(content: str | bytes, **options: Any) -> Any:
    """What JSON says. Raises `ValueError` for anything else, and for what is nested too deeply."""
    try:
        return json.loads(content, **options)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
