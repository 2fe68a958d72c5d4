"""Forward sensitivities: the derivatives of the states by parameters are integrated with the states.

`ds/dt = f_x s + f_p` for each parameter, a directional derivative of the rates (Hairer, Nørsett, Wanner 1993, I.14).
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from aleator.foreign._fmu import _differences as differences
from aleator.foreign._fmu._equations import Equations, Place
from aleator.foreign._fmu._exchange import Motion, integrated
from aleator.foreign._fmu._inputs import Inputs

# At as many instants of a motion, derivatives that the FMU offers are compared with differences.
_JUDGED = 5


def sensitivities(
    equations: Equations, inputs: Inputs, p: Float[np.ndarray, " k"], tolerance: float
) -> Float[np.ndarray, "instants outputs k"]:
    """The derivatives of the outputs by the parameters at all instants.

    Raises `EventError` if there is an event, and `SimulationError` if the FMU or the integrator fails.
    """
    n, k = equations.n, len(p)

    def initial(p: np.ndarray) -> np.ndarray:
        return equations.instance(p).initial

    def place(t: float, y: np.ndarray) -> Place:
        return Place(t, y[:n], inputs.at(t), p)

    def slopes(t: float, y: np.ndarray) -> np.ndarray:
        """The derivatives of rates and outputs by each parameter, shape (k, n + outputs)."""
        now, by, held = place(t, y), np.eye(k), np.zeros(len(inputs.references))
        return np.stack([equations.slope(now, s, held, e) for s, e in zip(y[n:].reshape(k, n), by, strict=True)])

    def motion(rates: Callable, observe: Callable, atol: np.ndarray) -> Motion:
        return Motion(n, rates, observe, lambda t: inputs.apply(instance, t), inputs.kink_after, tolerance, atol, False)

    def of_states(t: float, y: np.ndarray) -> np.ndarray:
        return equations.values(place(t, y))[:n]

    instance, x = equations.instance(p), initial(p)
    sizes, steps = equations.nominals(p), equations.scales(p, equations.parameters)
    if equations.trusted is None:
        path = integrated(instance, motion(of_states, lambda _, y: y, tolerance * sizes), x, inputs.times)
        chosen = np.unique(np.linspace(0, len(path) - 1, _JUDGED).astype(int))
        equations.judge([place(float(inputs.times[one]), path[one]) for one in chosen])
    start = differences.jacobian(initial, p, differences.STEP * steps).value
    atol = tolerance * np.concatenate([sizes, (sizes / steps[:, None]).ravel()])
    full = motion(
        lambda t, y: np.concatenate([of_states(t, y), slopes(t, y)[:, :n].ravel()]),
        lambda t, y: slopes(t, y)[:, n:].T,
        atol,
    )
    return integrated(instance, full, np.concatenate([x, start.T.ravel()]), inputs.times)
