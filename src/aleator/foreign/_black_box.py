"""`BlackBox`: any function or command line as the model of an uncertainty analysis; its samples, and their journal."""

import json
import math
import uuid
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeAlias, final

import jax
import numpy as np
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.errors import AleatorError, ProblemError, SimulationError, SimulationWarning, warn_outside
from aleator._core.executors import check_executor, end_running
from aleator._core.identity import identity_of, joined
from aleator._core.journalled import read_lines
from aleator.ensemble import AbstractBox, Realisation, as_outputs, name_of, same_shapes
from aleator.foreign._command import Command, Isolated, arrays_of

# Runs that an executor is given at a time: enough for all its workers, and few to cancel.
_IN_FLIGHT = 256
# Inputs of the dropped samples are named where these lie within this part of the range of all samples.
_NARROW = 0.5
# As many inputs as a warning names, and as much of a reason as a message repeats.
_MOST_NAMED, _LONGEST = 3, 240
# The first line of a journal.
_HEADER = {"journal": "aleator.foreign", "version": 1}

_Key: TypeAlias = tuple[str, str]
"""Of a sample, by a digest of the box, and one of the model."""


@final
class BlackBox(AbstractBox):
    """A function that cannot be traced, for `al.expand`, `al.references.monte_carlo` and their like.

        box = al.foreign.BlackBox(simulate, executor=executor, retries=1, drop=0.05, journal="runs.jsonl")
        expanded = al.expand(box, {"mass": al.Normal(1.0, 0.1)}, al.Expansion(order=4))

    - `function`: takes the model with plain numbers in the place of its distributions and returns a number, an array,
      or a dict of these, always of the same shapes; or a `Command`. It must return the same for the same numbers;
    - `executor`: any executor of `concurrent.futures` runs samples in parallel; by default they run one by one. A
      command line needs threads only; processes must be spawned;
    - `retries`: how often a sample that fails runs again;
    - `drop`: the largest part of the samples that may be left out if they fail, below one half; by default none may.
      Least squares on a fixed index set and plain Monte Carlo can do without some, other methods need all;
    - `journal`: the path of a file that keeps finished samples, one line of JSON for each, for later calls and
      processes. Without one, the box itself remembers them. A sample is found there if all numbers of the model are the
      same and the box is: the function's code with the globals and closures that it names, or the command with the
      files that it names, and the `version`;
    - `version`: stands for all that the function computes: say another one where that changes. Needed where it reads a
      file, or holds what cannot be written out or changes with each call: without it, these are other boxes.

    Results are those of the function called directly, bit by bit. A sample fails if the function raises an exception,
    or returns anything but finite real numbers of the same shapes as before.

    Raises `SimulationError` for a sample that fails, naming its number and inputs, and for a broken executor; samples
    that finished are kept, so that a second call goes on. Warns with `SimulationWarning` if samples were dropped,
    because failures are seldom random. Raises `ProblemError` if no sample could succeed, such as for a command that
    does not exist.
    """

    def __init__(
        self,
        function: Callable[[Any], Pytree],
        *,
        executor: Executor | None = None,
        retries: int = 0,
        drop: float = 0.0,
        journal: str | Path | None = None,
        version: str | int = "",
    ):
        if not callable(function):
            raise border.refusal("BlackBox", "a function or a Command", function)
        check_executor("BlackBox", executor)
        self._function, self._executor = function, executor
        self._retries = border.whole("BlackBox: retries", retries, least=0)
        self._drop = drop_given("BlackBox: drop", drop)
        self._version = str(border.one_of("BlackBox: version", version, (str, int)))
        self._inner = function.function if isinstance(function, Isolated) else function
        self._unlike = self._version or uuid.uuid4().hex
        self._journal = _Journal(journal)
        self.__name__ = name_of(function).strip("'")

    @property
    @override
    def follows_from(self) -> Any:
        # A command may read what nobody sees, and what warns of dropped samples would be silent if it is recalled.
        return None if self._drop or isinstance(self._inner, Command) else (self._inner, self._version)

    @override
    def __call__(self, realised: Pytree) -> Pytree:
        return self._function(realised)

    def _identity(self) -> str:
        """A digest of a function's code or its version, or of a command with the contents of the files it names."""
        if isinstance(self._inner, Command):
            return self._inner.digest(self._version)
        name = getattr(self._inner, "__qualname__", type(self._inner).__qualname__)
        code = None if self._version else identity_of(self._inner)
        return code or joined([self._inner.__module__, name, self._unlike])

    @override
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        journal, box = self._journal, self._identity()
        keys = [(box, _digest(realisation.model)) for realisation in realisations]
        samples = Samples(name_of(self), realisations, self._drop, whole=whole)
        try:
            self._run(samples, keys)
        except AleatorError as error:
            kept = sum(journal.find(key) is not None for key in keys)
            # A journal that could not be written does not have them.
            in_file = journal.path is not None and isinstance(error, SimulationError)
            place = f"in {journal.path.name}" if journal.path and in_file else "by this box"
            goes_on = f" Finished samples are kept {place} ({kept}): a second call goes on." if kept else ""
            raise type(error)(f"{str(error).rstrip('.')}.{goes_on}") from error
        samples.warn_of_dropped()
        return [journal.find(key) for key in keys]

    def _run(self, samples: "Samples", keys: Sequence[_Key]) -> None:
        """Run the samples that have not finished, one of several equal ones, and keep each that does."""
        for realisation, key in zip(samples.realisations, keys, strict=True):
            if (outputs := self._journal.find(key)) is not None:
                samples.first = samples.first or (realisation, outputs)
        missing = {key: index for index, key in reversed([*enumerate(keys)]) if self._journal.find(key) is None}
        waiting, running, tries = deque(sorted(missing.values())), dict[Future[Any], int](), Counter[int]()
        width = 1 if self._executor is None else _IN_FLIGHT

        def keep(index: int, returned: Any) -> None:
            self._journal.add(keys[index], samples.realisations[index], samples.sound(index, returned))

        try:
            while waiting or running:
                while waiting and len(running) < width:
                    index = waiting.popleft()
                    running[self._submitted(samples.realisations[index].model)] = index
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    index = running.pop(future)
                    lost = CancelledError("it cancelled its work") if future.cancelled() else None
                    error = lost or future.exception()
                    reason = "" if error is None else _reason(error)
                    try:
                        if error is not None:
                            raise SimulationError(reason) from error
                        keep(index, future.result())
                    except SimulationError as failure:
                        tries[index] += 1
                        if tries[index] > self._retries:
                            samples.fail(index, failure)
                        else:
                            waiting.appendleft(index)
        except BaseException as error:
            # First, or a thread whose run is ended would begin the next one.
            for future in running:
                future.cancel()
            if not isinstance(error, Exception):
                end_running()
            for future, index in running.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    with suppress(AleatorError):
                        keep(index, future.result())
            raise

    def _submitted(self, model: Pytree) -> Future[Any]:
        """A run of the function, which may change containers and arrays of its model."""
        model = jax.tree.map(lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, model)
        if self._executor is not None:
            try:
                return self._executor.submit(self._function, model)
            except RuntimeError as error:  # a broken one, or one that takes no more work
                raise _broken(error) from error
        future = Future[Any]()
        try:
            future.set_result(self._function(model))
        except (Exception, SystemExit) as error:
            future.set_exception(error)
        return future


def _reason(error: BaseException) -> str:
    """Why a sample failed, in one line. Raises errors that have nothing to do with this sample."""
    if isinstance(error, BrokenExecutor | CancelledError):
        raise _broken(error) from error
    if isinstance(error, SystemExit):
        # A model that ends its own process has failed; it does not end this one.
        return f"it ended itself by sys.exit({'' if error.code is None else error.code!r})"
    if isinstance(error, ProblemError) or not isinstance(error, Exception):
        raise error
    words = next((line.strip() for line in str(error).splitlines() if line.strip()), "")[:_LONGEST].rstrip(".")
    return words if isinstance(error, SimulationError) else f"it raised {type(error).__name__}{words and ': '}{words}"


def _broken(error: BaseException) -> SimulationError:
    words = next(iter(str(error).splitlines()), "").rstrip(".")
    return SimulationError(
        f"BlackBox: its executor is broken ({words}). If a sample ends its process, let it run in one of its own by "
        'al.foreign.Isolated; a script that starts processes needs `if __name__ == "__main__":`'
    )


def drop_given(what: str, drop: Any) -> float:
    """The largest part of the samples that may be dropped, from 0 to less than one half."""
    expected = "a number from 0 to less than 0.5"
    part = border.real(what, drop, expected)
    if not 0 <= part < 0.5:
        raise border.refusal(what, expected, drop)
    return part


@final
class Samples:
    """The realisations of a model called `name`, of which a part `drop` may fail, but none if a method needs the
    `whole`; `first`: one that has finished.
    """

    def __init__(self, name: str, realisations: Sequence[Realisation], drop: float, *, whole: bool):
        self._name, self.realisations, self._drop, self._whole = name, realisations, drop, whole
        self.first: tuple[Realisation, Pytree] | None = None
        self._failures: dict[int, str] = {}

    def sound(self, index: int, returned: Any) -> Pytree:
        """What was returned for a sample, as finite arrays of the same shapes as those of the first one.

        Raises `SimulationError` if it is anything else, in words that go on after the name of the sample.
        """
        try:
            outputs = as_outputs(returned, self._name, np)
        except ProblemError as error:
            raise SimulationError(str(error).rstrip(".")) from error
        for path, leaf in jax.tree_util.tree_leaves_with_path(outputs):
            if not np.isfinite(leaf).all():
                place = jax.tree_util.keystr(path, simple=True, separator=".")
                what = f"output {place!r}" if place else "its output"
                raise SimulationError(f"{what} is {leaf[~np.isfinite(leaf)][0]}")
        first, expected = self.first or (self.realisations[index], outputs)
        if not same_shapes(outputs, expected):
            now, before = (jax.tree.map(np.shape, tree) for tree in (outputs, expected))
            raise SimulationError(f"it returned arrays of shapes {now}, where sample {first.number} had {before}")
        self.first = first, expected
        return outputs

    def fail(self, index: int, failure: SimulationError) -> None:
        """Note a failure. Raises `SimulationError` if these are more than may be dropped."""
        self._failures[index] = str(failure)
        count = len(self.realisations)
        # Products such as 0.29 * 100 are not rounded down.
        most = 0 if self._whole else math.floor(self._drop * count * (1 + 1e-12))
        if len(self._failures) > most:
            failed = f"{len(self._failures)} of {count} samples failed, and drop={self._drop:g} allows {most}: "
            which = f"{self._name} failed at {self.realisations[index]}: {failure}"
            needed = ". This method needs every sample, so that none is dropped" * (self._whole and self._drop > 0)
            raise SimulationError(failed * bool(most) + which + needed) from failure

    def warn_of_dropped(self) -> None:
        """Warn if samples were dropped: how many, why the first one, and where they lie among all."""
        if self._failures:
            first = min(self._failures)
            warn_outside(
                f"{len(self._failures)} of {len(self.realisations)} samples of {self._name} failed and were dropped, "
                f"first {self.realisations[first]}: {self._failures[first]}. {self._whereabouts()} Statistics may be "
                "biased: they describe the inputs at which it works, and an expansion extrapolates to the others.",
                SimulationWarning,
            )

    def _whereabouts(self) -> str:
        """In words: whether the dropped samples lie together, and how many others lie among them."""
        dropped = list(self._failures)
        names = list(self.realisations[0].inputs)
        values = np.array([list(realisation.inputs.values()) for realisation in self.realisations])
        low, high = values[dropped].min(axis=0), values[dropped].max(axis=0)
        width = (high - low) / np.maximum(np.ptp(values, axis=0), np.finfo(float).tiny)
        narrow = [i for i in np.argsort(width, kind="stable")[:_MOST_NAMED].tolist() if width[i] <= _NARROW]
        if not narrow or len(dropped) < 2:
            return "They do not lie together." if len(dropped) > 1 else "It may be one of many that would fail nearby."
        among = np.all((values >= low) & (values <= high), axis=1)
        ranges = ", ".join(f"{names[i]} from {low[i]:.4g} to {high[i]:.4g}" for i in sorted(narrow))
        return f"They lie within {ranges}, where {len(dropped)} of {np.count_nonzero(among)} samples failed."


@final
class _Journal:
    """Outputs by a digest of the box, and one of all numbers of its model.

    A file has a header and then one line of JSON for each finished sample, written as soon as it is known. A line that
    cannot be read, such as the last one of a process that was killed, counts as not written: its sample runs again.
    Numbers are written with all their digits, so that outputs read back are the same to the last bit.

    Raises `ProblemError` if the file is no journal, or cannot be read or written.
    """

    def __init__(self, path: Any):
        self.path = None if path is None else Path(border.one_of("BlackBox: journal", path, (str, Path))).absolute()
        self._known: dict[_Key, Pytree] = {}
        if self.path is None:
            return
        try:
            content = read_lines(self.path)
        except OSError as error:
            raise ProblemError(f"BlackBox: the journal {self.path} cannot be read ({error.strerror}).") from error
        lines = [line.value for line in content.lines]
        if (lines or content.cut) and lines[:1] != [_HEADER]:
            raise border.refusal(
                "BlackBox: journal", "the path of a journal, or of a file that does not exist yet", path
            )
        for line in lines[1:]:
            with suppress(TypeError, KeyError, SimulationError):
                self._known[line["box"], line["key"]] = arrays_of(line["outputs"])

    def find(self, key: _Key) -> Pytree | None:
        """The outputs of a finished sample; None if it is not known."""
        return self._known.get(key)

    def add(self, key: _Key, realisation: Realisation, outputs: Pytree) -> None:
        """Keep a finished sample, unless it is kept already."""
        if self.find(key) is not None:
            return
        self._known[key] = outputs
        if self.path is None:
            return
        if not _is_named(outputs):
            raise border.refusal("BlackBox: a journal keeps", "arrays, or dicts of arrays by their names", outputs)
        line = {"box": key[0], "key": key[1], "inputs": realisation.inputs, "outputs": outputs}
        with border.writing("BlackBox: the journal", self.path) as path, path.open("a+b") as file:
            if file.seek(0, 2) == 0:
                file.write(f"{json.dumps(_HEADER)}\n".encode())
            else:
                file.seek(-1, 2)
                # A line that a killed process left unfinished is ended, so that it spoils no other.
                file.write(b"" if file.read(1) == b"\n" else b"\n")
            file.write(f"{json.dumps(line, default=np.ndarray.tolist)}\n".encode())


def _is_named(outputs: Pytree) -> bool:
    """Whether JSON has the same containers: dicts by names, and nothing else."""
    if isinstance(outputs, dict):
        return all(isinstance(name, str) and _is_named(value) for name, value in outputs.items())
    return isinstance(outputs, np.ndarray)


def _digest(model: Pytree) -> str:
    """What identifies a sample: all numbers of its model, and whatever else the model holds."""
    leaves = [(jax.tree_util.keystr(path), leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(model)]
    return joined([json.dumps([str(jax.tree.structure(model)), leaves], default=_text)])


def _text(leaf: Any) -> Any:
    """A leaf that JSON does not have, with all its digits if it has numbers."""
    is_array = isinstance(leaf, np.ndarray | np.generic) and leaf.dtype != object
    return [str(leaf.dtype), leaf.shape, leaf.tolist()] if is_array else repr(leaf)
