"""`BlackBox`: any function or command line as the model of an uncertainty analysis."""

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.errors import AleatorError, SimulationError, SimulationWarning, warn_outside
from aleator._core.executors import check_executor, end_running
from aleator._core.identity import code_digest, own_code
from aleator.ensemble import AbstractBox, Realisation, name_of
from aleator.foreign._campaign import Campaign, Journal, drop_given, most_of, warn_of_dropped
from aleator.foreign._command import Command
from aleator.foreign._runs import Isolated, Runs


def identity(function: Callable[..., Any], version: str) -> str:
    """A digest of a function's code or its version, or of a command with the contents of the files that it names."""
    if isinstance(function, Isolated):
        return identity(function.function, version)
    if not isinstance(function, Command):
        return code_digest(function, version)
    paths = [Path(argument) for argument in function.arguments]
    files = [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()]
    described = [list(function.arguments), function.input_file, function.output_file, files, version]
    return hashlib.sha256(repr(described).encode()).hexdigest()


def followed(function: Callable[..., Any]) -> Any:
    """What the outputs follow from, for the journal of a run: a function, told by its code; None for a command.

    A command may read what nobody sees.
    """
    if isinstance(function, Isolated):
        return followed(function.function)
    return None if isinstance(function, Command) else function


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
        self._retries = border.whole("BlackBox: retries", retries, least=0)
        self._drop = drop_given("BlackBox: drop", drop)
        self._version = str(border.one_of("BlackBox: version", version, (str, int)))
        self._code = own_code(function)
        self._journal = Journal(journal, identity(function, self._version))
        self.__name__ = name_of(function).strip("'")

    @property
    @override
    def follows_from(self) -> Any:
        # What warns of dropped samples would be silent where a result is recalled.
        followed_from = None if self._drop else followed(self._function)
        return followed_from and (followed_from, self._version)

    @override
    def __call__(self, realised: Pytree) -> Pytree:
        return self._function(realised)

    @override
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        code = own_code(self._function)
        if isinstance(self._function, Command) or (code != self._code and not self._version):
            self._code, self._journal.box = code, identity(self._function, self._version)
        campaign = Campaign(name_of(self), realisations, self._journal, self._retries)
        self._warn_of_others(campaign)
        self._run(campaign, whole=whole)
        if campaign.failures:
            warn_of_dropped(name_of(self), realisations, campaign.failures)
        return campaign.outputs

    def _run(self, campaign: Campaign, *, whole: bool) -> None:
        """Run what has not finished yet."""
        runs = Runs(self._function, campaign.missing, self._executor)
        try:
            for ended in runs:
                campaign.take(ended, runs)
                self._refuse_failures(campaign, whole=whole)
        except BaseException as error:
            # First, or a thread whose run is ended would begin the next one.
            runs.cancel()
            if not isinstance(error, Exception):
                end_running()
            campaign.take(run for run in runs.close() if run.error is None)
            if not isinstance(error, AleatorError):
                raise
            raise type(error)(f"{str(error).rstrip('.')}.{self._kept(campaign, error)}") from error.__cause__

    def _refuse_failures(self, campaign: Campaign, *, whole: bool) -> None:
        """Refuse more failures than may be dropped, naming the last one."""
        failures, count = campaign.failures, len(campaign.realisations)
        most = 0 if whole else most_of(self._drop, count)
        if len(failures) <= most:
            return
        index = next(reversed(failures))
        said = f"{name_of(self)} failed at {campaign.realisations[index]}: {failures[index]}"
        if most:
            said = f"{len(failures)} of {count} samples failed, and drop={self._drop:g} allows {most}: {said}"
        elif whole and self._drop:
            said += ". This method needs every sample, so that none is dropped"
        raise SimulationError(said)

    def _kept(self, campaign: Campaign, error: AleatorError) -> str:
        """What has been kept, as a sentence."""
        count = sum(outputs is not None for outputs in campaign.outputs)
        path = self._journal.path
        # A journal that could not be written does not have them.
        place = "by this box" if path is None or not isinstance(error, SimulationError) else f"in {path.name}"
        return f" Finished samples are kept {place} ({count}): a second call goes on." if count else ""

    def _warn_of_others(self, campaign: Campaign) -> None:
        count = sum(map(self._journal.is_of_others, campaign.keys))
        if count:
            warn_outside(
                f"The journal {self._journal.path} has {count} of these samples by another box, or by this one before "
                "its code, command or version changed: they are not used, and run again.",
                SimulationWarning,
            )
