"""`Fmu`: a model in a file, and what it offers."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, final

from aleator._core.errors import ProblemError
from aleator._core.given import shown
from aleator.foreign._fmu._files import (
    MODEL_EXCHANGE,
    folder_of,
    kind_of,
    offers_slopes,
    path_of,
    read_description,
    unpack_all,
)
from aleator.foreign._fmu._hidden import Hidden
from aleator.foreign._fmu._instance import Instance, started
from aleator.foreign._fmu._library import LOCK, Library
from aleator.foreign._fmu._variables import Variables


@final
class Fmu:
    """A functional mock-up unit (FMI 2 or 3), as simulation tools export it: `al.foreign.Fmu("pendulum.fmu")`.

    - `path`: the file;
    - `kind`: "model exchange" (the FMU gives the rates of its states, which are integrated here, with sensitivities) or
      "co-simulation" (it steps by itself); by default the first of the two that it offers;
    - `settings`: values of parameters of any type (numbers, whole numbers, truth values, texts), for all runs.

    `parameters`, `inputs`, `outputs` and `states` list its real variables by name. It is run by `FmuSimulation`, a
    function of its parameters, and by `FmuSystem`, a system. All calls of FMUs are made one at a time, in this process:
    an FMU that crashes ends it.

    Raises `ProblemError` for a file that is no FMU, of FMI 1, or without a binary for this machine, and for unknown
    settings; `MissingExtraError` without FMPy.
    """

    variables = Hidden[Variables]()
    library = Hidden[Library]()
    settings = Hidden[dict[Any, Any]]()

    def __init__(self, path: str | Path, *, kind: str | None = None, settings: Mapping[str, Any] | None = None):
        path = path_of(path)
        folder = folder_of(self)
        description = read_description(path, folder)
        self.name = path.stem
        self.kind = kind_of(self.name, description, kind)
        self.variables = Variables(self.name, description)
        if self.is_exchange:
            self.variables.refuse_odd_states()
        self.settings = self._settings(settings)
        interface = description.modelExchange if self.is_exchange else description.coSimulation
        unpack_all(path, folder, description, interface.modelIdentifier)
        with LOCK:
            self.library = Library(self.name, description, self.kind, folder)
        self.offers_slopes = offers_slopes(folder, self.kind)
        self.indicators = int(description.numberOfEventIndicators)
        self._version = description.fmiVersion

    @property
    def is_exchange(self) -> bool:
        """Whether its states are integrated here."""
        return self.kind == MODEL_EXCHANGE

    @property
    def parameters(self) -> list[str]:
        """Its real parameters."""
        return self.variables.parameters()

    @property
    def inputs(self) -> list[str]:
        """Its real inputs."""
        return self.variables.inputs()

    @property
    def outputs(self) -> list[str]:
        """Its real outputs. Other real variables can be read too."""
        return list(self.variables.outputs)

    @property
    def states(self) -> list[str]:
        """Its continuous states, in its own order; none of co-simulation, which keeps them to itself."""
        return [one.name for one in self.variables.states] if self.is_exchange else []

    def started(
        self, values: Mapping[Any, float], t: float, tolerance: float | None
    ) -> AbstractContextManager[Instance]:
        """A fresh instance at the time `t`, with values of variables besides the settings."""
        return started(self.library, len(self.states), self.indicators, {**self.settings, **values}, t, tolerance)

    def __str__(self) -> str:
        parts = {name: getattr(self, name) for name in ("parameters", "inputs", "states", "outputs")}
        if not self.is_exchange:
            del parts["states"]
        lines = [f"  {name}: {', '.join(found) or 'none'}" for name, found in parts.items()]
        offer = "offers directional derivatives" if self.offers_slopes else "offers no derivatives"
        events = f"; {self.indicators} event indicators" if self.is_exchange and self.indicators else ""
        return "\n".join([f"FMU '{self.name}': FMI {self._version}, {self.kind}; {offer}{events}", *lines])

    def _settings(self, given: Any) -> dict[Any, Any]:
        if not isinstance(given, Mapping | None):
            raise ProblemError(
                f"FMU '{self.name}': expected settings as values by name, such as {{'stages': 3}}; "
                f"received {shown(given)}."
            )
        # Variables of FMPy are told apart by identity, so that they may be keys.
        return dict(self.variables.setting(name, value) for name, value in (given or {}).items())


def fmu_given(who: str, given: Any) -> Fmu:
    """An `Fmu`, or `ProblemError`."""
    if not isinstance(given, Fmu):
        raise ProblemError(f"{who}: expected an al.foreign.Fmu, such as Fmu('pendulum.fmu'); received {shown(given)}.")
    return given
