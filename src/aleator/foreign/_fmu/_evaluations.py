"""An FMU's equations and its initial state as functions of one vector, with two derivatives, to be called back."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from aleator.foreign._fmu import _differences as differences
from aleator.foreign._fmu._callbacks import Host
from aleator.foreign._fmu._equations import Equations, Place

# By time they are differentiated over such a step, s, after it alone: there may be nothing before the start.
_LATER = 1e-5


class Evaluations(NamedTuple):
    """What `called_back` takes."""

    value: Host
    jacobian: Host
    hessian: Host
    size: int


def evaluations(equations: Equations) -> Evaluations:
    """Rates and outputs as functions of `(t, x, u, p)`: time, states, inputs and parameters."""
    n, r = equations.n, len(equations.inputs)

    def place(z: Float[np.ndarray, " m"]) -> Place:
        return Place(float(z[0]), z[1 : 1 + n], z[1 + n : 1 + n + r], z[1 + n + r :])

    def value(z: Float[np.ndarray, " m"]) -> np.ndarray:
        return equations.values(place(z))

    def jacobian(z: Float[np.ndarray, " m"]) -> np.ndarray:
        by_time = differences.forward_slope(lambda a: value(_later(z, a)), _LATER)
        units = np.eye(len(z) - 1)
        others = [equations.slope(place(z), e[:n], e[n : n + r], e[n + r :]) for e in units]
        return np.stack([by_time, *others], axis=-1)

    def hessian(z: Float[np.ndarray, " m"]) -> np.ndarray:
        by_time = differences.forward_slope(lambda a: jacobian(_later(z, a)), _LATER)
        t, x, u, p = place(z)
        sizes = equations.sizes(x, u, p)
        found = differences.jacobian(
            lambda rest: jacobian(np.concatenate([[t], rest])), z[1:], differences.STEP * sizes
        )
        return np.concatenate([by_time[..., None], found.value], axis=-1)

    return Evaluations(value, jacobian, hessian, n + len(equations.outputs))


def starts(equations: Equations) -> Evaluations:
    """The initial state as a function of `(u, p)`: inputs and parameters. Its derivatives are differences."""
    fmu, variables = equations.fmu, [*equations.inputs, *equations.parameters]

    def value(z: Float[np.ndarray, " m"]) -> np.ndarray:
        with fmu.started(dict(zip(variables, z.tolist(), strict=True)), 0.0, equations.tolerance) as instance:
            return instance.initial

    def steps(z: Float[np.ndarray, " m"]) -> np.ndarray:
        return differences.STEP * equations.scales(z, variables)

    def jacobian(z: Float[np.ndarray, " m"]) -> np.ndarray:
        return differences.jacobian(value, z, steps(z)).value if len(z) else np.zeros((equations.n, 0))

    def hessian(z: Float[np.ndarray, " m"]) -> np.ndarray:
        return differences.jacobian(jacobian, z, steps(z)).value if len(z) else np.zeros((equations.n, 0, 0))

    return Evaluations(value, jacobian, hessian, equations.n)


def _later(z: Float[np.ndarray, " m"], by: float) -> np.ndarray:
    return np.concatenate([[z[0] + by], z[1:]])
