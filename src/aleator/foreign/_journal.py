"""What a black box has found: in memory, and in a file for later processes."""

import hashlib
import json
from pathlib import Path
from typing import Any, final

import jax
import numpy as np

from aleator._core.arrays import Pytree
from aleator._core.border import one_of, refusal
from aleator._core.errors import ProblemError
from aleator._core.journalled import read_lines
from aleator.ensemble import Realisation

_HEADER = {"journal": "aleator.foreign", "version": 1}


@final
class Journal:
    """Outputs by a digest of the `box`, which is set before each use, and of all numbers of its model.

    A file has a header and then one line of JSON for each finished sample, written as soon as it is known. A line that
    cannot be read, such as the last one of a process that was killed, counts as not written: its sample runs again.
    Numbers are written with all their digits, so that outputs read back are the same to the last bit.

    Raises `ProblemError` if the file is no journal, or cannot be read or written.
    """

    def __init__(self, path: Any):
        self.box = ""
        self.path = None if path is None else Path(one_of("BlackBox: journal", path, (str, Path))).absolute()
        self._known: dict[tuple[str, str], Pytree] = {}
        if self.path is None:
            return
        try:
            content = read_lines(self.path)
        except OSError as error:
            raise ProblemError(f"BlackBox: the journal {self.path} cannot be read ({error.strerror}).") from error
        lines = [line.value for line in content.lines]
        if (lines or content.cut) and lines[:1] != [_HEADER]:
            raise refusal("BlackBox: journal", "the path of a journal, or of a file that does not exist yet", path)
        for line in lines[1:]:
            if isinstance(line, dict) and {"box", "key", "outputs"} <= set(line):
                self._known[line["box"], line["key"]] = _from_json(line["outputs"])

    def key(self, realisation: Realisation) -> str:
        """What identifies a sample: all numbers of its model, and whatever else the model holds, as text."""
        named = jax.tree_util.tree_leaves_with_path(realisation.model)
        leaves = [(jax.tree_util.keystr(path), _text(leaf)) for path, leaf in named]
        text = json.dumps([str(jax.tree.structure(realisation.model)), leaves])
        return hashlib.sha256(text.encode()).hexdigest()

    def find(self, key: str) -> Pytree | None:
        """The outputs of a finished sample; None if it is not known."""
        return self._known.get((self.box, key))

    def add(self, key: str, realisation: Realisation, outputs: Pytree) -> None:
        """Keep a finished sample, unless it is kept already."""
        if self.find(key) is not None:
            return
        self._known[self.box, key] = outputs
        if self.path is None:
            return
        line = {"box": self.box, "key": key, "inputs": realisation.inputs, "outputs": _as_json(outputs)}
        try:
            with self.path.open("a+b") as file:
                if file.seek(0, 2) == 0:
                    file.write(f"{json.dumps(_HEADER)}\n".encode())
                else:
                    file.seek(-1, 2)
                    # A line that a killed process left unfinished is ended, so that it spoils no other.
                    file.write(b"" if file.read(1) == b"\n" else b"\n")
                file.write(f"{json.dumps(line)}\n".encode())
        except OSError as error:
            raise ProblemError(f"BlackBox: the journal {self.path} cannot be written ({error.strerror}).") from error


def _text(leaf: Any) -> Any:
    """A leaf of a model as JSON, with all its digits."""
    if isinstance(leaf, np.ndarray | np.generic):
        return [str(leaf.dtype), list(leaf.shape), leaf.tolist() if leaf.dtype != object else repr(leaf)]
    return leaf if isinstance(leaf, bool | int | float | str) else repr(leaf)


def _as_json(outputs: Pytree) -> Any:
    if isinstance(outputs, dict) and all(isinstance(name, str) for name in outputs):
        return {name: _as_json(value) for name, value in outputs.items()}
    if isinstance(outputs, np.ndarray):
        return outputs.tolist()
    raise refusal("BlackBox: a journal keeps", "arrays, or dicts of arrays by their names", outputs)


def _from_json(outputs: Any) -> Pytree:
    if isinstance(outputs, dict):
        return {name: _from_json(value) for name, value in outputs.items()}
    return np.array(outputs, dtype=float)
