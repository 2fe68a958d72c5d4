"""`FmuSystem`: the equations of an FMU as a system of this package."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array
from typing_extensions import override

from aleator._core.border import real, shown
from aleator._core.errors import ProblemError
from aleator._core.leaves import AbstractLeaf, transparent
from aleator.dynamics import System
from aleator.foreign._fmu._derivatives import Evaluations, Host, called_back
from aleator.foreign._fmu._description import units_of, with_numbers
from aleator.foreign._fmu._doors import Served
from aleator.foreign._fmu._equations import Field
from aleator.foreign._fmu._fmu import Fmu, fmu_given


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
    without a signal keep the FMU's initial values. Rates and outputs are differentiated by the FMU's directional
    derivatives where these agree with differences at its initial state and beside it, and by differences elsewhere;
    second derivatives are differences of these. Each evaluation calls the FMU, so that such a system is many times
    slower than one written with JAX.

    Raises `ProblemError` for an FMU with events or for co-simulation, for unknown names, and for variables that the FMU
    computes itself; `SimulationError` if it fails at its initial state.
    """

    parameters: dict[str, Any]
    _equations: "ServedField" = eqx.field(static=True)
    _held: tuple[float, ...] = eqx.field(static=True)
    _first: tuple[float, ...] = eqx.field(static=True)

    def __init__(self, fmu: Fmu, parameters: Mapping[str, Any] | None = None, *, outputs: Sequence[str] | None = None):
        fmu_given("FmuSystem", fmu)
        if not fmu.is_exchange:
            raise ProblemError(
                f"FmuSystem: expected an FMU for model exchange, which gives the rates of its states; '{fmu.name}' is "
                "used for co-simulation. Use FmuSimulation."
            )
        if not isinstance(parameters, Mapping | None):
            raise ProblemError(
                f"FmuSystem: expected numbers by the names of parameters of '{fmu.name}'; received {shown(parameters)}."
            )
        self.parameters = {name: _checked(fmu, name, value) for name, value in (parameters or {}).items()}
        variables = fmu.variables
        variables.settable(self.parameters)
        read = [variable.name for variable in variables.readable(outputs)]
        numbers = {name: value if isinstance(value, float) else None for name, value in self.parameters.items()}
        free = [one.name for one in variables.of_inputs(one for one in fmu.inputs if one not in numbers)]
        self._equations = ServedField(fmu, numbers, free, read)
        self._held, self._first = self._equations.first()

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        """The FMU's states, as names of Python."""
        names = [re.sub(r"\W", "_", name).strip("_") for name in self._equations.fmu.states]
        return tuple(name if name.isidentifier() else f"x_{name}" for name in names)

    @property
    def units(self) -> Mapping[str, str]:  # type: ignore[override]
        """The units that the FMU declares."""
        return units_of(self._equations.fmu.variables.readable(self._equations.outputs))

    @override
    def initial(self) -> Mapping[str, Any]:
        return self.starting(0.0, {})

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        given = jnp.concatenate([self._inputs(inputs), self._numbers()])
        found = called_back(self._equations.starts())(0.0, given) if len(given) else self._first
        return dict(zip(self.states, found, strict=True))

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> tuple[Array, ...]:
        return self.rates_and_outputs(t, z, **inputs)[0]

    @override
    def outputs(self, t: Any, z: Any, **inputs: Any) -> dict[str, Any]:
        return self.rates_and_outputs(t, z, **inputs)[1]

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[tuple[Array, ...], dict[str, Any]]:
        del args
        n = self._equations.n
        given = [jnp.stack([*map(_number, z)]) if n else jnp.zeros(0), self._inputs(inputs), self._numbers()]
        found = called_back(self._equations.evaluations())(t, jnp.concatenate(given))
        return tuple(found[:n]), {name: found[n + index] for index, name in enumerate(self._equations.outputs)}

    def _numbers(self) -> Array:
        # By name: trees of JAX sort what is in a dict.
        values = [self.parameters[name] for name in self._equations.parameters]
        return jnp.array([_number(value) for value in values], dtype=float)

    def _inputs(self, given: Mapping[str, Any]) -> Array:
        """All inputs that are no parameters: as they are given, or as the FMU has them."""
        taken = self._equations.inputs
        unknown = [name for name in given if name not in taken]
        if unknown:
            self._equations.fmu.variables.of_inputs(unknown)
            raise ProblemError(f"FmuSystem: the input '{unknown[0]}' is among the parameters; give it once.")
        values = zip(taken, self._held, strict=True)
        return jnp.array([_number(given.get(name, held)) for name, held in values], dtype=float)


def _checked(fmu: Fmu, name: str, value: Any) -> Any:
    """A number of the system, which may be a leaf, or traced."""
    if isinstance(value, AbstractLeaf | Tracer):
        return value
    return real(f"FMU '{fmu.name}': '{name}'", np.asarray(value) if isinstance(value, jax.Array) else value)


def _number(value: Any) -> Array:
    return jnp.asarray(value, dtype=float)


@final
class ServedField:
    """The equations of an FMU: those of a `Field`, wherever its library is loaded.

    `numbers`: its parameters with their values, as far as these are known; `inputs`, `outputs`: names.
    """

    def __init__(self, fmu: Fmu, numbers: dict[str, float | None], inputs: list[str], outputs: list[str]):
        self.fmu, self.inputs, self.outputs = fmu, inputs, outputs
        self.parameters, self._numbers, self.n = list(numbers), numbers, len(fmu.states)
        self._served = Served(fmu.door, Field, numbers, inputs, outputs)

    def __reduce__(self) -> tuple[Any, ...]:
        """Sent to other processes as what it was made of."""
        return ServedField, (self.fmu, self._numbers, self.inputs, self.outputs)

    def first(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The FMU's own values of the inputs, and its states at the start."""
        u, x = self._served.ask("first", where=lambda: " near its initial state")
        return tuple(u), tuple(x)

    def evaluations(self) -> Evaluations:
        """Rates and outputs, of the time and of states, inputs and parameters in one vector."""
        return self._of("rates", [*self.fmu.states, *self.inputs, *self.parameters], self.n + len(self.outputs))

    def starts(self) -> Evaluations:
        """The initial state, of inputs and parameters in one vector."""
        return self._of("start", [*self.inputs, *self.parameters], self.n)

    def _of(self, method: str, names: list[str], size: int) -> Evaluations:
        def asked(method: str) -> Host:
            return lambda t, z: self._served.ask(
                method, t, z, where=lambda: f" at t = {t:.6g} s{with_numbers(names, z)}"
            )

        return Evaluations(asked(method), asked(f"{method}_jacobian"), asked(f"{method}_hessian"), size)
