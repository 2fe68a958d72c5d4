"""An FMU's equations and its initial state as functions of one vector, with two derivatives, to be called back."""

import numpy as np
from jaxtyping import Float

from aleator.foreign._fmu import _differences as differences
from aleator.foreign._fmu._callbacks import Evaluations
from aleator.foreign._fmu._equations import Equations, Place


def evaluations(equations: Equations) -> Evaluations:
    """Rates and outputs as functions of the time and of states, inputs and parameters in one vector."""
    n, r = equations.n, len(equations.inputs)

    def place(t: float, z: Float[np.ndarray, " m"]) -> Place:
        return Place(t, z[:n], z[n : n + r], z[n + r :])

    def value(t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        return equations.values(place(t, z))

    def jacobian(t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        return equations.jacobian(place(t, z))

    def hessian(t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        steps = differences.STEP * equations.sizes(*place(t, z)[1:])
        return differences.jacobian(lambda z: jacobian(t, z), z, steps).value

    return Evaluations(value, jacobian, hessian, n + len(equations.outputs))


def starts(equations: Equations) -> Evaluations:
    """The initial state as a function of inputs and parameters in one vector. Its derivatives are differences."""
    fmu, variables = equations.fmu, [*equations.inputs, *equations.parameters]

    def value(_: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        with fmu.started(dict(zip(variables, z.tolist(), strict=True)), 0.0, equations.tolerance) as instance:
            return instance.initial

    def steps(z: Float[np.ndarray, " m"]) -> np.ndarray:
        return differences.STEP * equations.scales(z, variables)

    def jacobian(t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        return differences.jacobian(lambda z: value(t, z), z, steps(z)).value

    def hessian(t: float, z: Float[np.ndarray, " m"]) -> np.ndarray:
        return differences.jacobian(lambda z: jacobian(t, z), z, steps(z)).value

    return Evaluations(value, jacobian, hessian, equations.n)
