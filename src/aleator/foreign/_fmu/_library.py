"""What can be asked of an FMU: whole runs, and values of its equations at points."""

import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, final

import numpy as np
from jaxtyping import Float

from aleator._core.errors import SimulationError
from aleator.foreign._fmu._instance import Instance, Loaded
from aleator.foreign._fmu._motion import Motion, stepped

# As many instances are kept for evaluations of the equations, each with its own parameters.
_KEPT = 256
# The initial state is determined within this tolerance, if the FMU has to iterate for it.
_TOLERANCE = 1e-10


@final
class Library(Loaded):
    """The FMU `name` in an unpacked `folder`, loaded; variables are told by their names.

    `settings`: values of variables of any type, for all runs. Raises `ProblemError` if it cannot be loaded.
    """

    def __init__(self, name: str, folder: str, kind: str, settings: Mapping[str, Any]):
        super().__init__(name, folder, kind)
        self._settings = settings
        self._instances = OrderedDict[tuple[Any, ...], Instance]()
        weakref.finalize(self, _free_all, self._instances)

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
        driven, values = self.references(list(inputs)), np.array([*inputs.values()]).reshape(-1, len(times)).T
        first = dict(zip(inputs, values[0].tolist(), strict=True))
        with self._started({**start, **first}, float(times[0]), tolerance) as instance:
            if self.is_exchange:
                found = Motion(instance, times, driven, values, tolerance).outputs(self.references(outputs))
            else:
                found = stepped(instance, times, driven, values, self.references(outputs))
        if not np.isfinite(found).all():
            instant, output = np.argwhere(~np.isfinite(found))[0]
            what = f"output '{outputs[output]}' is {found[instant, output]:g} at t = {times[instant]:.6g} s"
            raise SimulationError(f"FMU '{self.name}': {what}.")
        return found

    # --- Equations ---

    def first(self, parameters: Mapping[str, float | None], inputs: Sequence[str]) -> dict[str, Any]:
        """How the equations begin, for values of parameters, None for the FMU's own.

        Values of the `inputs` and `parameters`, the `states` and their usual sizes, and how many `indicators` of events
        there are, and whether some are known by their time.
        """
        with self._started({}, 0.0, _TOLERANCE) as instance:
            own, u = instance.get(self.references(list(parameters))), instance.get(self.references(inputs))
            is_timed = bool(np.isfinite(instance.next_event))
        p = np.array([its if value is None else value for value, its in zip(parameters.values(), own, strict=True)])
        instance = self._instance(tuple(parameters), p)
        found = {"inputs": u, "parameters": p, "states": instance.state(), "nominals": instance.nominals()}
        return found | {"indicators": self.indicators, "is_timed": is_timed}

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

        return _each(values, points, self.states + len(read))

    def initial(
        self, names: Sequence[str], points: Float[np.ndarray, "points m"]
    ) -> tuple[Float[np.ndarray, "points n"], str]:
        """The initial states at values of variables, after a time that is left aside; as `rates` returns them."""

        def state(point: np.ndarray) -> np.ndarray:
            with self._started(dict(zip(names, point[1:].tolist(), strict=True)), 0.0, _TOLERANCE) as instance:
                return instance.state()

        return _each(state, points, self.states)

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


def _each(
    function: Callable[[np.ndarray], np.ndarray], points: Float[np.ndarray, "points m"], size: int
) -> tuple[Float[np.ndarray, "points values"], str]:
    """`size` values of a function at each point, NaN where it fails or the point is not finite; the first failure."""
    found, said = np.full((len(points), size), np.nan), ""
    for index in np.flatnonzero(np.isfinite(points).all(axis=1)):
        try:
            found[index] = function(points[index])
        except SimulationError as error:
            said = said or str(error)
    return found, said
