"""`Fmu`: a model in a file, and what it offers."""

import functools
import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

from aleator._core.border import positive, refusal, shown
from aleator._core.errors import ProblemError
from aleator.foreign._fmu._description import Described, Variables, folder_of, path_of, read_description, unpack_all
from aleator.foreign._fmu._doors import Here, OwnProcess


@final
class Fmu:
    """A functional mock-up unit (FMI 2 or 3), as simulation tools export it: `al.foreign.Fmu("pendulum.fmu")`.

    - `path`: the file;
    - `kind`: "model exchange" (the FMU gives the rates of its states, which are integrated here, with sensitivities) or
      "co-simulation" (it steps by itself); by default the first of the two that it offers;
    - `settings`: values of parameters of any type (numbers, whole numbers, truth values, texts), for all runs;
    - `own_process`: whether the compiled code of the FMU runs in a process of its own, which starts once, and again
      after a crash. Without one, an FMU that crashes or hangs does so with this process;
    - `time_limit`: seconds for one run, or for one evaluation of an `FmuSystem`, after which that process is ended and
      the run has failed; None for no limit.

    `parameters`, `inputs`, `outputs` and `states` list its real variables by name. It is run by `FmuSimulation`, a
    function of its parameters, and by `FmuSystem`, a system. Calls of one FMU are made one at a time.

    Raises `ProblemError` for a file that is no FMU, of FMI 1, or without a binary for this machine, and for unknown
    settings; `SimulationError` if its library ends its process while it is loaded; `MissingExtraError` without FMPy.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        kind: str | None = None,
        settings: Mapping[str, Any] | None = None,
        own_process: bool = True,
        time_limit: float | None = 600.0,
    ):
        path = path_of(path)
        if not isinstance(own_process, bool):
            raise refusal("Fmu: own_process", "True or False", own_process)
        limit = None if time_limit is None else positive("Fmu: time_limit", time_limit)
        folder = folder_of(self)
        self.name = path.stem
        self._described = known = Described(
            self.name, folder, kind, settings, description=read_description(path, folder)
        )
        self.kind = known.kind
        # Two files are two models, whatever they are called.
        self._digest = hashlib.sha256(path.read_bytes()).hexdigest()
        self._settings = dict(settings or {})
        interface = known.description.modelExchange if self.is_exchange else known.description.coSimulation
        unpack_all(path, folder, known.description, interface.modelIdentifier)
        self._given = path.absolute(), self.kind, tuple(self._settings.items()), own_process, limit
        opening = self.name, folder, self.kind, self._settings
        self.door = OwnProcess(opening, limit) if own_process else Here(*opening)

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as its file, which must be the same there."""
        return _opened_again, (*self._given, self._digest)

    @property
    def variables(self) -> Variables:
        """Its variables by name."""
        return self._described.variables

    @property
    def is_exchange(self) -> bool:
        """Whether its states are integrated here."""
        return self._described.is_exchange

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
        return self._described.states

    def __str__(self) -> str:
        known = self._described
        parts = {name: getattr(self, name) for name in ("parameters", "inputs", "states", "outputs")}
        if not self.is_exchange:
            del parts["states"]
        lines = [f"  {name}: {', '.join(found) or 'none'}" for name, found in parts.items()]
        offer = "offers directional derivatives" if known.offers_slopes else "offers no derivatives"
        events = f"; {known.indicators} event indicators" if self.is_exchange and known.indicators else ""
        version = known.description.fmiVersion
        return "\n".join([f"FMU '{self.name}': FMI {version}, {self.kind}; {offer}{events}", *lines])


def fmu_given(who: str, given: Any) -> Fmu:
    """An `Fmu`, or `ProblemError`."""
    if not isinstance(given, Fmu):
        raise ProblemError(f"{who}: expected an al.foreign.Fmu, such as Fmu('pendulum.fmu'); received {shown(given)}.")
    return given


# Each task that a worker is sent has the model anew: the FMU stays open for the next one.
@functools.lru_cache(maxsize=4)
def _opened_again(
    path: Path,
    kind: str,
    settings: tuple[tuple[str, Any], ...],
    own_process: bool,
    time_limit: float | None,
    digest: str,
) -> Fmu:
    found = Fmu(path, kind=kind, settings=dict(settings), own_process=own_process, time_limit=time_limit)
    if found._digest != digest:
        raise ProblemError(f"FMU '{found.name}': '{path}' has changed since the model was made: make the model again.")
    return found
