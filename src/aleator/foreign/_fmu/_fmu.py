"""`Fmu`: a model in a file, and what it offers."""

import functools
import hashlib
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

from aleator._core.border import one_of, positive
from aleator._core.errors import ProblemError
from aleator.foreign._fmu._description import Variables, interface_of, kind_of, unpacked
from aleator.foreign._fmu._doors import OwnProcess, SameProcess


@final
class Fmu:
    """A functional mock-up unit (FMI 2 or 3), as simulation tools export it: `al.foreign.Fmu("pendulum.fmu")`.

    - `path`: the file;
    - `kind`: "model exchange" (the FMU gives the rates of its states, which are integrated here) or "co-simulation" (it
      steps by itself), also spelt "ModelExchange" or "CS"; by default the first of the two that it offers;
    - `settings`: values of parameters of any type (numbers, whole numbers, truth values, texts), for all runs;
    - `own_process`: whether the compiled code of the FMU runs in a process of its own, which starts once, and again
      after a crash. Without one, an FMU that crashes or hangs does so with this process;
    - `time_limit`: seconds for one run, or for those evaluations of an `FmuSystem` that are made at once, after which
      that process is ended and the run has failed; None for no limit.

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
        path = Path(one_of("Fmu: path", path, (str, Path), "'pendulum.fmu'"))
        one_of("Fmu: own_process", own_process, bool)
        limit = None if time_limit is None else positive("Fmu: time_limit", time_limit)
        settings = dict(one_of("Fmu: settings", settings or {}, Mapping, "{'stages': 3}"))
        folder = Path(tempfile.mkdtemp(prefix="aleator-fmu-"))
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.name, description = path.stem, unpacked(path, folder)
        self.kind, self.variables = kind_of(self.name, description, kind), Variables(self.name, description)
        self.variables.refuse_settings(settings)
        self._version, self._indicators = description.fmiVersion, int(description.numberOfEventIndicators)
        self.is_exchange = self.kind == "model exchange"
        self.states = self.variables.states() if self.is_exchange else []
        # Two files are two models, whatever they are called.
        self._digest = hashlib.sha256(path.read_bytes()).hexdigest()
        self._given = path.absolute(), self.kind, tuple(settings.items()), own_process, limit
        opening = self.name, str(folder), interface_of(self.kind), settings
        self.door = OwnProcess(*opening, time_limit=limit) if own_process else SameProcess(*opening)

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as its file, which must be the same there."""
        return _opened_again, (*self._given, self._digest)

    @property
    def parameters(self) -> list[str]:
        """Its real parameters."""
        return self.variables.of("parameter")

    @property
    def inputs(self) -> list[str]:
        """Its real inputs."""
        return self.variables.of("input")

    @property
    def outputs(self) -> list[str]:
        """Its real outputs. Other real variables can be read too."""
        return self.variables.of("output")

    def __str__(self) -> str:
        listed = {name: getattr(self, name) for name in ("parameters", "inputs", "states", "outputs")}
        events = f"; {self._indicators} event indicators" if self.is_exchange and self._indicators else ""
        lines = [f"  {name}: {', '.join(variables) or 'none'}" for name, variables in listed.items()]
        return "\n".join([f"FMU '{self.name}': FMI {self._version}, {self.kind}{events}", *lines])


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
    fmu = Fmu(path, kind=kind, settings=dict(settings), own_process=own_process, time_limit=time_limit)
    if fmu._digest != digest:
        raise ProblemError(f"FMU '{fmu.name}': '{path}' has changed since the model was made: make the model again.")
    return fmu
