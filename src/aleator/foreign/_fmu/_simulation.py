"""`FmuSimulation`: a run of an FMU as a function of its parameters."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from aleator._core.border import one_of, positive, real, shown
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf
from aleator.dynamics import Grid
from aleator.foreign._fmu._derivatives import Evaluations, called_back
from aleator.foreign._fmu._description import with_numbers
from aleator.foreign._fmu._doors import Served
from aleator.foreign._fmu._fmu import Fmu, fmu_given
from aleator.foreign._fmu._runs import Runs, Sampled
from aleator.trajectories import AbstractSignal


def sampled_inputs(fmu: Fmu, grid: Grid, given: Any) -> Sampled:
    """Signals by the names of inputs, sampled at the instants of a grid. Raises `ProblemError` if they do not fit."""
    if not isinstance(given, Mapping | None):
        raise ProblemError(
            f"FMU '{fmu.name}': expected inputs as signals by name, such as {{'force': al.Tabulated(times, values)}}; "
            f"received {shown(given)}."
        )
    given = given or {}
    fmu.variables.of_inputs(given)
    times = np.asarray(grid.times)
    columns = [_sampled(fmu, name, signal, grid) for name, signal in given.items()]
    values = np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))
    return Sampled(list(given), times, values)


def _sampled(fmu: Fmu, name: str, signal: Any, grid: Grid) -> np.ndarray:
    who = f"FMU '{fmu.name}', input '{name}'"
    if not isinstance(signal, AbstractSignal):
        raise ProblemError(
            f"{who}: expected a signal, such as al.Tabulated(times, values); received {shown(signal)}. A constant is "
            "given among the parameters."
        )
    first, last = signal.over(grid.t_start, grid.t_final).span()
    if float(grid.t_start) < first or float(grid.t_final) > last:
        raise ProblemError(
            f"{who} is known from {first:g} to {last:g} s; expected from {grid.t_start:g} to {grid.t_final:g} s."
        )
    try:
        values = np.asarray(signal.sampled(grid.fractions, grid.t_start, grid.t_final))
    except (TypeError, jax.errors.JAXTypeError) as error:
        raise ProblemError(f"{who}: expected a signal of known numbers; received {shown(signal)}.") from error
    if values.shape != (len(grid.fractions),) or not np.isfinite(values).all():
        raise ProblemError(f"{who}: expected one finite number at each instant; received shape {values.shape[1:]}.")
    return values


@final
class FmuSimulation:
    """A run of an FMU as a function of its parameters: `swing({"damping": 0.1})` gives outputs at all instants.

        swing = al.foreign.FmuSimulation(fmu, al.Grid(2.0, 200), outputs=["angle"])
        al.expand(swing, {"damping": al.Uniform(0.1, half_width=0.02)}, traced=False)

    - `fmu`: an `Fmu` of either kind;
    - `grid`: the instants, with a known final time; co-simulation steps from each to the next;
    - `outputs`: the variables to read, by default all real outputs;
    - `inputs`: known signals by the names of inputs, taken at the instants and straight in between (co-simulation: the
      mean of its ends over each step). An input that is constant may be among the parameters instead;
    - `tolerance`: relative tolerance of the integration, and the one that an FMU of co-simulation is told.

    A call takes numbers by the names of parameters, constant inputs, and initial values; others are as the FMU has
    them. It returns arrays of shape (instants,) by output. With plain numbers these are NumPy's. Inside of JAX
    it is differentiable in all modes: model exchange by forward sensitivities with the FMU's directional derivatives,
    where it has any that agree with differences; co-simulation, and runs with events, by differences of runs.
    Every run begins with a new instance, so that no run depends on another.

    Raises `ProblemError` for unknown names and numbers that the FMU computes itself, and, called with plain numbers,
    `SimulationError` for a run that fails, with what the FMU said. Inside of JAX such a run gives NaN, and warns with
    `SimulationWarning`.
    """

    def __init__(
        self,
        fmu: Fmu,
        grid: Grid,
        *,
        outputs: Sequence[str] | None = None,
        inputs: Mapping[str, Any] | None = None,
        tolerance: float = 1e-9,
    ):
        self._fmu, self._grid = fmu_given("FmuSimulation", fmu), _known_grid(grid)
        self.__name__ = fmu.name  # in messages
        self._outputs = [variable.name for variable in fmu.variables.readable(outputs)]
        self._tolerance = positive("FmuSimulation: tolerance", tolerance, below=1.0)
        self._inputs = sampled_inputs(fmu, grid, inputs)
        self._signals = dict(inputs or {})
        self._served = {}

    @property
    def times(self) -> Float[np.ndarray, " instants"]:
        """The instants, s."""
        return self._inputs.times

    def __call__(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """The outputs by name, each of shape (instants,), for numbers by the names of parameters."""
        known, traced = self._sorted(at)
        names = tuple(traced) + tuple(known)
        fixed = np.array(list(known.values()), dtype=float)
        if not traced:
            return self._by_name(self._run(names, "outputs", fixed))
        numbers = jnp.stack([jnp.asarray(value, dtype=float) for value in traced.values()])
        return self._by_name(self._differentiable(names, fixed, len(traced))(numbers).reshape(len(self.times), -1))

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as what it was made of."""
        settings = {"outputs": self._outputs, "inputs": self._signals, "tolerance": self._tolerance}
        return partial(FmuSimulation, **settings), (self._fmu, self._grid)

    def __str__(self) -> str:
        outputs = ", ".join(self._outputs)
        how = "forward sensitivities; differences of runs with events" if self._fmu.is_exchange else "differences"
        return (
            f"FMU '{self._fmu.name}', {self._fmu.kind}, from {self.times[0]:g} to {self.times[-1]:g} s in "
            f"{len(self.times) - 1} steps: {outputs}\n  derivatives: {how}"
        )

    def _run(self, names: tuple[str, ...], method: str, numbers: Float[np.ndarray, " k"]) -> np.ndarray:
        """Ask for the outputs of a run, or for their derivatives, by the names of its numbers."""
        if names not in self._served:
            parts = list(names), self._outputs, self._inputs, self._tolerance
            self._served[names] = Served(self._fmu.door, Runs, *parts)
        return self._served[names].ask(method, numbers, where=lambda: with_numbers(names, numbers))

    def _differentiable(self, names: tuple[str, ...], fixed: np.ndarray, k: int) -> Any:
        """The outputs as a function of JAX of the first `k` numbers, the others fixed."""

        def asked(method: str, z: np.ndarray) -> np.ndarray:
            return self._run(names, method, np.concatenate([z, fixed]))

        function = called_back(
            Evaluations(
                lambda _, z: asked("outputs", z).ravel(),
                lambda _, z: asked("jacobian", z)[..., :k].reshape(-1, k),
                lambda _, z: asked("hessian", z)[..., :k, :k].reshape(-1, k, k),
                len(self.times) * len(self._outputs),
            )
        )
        return lambda numbers: function(0.0, numbers)

    def _by_name(self, found: Any) -> dict[str, Any]:
        return {name: found[:, index] for index, name in enumerate(self._outputs)}

    def _sorted(self, at: Any) -> tuple[dict[str, float], dict[str, Array]]:
        """The numbers that are known, and those that are traced."""
        who = f"FMU '{self._fmu.name}'"
        if not isinstance(at, Mapping):
            example = next(iter(self._fmu.parameters), "x")
            raise ProblemError(
                f"{who}: expected numbers by the names of parameters, such as {{'{example}': 1.0}}; "
                f"received {shown(at)}."
            )
        known, traced = {}, {}
        for name, value in at.items():
            self._fmu.variables.settable([name])
            if name in self._signals:
                raise ProblemError(f"{who}: the input '{name}' is given by a signal; leave it out of the parameters.")
            if isinstance(value, AbstractLeaf):
                raise ProblemError(
                    f"{who}: expected plain numbers; '{name}' is {shown(value)}. Give it to al.expand, "
                    "al.references.monte_carlo or a system in an al.Problem, which realise it."
                )
            if isinstance(value, Tracer):
                if value.shape:
                    raise ProblemError(f"{who}: expected one number for '{name}'; received the shape {value.shape}.")
                traced[name] = value
            else:
                known[name] = real(f"{who}: '{name}'", np.asarray(value) if isinstance(value, jax.Array) else value)
        return known, traced


def _known_grid(grid: Any) -> Grid:
    one_of("FmuSimulation: grid", grid, Grid, "al.Grid(2.0, 200)")
    if not isinstance(grid.t_final, float | int):
        raise ProblemError(f"FmuSimulation: expected a grid whose final time is known; received {shown(grid.t_final)}.")
    return grid
