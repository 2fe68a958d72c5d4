"""Parts of a result that takes long, kept until the whole result is."""

import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator._core.journalled import AbstractParts
from aleator.journalling._results import read_private, write_private

_DIGEST = hashlib.sha256().digest_size


@final
class Parts(AbstractParts):
    """One file a part, beside the results: a digest of its place and content, and Python's pickle.

    - `key`: that of the result; `warn`: is told why a part could not be kept;
    - `recalls`: whether parts of an earlier run are taken.
    """

    def __init__(self, folder: Path, key: str, warn: Callable[[str], None], *, recalls: bool = True):
        self._folder, self._key, self._warn, self._recalls = folder, key, warn, recalls

    @override
    def recall(self, number: int) -> Any:
        try:
            data = read_private(self._place(number)) if self._recalls else b""
        except ProblemError:  # it is missing, or others could have written it
            return None
        digest, content = data[:_DIGEST], data[_DIGEST:]
        # What a crash has cut off is computed again.
        return pickle.loads(content) if digest == self._digest(number, content) else None

    @override
    def keep(self, number: int, part: Any) -> None:
        content = pickle.dumps(part)
        try:
            write_private(self._place(number), self._digest(number, content) + content)
        except (ProblemError, OSError) as error:
            self._warn(f"a part of a result is not kept: {error}")

    def drop(self) -> None:
        """Delete all parts: the whole result is kept."""
        for path in self._folder.glob(f"{self._key}-*.part"):
            path.unlink(missing_ok=True)

    def _digest(self, number: int, content: bytes) -> bytes:
        """Of the result and the number too: a part in another place is another one."""
        return hashlib.sha256(f"{self._key} {number}\0".encode() + content).digest()

    def _place(self, number: int) -> Path:
        return self._folder / f"{self._key}-{number}.part"
