"""Parts of a result that takes long, kept until the whole result is."""

import hashlib
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.journalled import AbstractParts
from aleator._core.programs import is_private
from aleator.reporting import write_whole

_DIGEST = hashlib.sha256().digest_size
_OTHERS = 0o022  # may write


@final
class Parts(AbstractParts):
    """One file a part, beside the results: a digest of its place and content, and Python's pickle.

    Files that others could have written are not read.

    - `key`: that of the result; `warn`: is told why a part could not be kept;
    - `recalls`: whether parts of an earlier run are taken.
    """

    def __init__(self, folder: Path, key: str, warn: Callable[[str], None], *, recalls: bool = True):
        self._folder, self._key, self._warn, self._recalls = folder, key, warn, recalls

    @override
    def recall(self, number: int) -> Any:
        if not self._recalls:
            return None
        try:
            with self._place(number).open("rb") as file:
                private, data = is_private(os.fstat(file.fileno())), file.read()
        except OSError:
            return None
        digest, content = data[:_DIGEST], data[_DIGEST:]
        # What others could have written, or a crash has cut off, is computed again.
        if not private or self._digest(number, content) != digest:
            return None
        return pickle.loads(content)

    @override
    def keep(self, number: int, part: Any) -> None:
        content = pickle.dumps(part)
        data = self._digest(number, content) + content
        try:
            path = write_whole(self._place(number), lambda file: file.write_bytes(data))
            path.chmod(path.stat().st_mode & ~_OTHERS)
        except (ProblemError, OSError) as error:
            self._warn(f"a part of a result is not kept: {error}")

    def drop(self) -> None:
        """Delete all parts: the whole result is kept."""
        for path in self._folder.glob(f"{self._key}-*.part"):
            path.unlink(missing_ok=True)

    def _digest(self, number: int, content: bytes) -> bytes:
        """Of the result and the number too: elsewhere, a part would be another one."""
        return hashlib.sha256(f"{self._key} {number}\0".encode() + content).digest()

    def _place(self, number: int) -> Path:
        return self._folder / f"{self._key}-{number}.part"
