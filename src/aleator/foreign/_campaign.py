"""`Campaign`: what is known of the samples of one call of a black box, as its runs end."""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import final

from aleator._core.arrays import Pytree
from aleator._core.errors import ProblemError, SimulationError
from aleator.ensemble import Realisation, absent
from aleator.foreign._failures import sound
from aleator.foreign._journal import Journal
from aleator.foreign._runs import Ended, Runs

# As much of a reason as a message repeats.
_LONGEST = 240


@final
class Campaign:
    """The samples of one call: which have finished, in the journal too, and which have failed.

    `name`: of the box in messages; `retries`: how often a sample that fails runs again.
    """

    def __init__(self, name: str, realisations: Sequence[Realisation], journal: Journal, retries: int):
        self.name, self.realisations, self._journal, self._retries = name, realisations, journal, retries
        self.keys = [journal.key(one) for one in realisations]
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
