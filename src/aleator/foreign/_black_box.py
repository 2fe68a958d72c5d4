"""`BlackBox`: any function or command line as the model of an uncertainty analysis, and how its samples run."""

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from contextlib import suppress
from pathlib import Path
from typing import Any, final

import jax
import numpy as np
from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.errors import AleatorError, ProblemError, SimulationError, SimulationWarning, warn_outside
from aleator._core.executors import check_executor, end_running
from aleator._core.identity import code_digest, own_code
from aleator.ensemble import AbstractBox, Realisation, as_outputs, name_of, same_shapes
from aleator.foreign._command import Command, Isolated, refuse_unsendable
from aleator.foreign._journal import Journal

# Runs that an executor is given at a time: enough for all its workers, and few to cancel.
_IN_FLIGHT = 256
# Inputs of the dropped samples are named where these lie within this part of the range of all samples.
_NARROW = 0.5
# As many inputs as a warning names, and as much of a reason as a message repeats.
_MOST_NAMED, _LONGEST = 3, 240


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

    A sample fails if the function raises an exception, or if it returns anything but finite real numbers of the same
    shapes as before. Results are those of the function called directly, bit by bit.

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
        self.retries = border.whole("BlackBox: retries", retries, least=0)
        self.drop = drop_given("BlackBox: drop", drop)
        self._version = str(border.one_of("BlackBox: version", version, (str, int)))
        self._inner = function.function if isinstance(function, Isolated) else function
        self._code = own_code(self._inner)
        self.journal = Journal(journal, self._identity())
        self.__name__ = name_of(function).strip("'")

    @property
    @override
    def follows_from(self) -> Any:
        # A command may read what nobody sees, and what warns of dropped samples would be silent if it is recalled.
        return None if self.drop or isinstance(self._inner, Command) else (self._inner, self._version)

    @override
    def __call__(self, realised: Pytree) -> Pytree:
        return self._function(realised)

    @override
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        code = own_code(self._inner)
        if isinstance(self._inner, Command) or (code != self._code and not self._version):
            self._code, self.journal.box = code, self._identity()
        campaign = _Campaign(self, realisations, whole=whole)
        campaign.run(self._function, self._executor)
        return campaign.outputs

    def _identity(self) -> str:
        """A digest of a function's code or its version, or of a command with the contents of the files it names."""
        if isinstance(self._inner, Command):
            return self._inner.digest(self._version)
        return code_digest(self._inner, self._version)


@final
class _Campaign:
    """The samples of one call of a box, of which those in the journal have finished; `whole`: none may fail."""

    def __init__(self, box: BlackBox, realisations: Sequence[Realisation], *, whole: bool):
        self._box, self._realisations, self._name = box, realisations, name_of(box)
        self._most, self._whole = 0 if whole else most_of(box.drop, len(realisations)), whole
        self._keys = [box.journal.key(realisation) for realisation in realisations]
        self._failures: dict[int, str] = {}
        finished = zip(realisations, self.outputs, strict=True)
        self._first = next(((one, outputs) for one, outputs in finished if outputs is not None), None)

    @property
    def outputs(self) -> list[Pytree | None]:
        """The outputs of each sample; None if it has not finished."""
        return [self._box.journal.find(key) for key in self._keys]

    def run(self, function: Callable[[Pytree], Pytree], executor: Executor | None) -> None:
        """Run what has not finished, one of several equal samples.

        Raises `SimulationError` for more failures than may be dropped and for a broken executor, and `ProblemError` if
        no sample could succeed, after what had finished was kept. Warns of those dropped.
        """
        self._warn_of_others()
        first = {key: i for i, key in reversed([*enumerate(self._keys)]) if self._box.journal.find(key) is None}
        waiting, running, tries = deque(sorted(first.values())), dict[Future[Any], int](), Counter[int]()
        executor, width = (_InTurn(), 1) if executor is None else (executor, _IN_FLIGHT)
        try:
            while waiting or running:
                while waiting and len(running) < width:
                    index = waiting.popleft()
                    running[_submitted(executor, function, self._realisations[index].model)] = index
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    error, index = _error_of(future), running.pop(future)
                    try:
                        if error is not None:
                            raise self._failure(error) from error
                        self._keep(index, future.result())
                    except SimulationError as failure:
                        tries[index] += 1
                        if tries[index] <= self._box.retries:
                            waiting.appendleft(index)
                        else:
                            self._failures[index] = f"{failure}"
                            self._refuse_failures()
        except BaseException as error:
            # First, or a thread whose run is ended would begin the next one.
            for future in running:
                future.cancel()
            if not isinstance(error, Exception):
                end_running()
            for future, index in running.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    with suppress(AleatorError):
                        self._keep(index, future.result())
            if not isinstance(error, AleatorError):
                raise
            raise type(error)(f"{str(error).rstrip('.')}.{self._kept(error)}") from error.__cause__
        if self._failures:
            warn_of_dropped(self._name, self._realisations, self._failures)

    def _warn_of_others(self) -> None:
        if count := sum(map(self._box.journal.is_of_others, self._keys)):
            warn_outside(
                f"The journal {self._box.journal.path} has {count} of these samples by another box, or by this one "
                "before its code, command or version changed: they are not used, and run again.",
                SimulationWarning,
            )

    def _keep(self, index: int, returned: Pytree) -> None:
        """Keep what a run returned. Raises `SimulationError` if that is no output."""
        realisation = self._realisations[index]
        outputs = sound(returned, self._name, self._first)
        self._first = self._first or (realisation, outputs)
        if self._box.journal.find(self._keys[index]) is None:
            self._box.journal.add(self._keys[index], realisation, outputs)

    def _failure(self, error: BaseException) -> SimulationError:
        """Why a run failed, in one line. Raises what is wrong with all of them: no sample could succeed."""
        if isinstance(error, SystemExit):
            # A model that ends its own process has failed; it does not end this one.
            return SimulationError(f"it ended itself by sys.exit({'' if error.code is None else error.code!r})")
        if isinstance(error, ProblemError) or not isinstance(error, Exception):
            raise error
        words = next((line.strip() for line in str(error).splitlines() if line.strip()), "")[:_LONGEST].rstrip(".")
        raised = "" if isinstance(error, SimulationError) else f"it raised {type(error).__name__}{words and ': '}"
        return SimulationError(raised + words)

    def _refuse_failures(self) -> None:
        """Refuse more failures than may be dropped, naming the last one."""
        if len(self._failures) <= self._most:
            return
        count, (index, reason) = len(self._realisations), next(reversed(self._failures.items()))
        message = f"{self._name} failed at {self._realisations[index]}: {reason}"
        if self._most:
            failed = f"{len(self._failures)} of {count} samples failed"
            message = f"{failed}, and drop={self._box.drop:g} allows {self._most}: {message}"
        elif self._whole and self._box.drop:
            message += ". This method needs every sample, so that none is dropped"
        raise SimulationError(message)

    def _kept(self, error: AleatorError) -> str:
        """What has been kept, as a sentence."""
        count, path = sum(outputs is not None for outputs in self.outputs), self._box.journal.path
        # A journal that could not be written does not have them.
        place = "by this box" if path is None or not isinstance(error, SimulationError) else f"in {path.name}"
        return f" Finished samples are kept {place} ({count}): a second call goes on." if count else ""


@final
class _InTurn(Executor):
    """Runs everything at once, in the calling thread."""

    @override
    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = Future[Any]()
        try:
            future.set_result(fn(*args, **kwargs))
        except (Exception, SystemExit) as error:
            future.set_exception(error)
        return future


def _submitted(executor: Executor, function: Callable[[Pytree], Pytree], model: Pytree) -> Future[Any]:
    """A run of a function, which may change containers and arrays of its model."""
    model = jax.tree.map(lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, model)
    try:
        return executor.submit(function, model)
    except RuntimeError as error:  # a broken one, or one that takes no more work
        raise _broken(error) from error


def _error_of(future: Future[Any]) -> BaseException | None:
    """What a run raised. Raises `SimulationError` if the executor is broken."""
    error = BrokenExecutor("it cancelled its work") if future.cancelled() else future.exception()
    if isinstance(error, BrokenExecutor):
        raise _broken(error) from error
    refuse_unsendable("BlackBox", error)
    return error


def _broken(error: BaseException) -> SimulationError:
    words = next(iter(str(error).splitlines()), "").rstrip(".")
    return SimulationError(
        f"BlackBox: its executor is broken ({words}). If a sample ends its process, let it run in one of its own by "
        'al.foreign.Isolated; a script that starts processes needs `if __name__ == "__main__":`'
    )


def drop_given(what: str, drop: Any) -> float:
    """The largest part of the samples that may be dropped, from 0 to less than one half."""
    part = border.real(what, drop, "a number from 0 to less than 0.5")
    if not 0 <= part < 0.5:
        raise border.refusal(what, "a number from 0 to less than 0.5", drop)
    return part


def most_of(drop: float, count: int) -> int:
    """How many of `count` samples may be dropped; products such as 0.29 * 100 are not rounded down."""
    return math.floor(drop * count * (1 + 1e-12))


def sound(returned: Any, name: str, first: tuple[Realisation, Pytree] | None = None) -> Pytree:
    """What a box called `name` returned, as finite arrays of the same shapes as those of a `first` sample.

    Raises `SimulationError` if it is anything else, in words that go on after the name of the sample.
    """
    try:
        outputs = as_outputs(returned, name, np)
    except ProblemError as error:
        raise SimulationError(str(error).rstrip(".")) from error
    if not jax.tree.leaves(outputs):
        raise SimulationError("it returned no outputs")
    for output, leaf in _by_name(outputs):
        if not np.isfinite(leaf).all():
            raise SimulationError(
                f"{f'output {output!r}' if output else 'its output'} is {leaf[~np.isfinite(leaf)][0]}"
            )
    if first is not None and not same_shapes(outputs, first[1]):
        now, before = (
            ", ".join(
                f"{f'{output!r}' if output else 'an array'} of shape {leaf.shape}" for output, leaf in _by_name(of)
            )
            for of in (outputs, first[1])
        )
        raise SimulationError(f"it returned {now}, where sample {first[0].number} had {before}")
    return outputs


def _by_name(outputs: Pytree) -> list[tuple[str, np.ndarray]]:
    named = jax.tree_util.tree_leaves_with_path(outputs)
    return [(jax.tree_util.keystr(path, simple=True, separator="."), leaf) for path, leaf in named]


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
