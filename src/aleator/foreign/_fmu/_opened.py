"""`Opened`: an FMU whose library is loaded in this process; and what is known of it before."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, final

from aleator._core.border import shown
from aleator._core.errors import ProblemError
from aleator.foreign._fmu._files import MODEL_EXCHANGE, described, kind_of, offers_slopes
from aleator.foreign._fmu._instance import Instance, started
from aleator.foreign._fmu._library import Library
from aleator.foreign._fmu._variables import Variable, Variables


class Described:
    """What the description of an FMU says: of the FMU `name`, unpacked in a `folder`, as it is to be run.

    Raises `ProblemError` for a kind that it does not offer, and for settings that it does not have.
    """

    def __init__(
        self, name: str, folder: Path, kind: str | None, settings: Mapping[str, Any] | None, *, description: Any
    ):
        self.name, self.folder, self.description = name, folder, description
        self.kind = kind_of(name, description, kind)
        self.variables = Variables(name, description)
        if self.is_exchange:
            self.variables.refuse_odd_states()
        self.settings = self._settings(settings)
        self.offers_slopes = offers_slopes(folder, self.kind)
        self.indicators = int(description.numberOfEventIndicators)

    @property
    def is_exchange(self) -> bool:
        """Whether its states are integrated here."""
        return self.kind == MODEL_EXCHANGE

    @property
    def states(self) -> list[str]:
        """Its continuous states, in its own order; none of co-simulation, which keeps them to itself."""
        return [one.name for one in self.variables.states] if self.is_exchange else []

    def _settings(self, given: Any) -> dict[Variable, Any]:
        if not isinstance(given, Mapping | None):
            raise ProblemError(
                f"FMU '{self.name}': expected settings as values by name, such as {{'stages': 3}}; "
                f"received {shown(given)}."
            )
        # Variables of FMPy are told apart by identity, so that they may be keys.
        return dict(self.variables.setting(name, value) for name, value in (given or {}).items())


@final
class Opened(Described):
    """An FMU whose library is loaded. Raises `ProblemError` if it cannot be."""

    def __init__(self, name: str, folder: Path, kind: str | None, settings: Mapping[str, Any] | None):
        super().__init__(name, folder, kind, settings, description=described(name, folder, validate=False))
        self.library = Library(name, self.description, self.kind, folder)

    def started(
        self, values: Mapping[Variable, float], t: float, tolerance: float | None
    ) -> AbstractContextManager[Instance]:
        """A fresh instance at the time `t`, with values of variables besides the settings."""
        return started(self.library, len(self.states), self.indicators, {**self.settings, **values}, t, tolerance)
