"""The compiled code of an FMU, loaded by FMPy, whatever its version of FMI: runs, and values of its equations."""

import threading
import warnings
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir, closing
from itertools import pairwise
from typing import Any, TypeAlias, final

import numpy as np
from jaxtyping import Float
from scipy.integrate import LSODA

from aleator._core.errors import ProblemError, SimulationError
from aleator.foreign._fmu._instance import LONGEST, Instance

# FMUs share what is static in their libraries, and FMPy's logger is one for the whole process.
_LOCK = threading.RLock()
# As many instances are kept for evaluations of the equations, each with its own parameters.
_KEPT = 256
# The initial state is determined within this tolerance, if the FMU has to iterate for it.
_TOLERANCE = 1e-10
# How finely the time of an event is determined, as a part of the step in which it happens.
_FINE = 1e-13

Names: TypeAlias = tuple[Sequence[str], Sequence[str], Sequence[str]]
"""Parameters, inputs and outputs of equations."""
Found: TypeAlias = tuple[Float[np.ndarray, "points ..."], str]
"""Values at some points, NaN where the FMU fails, and what its first failure was."""


@final
class Library:
    """The FMU `name`, loaded from an unpacked `folder`, for model exchange or co-simulation.

    `settings`: values of variables of any type, for all runs. Variables are told by their names. Raises `ProblemError`
    if it cannot be loaded.
    """

    def __init__(self, name: str, folder: str, is_exchange: bool, settings: Mapping[str, Any]):
        import fmpy
        from fmpy import fmi2, fmi3

        description: Any = fmpy.read_model_description(folder, validate=False)
        interface = description.modelExchange if is_exchange else description.coSimulation
        self.name, self.is_exchange, self.settings = name, is_exchange, settings
        self.version = int(description.fmiVersion[0])
        self.steps_are_reported = bool(getattr(interface, "needsCompletedIntegratorStep", False))
        self.variables: dict[str, Any] = {variable.name: variable for variable in description.modelVariables}
        self.states = len(description.derivatives) if is_exchange else 0
        self.indicators = int(description.numberOfEventIndicators)
        self.is_broken = False  # for good, by what FMI calls a fatal error
        self._most_instances = 1 if interface.canBeInstantiatedOnlyOncePerProcess else _KEPT
        self._instances = OrderedDict[tuple[Any, ...], Instance]()
        model, slave = {2: (fmi2.FMU2Model, fmi2.FMU2Slave), 3: (fmi3.FMU3Model, fmi3.FMU3Slave)}[self.version]
        what = {"guid": description.guid, "modelIdentifier": interface.modelIdentifier, "unzipDirectory": folder}
        try:
            with _LOCK, chdir("."):  # FMPy changes the folder, and leaves it so if the library cannot be loaded
                self.prototype: Any = (model if is_exchange else slave)(instanceName=name, **what)
        except Exception as error:
            text = " ".join(str(error).split())[:LONGEST].rstrip(".")
            raise ProblemError(f"FMU '{name}': its library cannot be loaded: {text}.") from error

    def ask(self, method: str, *arguments: Any, where: str = "") -> Any:
        """What a method returns. `where` it is asked is told by processes that end."""
        del where
        with _LOCK:
            return getattr(self, method)(*arguments)

    def run(
        self,
        start: Mapping[str, float],
        outputs: Sequence[str],
        times: Float[np.ndarray, " instants"],
        inputs: Mapping[str, Float[np.ndarray, " instants"]],
        tolerance: float,
    ) -> Float[np.ndarray, "instants outputs"]:
        """The outputs at all instants, from values at the start, with inputs that are straight between instants.

        Raises `SimulationError` if the run fails.
        """
        driven, read = self._references(list(inputs)), self._references(outputs)
        first = {name: float(values[0]) for name, values in inputs.items()}
        with self._started({**start, **first}, float(times[0]), tolerance) as instance:

            def drive(t: float) -> None:
                instance.set(driven, np.array([np.interp(t, times, values) for values in inputs.values()]))

            if self.is_exchange:
                course = _integrated(instance, times, drive, tolerance, is_driven=bool(driven))
            else:
                course = _stepped(instance, times, drive)
            return np.stack([instance.get(read) for _ in course])

    def first(self, parameters: Mapping[str, float | None], inputs: Sequence[str]) -> dict[str, Any]:
        """How the equations begin, for values of parameters, None for the FMU's own.

        Values of the `inputs` and `parameters`, the `states` and their usual sizes, and whether an event is known by
        its time.
        """
        known = {name: value for name, value in parameters.items() if value is not None}
        with self._started(known) as instance:
            return {
                "inputs": instance.get(self._references(inputs)),
                "parameters": instance.get(self._references(list(parameters))),
                "states": instance.vector("ContinuousStates"),
                "sizes": instance.sizes(),
                "is_timed": bool(np.isfinite(instance.next_event)),
            }

    def rates(self, names: Names, points: Float[np.ndarray, "points m"]) -> Found:
        """Rates of the states, then outputs, at points (time, states, inputs, parameters)."""
        parameters, inputs, outputs = names
        driven, read = self._references(inputs), self._references(outputs)
        n = 1 + self.states
        r = n + len(driven)

        def values(point: np.ndarray) -> np.ndarray:
            instance = self._instance(dict(zip(parameters, point[r:].tolist(), strict=True)))
            instance.at(float(point[0]), point[1:n])
            instance.set(driven, point[n:r])
            return np.concatenate([instance.vector("ContinuousStateDerivatives"), instance.get(read)])

        return each(values, points, (self.states + len(read),))

    def initial(self, names: Names, points: Float[np.ndarray, "points m"]) -> Found:
        """The initial states at points (time, inputs, parameters), of which the time is left aside."""
        parameters, inputs, _ = names

        def state(point: np.ndarray) -> np.ndarray:
            with self._started(dict(zip((*inputs, *parameters), point[1:].tolist(), strict=True))) as instance:
                return instance.vector("ContinuousStates")

        return each(state, points, (self.states,))

    def _references(self, names: Sequence[str]) -> list[int]:
        return [self.variables[name].valueReference for name in names]

    def _started(self, values: Mapping[str, Any], t: float = 0.0, tolerance: float = _TOLERANCE) -> closing[Instance]:
        """A fresh instance, so that no run depends on the runs before it."""
        if self._most_instances == 1:
            self._instances.clear()
        return closing(Instance(self, {**self.settings, **values}, t, tolerance))

    def _instance(self, parameters: Mapping[str, float]) -> Instance:
        """The instance of a set of parameters, which are set before an FMU starts; it is started if it is new."""
        key = tuple(parameters.items())
        if key not in self._instances:
            while len(self._instances) >= self._most_instances:
                self._instances.popitem(last=False)
            self._instances[key] = Instance(self, {**self.settings, **parameters}, 0.0, _TOLERANCE)
        self._instances.move_to_end(key)
        return self._instances[key]


def each(
    function: Callable[[np.ndarray], np.ndarray], points: Float[np.ndarray, "points m"], shape: tuple[int, ...]
) -> Found:
    """Values of a function at each point that is finite."""
    values, reason = np.full((len(points), *shape), np.nan), ""
    for index in np.flatnonzero(np.isfinite(points).all(axis=1)):
        try:
            values[index] = function(points[index])
        except SimulationError as error:
            reason = reason or str(error)
    return values, reason


# --- Runs -------------------------------------------------------------------------------------------------------------


def _stepped(
    instance: Instance, times: Float[np.ndarray, " instants"], drive: Callable[[float], None]
) -> Iterator[None]:
    """Take a co-simulation to each instant. During a step, each input has its value in the middle of it."""
    yield
    for t, after in pairwise(times.tolist()):
        drive((t + after) / 2)
        instance.step(t, after - t)
        yield


def _integrated(
    instance: Instance,
    times: Float[np.ndarray, " instants"],
    drive: Callable[[float], None],
    tolerance: float,
    *,
    is_driven: bool,
) -> Iterator[None]:
    """Take a model exchange to each instant, before an event that falls on it. Inputs are straight between instants.

    By LSODA (Petzold 1983), which chooses between methods for stiff equations and others. FMPy's own loop is not used:
    its BDF is ten times less accurate at a tolerance, it loses what an FMU says of its failure, and where an FMU ends
    the simulation it returns what there is.
    """
    n, t, waiting = instance.library.states, float(times[0]), deque(times[1:].tolist())

    def go(t: float, y: np.ndarray) -> None:
        instance.at(float(t), y[:n])
        drive(t)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        go(t, y)
        found = instance.vector("ContinuousStateDerivatives") if n else np.zeros(1)
        if not np.isfinite(found).all():  # LSODA would not notice
            raise SimulationError(f"FMU '{instance.name}': the rate of a state is not finite at t = {t:.6g} s.")
        return found

    def signs(t: float, y: np.ndarray) -> np.ndarray:
        go(t, y)
        return instance.vector("EventIndicators")

    go(t, instance.vector("ContinuousStates"))
    yield
    # Events are looked for between the integrator's steps.
    longest = float(np.min(np.diff(times))) if instance.library.indicators else np.inf
    while waiting:
        if t >= instance.next_event:
            instance.handle_event()
        y = instance.vector("ContinuousStates") if n else np.zeros(1)  # integrators need one number at least
        before, is_event = signs(t, y), False
        # The rates have kinks where the slopes of inputs change.
        bound = min(waiting[0 if is_driven else -1], instance.next_event)
        atol: Any = tolerance * instance.sizes() if n else 1.0
        solver: Any = LSODA(rates, t, y, bound, rtol=tolerance, atol=atol, max_step=min(longest, bound - t))
        while solver.status == "running" and not is_event:
            began = t
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what it says of a failure
                solver.step()
            if solver.status == "failed":
                raise SimulationError(
                    f"FMU '{instance.name}': the integrator stops at t = {solver.t:.6g} s, where no step is short "
                    f"enough for a tolerance of {tolerance:g}."
                )
            t, y, curve = float(solver.t), solver.y.copy(), solver.dense_output()
            after = signs(t, y)
            if is_event := _has_changed(before, after):
                low, width = began, _FINE * (t - began)
                while t - low > width and low < (middle := (low + t) / 2) < t:
                    is_late = _has_changed(before, signs(middle, curve(middle)))
                    low, t = (low, middle) if is_late else (middle, t)
                y = curve(t)
            while waiting and waiting[0] <= t:
                instant = waiting.popleft()
                go(instant, y if instant == t else curve(instant))
                yield
            go(t, y)
            is_event, before = instance.asks_for_event() or is_event, after
        if is_event:
            instance.handle_event()


def _has_changed(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether an event indicator has passed zero."""
    return bool(np.any((before < 0) & (after >= 0) | (before > 0) & (after <= 0)))
