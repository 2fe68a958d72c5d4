"""The samples of one call of a black box: those that finished, in a journal, and those that failed."""

import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, final

import jax
import numpy as np

from aleator._core.arrays import Pytree
from aleator._core.border import real, refusal
from aleator._core.errors import ProblemError, SimulationError, SimulationWarning, warn_outside
from aleator._core.journalled import read_lines
from aleator.ensemble import Realisation, absent, as_outputs, same_shapes
from aleator.foreign._runs import Ended, Runs

# Inputs of the dropped samples are named where these lie within this part of the range of all samples.
_NARROW = 0.5

# As many inputs as a warning names.
_MOST_NAMED = 3
_HEADER = {"journal": "aleator.foreign", "version": 1}
# As much of a reason as a message repeats.
_LONGEST = 240


def drop_given(what: str, drop: Any) -> float:
    """The largest part of the samples that may be dropped, from 0 to less than one half."""
    part = real(what, drop, "a number from 0 to less than 0.5")
    if not 0 <= part < 0.5:
        raise refusal(what, "a number from 0 to less than 0.5", drop)
    return part


def most_of(drop: float, count: int) -> int:
    """How many of `count` samples may be dropped; products such as 0.29 * 100 are not rounded down."""
    return math.floor(drop * count * (1 + 1e-12))


def sound(given: Any, name: str, first: tuple[Realisation, Pytree] | None) -> Pytree:
    """What a box called `name` returned, as finite arrays of the same shapes as those of a `first` sample.

    Raises `SimulationError` if it is anything else, in words that go on after the name of the sample.
    """
    try:
        outputs = as_outputs(given, name, np)
    except ProblemError as error:
        raise SimulationError(str(error).rstrip(".")) from error
    if not jax.tree.leaves(outputs):
        raise SimulationError("it returned no outputs")
    for path, leaf in jax.tree_util.tree_leaves_with_path(outputs):
        if not np.isfinite(leaf).all():
            output = jax.tree_util.keystr(path, simple=True, separator=".")
            bad = leaf[~np.isfinite(leaf)].flat[0]
            raise SimulationError(f"{f'output {output!r}' if output else 'its output'} is {bad}")
    if first is not None and not same_shapes(outputs, first[1]):
        before, now = (_shapes(found) for found in (first[1], outputs))
        raise SimulationError(f"it returned {now}, where sample {first[0].number} had {before}")
    return outputs


def _shapes(outputs: Pytree) -> str:
    """The outputs and their shapes, for messages."""
    named = jax.tree_util.tree_leaves_with_path(outputs)
    texts = [(jax.tree_util.keystr(path, simple=True, separator="."), leaf.shape) for path, leaf in named]
    return ", ".join(f"{name!r} of shape {shape}" if name else f"an array of shape {shape}" for name, shape in texts)


def warn_of_dropped(name: str, realisations: Sequence[Realisation], failures: Mapping[int, str]) -> None:
    """Warn that samples were dropped: how many, why the first one, and where they lie among all.

    `failures`: the reasons, by index into the realisations.
    """
    first = min(failures)
    warn_outside(
        f"{len(failures)} of {len(realisations)} samples of {name} failed and were dropped, first {realisations[first]}"
        f": {failures[first]}. {_whereabouts(realisations, list(failures))} Statistics may be biased: they describe "
        "the inputs at which it works, and an expansion extrapolates to the others.",
        SimulationWarning,
    )


def _whereabouts(realisations: Sequence[Realisation], dropped: Sequence[int]) -> str:
    """In words: whether the dropped samples lie together, and how many others lie among them."""
    names = list(realisations[0].inputs)
    values = np.array([list(realisation.inputs.values()) for realisation in realisations])
    low, high = values[dropped].min(axis=0), values[dropped].max(axis=0)
    width = (high - low) / np.maximum(np.ptp(values, axis=0), np.finfo(float).tiny)
    narrow = [i for i in np.argsort(width, kind="stable")[:_MOST_NAMED].tolist() if width[i] <= _NARROW]
    if not narrow or len(dropped) < 2:
        return "They do not lie together." if len(dropped) > 1 else "It may be one of many that would fail nearby."
    among = np.all((values >= low) & (values <= high), axis=1)
    ranges = ", ".join(f"{names[i]} from {low[i]:.4g} to {high[i]:.4g}" for i in sorted(narrow))
    return f"They lie within {ranges}, where {len(dropped)} of {np.count_nonzero(among)} samples failed."


@final
class Journal:
    """Outputs by a digest of the `box`, which may become another, and of all numbers of its model.

    A file has a header and then one line of JSON for each finished sample, written as soon as it is known. A line that
    cannot be read, such as the last one of a process that was killed, counts as not written: its sample runs again.
    Numbers are written with all their digits, so that outputs read back are the same to the last bit.

    Raises `ProblemError` if the file is no journal, or cannot be read or written.
    """

    def __init__(self, path: Any, box: str):
        self.box = box
        self.path = None if path is None else _path_given(path)
        self._known: dict[tuple[str, str], Pytree] = {}
        self._keys: set[str] = set()
        if self.path is not None:
            self._read(self.path)

    def key(self, realisation: Realisation) -> str:
        """What identifies a sample: all numbers of its model, and whatever else the model holds, as text."""
        named = jax.tree_util.tree_leaves_with_path(realisation.model)
        leaves = [(jax.tree_util.keystr(path), _text(leaf)) for path, leaf in named]
        return _digest([str(jax.tree.structure(realisation.model)), leaves])

    def find(self, key: str) -> Pytree | None:
        """The outputs of a finished sample; None if it is not known."""
        return self._known.get((self.box, key))

    def is_of_others(self, key: str) -> bool:
        """Whether the file has this sample by another box only, or by this one as it was before a change."""
        return self.path is not None and key in self._keys and (self.box, key) not in self._known

    def add(self, key: str, realisation: Realisation, outputs: Pytree) -> None:
        """Keep a finished sample."""
        self._keep(self.box, key, outputs)
        if self.path is not None:
            line = {"box": self.box, "key": key, "inputs": realisation.inputs, "outputs": _as_json(outputs)}
            self._write(self.path, json.dumps(line))

    def _keep(self, box: str, key: str, outputs: Pytree) -> None:
        self._known[box, key] = outputs
        self._keys.add(key)

    def _read(self, path: Path) -> None:
        try:
            found = read_lines(path)
        except OSError as error:
            raise ProblemError(f"BlackBox: the journal {path} cannot be read ({error.strerror}).") from error
        lines = [line.value for line in found.lines]
        if (lines or found.cut) and lines[:1] != [_HEADER]:
            raise ProblemError(
                f"BlackBox: expected the path of a journal, or of a file that does not exist yet; {path} is another "
                "file, whose first line is not a journal's."
            )
        for line in lines[1:]:
            if not isinstance(line, dict) or not {"box", "key", "outputs"} <= set(line):
                continue
            self._keep(line["box"], line["key"], _from_json(line["outputs"]))

    def _write(self, path: Path, line: str) -> None:
        try:
            with path.open("a+b") as file:
                length = file.seek(0, 2)
                if length == 0:
                    file.write(f"{json.dumps(_HEADER)}\n".encode())
                else:
                    file.seek(-1, 2)
                    # A line that a killed process left unfinished is ended, so that it spoils no other.
                    file.write(b"" if file.read(1) == b"\n" else b"\n")
                file.write(f"{line}\n".encode())
        except OSError as error:
            raise ProblemError(f"BlackBox: the journal {path} cannot be written ({error.strerror}).") from error


def _path_given(path: Any) -> Path:
    if not isinstance(path, str | Path) or not str(path):
        raise refusal("BlackBox: journal", "the path of a file", path)
    if Path(path).is_dir():
        raise refusal("BlackBox: journal", "the path of a file, not of a folder", str(path))
    return Path(path).absolute()


def _digest(it: Any) -> str:
    return hashlib.sha256(json.dumps(it).encode()).hexdigest()


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


@final
class Campaign:
    """The samples of one call: which have finished, in the journal too, and which have failed.

    `name`: of the box in messages; `retries`: how often a sample that fails runs again.
    """

    def __init__(self, name: str, realisations: Sequence[Realisation], journal: Journal, retries: int):
        self.name, self.realisations, self._journal, self._retries = name, realisations, journal, retries
        self.keys = [journal.key(realisation) for realisation in realisations]
        self.failures: dict[int, str] = {}
        self._failed: Counter[int] = Counter()
        self._first: tuple[Realisation, Pytree] | None = None
        for index, outputs in enumerate(self.outputs):
            if outputs is not None and not self._is_sound(index, outputs):
                raise ProblemError(
                    f"{name}: the journal has outputs of different shapes: {self.failures[index]}. Its box has changed "
                    "unnoticed: take another file."
                )

    @property
    def outputs(self) -> list[Pytree | None]:
        """The outputs of each sample; None if it has not finished."""
        return [self._journal.find(key) for key in self.keys]

    @property
    def missing(self) -> dict[int, Pytree]:
        """The models of the samples that have not finished, by index; one of several equal ones."""
        first = {key: i for i, key in reversed(list(enumerate(self.keys))) if self._journal.find(key) is None}
        return {i: self.realisations[i].model for i in sorted(first.values())}

    def take(self, ended: Iterable[Ended], runs: Runs | None = None) -> None:
        """Keep what runs returned, and let those that failed run again as often as that is allowed.

        Raises `ProblemError` if a run raised one, or asked for an input that there is not: no sample could succeed.
        """
        fatal: BaseException | None = None
        for index, returned, error in ended:
            fatal = self._fatal(index, error) or fatal
            if fatal is not None and error is not None:
                continue
            if error is not None:
                self.failures[index] = _reason(error)
            elif self._is_sound(index, returned):
                self.failures.pop(index, None)
                continue
            self._failed[index] += 1
            if runs is not None and self._failed[index] <= self._retries:
                del self.failures[index]
                runs.again(index)
        if fatal is not None:
            raise fatal

    def _is_sound(self, index: int, returned: Pytree) -> bool:
        realisation = self.realisations[index]
        try:
            outputs = sound(returned, self.name, self._first)
        except SimulationError as error:
            self.failures[index] = _reason(error)
            return False
        self._first = self._first or (realisation, outputs)
        if self._journal.find(self.keys[index]) is None:
            self._journal.add(self.keys[index], realisation, outputs)
        return True

    def _fatal(self, index: int, error: BaseException | None) -> BaseException | None:
        """The error that ends all runs if a run raised `error`."""
        if error is None:
            return None
        # Once samples have finished, a key that is missing is one of the function's own.
        if self._first is None and isinstance(error, Exception):
            missing = absent(error, self.realisations[index].model)
            if missing:
                return ProblemError(f"{self.name} asks for {missing}.")
        return error if isinstance(error, ProblemError) or not isinstance(error, Exception) else None


def _reason(error: BaseException) -> str:
    """Why a run failed, in one line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    said = (lines[0] if lines else "")[:_LONGEST].rstrip(".")
    return said if isinstance(error, SimulationError) else f"it raised {type(error).__name__}{said and ': '}{said}"
