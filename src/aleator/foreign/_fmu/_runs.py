"""Runs of an FMU over a grid as a function of its parameters: outputs at all instants, and their derivatives."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from aleator._core.errors import SimulationError, SimulationWarning
from aleator.foreign._fmu._derivatives import STEP, Slope, difference_jacobian, scales
from aleator.foreign._fmu._description import Variable, nominals_of, with_numbers
from aleator.foreign._fmu._equations import Equations, Place
from aleator.foreign._fmu._library import Opened
from aleator.foreign._fmu._motion import EventError, Inputs, Motion, integrated, motion_of, stepped

# At as many instants of a motion, derivatives that the FMU offers are compared with differences.
_JUDGED = 5
# Differences over one step and over two may disagree by this part of the largest derivative.
_NOISY = 1e-2


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
    start = difference_jacobian(initial, p, STEP * steps).value
    atol = tolerance * np.concatenate([sizes, (sizes / steps[:, None]).ravel()])
    full = motion(
        lambda t, y: np.concatenate([of_states(t, y), slopes(t, y)[:, :n].ravel()]),
        lambda t, y: slopes(t, y)[:, n:].T,
        atol,
    )
    return integrated(instance, full, np.concatenate([x, start.T.ravel()]), inputs.times)


class Runs:
    """An FMU from the start to the end of a grid, by the values of `parameters`, with chosen `outputs`."""

    def __init__(
        self, fmu: Opened, parameters: list[Variable], outputs: list[Variable], inputs: Inputs, tolerance: float
    ):
        self._fmu, self._parameters, self._outputs = fmu, parameters, outputs
        self._inputs, self._tolerance = inputs, tolerance
        self._equations = None
        if fmu.is_exchange:
            t = float(inputs.times[0])
            self._equations = Equations(fmu, parameters, inputs.variables, outputs, t, tolerance, inputs.first)

    def outputs(self, p: Float[np.ndarray, " k"]) -> Float[np.ndarray, "instants outputs"]:
        """The outputs at all instants. Raises `SimulationError` if a run fails or an output is not finite."""
        references = [one.valueReference for one in self._outputs]
        inputs = self._inputs
        start = {**inputs.first, **dict(zip(self._parameters, p.tolist(), strict=True))}
        with self._explained(p), self._fmu.started(start, float(inputs.times[0]), self._tolerance) as instance:
            if self._fmu.is_exchange:
                motion, first = motion_of(instance, references, inputs, self._tolerance)
                found = integrated(instance, motion, first, inputs.times)
            else:
                found = stepped(instance, references, inputs, inputs.times)
            self._refuse_missing(found)
        return found

    def jacobian(self, p: Float[np.ndarray, " k"]) -> Float[np.ndarray, "instants outputs k"]:
        """The derivatives of the outputs by the parameters.

        For model exchange by forward sensitivities, integrated with the states. These hold up to the first event: then,
        and for co-simulation, by differences of runs.

        Warns with `SimulationWarning` where differences over one step and over two do not agree.
        """
        if self._equations is not None:
            try:
                with self._explained(p):
                    return sensitivities(self._equations, self._inputs, p, self._tolerance)
            except EventError:
                pass
            finally:
                self._equations.forget()
        found = difference_jacobian(self.outputs, p, self._steps(p))
        self._warn_of_noise(found)
        return found.value

    def hessian(self, p: Float[np.ndarray, " k"]) -> Float[np.ndarray, "instants outputs k k"]:
        """The second derivatives, by differences of the first."""
        return difference_jacobian(self.jacobian, p, self._steps(p)).value

    def _steps(self, p: np.ndarray) -> np.ndarray:
        return STEP * scales(p, nominals_of(self._parameters))

    @contextmanager
    def _explained(self, p: np.ndarray) -> Iterator[None]:
        """Add the parameters to what is said of a failure."""
        try:
            yield
        except SimulationError as error:
            text = str(error) if str(error).startswith("FMU ") else f"FMU '{self._fmu.name}': {error}."
            values = with_numbers([one.name for one in self._parameters], p)
            raise SimulationError(f"{text.removesuffix('.')}{values}.") from error

    def _refuse_missing(self, found: np.ndarray) -> None:
        if np.isfinite(found).all():
            return
        instant, output = np.argwhere(~np.isfinite(found))[0]
        raise SimulationError(
            f"FMU '{self._fmu.name}': output '{self._outputs[output].name}' is {found[instant, output]:g} at "
            f"t = {self._inputs.times[instant]:.6g} s"
        )

    def _warn_of_noise(self, found: Slope) -> None:
        largest = np.max(np.abs(found.value), axis=0)
        doubt = np.max(found.disagreement, axis=0) / np.where(largest > 0, largest, 1.0)
        output, parameter = np.unravel_index(np.argmax(doubt), doubt.shape)
        if doubt[output, parameter] > _NOISY:
            warnings.warn(
                f"FMU '{self._fmu.name}': the derivative of '{self._outputs[output].name}' by "
                f"'{self._parameters[parameter].name}' is unreliable: differences over two steps disagree by "
                f"{doubt[output, parameter]:.1%}. Outputs jump at times that depend on it, or the FMU's own solver is "
                "too coarse; optimise an expansion or a search without derivatives instead.",
                SimulationWarning,
                stacklevel=2,
            )
