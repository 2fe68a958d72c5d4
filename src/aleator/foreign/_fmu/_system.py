"""`FmuSystem`: the equations of an FMU as a system of this package."""

import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import one_of, real
from aleator._core.errors import ProblemError, SimulationError, SimulationWarning
from aleator._core.leaves import AbstractLeaf, transparent
from aleator.dynamics import System
from aleator.foreign._fmu._fmu import Fmu
from aleator.foreign._fmu._simulation import differentiable

# Relative to a number. The error of differences, of the fourth order of the step, is about 1e-12 of a smooth function.
_STEP = 1e-3
# Values at one place may differ by this much, for an FMU may iterate for them.
_REPEATED = 1e-6
# Where it is seen whether the FMU remembers where it was: at its initial state, and so many usual sizes away.
_AWAY = (0.0, 0.3, 0.0, -0.7, 0.0)


@final
@transparent("parameters")
class FmuSystem(System):
    """The equations of an FMU for model exchange as a `System`, integrated and optimised like any other.

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
        state = self._equations("initial", 0.0, self._inputs_and_numbers(inputs))
        return dict(zip(self.states, state, strict=True))

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> tuple[Array, ...]:
        return self.rates_and_outputs(t, z, **inputs)[0]

    @override
    def outputs(self, t: Any, z: Any, **inputs: Any) -> dict[str, Any]:
        return self.rates_and_outputs(t, z, **inputs)[1]

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[tuple[Array, ...], dict[str, Any]]:
        del args
        place = jnp.concatenate([_array(z), self._inputs_and_numbers(inputs)])
        values, n = self._equations("rates", t, place), len(self._equations.fmu.states)
        return tuple(values[:n]), {name: values[n + index] for index, name in enumerate(self._equations.outputs)}

    def _inputs_and_numbers(self, given: Mapping[str, Any]) -> Float[Array, " n"]:
        """All inputs that are no parameters, as they are given or as the FMU has them; then all parameters."""
        equations = self._equations
        equations.fmu.refuse_other_inputs(given, equations.inputs)
        own = dict(zip(equations.inputs, equations.first["inputs"].tolist(), strict=True))
        # By name: trees of JAX sort what is in a dict.
        return _array([*(own | dict(given)).values(), *(self.parameters[name] for name in equations.numbers)])


def _array(values: Any) -> Float[Array, " n"]:
    return jnp.array([jnp.asarray(value, dtype=float) for value in values], dtype=float)


@final
class _Equations:
    """The equations of an FMU as functions of JAX; `inputs`, `outputs`: names; `first`: how they begin.

    `numbers`: its parameters with their values, as far as these are known.

    Raises `ProblemError` for an FMU whose equations do not follow from time, states, inputs and parameters.
    """

    def __init__(self, fmu: Fmu, numbers: dict[str, float | None], inputs: list[str], outputs: list[str]):
        self.fmu, self.numbers, self.inputs, self.outputs = fmu, numbers, inputs, outputs
        self._names = list(numbers), inputs, outputs
        self.first: dict[str, Any] = fmu.door.ask("first", numbers, inputs, where=" at its initial state")
        if (count := fmu.indicators) or self.first["is_timed"]:
            events = f"{count} event indicator{'s' * (count > 1)}" if count else "time events"
            raise ProblemError(
                f"FmuSystem: expected an FMU whose equations hold at all times; '{fmu.name}' has {events}. Use "
                "FmuSimulation, which handles events."
            )
        self._refuse_memory()

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as what it was made of."""
        return _Equations, (self.fmu, self.numbers, self.inputs, self.outputs)

    def __call__(self, method: str, t: Any, place: Float[Array, " n"]) -> Float[Array, " values"]:
        """The "rates" of the states, then outputs, of states, inputs and parameters; or the "initial" state, without
        states before these.
        """
        names, sizes = self._names, self.fmu.sizes([*self.inputs, *self.numbers])
        if method == "rates":
            sizes = np.concatenate([self.first["sizes"], sizes])
        size = len(self.fmu.states) + (len(self.outputs) if method == "rates" else 0)

        def values(points: Float[np.ndarray, "points m"]) -> Float[np.ndarray, "points values"]:
            # NaN with a warning where the FMU fails: an exception would end a search that may well turn back.
            try:
                found, reason = self.fmu.door.ask(method, names, points, where=" at one of its equations' points")
            except SimulationError as error:
                found, reason = np.full((len(points), size), np.nan), str(error)
            if reason:
                warnings.warn(reason, SimulationWarning, stacklevel=2)
            return found

        return differentiable(values, (size,), _STEP, sizes)(t, place)

    def _refuse_memory(self) -> None:
        """Raise `ProblemError` if values at a place depend on where the FMU was before, as those of delays do."""
        x, sizes, signs = self.first["states"], self.first["sizes"], np.cos(np.arange(len(self.first["states"])))
        rest = [self.first["inputs"], self.first["parameters"]]
        points = np.stack([np.concatenate([[0.0], x + away * signs * sizes, *rest]) for away in _AWAY])
        values, reason = self.fmu.door.ask("rates", self._names, points, where=" near its initial state")
        if not np.isfinite(values[0]).all():
            raise SimulationError(reason or f"FMU '{self.fmu.name}': a rate or an output is not finite at its start.")
        differences = np.abs(values[2::2] - values[0])
        if np.nanmax(differences, initial=0.0) > _REPEATED * np.max(np.abs(values[0]), initial=0.0):
            raise ProblemError(
                f"FmuSystem: expected rates that follow from time, states, inputs and parameters; those of "
                f"'{self.fmu.name}' depend on where it was before, by {np.nanmax(differences):.2g}. Use FmuSimulation."
            )
