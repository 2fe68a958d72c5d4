"""`FmuSimulation`: a run of an FMU as a function of its parameters, which JAX differentiates by differences."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias, final

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from aleator._core.border import one_of, positive, real
from aleator._core.errors import ProblemError, SimulationError, SimulationWarning
from aleator.dynamics import Grid, check_span
from aleator.foreign._fmu._fmu import Fmu
from aleator.foreign._fmu._library import each
from aleator.trajectories import AbstractSignal

# Relative to a parameter. The error of the formula is about 1e-9 of a smooth function; noise of a solver is magnified
# by about two hundred.
_STEP = 5e-3
# Runs behind derivatives have this part of the tolerance, as far as double precision allows.
_FINER, _FINEST = 1e-2, 1e-12
# Differences over one step and over two may disagree by this part of the largest derivative.
_NOISY = 1e-2


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
    it is differentiable in all modes, by differences of fourth order over 0.5 % and 1 % of each number: four runs each.
    Every run begins with a new instance, so that no run depends on another.

    Raises `ProblemError` for unknown names and numbers that the FMU computes itself, and, called with plain numbers,
    `SimulationError` for a run that fails, with what the FMU said. Inside of JAX such a run gives NaN, and warns with
    `SimulationWarning`; so do differences that are unreliable because outputs jump or the FMU's own solver is coarse.
    """

    def __init__(
        self,
        fmu: Fmu,
        grid: Grid,
        *,
        outputs: Sequence[str] | None = None,
        inputs: Mapping[str, AbstractSignal] | None = None,
        tolerance: float = 1e-9,
    ):
        self._fmu = one_of("FmuSimulation", fmu, Fmu, "Fmu('pendulum.fmu')")
        self._grid = one_of("FmuSimulation: grid", grid, Grid, "al.Grid(2.0, 200)")
        real("FmuSimulation: the final time", grid.t_final, "a known one")
        self.__name__, self._who = fmu.name, f"FMU '{fmu.name}'"  # in messages
        self._outputs = fmu.outputs if outputs is None else fmu.checked(outputs, is_set=False)
        self._tolerance = positive("FmuSimulation: tolerance", tolerance, below=1.0)
        self._signals = dict(one_of(f"{self._who}: inputs", inputs or {}, Mapping, "{'force': al.Tabulated(t, f)}"))
        fmu.refuse_other_inputs(self._signals, fmu.inputs)
        for name, signal in self._signals.items():
            who = f"{self._who}, input '{name}',"
            one_of(who, signal, AbstractSignal, "al.Tabulated(times, values), or a constant among the parameters")
            check_span(who, signal.over(grid.t_start, grid.t_final), grid)
        self._times = np.asarray(grid.times)
        self._inputs = {
            name: np.asarray(signal.sampled(grid.fractions, grid.t_start, grid.t_final))
            for name, signal in self._signals.items()
        }

    def __call__(self, at: Mapping[str, Any]) -> dict[str, Any]:
        """The outputs by name, each of shape (instants,), for numbers by the names of parameters."""
        one_of(f"{self._who}: its numbers", at, Mapping, f"{{'{next(iter(self._fmu.parameters), 'x')}': 1.0}}")
        self._fmu.checked(at)
        if varied := [name for name in at if name in self._signals]:
            raise ProblemError(f"{self._who}: the input '{varied[0]}' is a signal; leave it out of the parameters.")
        traced = {name: value for name, value in at.items() if isinstance(value, Tracer)}
        known = {name: real(f"{self._who}: '{name}'", value) for name, value in at.items() if name not in traced}
        if not traced:
            outputs = self._run(known, self._tolerance)
        else:
            numbers = jnp.stack([jnp.asarray(value, dtype=float) for value in traced.values()])
            outputs = self._differentiable(known, list(traced))(0.0, numbers)
        return {name: outputs[:, index] for index, name in enumerate(self._outputs)}

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as what it was made of."""
        settings = {"outputs": self._outputs, "inputs": self._signals, "tolerance": self._tolerance}
        return partial(FmuSimulation, **settings), (self._fmu, self._grid)

    def _run(self, start: Mapping[str, float], tolerance: float) -> Float[np.ndarray, "instants outputs"]:
        where = ", with " * bool(start) + ", ".join(f"{name}={value:.6g}" for name, value in start.items())
        try:
            return self._fmu.door.ask("run", start, self._outputs, self._times, self._inputs, tolerance, where=where)
        except SimulationError as error:
            text = str(error).removesuffix(".")
            raise SimulationError(text + ("" if where in text else where) + ".") from error

    def _differentiable(self, known: Mapping[str, float], names: list[str]) -> Any:
        """The outputs as a function of JAX of a time that is left aside and of the numbers of some names."""
        shape = len(self._times), len(self._outputs)

        def runs(tolerance: float, points: np.ndarray) -> np.ndarray:
            def run(point: np.ndarray) -> np.ndarray:
                return self._run({**dict(zip(names, point[1:].tolist(), strict=True)), **known}, tolerance)

            outputs, reason = each(run, points, shape)
            if reason:
                warnings.warn(reason, SimulationWarning, stacklevel=2)
            return outputs

        def warn_of_noise(slopes: np.ndarray, disagreement: np.ndarray) -> None:
            largest = np.max(np.abs(slopes), axis=1)  # over instants
            doubt = np.max(np.max(disagreement, axis=1) / np.where(largest > 0, largest, 1.0), axis=0)
            output, parameter = np.unravel_index(np.argmax(doubt), doubt.shape)
            if doubt[output, parameter] > _NOISY:
                warnings.warn(
                    f"{self._who}: the derivative of '{self._outputs[output]}' by '{names[parameter]}' is unreliable: "
                    f"differences over two steps disagree by {doubt[output, parameter]:.1%}. Outputs jump at times "
                    "that depend on it, or the FMU's own solver is too coarse; optimise an expansion or a search "
                    "without derivatives instead.",
                    SimulationWarning,
                    stacklevel=2,
                )

        finer = partial(runs, max(_FINER * self._tolerance, _FINEST))
        host, sizes = partial(runs, self._tolerance), self._fmu.sizes(names)
        return differentiable(host, shape, _STEP, sizes, judge=warn_of_noise, exacter=finer)


# --- Functions of NumPy as functions of JAX ---------------------------------------------------------------------------

Host: TypeAlias = Callable[[Float[np.ndarray, "points m"]], np.ndarray]
"""Values at some points, shape (points, ...): each is a time and then numbers."""
Judge: TypeAlias = Callable[[np.ndarray, np.ndarray], None]
"""Takes derivatives and by how much those over one step and over two disagree: much if noise or jumps do."""

_ABOUT = np.array([-2.0, -1.0, 1.0, 2.0])
# By time, values are asked for after it alone: there may be nothing before the start. Weights by the count of steps, s.
# What changes within a millisecond is differentiated to five digits.
_LATER, _WEIGHTS = 1e-5, (-25 / 12, 48 / 12, -36 / 12, 16 / 12, -3 / 12)


def differentiable(
    host: Host,
    shape: tuple[int, ...],
    step: float,
    sizes: Float[np.ndarray, " n"],
    *,
    judge: Judge | None = None,
    exacter: Host | None = None,
) -> Any:
    """A host, whose values have a shape, as a function of JAX of a time and a vector of numbers.

    - `step`: that of differences, relative to a number, or to its usual size where it is about zero;
    - `exacter`: the same host with less noise, for differences.

    Derivatives of all orders exist in all modes: by the numbers to about the fourth power of a step relative to the
    scale on which the host changes; first ones are judged. Those by time cost nothing where it is not differentiated.
    Batches are evaluated together.
    """

    def batch(points: Any) -> np.ndarray:
        points = np.asarray(points, dtype=float)
        return host(points.reshape(-1, points.shape[-1])).reshape(*points.shape[:-1], *shape)

    def slopes(points: Float[np.ndarray, "points m"]) -> Float[np.ndarray, "points ..."]:
        """Derivatives by the numbers, on a last axis: by four points about each, of fourth order."""
        z, (count, m) = points[:, 1:], points.shape
        h = step * np.where(np.abs(z) > 1e-6 * sizes, np.abs(z), sizes)
        moves = h[:, :, None, None] * _ABOUT[:, None] * np.eye(m)[1:, None]
        values = (exacter or host)((points[:, None, None] + moves).reshape(-1, m)).reshape(count, m - 1, 4, *shape)
        h = h.reshape(*h.shape, *(1,) * len(shape))
        once = (values[:, :, 2] - values[:, :, 1]) / (2 * h)
        twice = (values[:, :, 3] - values[:, :, 0]) / (4 * h)
        found, disagreement = (np.moveaxis(part, 1, -1) for part in ((4 * once - twice) / 3, np.abs(once - twice)))
        if judge is not None:
            judge(found, disagreement)
        return found

    def by_time(points: Float[np.ndarray, "points m"]) -> np.ndarray:
        later = np.eye(points.shape[1])[0] * _LATER
        return sum(weight * host(points + count * later) for count, weight in enumerate(_WEIGHTS)) / np.asarray(_LATER)

    @jax.custom_jvp
    def function(t: Float[Array, ""], z: Float[Array, " n"]) -> Array:
        point = jnp.concatenate([t[None], z])
        return jax.pure_callback(batch, jax.ShapeDtypeStruct(shape, float), point, vmap_method="expand_dims")

    def rule(primals: Any, tangents: Any) -> Any:
        (t, z), (later, change) = primals, tangents
        value = function(t, z)
        moved = jnp.zeros_like(value)
        if not isinstance(change, SymbolicZero) and len(z):
            moved = moved + differentiable(slopes, (*shape, len(z)), step, sizes)(t, z) @ change
        if not isinstance(later, SymbolicZero):
            moved = moved + differentiable(by_time, shape, step, sizes)(t, z) * later
        return value, moved

    function.defjvp(rule, symbolic_zeros=True)
    return lambda t, z: function(jnp.asarray(t, dtype=float), z)
