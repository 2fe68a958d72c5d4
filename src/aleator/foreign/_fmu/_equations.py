"""The equations of an FMU at an instant, as functions of time, states, inputs and parameters, and their derivatives."""

import weakref
from collections import OrderedDict
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Bool, Float

from aleator._core.errors import ProblemError, SimulationError
from aleator.foreign._fmu._derivatives import STEP, difference_jacobian, scales, slope
from aleator.foreign._fmu._description import Variable, nominals_of
from aleator.foreign._fmu._library import LOCK, Instance, Opened

# As many instances are kept, each with its own parameters.
_KEPT = 256
# By which a derivative that the FMU gives may differ from a difference, relative to the largest of its kind.
_SAME = 1e-5
# Derivatives that are always smaller count as zero.
_SMALL = 1e-6
# Values at one place may differ by this much, for an FMU may iterate for them.
_REPEATED = 1e-6
# The initial state is told within this tolerance, if the FMU has to iterate for it.
_TOLERANCE = 1e-10
# Where the FMU's derivatives are judged: at its initial state, and so many of the states' usual sizes away.
_AWAY = (0.0, 0.3, -0.7)


class Place(NamedTuple):
    """Where the equations are evaluated: time, states `x`, inputs `u`, parameters `p`."""

    t: float
    x: np.ndarray
    u: np.ndarray
    p: np.ndarray


class Equations:
    """Rates of the states, then outputs, of a model-exchange FMU; `parameters`, `inputs`, `outputs`: its variables.

    Parameters are set before an FMU starts, so that there is one instance for each set of them; it starts at the time
    `t` with the inputs `first`.

    Derivatives along a direction are those that the FMU offers, as far as these agree with differences where they were
    judged (`judge`), and else differences. The standard promises them by states and inputs alone; many tools
    offer them by parameters too.
    """

    def __init__(
        self,
        fmu: Opened,
        parameters: list[Variable],
        inputs: list[Variable],
        outputs: list[Variable],
        t: float,
        tolerance: float,
        first: Mapping[Variable, float] = MappingProxyType({}),
    ):
        self.fmu, self.parameters, self.inputs, self.outputs = fmu, parameters, inputs, outputs
        self._t, self.tolerance, self._first = t, tolerance, dict(first)
        self.n = len(fmu.variables.states)
        self._of = [variable.valueReference for variable in (*fmu.variables.rates, *outputs)]
        self._by = [variable.valueReference for variable in (*fmu.variables.states, *inputs, *parameters)]
        self._input_references = [variable.valueReference for variable in inputs]
        self._output_references = [variable.valueReference for variable in outputs]
        # An initial value of a state acts through the state alone.
        states = {variable.valueReference for variable in fmu.variables.states}
        self._only_start = np.array([variable.valueReference in states for variable in parameters], dtype=bool)
        self._instances: OrderedDict[bytes, Instance] = OrderedDict()
        weakref.finalize(self, _free_all, self._instances)
        self.trusted: Bool[np.ndarray, " variables"] | None = None
        self._nominals: Float[np.ndarray, " n"] | None = None

    def instance(self, p: Float[np.ndarray, " k"]) -> Instance:
        """The instance of a set of parameters, started if it is new."""
        key = p.tobytes()
        if key in self._instances:
            self._instances.move_to_end(key)
            return self._instances[key]
        most = 1 if self.fmu.library.is_alone else _KEPT
        while len(self._instances) >= most:
            self._instances.popitem(last=False)[1].free()
        made = Instance(self.fmu.library, self.n, self.fmu.indicators)
        try:
            values = {**self.fmu.settings, **self._first, **dict(zip(self.parameters, p, strict=True))}
            made.start(values, self._t, self.tolerance)
        except BaseException:
            made.free()
            raise
        self._instances[key] = made
        return made

    def forget(self) -> None:
        """Give all instances back, so that nothing depends on what they went through."""
        _free_all(self._instances)

    def values(self, place: Place) -> Float[np.ndarray, " m"]:
        """Rates of the states, then outputs. Raises `SimulationError` if the FMU fails."""
        instance = self._at(place)
        rates = instance.rates()
        return np.concatenate([rates, instance.get(self._output_references)]) if self._output_references else rates

    def slope(
        self, place: Place, x: Float[np.ndarray, " n"], u: Float[np.ndarray, " r"], p: Float[np.ndarray, " k"]
    ) -> Float[np.ndarray, " m"]:
        """The derivative of the values along a direction of states, inputs and parameters."""
        direction = np.concatenate([x, u, np.where(self._only_start, 0.0, p)])
        trusted = np.zeros(len(direction), bool) if self.trusted is None else self.trusted
        found = np.zeros(len(self._of))
        if np.any(direction[trusted]):
            by = [reference for reference, use in zip(self._by, trusted, strict=True) if use]
            found += self._at(place).slopes(self._of, by, direction[trusted].tolist())
        left = np.where(trusted, 0.0, direction)
        return found + self._difference(place, left) if np.any(left) else found

    def jacobian(self, place: Place) -> Float[np.ndarray, "m variables"]:
        """The derivatives of the values by states, inputs and parameters."""
        found = np.zeros((len(self._of), len(self._by)))
        units = np.eye(len(self._by))
        trusted = np.zeros(len(self._by), bool) if self.trusted is None else self.trusted
        instance = self._at(place)
        for index in np.flatnonzero(trusted):
            found[:, index] = instance.slopes(self._of, [self._by[index]], [1.0])
        skipped = np.append(np.zeros(len(self._by) - len(self._only_start), bool), self._only_start)
        for index in np.flatnonzero(~trusted & ~skipped):
            found[:, index] = self._difference(place, units[index])
        return found

    def judge(self, places: list[Place]) -> None:
        """Trust those derivatives of the FMU that agree with differences at all of some places where it has values."""
        size = len(self._by)
        asked = [variable.causality in ("parameter", "input") for variable in self.parameters]
        candidates = np.array([True] * (size - len(asked)) + asked, dtype=bool) & self.fmu.offers_slopes
        self.trusted = np.zeros(size, bool)
        places = [place for place in places if self.has_values(place)]
        for index in np.flatnonzero(candidates) if places else ():
            self.trusted[index] = self._agree(places, int(index))

    def scales(self, values: np.ndarray, variables: list[Variable]) -> np.ndarray:
        """By how much a change of each of some variables is large."""
        return scales(values, nominals_of(variables))

    def sizes(self, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        """The same of all states, inputs and parameters."""
        others = [self.scales(u, self.inputs), self.scales(p, self.parameters)]
        return np.concatenate([scales(x, self.nominals(p)), *others])

    def nominals(self, p: np.ndarray) -> np.ndarray:
        """The usual sizes of the states."""
        if self._nominals is None:
            self._nominals = self.instance(p).nominals()
        return self._nominals

    def _at(self, place: Place) -> Instance:
        instance = self.instance(place.p)
        instance.at(place.t, place.x)
        instance.set(self._input_references, place.u.tolist())
        return instance

    def has_values(self, place: Place) -> bool:
        """Whether the FMU gives finite values at a place."""
        try:
            return bool(np.isfinite(self.values(place)).all())
        except SimulationError:
            return False

    def _agree(self, places: list[Place], index: int) -> bool:
        """Whether the derivative by one variable that the FMU gives, if it gives one, is that of differences."""
        unit = np.eye(len(self._by))[index]
        try:
            expected = np.array([self._difference(place, unit) for place in places])
            given = np.array([self._at(place).slopes(self._of, [self._by[index]], [1.0]) for place in places])
        except SimulationError:
            return False
        near = _SAME * np.maximum(np.max(np.abs(expected), axis=0), _SMALL)
        return bool(np.all(np.abs(given - expected) <= near))

    def _difference(self, place: Place, direction: np.ndarray) -> np.ndarray:
        """The derivative along a direction by differences: along states and inputs at once, by each parameter alone.

        So the same few sets of parameters serve a whole motion.
        """
        n, r = self.n, len(self.inputs)
        x, u, p = direction[:n], direction[n : n + r], direction[n + r :]
        found = np.zeros(len(self._of))
        if np.any(direction[: n + r]):
            sizes = self.sizes(place.x, place.u, place.p)[: n + r]
            step = STEP / np.max(np.abs(direction[: n + r]) / sizes)
            found += slope(
                lambda a: self.values(place._replace(x=place.x + a * x, u=place.u + a * u)), float(step)
            ).value
        steps = STEP * self.scales(place.p, self.parameters)
        for index in np.flatnonzero(p):
            unit = np.eye(len(p))[index]
            along = slope(lambda a, unit=unit: self.values(place._replace(p=place.p + a * unit)), steps[index])
            found += p[index] * along.value
        return found


def refuse_memory(equations: Equations, place: Place, others: list[Place]) -> None:
    """Raise `ProblemError` if values at a place depend on where the FMU was before, as those of delays do."""
    first = equations.values(place)
    for other in others:
        if equations.has_values(other):
            again = equations.values(place)
            if not np.allclose(
                first, again, rtol=_REPEATED, atol=_REPEATED * float(np.max(np.abs(first), initial=0.0))
            ):
                raise ProblemError(
                    f"FmuSystem: expected rates that follow from time, states, inputs and parameters; those of "
                    f"'{equations.fmu.name}' depend on where it was before, by {np.max(np.abs(again - first)):.2g}. "
                    "Use FmuSimulation."
                )


def refuse_events(fmu: Opened, instance: Instance) -> None:
    """Raise `ProblemError` for an FMU whose equations change at events."""
    if fmu.indicators or np.isfinite(instance.first.next_event):
        count = f"{fmu.indicators} event indicator{'s' * (fmu.indicators > 1)}"
        what = count if fmu.indicators else "time events"
        raise ProblemError(
            f"FmuSystem: expected an FMU whose equations hold at all times; '{fmu.name}' has {what}. Use "
            "FmuSimulation, which handles events."
        )


def _free_all(instances: OrderedDict[bytes, Instance]) -> None:
    with LOCK:
        while instances:
            instances.popitem()[1].free()


@final
class Field:
    """The equations of an FMU for model exchange, for `numbers` of its parameters, None where they are not known.

    `rates` are those of the states, then outputs, as functions of the time and of states, inputs and parameters in one
    vector. The initial state, `start`, is one of the time, which it ignores, and of inputs and parameters; its
    derivatives are differences.

    Raises `ProblemError` for an FMU whose equations do not follow from these, `SimulationError` if it fails at its
    start.
    """

    def __init__(self, fmu: Opened, numbers: Mapping[str, float | None], inputs: list[str], outputs: list[str]):
        self._fmu, named = fmu, fmu.variables
        parameters, free = named.settable(numbers), named.of_inputs(inputs)
        self._equations = Equations(fmu, parameters, free, named.readable(outputs), 0.0, _TOLERANCE)
        self._first = self._judged(list(numbers.values()))

    def first(self) -> tuple[list[float], list[float]]:
        """The FMU's own values of the inputs, and its states at the start."""
        return self._first

    def rates(self, t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """Rates of the states, then outputs."""
        return self._equations.values(self._place(t, z))

    def rates_jacobian(self, t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """Their first derivatives."""
        return self._equations.jacobian(self._place(t, z))

    def rates_hessian(self, t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """Their second derivatives."""
        steps = STEP * self._equations.sizes(*self._place(t, z)[1:])
        return difference_jacobian(lambda z: self.rates_jacobian(t, z), z, steps).value

    def start(self, _: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """The initial state."""
        equations = self._equations
        variables = [*equations.inputs, *equations.parameters]
        given = dict(zip(variables, z.tolist(), strict=True))
        with self._fmu.started(given, 0.0, equations.tolerance) as instance:
            return instance.initial

    def start_jacobian(self, t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """Its first derivatives."""
        return difference_jacobian(lambda z: self.start(t, z), z, self._steps(z)).value

    def start_hessian(self, t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """Its second derivatives."""
        return difference_jacobian(lambda z: self.start_jacobian(t, z), z, self._steps(z)).value

    def _place(self, t: float, z: Float[np.ndarray, " m"]) -> Place:
        n, r = self._equations.n, len(self._equations.inputs)
        return Place(t, z[:n], z[n : n + r], z[n + r :])

    def _steps(self, z: Float[np.ndarray, " m"]) -> np.ndarray:
        equations = self._equations
        return STEP * equations.scales(z, [*equations.inputs, *equations.parameters])

    def _judged(self, numbers: list[float | None]) -> tuple[list[float], list[float]]:
        """Compare the FMU's derivatives with differences at its start; its free inputs and its states there."""
        fmu, equations = self._fmu, self._equations
        with fmu.started({}, 0.0, _TOLERANCE) as instance:
            refuse_events(fmu, instance)
            u = instance.get([variable.valueReference for variable in equations.inputs])
            own = instance.get([variable.valueReference for variable in equations.parameters])
        p = np.array([its if number is None else number for number, its in zip(numbers, own, strict=True)])
        x, sizes = equations.instance(p).initial, equations.nominals(p)
        signs = np.cos(np.arange(len(x)))
        places = [Place(0.0, x + away * signs * sizes, u, p) for away in _AWAY]
        refuse_memory(equations, places[0], places[1:])
        equations.judge(places)
        return u.tolist(), x.tolist()
