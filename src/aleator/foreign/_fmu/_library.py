"""What can be asked of an FMU that is loaded: runs, and values of its equations."""

import threading
import warnings
import weakref
from collections import OrderedDict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, final

import numpy as np
from jaxtyping import Float
from scipy.integrate import LSODA

from aleator._core.errors import SimulationError
from aleator.foreign._fmu._instance import Instance, Loaded

# FMUs share what is static in their libraries, and FMPy's logger is one for the whole process.
_LOCK = threading.RLock()
# As many instances are kept for evaluations of the equations, each with its own parameters.
_KEPT = 256
# The initial state is determined within this tolerance, if the FMU has to iterate for it.
_TOLERANCE = 1e-10
# How finely the time of an event is determined, as a part of the step in which it happens.
_FINE = 1e-13


@final
class Library(Loaded):
    """The FMU `name` in an unpacked `folder`, loaded; variables are told by their names.

    `settings`: values of variables of any type, for all runs. Raises `ProblemError` if it cannot be loaded.
    """

    def __init__(self, name: str, folder: str, is_exchange: bool, settings: Mapping[str, Any]):
        with _LOCK:
            super().__init__(name, folder, is_exchange)
        self._settings, self._instances = settings, OrderedDict[tuple[Any, ...], Instance]()
        weakref.finalize(self, _free_all, self._instances)

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

        Raises `SimulationError` if the run fails, or an output is not finite.
        """
        driven, read = self.references(list(inputs)), self.references(outputs)
        first = {name: float(values[0]) for name, values in inputs.items()}
        with self._started({**start, **first}, float(times[0]), tolerance) as instance:

            def drive(t: float) -> None:
                instance.set(driven, np.array([np.interp(t, times, values) for values in inputs.values()]))

            if self.is_exchange:
                course = integrated(instance, times, drive, tolerance, is_driven=bool(driven))
            else:
                course = stepped(instance, times, drive)
            rows = np.stack([instance.get(read) for _ in course])
        if not np.isfinite(rows).all():
            instant, output = np.argwhere(~np.isfinite(rows))[0]
            what = f"output '{outputs[output]}' is {rows[instant, output]:g} at t = {times[instant]:.6g} s"
            raise SimulationError(f"FMU '{self.name}': {what}.")
        return rows

    def first(self, parameters: Mapping[str, float | None], inputs: Sequence[str]) -> dict[str, Any]:
        """How the equations begin, for values of parameters, None for the FMU's own.

        Values of the `inputs` and `parameters`, the `states` and their usual sizes, and whether an event is known by
        its time.
        """
        known = {name: value for name, value in parameters.items() if value is not None}
        with self._started(known, 0.0, _TOLERANCE) as instance:
            return {
                "inputs": instance.get(self.references(inputs)),
                "parameters": instance.get(self.references(list(parameters))),
                "states": instance.state(),
                "nominals": instance.nominals(),
                "is_timed": bool(np.isfinite(instance.next_event)),
            }

    def rates(
        self,
        parameters: Sequence[str],
        inputs: Sequence[str],
        outputs: Sequence[str],
        points: Float[np.ndarray, "points m"],
    ) -> tuple[Float[np.ndarray, "points values"], str]:
        """Rates of the states, then outputs, at points (time, states, inputs, parameters); NaN where the FMU fails.

        Parameters are set before an FMU starts, so that there is one instance for each set of them. Also returns what
        the first failure was.
        """
        names, driven, read = tuple(parameters), self.references(inputs), self.references(outputs)
        n = 1 + self.states
        r = n + len(driven)

        def values(point: np.ndarray) -> np.ndarray:
            instance = self._instance(names, point[r:])
            instance.at(float(point[0]), point[1:n])
            instance.set(driven, point[n:r])
            return np.concatenate([instance.rates(), instance.get(read)])

        return each(values, points, (self.states + len(read),))

    def initial(
        self, names: Sequence[str], points: Float[np.ndarray, "points m"]
    ) -> tuple[Float[np.ndarray, "points n"], str]:
        """The initial states at values of variables, after a time that is left aside; as `rates` returns them."""

        def state(point: np.ndarray) -> np.ndarray:
            with self._started(dict(zip(names, point[1:].tolist(), strict=True)), 0.0, _TOLERANCE) as instance:
                return instance.state()

        return each(state, points, (self.states,))

    @contextmanager
    def _started(self, values: Mapping[str, Any], t: float, tolerance: float) -> Iterator[Instance]:
        """A fresh instance, so that no run depends on the runs before it; given back at the end."""
        if self.is_alone:
            _free_all(self._instances)
        instance = Instance(self, {**self._settings, **values}, t, tolerance)
        try:
            yield instance
        finally:
            instance.free()

    def _instance(self, names: tuple[str, ...], p: Float[np.ndarray, " k"]) -> Instance:
        """The instance of a set of parameters at the time 0, started if it is new."""
        key = (names, p.tobytes())
        if key not in self._instances:
            while len(self._instances) >= (1 if self.is_alone else _KEPT):
                self._instances.popitem(last=False)[1].free()
            values = dict(zip(names, p.tolist(), strict=True))
            self._instances[key] = Instance(self, {**self._settings, **values}, 0.0, _TOLERANCE)
        self._instances.move_to_end(key)
        return self._instances[key]


def _free_all(instances: OrderedDict[tuple[Any, ...], Instance]) -> None:
    while instances:
        instances.popitem()[1].free()


def each(
    function: Callable[[np.ndarray], np.ndarray], points: Float[np.ndarray, "points m"], shape: tuple[int, ...]
) -> tuple[Float[np.ndarray, "points ..."], str]:
    """Values of a function at each point, NaN where it fails or the point is not finite; the first failure."""
    values, reason = np.full((len(points), *shape), np.nan), ""
    for index in np.flatnonzero(np.isfinite(points).all(axis=1)):
        try:
            values[index] = function(points[index])
        except SimulationError as error:
            reason = reason or str(error)
    return values, reason


def stepped(
    instance: Instance, times: Float[np.ndarray, " instants"], drive: Callable[[float], None]
) -> Iterator[None]:
    """Take a co-simulation to each instant. During a step, each input has its value in the middle of it."""
    yield
    for t, after in pairwise(times.tolist()):
        drive((t + after) / 2)
        instance.step(t, after - t)
        yield


def integrated(
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
    n, t, waiting = instance.loaded.states, float(times[0]), deque(times[1:].tolist())

    def state() -> np.ndarray:
        return instance.state() if n else np.zeros(1)  # integrators need one number at least

    def go(t: float, y: np.ndarray) -> None:
        instance.at(float(t), y[:n])
        drive(t)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        go(t, y)
        found = instance.rates() if n else np.zeros(1)
        if not np.isfinite(found).all():  # LSODA would not notice
            raise SimulationError(f"FMU '{instance.name}': the rate of a state is not finite at t = {t:.6g} s.")
        return found

    def indicators(t: float, y: np.ndarray) -> np.ndarray:
        go(t, y)
        return instance.indicators()

    go(t, state())
    yield
    # Events are looked for between the integrator's steps.
    longest = float(np.min(np.diff(times))) if instance.loaded.indicators else np.inf
    while waiting:
        if t >= instance.next_event:
            instance.handle_event()
        y, is_event = state(), False
        before = indicators(t, y)
        # The rates have kinks where the slopes of inputs change.
        bound = min(waiting[0 if is_driven else -1], instance.next_event)
        atol: Any = tolerance * instance.nominals() if n else 1.0
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
            after = indicators(t, y)
            if is_event := _has_changed(before, after):
                low, width = began, _FINE * (t - began)
                while t - low > width and low < (middle := (low + t) / 2) < t:
                    is_late = _has_changed(before, indicators(middle, curve(middle)))
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
