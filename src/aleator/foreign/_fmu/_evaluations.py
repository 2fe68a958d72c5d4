"""An FMU's equations and its initial state as functions of one vector, with two derivatives."""

from typing import final

import numpy as np
from jaxtyping import Float

from aleator.foreign._fmu import _differences as differences
from aleator.foreign._fmu._equations import Equations, Place, refuse_events, refuse_memory
from aleator.foreign._fmu._opened import Opened
from aleator.foreign._fmu._variables import Variable

# The initial state is told within this tolerance, if the FMU has to iterate for it.
_TOLERANCE = 1e-10
# Where the FMU's derivatives are judged: at its initial state, and so many of the states' usual sizes away.
_AWAY = (0.0, 0.3, -0.7)


@final
class Field:
    """The equations of an FMU for model exchange, for `numbers` of its parameters where they are known.

    `rates` are those of the states, then outputs, as functions of the time and of states, inputs and parameters in one
    vector. The initial state, `start`, is one of the time, which it ignores, and of inputs and parameters; its
    derivatives are differences.

    Raises `ProblemError` for an FMU whose equations do not follow from these, `SimulationError` if it fails at its
    start.
    """

    def __init__(
        self,
        fmu: Opened,
        parameters: list[Variable],
        inputs: list[Variable],
        outputs: list[Variable],
        numbers: list[float | None],
    ):
        self._fmu = fmu
        self._equations = Equations(fmu, parameters, inputs, outputs, 0.0, _TOLERANCE)
        self._first = self._judged(numbers)

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
        steps = differences.STEP * self._equations.sizes(*self._place(t, z)[1:])
        return differences.jacobian(lambda z: self.rates_jacobian(t, z), z, steps).value

    def start(self, _: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """The initial state."""
        equations = self._equations
        variables = [*equations.inputs, *equations.parameters]
        given = dict(zip(variables, z.tolist(), strict=True))
        with self._fmu.started(given, 0.0, equations.tolerance) as instance:
            return instance.initial

    def start_jacobian(self, t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """Its first derivatives."""
        return differences.jacobian(lambda z: self.start(t, z), z, self._steps(z)).value

    def start_hessian(self, t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        """Its second derivatives."""
        return differences.jacobian(lambda z: self.start_jacobian(t, z), z, self._steps(z)).value

    def _place(self, t: float, z: Float[np.ndarray, " m"]) -> Place:
        n, r = self._equations.n, len(self._equations.inputs)
        return Place(t, z[:n], z[n : n + r], z[n + r :])

    def _steps(self, z: Float[np.ndarray, " m"]) -> np.ndarray:
        equations = self._equations
        return differences.STEP * equations.scales(z, [*equations.inputs, *equations.parameters])

    def _judged(self, numbers: list[float | None]) -> tuple[list[float], list[float]]:
        """Compare the FMU's derivatives with differences at its start; its free inputs and its states there."""
        fmu, equations = self._fmu, self._equations
        with fmu.started({}, 0.0, _TOLERANCE) as instance:
            refuse_events(fmu, instance)
            u = instance.get([one.valueReference for one in equations.inputs])
            own = instance.get([one.valueReference for one in equations.parameters])
        p = np.array([its if one is None else one for one, its in zip(numbers, own, strict=True)])
        x, sizes = equations.instance(p).initial, equations.nominals(p)
        signs = np.cos(np.arange(len(x)))
        places = [Place(0.0, x + away * signs * sizes, u, p) for away in _AWAY]
        refuse_memory(equations, places[0], places[1:])
        equations.judge(places)
        return u.tolist(), x.tolist()
