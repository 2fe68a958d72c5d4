"""`BlackBox`: any function or command line as the model of an uncertainty analysis."""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, final

from typing_extensions import override

from aleator._core import border
from aleator._core.arrays import Pytree
from aleator._core.executors import check_executor
from aleator._core.identity import code_digest, own_code
from aleator.ensemble import AbstractBox, Realisation, name_of
from aleator.foreign._campaign import Campaign, drop_given
from aleator.foreign._command import Command
from aleator.foreign._isolated import Isolated
from aleator.foreign._journal import Journal


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
        self._told_by = function.function if isinstance(function, Isolated) else function
        self._code = own_code(self._told_by)
        self._journal = Journal(journal, self._identity())
        self.__name__ = name_of(function).strip("'")

    @property
    @override
    def follows_from(self) -> Any:
        # A command may read what nobody sees, and what warns of dropped samples would be silent if it is recalled.
        return None if self._drop or isinstance(self._told_by, Command) else (self._told_by, self._version)

    @override
    def __call__(self, realised: Pytree) -> Pytree:
        return self._function(realised)

    @override
    def at_all(self, realisations: Sequence[Realisation], *, whole: bool) -> list[Pytree | None]:
        code = own_code(self._told_by)
        if isinstance(self._told_by, Command) or (code != self._code and not self._version):
            self._code, self._journal.box = code, self._identity()
        how = {"retries": self._retries, "drop": self._drop, "whole": whole}
        campaign = Campaign(name_of(self), realisations, self._journal, **how)
        campaign.run(self._function, self._executor)
        return campaign.outputs

    def _identity(self) -> str:
        """A digest of a function's code or its version, or of a command with the contents of the files it names."""
        if isinstance(self._told_by, Command):
            return self._told_by.digest(self._version)
        return code_digest(self._told_by, self._version)
