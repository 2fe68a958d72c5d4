"""An FMU as functions of JAX: `FmuSimulation`, a run of it, and `FmuSystem`, its equations; both by differences."""

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import one_of, positive, real
from aleator._core.errors import ProblemError, SimulationError, SimulationWarning
from aleator._core.leaves import AbstractLeaf, transparent
from aleator.dynamics import AbstractCombined, Grid, check_span
from aleator.foreign._fmu._fmu import Fmu
from aleator.foreign._fmu._library import Found, each
from aleator.trajectories import AbstractSignal

# Steps of differences, relative to a number. Over those of a run, the error of the formula is about 1e-9 of a smooth
# function, and noise of a solver is magnified by about two hundred; over those of the equations, the error is 1e-12.
_STEP_OF_RUNS, _STEP_OF_EQUATIONS = 5e-3, 1e-3
# Runs behind derivatives have this part of the tolerance, as far as double precision allows.
_FINER, _FINEST = 1e-2, 1e-12
# Differences over one step and over two may disagree by this part of the largest derivative.
_NOISY = 1e-2
# Values at one place may differ by this much, for an FMU may iterate for them.
_REPEATED = 1e-6
# Where it is seen whether the FMU remembers where it was: at its initial state, and so many usual sizes away.
_AWAY = (0.0, 0.3, 0.0, -0.7, 0.0)


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
            outputs = self._traceable(known, list(traced))(0.0, numbers)
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

    def _traceable(self, known: Mapping[str, float], names: list[str]) -> Any:
        """The outputs as a function of JAX of a time that is left aside and of the numbers of some names."""
        shape = len(self._times), len(self._outputs)

        def runs(tolerance: float, points: np.ndarray) -> np.ndarray:
            def run(point: np.ndarray) -> np.ndarray:
                return self._run({**dict(zip(names, point[1:].tolist(), strict=True)), **known}, tolerance)

            return _warned(each(run, points, shape))

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
        return _differentiable(host, shape, _STEP_OF_RUNS, sizes, judge=warn_of_noise, exacter=finer)


@final
@transparent("parameters")
class FmuSystem(AbstractCombined):
    """The equations of an FMU for model exchange as an `al.System`, integrated and optimised like any other.

        rod = al.foreign.FmuSystem(fmu, {"damping": al.Uniform(al.Decision(0.1, 0.05, 1.0), half_width=0.02)})

    - `fmu`: an `Fmu` for model exchange, without events;
    - `parameters`: numbers, distributions and decisions by the names of its parameters and initial values; others are
      as the FMU has them;
    - `outputs`: the variables to read, by default all real outputs.

    Its states are the FMU's, with `_` for what is no letter or digit. Its inputs are the FMU's, by their names; those
    without a signal keep the FMU's initial values. Rates and outputs are differentiated by differences of fourth order,
    whose error is about 1e-12 of a smooth function. Each evaluation calls the FMU, so that such a system is many
    times slower than one written with JAX.

    Raises `ProblemError` for an FMU with events or for co-simulation, for unknown names, and for variables that the FMU
    computes itself; `SimulationError` if it fails at its initial state.
    """

    parameters: dict[str, Any]
    _equations: "_Equations" = eqx.field(static=True)

    def __init__(self, fmu: Fmu, parameters: Mapping[str, Any] | None = None, *, outputs: Sequence[str] | None = None):
        one_of("FmuSystem", fmu, Fmu, "Fmu('pendulum.fmu')")
        if not fmu.is_exchange:
            raise ProblemError(
                f"FmuSystem: expected an FMU for model exchange, which gives the rates of its states; '{fmu.name}' is "
                "used for co-simulation. Use FmuSimulation."
            )
        given = one_of(f"FmuSystem: parameters of '{fmu.name}'", parameters or {}, Mapping, "{'damping': 0.1}")
        self.parameters = {
            name: value if isinstance(value, AbstractLeaf | Tracer) else real(f"FMU '{fmu.name}': '{name}'", value)
            for name, value in zip(fmu.checked(given), given.values(), strict=True)
        }
        numbers = {name: value if isinstance(value, float) else None for name, value in self.parameters.items()}
        free = [name for name in fmu.inputs if name not in numbers]
        read = fmu.outputs if outputs is None else fmu.checked(outputs, is_set=False)
        self._equations = _Equations(fmu, numbers, free, read)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """The FMU's states, as names of Python."""
        names = [re.sub(r"\W", "_", name).strip("_") for name in self._equations.fmu.states]
        return tuple(name if name.isidentifier() else f"x_{name}" for name in names)

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the FMU declares."""
        return self._equations.fmu.units(self._equations.outputs)

    @override
    def initial(self) -> Mapping[str, Any]:
        return self.starting(0.0, {})

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        del t
        return dict(zip(self.states, self._equations.initial(self._inputs_and_numbers(inputs)), strict=True))

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[tuple[Array, ...], dict[str, Any]]:
        del args
        values = self._equations.rates(t, jnp.concatenate([_array(z), self._inputs_and_numbers(inputs)]))
        n = len(self._equations.start)
        return tuple(values[:n]), dict(zip(self._equations.outputs, values[n:], strict=True))

    def _inputs_and_numbers(self, given: Mapping[str, Any]) -> Float[Array, " n"]:
        """All inputs that are no parameters, as they are given or as the FMU has them; then all parameters."""
        equations = self._equations
        equations.fmu.refuse_other_inputs(given, equations.inputs)
        own = equations.given[: len(equations.inputs)].tolist()
        inputs = dict(zip(equations.inputs, own, strict=True)) | dict(given)
        # By name: trees of JAX sort what is in a dict.
        return _array([*inputs.values(), *(self.parameters[name] for name in equations.numbers)])


def _array(values: Any) -> Float[Array, " n"]:
    return jnp.array([jnp.asarray(value, dtype=float) for value in values], dtype=float)


@final
class _Equations:
    """The equations of an FMU as functions of JAX.

    - `numbers`: its parameters with their values, as far as these are known; `inputs`, `outputs`: names;
    - `start`: the initial state; `given`: the FMU's own values of the inputs, then of the parameters.

    Raises `ProblemError` for an FMU whose equations do not follow from time, states, inputs and parameters.
    """

    def __init__(self, fmu: Fmu, numbers: dict[str, float | None], inputs: list[str], outputs: list[str]):
        self.fmu, self.numbers, self.inputs, self.outputs = fmu, numbers, inputs, outputs
        self._free = [*inputs, *numbers]
        known = {name: value for name, value in numbers.items() if value is not None}
        self.start, self.given, is_timed = fmu.door.ask("first", known, self._free, where=" at its initial state")
        if (count := fmu.indicators) or is_timed:
            events = f"{count} event indicator{'s' * (count > 1)}" if count else "time events"
            raise ProblemError(
                f"FmuSystem: expected an FMU whose equations hold at all times; '{fmu.name}' has {events}. Use "
                "FmuSimulation, which handles events."
            )
        self._refuse_memory()

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as what it was made of."""
        return _Equations, (self.fmu, self.numbers, self.inputs, self.outputs)

    def initial(self, given: Float[Array, " n"]) -> Float[Array, " states"]:
        """The initial state, for values of the inputs, then of the parameters."""

        def begin(point: np.ndarray) -> np.ndarray:
            known = dict(zip(self._free, point[1:].tolist(), strict=True))
            return self.fmu.door.ask("first", known, [], where=" at its initial state")[0]

        shape, sizes = self.start.shape, self.fmu.sizes(self._free)
        return _differentiable(lambda at: _warned(each(begin, at, shape)), shape, _STEP_OF_EQUATIONS, sizes)(0.0, given)

    def rates(self, t: Any, place: Float[Array, " n"]) -> Float[Array, " values"]:
        """The rates of the states, then outputs, of states, inputs and parameters."""
        shape = (len(self.start) + len(self.outputs),)

        def values(points: Float[np.ndarray, "points m"]) -> Float[np.ndarray, "points values"]:
            try:
                return _warned(self._rates(points, " at one of its equations' points"))
            except SimulationError as error:  # none of the points has been answered
                return _warned((np.full((len(points), *shape), np.nan), str(error)))

        sizes = self.fmu.sizes([*self.fmu.states, *self._free])
        return _differentiable(values, shape, _STEP_OF_EQUATIONS, sizes)(t, place)

    def _rates(self, points: Float[np.ndarray, "points m"], where: str) -> Found:
        return self.fmu.door.ask("rates", list(self.numbers), self.inputs, self.outputs, points, where=where)

    def _refuse_memory(self) -> None:
        """Raise `ProblemError` if values at a place depend on where the FMU was before, as those of delays do."""
        away = np.cos(np.arange(len(self.start))) * self.fmu.sizes(self.fmu.states)
        points = np.stack([np.concatenate([[0.0], self.start + part * away, self.given]) for part in _AWAY])
        values, reason = self._rates(points, " near its initial state")
        if not np.isfinite(values[0]).all():
            raise SimulationError(reason or f"FMU '{self.fmu.name}': a rate or an output is not finite at its start.")
        difference = np.nanmax(np.abs(values[2::2] - values[0]), initial=0.0)
        if difference > _REPEATED * np.max(np.abs(values[0]), initial=0.0):
            raise ProblemError(
                f"FmuSystem: expected rates that follow from time, states, inputs and parameters; those of "
                f"'{self.fmu.name}' depend on where it was before, by {difference:.2g}. Use FmuSimulation."
            )


# --- Functions of NumPy as functions of JAX ---------------------------------------------------------------------------

Host: TypeAlias = Callable[[Float[np.ndarray, "points m"]], np.ndarray]
"""Values at some points, shape (points, ...): each is a time and then numbers."""
Judge: TypeAlias = Callable[[np.ndarray, np.ndarray], None]
"""Takes derivatives and by how much those over one step and over two disagree: much if noise or jumps do."""

_ABOUT = np.array([-2.0, -1.0, 1.0, 2.0])
# By time, values are asked for after it alone: there may be nothing before the start. Weights by the count of steps, s.
# What changes within a millisecond is differentiated to five digits.
_LATER, _WEIGHTS = 1e-5, (-25 / 12, 48 / 12, -36 / 12, 16 / 12, -3 / 12)


def _differentiable(
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
            moved = moved + _differentiable(slopes, (*shape, len(z)), step, sizes)(t, z) @ change
        if not isinstance(later, SymbolicZero):
            moved = moved + _differentiable(by_time, shape, step, sizes)(t, z) * later
        return value, moved

    function.defjvp(rule, symbolic_zeros=True)
    return lambda t, z: function(jnp.asarray(t, dtype=float), z)


def _warned(found: Found) -> np.ndarray:
    """Values at some points, with a warning of why some are NaN: an exception would end a search that may turn back."""
    values, reason = found
    if reason:
        warnings.warn(reason, SimulationWarning, stacklevel=2)
    return values
