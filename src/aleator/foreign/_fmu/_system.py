"""`FmuSystem`: the equations of an FMU as a system of this package."""

import re
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
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
from aleator.foreign._fmu._simulation import differentiable, relative_steps

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
    _equations: "Equations" = eqx.field(static=True)

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
            for name, value in zip(fmu.variables.settable(given), given.values(), strict=True)
        }
        numbers = {name: value if isinstance(value, float) else None for name, value in self.parameters.items()}
        free = [name for name in fmu.inputs if name not in numbers]
        self._equations = Equations(fmu, numbers, free, fmu.variables.readable(outputs))

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """The FMU's states, as names of Python."""
        names = [re.sub(r"\W", "_", name).strip("_") for name in self._equations.fmu.states]
        return tuple(name if name.isidentifier() else f"x_{name}" for name in names)

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the FMU declares."""
        return self._equations.fmu.variables.units(self._equations.outputs)

    @override
    def initial(self) -> Mapping[str, Any]:
        return self.starting(0.0, {})

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        del t
        values = jnp.concatenate([self._inputs(inputs), self._numbers()])
        state = self._equations.initial()(0.0, values) if len(values) else self._equations.first["states"].tolist()
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
        place = jnp.concatenate([_array(z), self._inputs(inputs), self._numbers()])
        values, n = self._equations.rates()(t, place), len(self._equations.fmu.states)
        return tuple(values[:n]), {name: values[n + index] for index, name in enumerate(self._equations.outputs)}

    def _numbers(self) -> Array:
        # By name: trees of JAX sort what is in a dict.
        return _array([self.parameters[name] for name in self._equations.numbers])

    def _inputs(self, given: Mapping[str, Any]) -> Array:
        """All inputs that are no parameters: as they are given, or as the FMU has them."""
        own = dict(zip(self._equations.inputs, self._equations.first["inputs"].tolist(), strict=True))
        for name in self._equations.fmu.variables.inputs(given):
            if name not in own:
                raise ProblemError(f"FmuSystem: the input '{name}' is among the parameters; give it once.")
        return _array((own | dict(given)).values())


def _array(values: Any) -> Float[Array, " n"]:
    return jnp.array([jnp.asarray(value, dtype=float) for value in values], dtype=float)


@final
class Equations:
    """The equations of an FMU as functions of JAX; `inputs`, `outputs`: names; `first`: how they begin.

    `numbers`: its parameters with their values, as far as these are known.

    Raises `ProblemError` for an FMU whose equations do not follow from time, states, inputs and parameters.
    """

    def __init__(self, fmu: Fmu, numbers: dict[str, float | None], inputs: list[str], outputs: list[str]):
        self.fmu, self.numbers, self.inputs, self.outputs = fmu, numbers, inputs, outputs
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
        return Equations, (self.fmu, self.numbers, self.inputs, self.outputs)

    def rates(self) -> Any:
        """Rates of the states, then outputs, of the time and of states, inputs and parameters in one vector."""
        sizes = np.concatenate([self.first["nominals"], self._sizes()])
        host = partial(self._values, "rates", list(self.numbers), self.inputs, self.outputs)
        return differentiable(host, (len(self.fmu.states) + len(self.outputs),), relative_steps(_STEP, sizes))

    def initial(self) -> Any:
        """The initial state, of a time that is left aside and of inputs and parameters in one vector."""
        host = partial(self._values, "initial", [*self.inputs, *self.numbers])
        return differentiable(host, (len(self.fmu.states),), relative_steps(_STEP, self._sizes()))

    def _sizes(self) -> Float[np.ndarray, " n"]:
        return self.fmu.variables.nominals([*self.inputs, *self.numbers])

    def _values(self, method: str, *arguments: Any) -> Float[np.ndarray, "points values"]:
        """Values at points, the last argument; NaN with a `SimulationWarning` where the FMU fails.

        An exception would end a search that may well turn back.
        """
        try:
            values, reason = self.fmu.door.ask(method, *arguments, where=" at one of its equations' points")
        except SimulationError as error:
            size = len(self.fmu.states) + (len(self.outputs) if method == "rates" else 0)
            values, reason = np.full((len(arguments[-1]), size), np.nan), str(error)
        if reason:
            warnings.warn(reason, SimulationWarning, stacklevel=2)
        return values

    def _refuse_memory(self) -> None:
        """Raise `ProblemError` if values at a place depend on where the FMU was before, as those of delays do."""
        x, sizes, signs = self.first["states"], self.first["nominals"], np.cos(np.arange(len(self.first["states"])))
        rest = [self.first["inputs"], self.first["parameters"]]
        points = np.stack([np.concatenate([[0.0], x + away * signs * sizes, *rest]) for away in _AWAY])
        chosen = list(self.numbers), self.inputs, self.outputs
        values, reason = self.fmu.door.ask("rates", *chosen, points, where=" near its initial state")
        if not np.isfinite(values[0]).all():
            raise SimulationError(reason or f"FMU '{self.fmu.name}': a rate or an output is not finite at its start.")
        differences = np.abs(values[2::2] - values[0])
        if np.nanmax(differences, initial=0.0) > _REPEATED * np.max(np.abs(values[0]), initial=0.0):
            raise ProblemError(
                f"FmuSystem: expected rates that follow from time, states, inputs and parameters; those of "
                f"'{self.fmu.name}' depend on where it was before, by {np.nanmax(differences):.2g}. Use FmuSimulation."
            )
