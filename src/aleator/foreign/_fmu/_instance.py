"""One instance of an FMU, whatever its version: started, set, read, asked for rates and their derivatives."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from ctypes import c_double
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from aleator._core.errors import SimulationError
from aleator.foreign._fmu._library import Library, said
from aleator.foreign._fmu._variables import REAL, Variable

# Most iterations of the equations at one event.
_MOST_UPDATES = 1000


class Update(NamedTuple):
    """What an FMU says after an event: whether its states jumped, and when the next event is due (inf if unknown)."""

    has_jumped: bool
    next_event: float


class Instance:
    """An instance of a library, with so many states and event indicators.

    Once started, `initial` is its initial state, and `first` what it said when it was initialised.
    """

    def __init__(self, library: Library, states: int, indicators: int):
        self._library, self._fmu = library, library.instantiated()
        self._states, self._indicators = states, indicators
        self._time = 0.0
        self.first, self.initial = Update(False, np.inf), np.zeros(0)

    def start(self, values: Mapping[Variable, Any], t: float, tolerance: float | None) -> None:
        """Set variables, initialise at the time `t`, and get ready for steps or for continuous time."""
        fmu, self._time = self._fmu, t
        with self._library.explained("to initialise"):
            if self._library.version == 2:
                fmu.setupExperiment(tolerance=tolerance, startTime=t)
                self._set_all(values)
                fmu.enterInitializationMode()
            else:
                self._set_all(values)
                fmu.enterInitializationMode(tolerance=tolerance, startTime=t)
            fmu.exitInitializationMode()
            if self._library.is_exchange:
                self.first = self._updated()
                fmu.enterContinuousTimeMode()
                self.initial = self.state()

    def free(self) -> None:
        """Give the instance back."""
        self._library.freed(self._fmu)

    def set(self, references: Sequence[int], values: Sequence[float] | np.ndarray) -> None:
        """Set real variables."""
        if len(references):
            with self._explained():
                setter = self._fmu.setReal if self._library.version == 2 else self._fmu.setFloat64
                setter(references, [float(one) for one in values])

    def get(self, references: Sequence[int]) -> Float[np.ndarray, " n"]:
        """Values of real variables."""
        with self._explained():
            getter = self._fmu.getReal if self._library.version == 2 else self._fmu.getFloat64
            return np.array(getter(references), dtype=float)

    # --- Model exchange ---

    def at(self, t: float, x: Float[np.ndarray, " n"] | None = None) -> None:
        """Go to a time and, if it is given, a state."""
        self._time = t
        with self._explained():
            self._fmu.setTime(t)
            if x is not None and self._states:
                self._fmu.setContinuousStates((c_double * self._states)(*x), self._states)

    def state(self) -> Float[np.ndarray, " n"]:
        """The continuous states."""
        return self._filled(self._fmu.getContinuousStates, self._states)

    def nominals(self) -> Float[np.ndarray, " n"]:
        """The usual sizes of the states; 1 where the FMU tells none."""
        found = np.abs(self._filled(self._fmu.getNominalsOfContinuousStates, self._states))
        return np.where(np.isfinite(found) & (found > 0), found, 1.0)

    def rates(self) -> Float[np.ndarray, " n"]:
        """The time derivatives of the states."""
        version = self._library.version
        asked = self._fmu.getDerivatives if version == 2 else self._fmu.getContinuousStateDerivatives
        return self._filled(asked, self._states)

    def indicators(self) -> Float[np.ndarray, " m"]:
        """The event indicators, which change their signs at events."""
        return self._filled(self._fmu.getEventIndicators, self._indicators)

    def slopes(self, of: Sequence[int], by: Sequence[int], seed: Sequence[float]) -> Float[np.ndarray, " m"]:
        """The derivative of variables along a direction of others."""
        with self._explained():
            return np.array(self._fmu.getDirectionalDerivative(of, by, [float(one) for one in seed]), dtype=float)

    def step_is_over(self) -> bool:
        """Tell the FMU that a step is accepted, if it wants to know. Returns whether it asks for an event."""
        if not self._library.steps_are_reported:
            return False
        with self._explained():
            asks, ends = self._fmu.completedIntegratorStep()
        if ends:
            raise self._ended()
        return asks

    def event(self) -> Update:
        """Let the FMU handle an event."""
        with self._explained():
            self._fmu.enterEventMode()
            found = self._updated()
            self._fmu.enterContinuousTimeMode()
        return found

    # --- Co-simulation ---

    def step(self, t: float, length: float) -> None:
        """Let the FMU step by itself. Raises `SimulationError` if it does not reach the end of the step."""
        self._time = t + length
        fmu = self._fmu
        with self._explained():
            if self._library.version == 2:
                from fmpy.fmi2 import fmi2Discard, fmi2Terminated

                try:
                    fmu.doStep(t, length)
                except self._library.failure as error:
                    if getattr(error, "status", None) == fmi2Discard and fmu.getBooleanStatus(fmi2Terminated):
                        raise self._ended() from error
                    raise
                return
            _, ends, early, reached = fmu.doStep(t, length)
        if ends or early:
            self._time = reached
            raise self._ended()

    # --- Inside ---

    def _filled(self, asked: Any, size: int) -> np.ndarray:
        buffer = (c_double * size)()
        if size:
            with self._explained():
                asked(buffer, size)
        return np.array(buffer, dtype=float)

    def _set_all(self, values: Mapping[Variable, Any]) -> None:
        for one, value in values.items():
            name = "Integer" if one.type == "Enumeration" and self._library.version == 2 else one.type
            name = "Int64" if name == "Enumeration" else name
            kind = float if one.type in (*REAL, "Float32") else lambda given: given
            getattr(self._fmu, f"set{name}")([one.valueReference], [kind(value)])

    def _updated(self) -> Update:
        jumped = False
        for _ in range(_MOST_UPDATES):
            asked = self._fmu.newDiscreteStates if self._library.version == 2 else self._fmu.updateDiscreteStates
            again, ends, _, changed, is_timed, next_event = asked()
            if ends:
                raise self._ended()
            jumped = jumped or bool(changed)
            if not again:
                return Update(jumped, float(next_event) if is_timed else np.inf)
        raise SimulationError(
            f"FMU '{self._library.name}' does not find its state after an event at t = {self._time:.6g} s{said()}: "
            f"{_MOST_UPDATES} updates were not enough."
        )

    def _explained(self) -> Any:
        return self._library.explained(f"at t = {self._time:.6g} s")

    def _ended(self) -> SimulationError:
        return SimulationError(f"FMU '{self._library.name}' ended the simulation at t = {self._time:.6g} s{said()}.")


@contextmanager
def started(
    library: Library, states: int, indicators: int, values: Mapping[Variable, Any], t: float, tolerance: float | None
) -> Iterator[Instance]:
    """A fresh instance that has been initialised, so that no run depends on one before; given back at the end."""
    instance = Instance(library, states, indicators)
    try:
        instance.start(values, t, tolerance)
        yield instance
    finally:
        instance.free()
