"""Differential equations and formulas of SymPy as systems."""

from collections.abc import Mapping, Sequence
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array
from typing_extensions import override

from aleator._core.border import refusal
from aleator._core.leaves import transparent
from aleator.dynamics import AlgebraicSystem, System
from aleator.dynamics._system import state_type
from aleator.foreign._sympy_expressions import (
    Program,
    contents_of,
    expression,
    expressions_by_name,
    load_sympy,
    name_of,
    number_of,
    numbers_by_name,
    refuse_unknown,
    symbols_given,
    time_symbol,
    units_given,
    written,
)

_WHO = "from_sympy"


@final
@transparent("numbers")
class SymPySystem(System):
    """A system from differential equations of SymPy; made by `al.foreign.from_sympy`.

    What is compiled is determined by its structure, which are all fields but `numbers` and `start`. Programs take the
    states, the inputs, the parameters and the time; `formulas`, the outputs, the states' rates besides; `begins`, the
    initial values that are expressions, the parameters alone.
    - `mass`: the entries of the matrix before the rates, row by row; none where the rates are explicit.
    """

    numbers: dict[str, Any]
    start: dict[str, Any]
    states: tuple[str, ...] = eqx.field(static=True)  # type: ignore[assignment]
    further_inputs: tuple[str, ...] = eqx.field(static=True)  # type: ignore[assignment]
    parameters: tuple[str, ...] = eqx.field(static=True)
    rates: Program = eqx.field(static=True)
    mass: Program | None = eqx.field(static=True)
    formulas: Program = eqx.field(static=True)
    begins: Program = eqx.field(static=True)
    declared: tuple[tuple[str, str], ...] = eqx.field(static=True)

    units = property(lambda self: dict(self.declared))  # type: ignore[assignment]

    @override
    def initial(self) -> Mapping[str, Any]:
        return {**self.start, **self.begins.by_name(self._parameters())}

    @override
    def rhs(self, t: Any, z: Any, /, **inputs: Any) -> tuple[Array, ...]:
        return self._rates(self._values(t, z, inputs))

    @override
    def outputs(self, t: Any, z: Any, /, **inputs: Any) -> dict[str, Array]:
        return self.rates_and_outputs(t, z, **inputs)[1]

    @override
    def rates_and_outputs(self, t: Any, z: Any, /, **inputs: Any) -> tuple[tuple[Array, ...], dict[str, Array]]:
        values = self._values(t, z, inputs)
        rates = self._rates(values)
        return rates, self.formulas.by_name([*values, *rates])

    def _parameters(self) -> list[Any]:
        return [self.numbers[name] for name in self.parameters]

    def _values(self, t: Any, z: Any, inputs: Mapping[str, Any]) -> list[Any]:
        return [*z, *(inputs[name] for name in self.further_inputs), *self._parameters(), t]

    def _rates(self, values: Sequence[Any]) -> tuple[Array, ...]:
        rates = self.rates(values)
        if self.mass is None:
            return tuple(rates)
        mass = jnp.stack(self.mass(values)).reshape(len(rates), len(rates))
        return tuple(jnp.linalg.solve(mass, jnp.stack(rates)))


def from_sympy(
    rates: Mapping[Any, Any],
    numbers: Mapping[Any, Any],
    *,
    mass_matrix: Any = None,
    outputs: Mapping[str, Any] | None = None,
    start: Mapping[Any, Any] | None = None,
    units: Mapping[str, str] | None = None,
) -> SymPySystem:
    """A dynamical system, an `al.System`, from SymPy expressions: `dz/dt = rates`.

        x, v, road = dynamicsymbols("x v road")
        m, k, c = sympy.symbols("m k c")
        spring = al.foreign.from_sympy(
            {x: v, v: (k * (road - x) - c * v) / m}, {m: al.Normal(2.0, 0.1), k: al.Decision(8e3, 500.0, 50e3), c: 50.0}
        )

    - `rates`: the rate of each state, by the state: a function of time, `x(t)`, or a plain symbol. Functions of time
      without a rate are inputs, given as signals in `al.Problem(inputs=...)`; SymPy's `t` is the time;
    - `numbers`: a number, distribution or decision for each of the other symbols; each has the symbol's name;
    - `mass_matrix`: `M` of `M dz/dt = rates`, a square matrix, such as the `mass_matrix_full` of SymPy's mechanics;
    - `outputs`: expressions by name, which may contain rates, `x.diff(t)`; the states by default;
    - `start`: initial values by state: numbers, distributions, decisions, or expressions of the symbols in `numbers`;
      zero for the others;
    - `units`: the units of outputs by name, for reports.

    Raises `ProblemError` for symbols without a number, for numbers that are not used, for equations that are not solved
    for the rates, and for functions that JAX lacks; `MissingExtraError` without SymPy.
    """
    sympy, time = load_sympy(_WHO), time_symbol()
    rates = {
        state: expression(f"{_WHO}: the rate of '{state}'", rate)
        for state, rate in symbols_given(f"{_WHO}: rates", rates).items()
    }
    states, size = tuple(rates), len(rates)
    if mass_matrix is not None and getattr(mass_matrix, "shape", None) != (size, size):
        raise refusal(f"{_WHO}: mass_matrix", f"a SymPy matrix of shape ({size}, {size})", mass_matrix)
    mass = [expression(f"{_WHO}: mass_matrix", entry) for entry in ([] if mass_matrix is None else mass_matrix)]
    outputs = {name_of(state): state for state in states} if outputs is None else outputs
    formulas = expressions_by_name(f"{_WHO}: outputs", outputs)
    begun = symbols_given(f"{_WHO}: start", {} if start is None else start)
    refuse_unknown(f"{_WHO}: start", begun, states)
    follow = {
        state: expression(f"{_WHO}: start", value) for state, value in begun.items() if isinstance(value, sympy.Basic)
    }

    found = contents_of(_WHO, [*rates.values(), *mass, *formulas.values(), *follow.values()])
    inputs = [symbol for symbol in found.functions if symbol not in states]
    parameters = [symbol for symbol in found.symbols if symbol not in (*states, time)]
    given = numbers_by_name(_WHO, (*states, *inputs), parameters, symbols_given(f"{_WHO}: numbers", numbers))
    state_names = tuple(map(name_of, states))
    state_type(state_names)

    # What derivatives in outputs mean: the first ones of states, and second ones where the first is a state. Plain
    # symbols have no derivatives by time: SymPy gives zero.
    dots, slopes = {state: sympy.Dummy(f"{name_of(state)}_rate") for state in states}, dict[Any, Any]()
    for state, rate in ((state, rate) for state, rate in rates.items() if state.is_Function):
        slopes[state.diff(time)] = dots[state]
        if not mass and rate in rates:
            slopes[state.diff(time, 2)] = dots[rate]
    known = [*states, *inputs, *parameters, time]
    unsolved = "Solve the equations for the rates (sympy.solve), or give their matrix as mass_matrix."
    constant = {state: value for state, value in begun.items() if state not in follow}
    return SymPySystem(
        numbers=given,
        start={name_of(state): number_of(f"{_WHO}: start", state, value) for state, value in constant.items()},
        states=state_names,
        further_inputs=tuple(map(name_of, inputs)),
        parameters=tuple(given),
        rates=written(f"{_WHO}: rates", rates.values(), known, unsolved),
        mass=written(f"{_WHO}: mass_matrix", mass, known, unsolved) if mass else None,
        formulas=written(
            f"{_WHO}: outputs",
            {name: formula.xreplace(slopes) for name, formula in formulas.items()},
            [*known, *dots.values()],
            "Of derivatives, the rates of states may stand there; give an input's as an input of its own.",
        ),
        begins=written(
            f"{_WHO}: start",
            {name_of(state): value for state, value in follow.items()},
            parameters,
            "Give numbers, or expressions of parameters.",
        ),
        declared=tuple(units_given(_WHO, units).items()),
    )


@final
@transparent("numbers")
class SymPyFormulas(AlgebraicSystem):
    """A system without time from formulas of SymPy; made by `al.foreign.from_sympy_formulas`."""

    numbers: dict[str, Any]
    parameters: tuple[str, ...] = eqx.field(static=True)
    formulas: Program = eqx.field(static=True)
    declared: tuple[tuple[str, str], ...] = eqx.field(static=True)

    units = property(lambda self: dict(self.declared))  # type: ignore[assignment]

    @override
    def outputs(self) -> dict[str, Array]:
        return self.formulas.by_name([self.numbers[name] for name in self.parameters])


def from_sympy_formulas(
    outputs: Mapping[str, Any], numbers: Mapping[Any, Any], *, units: Mapping[str, str] | None = None
) -> SymPyFormulas:
    """A system without time, an `al.AlgebraicSystem`, from SymPy expressions.

        F, L, E, I = sympy.symbols("F L E I")
        beam = al.foreign.from_sympy_formulas({"sag": F * L**3 / (3 * E * I)}, {F: al.Normal(1e3, 50.0), L: 1.0, ...})

    - `outputs`: expressions by name;
    - `numbers`, `units`: as in `al.foreign.from_sympy`, with the same errors.
    """
    who = "from_sympy_formulas"
    formulas = expressions_by_name(f"{who}: outputs", outputs)
    symbols = contents_of(who, formulas.values()).symbols
    given = numbers_by_name(who, (), symbols, symbols_given(f"{who}: numbers", numbers))
    program = written(who, formulas, symbols, "Use al.foreign.from_sympy for a system that moves.")
    return SymPyFormulas(given, tuple(given), program, tuple(units_given(who, units).items()))
