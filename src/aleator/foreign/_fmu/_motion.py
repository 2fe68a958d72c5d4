"""An instance of an FMU through time: by steps of its own (co-simulation), or integrated here (model exchange)."""

import warnings
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.integrate import LSODA

from aleator._core.errors import SimulationError
from aleator.foreign._fmu._instance import Instance

# How finely the time of an event is determined, as a part of the step in which it happens.
_FINE = 1e-13


def stepped(
    instance: Instance,
    times: Float[np.ndarray, " instants"],
    driven: Sequence[int],
    inputs: Float[np.ndarray, "instants inputs"],
    outputs: Sequence[int],
) -> Float[np.ndarray, "instants outputs"]:
    """The outputs of co-simulation at all instants. During a step, each input has its value in the middle of it."""
    rows = [instance.get(outputs)]
    for index, (t, after) in enumerate(pairwise(times.tolist())):
        instance.set(driven, (inputs[index] + inputs[index + 1]) / 2)
        instance.step(t, after - t)
        rows.append(instance.get(outputs))
    return np.stack(rows)


class Motion:
    """The motion of an instance for model exchange over some instants, through its events.

    By LSODA (Petzold 1983), which chooses between methods for stiff equations and others. FMPy's own loop is not used:
    it holds inputs still during a step, and goes on with wrong rates where the FMU fails.

    `driven`, `inputs`: references of the inputs and their values at the instants, straight in between.
    """

    def __init__(
        self,
        instance: Instance,
        times: Float[np.ndarray, " instants"],
        driven: Sequence[int],
        inputs: Float[np.ndarray, "instants inputs"],
        tolerance: float,
    ):
        self._instance, self._times, self._driven, self._inputs = instance, times, driven, inputs
        self._rtol, self._n = tolerance, instance.loaded.states

    def outputs(self, references: Sequence[int]) -> Float[np.ndarray, "instants outputs"]:
        """The outputs at all instants; before an event where one falls on it."""
        instance, (t, end) = self._instance, self._times[[0, -1]].tolist()
        self._go(t, self._state())
        rows = [instance.get(references)]
        # Events are looked for between the integrator's steps.
        longest = float(np.min(np.diff(self._times))) if instance.loaded.indicators else np.inf
        while t < end:
            if t >= instance.next_event:
                instance.handle_event()
            y, is_event = self._state(), False
            before = self._indicators(t, y)
            # The rates have kinks where the slopes of inputs change.
            kink = self._times[self._times > t][0] if self._driven else np.inf
            bound = min(end, instance.next_event, float(kink))
            atol: Any = self._rtol * instance.nominals() if self._n else 1.0
            solver = LSODA(self._rates, t, y, bound, rtol=self._rtol, atol=atol, max_step=min(longest, bound - t))
            while solver.status == "running" and not is_event:
                began = t
                t, y, curve = self._one_step(solver)
                after = self._indicators(t, y)
                if is_event := _has_changed(before, after):
                    t, y = self._change(began, t, curve, before)
                for instant in self._times[len(rows) :]:
                    if instant > t:
                        break
                    self._go(instant, y if instant == t else curve(instant))
                    rows.append(instance.get(references))
                self._go(t, y)
                is_event, before = instance.asks_for_event() or is_event, after
            if is_event:
                instance.handle_event()
        return np.stack(rows)

    def _go(self, t: float, y: np.ndarray) -> None:
        self._instance.at(float(t), y[: self._n])
        self._instance.set(self._driven, np.array([np.interp(t, self._times, column) for column in self._inputs.T]))

    def _state(self) -> np.ndarray:
        # Integrators need one number at least.
        return self._instance.state() if self._n else np.zeros(1)

    def _rates(self, t: float, y: np.ndarray) -> np.ndarray:
        self._go(t, y)
        rates = self._instance.rates() if self._n else np.zeros(1)
        if not np.isfinite(rates).all():  # LSODA would not notice
            raise SimulationError(f"FMU '{self._instance.name}': the rate of a state is not finite at t = {t:.6g} s.")
        return rates

    def _indicators(self, t: float, y: np.ndarray) -> np.ndarray:
        self._go(t, y)
        return self._instance.indicators()

    def _one_step(self, solver: Any) -> tuple[float, np.ndarray, Any]:
        """The time and state after a step, and the curve that leads there."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what it says of a failure
            solver.step()
        if solver.status == "failed":
            raise SimulationError(
                f"FMU '{self._instance.name}': the integrator stops at t = {solver.t:.6g} s, where no step is short "
                f"enough for a tolerance of {self._rtol:g}."
            )
        return float(solver.t), solver.y.copy(), solver.dense_output()

    def _change(self, low: float, high: float, curve: Any, before: np.ndarray) -> tuple[float, np.ndarray]:
        """The first time and state after a change of sign, by bisection."""
        width = _FINE * (high - low)
        while high - low > width and low < (middle := (low + high) / 2) < high:
            if _has_changed(before, self._indicators(middle, curve(middle))):
                high = middle
            else:
                low = middle
        return high, curve(high)


def _has_changed(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether an event indicator has passed zero."""
    return bool(np.any((before < 0) & (after >= 0) | (before > 0) & (after <= 0)))
