"""Differential equations, formulas and equations of motion (`sympy.physics.mechanics`) of SymPy as systems."""

from collections.abc import Iterable, Mapping
from typing import Any, final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import one_of, refusal
from aleator._core.errors import ProblemError
from aleator._core.functions import returned
from aleator._core.leaves import transparent
from aleator.dynamics import AbstractCombined, AlgebraicSystem
from aleator.dynamics._system import state_type
from aleator.foreign._sympy_expressions import (
    AbstractFromSymPy,
    Program,
    contents_of,
    expression,
    expressions_by_name,
    load_sympy,
    name_of,
    number_of,
    numbers_by_name,
    refuse_others,
    refuse_unknown,
    symbols_given,
    time_symbol,
    units_given,
    written,
)
from aleator.mechanics import AbstractMechanical, Motion

# --- Differential equations -------------------------------------------------------------------------------------------


@final
@transparent("numbers")
class SymPySystem(AbstractFromSymPy, AbstractCombined):
    """A system from differential equations of SymPy; made by `al.foreign.from_sympy`.

    Programs take the states, the inputs, the numbers and the time; `formulas` the states' rates besides; `begins`, the
    initial values that are expressions, the numbers alone.
    - `rates`: with the entries of the matrix before them, row by row, if there is one.
    """

    start: dict[str, Any]
    states: tuple[str, ...] = eqx.field(static=True)  # type: ignore[assignment]
    further_inputs: tuple[str, ...] = eqx.field(static=True)  # type: ignore[assignment]
    rates: Program = eqx.field(static=True)
    begins: Program = eqx.field(static=True)

    @override
    def initial(self) -> Mapping[str, Any]:
        return {**self.start, **self.begins.by_name(self._values())}

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> tuple[Array, ...]:
        # Alone: they are traced at each stage of a step.
        return self._rates(self._at(t, z, inputs))

    @override
    def rates_and_outputs(self, t: Any, z: Any, *args: Any, **inputs: Any) -> tuple[Any, dict[str, Array]]:
        values = self._at(t, z, inputs)
        rates = self._rates(values)
        return rates, self.formulas.by_name([*values, *rates])

    def _at(self, t: Any, z: Any, inputs: Mapping[str, Any]) -> list[Any]:
        return [*z, *(inputs[name] for name in self.further_inputs), *self._values(), t]

    def _rates(self, values: list[Any]) -> tuple[Array, ...]:
        n, found = len(self.states), self.rates(values)
        rates, mass = tuple(found[:n]), found[n:]
        return tuple(jnp.linalg.solve(jnp.stack(mass).reshape(n, n), jnp.stack(rates))) if mass else rates


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
    who, sympy, time = "from_sympy", load_sympy("from_sympy"), time_symbol()
    rates = {
        state: expression(f"{who}: the rate of '{state}'", rate)
        for state, rate in symbols_given(f"{who}: rates", rates).items()
    }
    states, size = tuple(rates), len(rates)
    if mass_matrix is not None and getattr(mass_matrix, "shape", None) != (size, size):
        raise refusal(f"{who}: mass_matrix", f"a SymPy matrix of shape ({size}, {size})", mass_matrix)
    mass = [expression(f"{who}: mass_matrix", entry) for entry in ([] if mass_matrix is None else mass_matrix)]
    outputs = {name_of(state): state for state in states} if outputs is None else outputs
    formulas = expressions_by_name(f"{who}: outputs", outputs)
    constant = symbols_given(f"{who}: start", {} if start is None else start)
    refuse_unknown(f"{who}: start", constant, states)
    symbolic = [state for state, value in constant.items() if isinstance(value, sympy.Basic)]
    follow = {state: expression(f"{who}: start", constant.pop(state)) for state in symbolic}

    functions, _, symbols = contents_of(who, [*rates.values(), *mass, *formulas.values(), *follow.values()])
    inputs = [function for function in functions if function not in states]
    parameters = [symbol for symbol in symbols if symbol not in (*states, time)]
    given = numbers_by_name(who, (*states, *inputs), parameters, symbols_given(f"{who}: numbers", numbers))
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
    return SymPySystem(
        numbers=given,
        start={name_of(state): number_of(f"{who}: start", state, value) for state, value in constant.items()},
        states=state_names,
        further_inputs=tuple(map(name_of, inputs)),
        rates=written(f"{who}: rates", [*rates.values(), *mass], known, unsolved),
        formulas=written(
            f"{who}: outputs",
            {name: formula.xreplace(slopes) for name, formula in formulas.items()},
            [*known, *dots.values()],
            "Of derivatives, the rates of states may stand there; give an input's as an input of its own.",
        ),
        begins=written(
            f"{who}: start",
            {name_of(state): value for state, value in follow.items()},
            parameters,
            "Give numbers, or expressions of parameters.",
        ),
        declared=units_given(who, units),
    )


@final
@transparent("numbers")
class SymPyFormulas(AbstractFromSymPy, AlgebraicSystem):
    """A system without time from formulas of SymPy; made by `al.foreign.from_sympy_formulas`."""

    @override
    def outputs(self) -> dict[str, Array]:
        return self.formulas.by_name(self._values())


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
    *_, symbols = contents_of(who, formulas.values())
    given = numbers_by_name(who, (), symbols, symbols_given(f"{who}: numbers", numbers))
    program = written(who, formulas, symbols, "Use al.foreign.from_sympy for a system that moves.")
    return SymPyFormulas(numbers=given, formulas=program, declared=units_given(who, units))


# --- Equations of motion ----------------------------------------------------------------------------------------------


@final
@transparent("numbers")
class SymPyMechanical(AbstractFromSymPy, AbstractMechanical):
    """A mechanical system from SymPy; made by `al.foreign.from_kane` and `al.foreign.from_lagrange`.

    Programs take the coordinates and the numbers; the other ones what is said besides.
    - `forces`: those on the left-hand side at zero torque, of the speeds too; `effect`: that of the torques, `B`, row
      by row; `rates`: the map `H` from speeds to the coordinates' rates, row by row; none where these are the same;
    - `formulas`: the outputs, of speeds, torques, rates of speeds, rates and accelerations of coordinates, and SymPy's
      multipliers.
    """

    coordinates: tuple[str, ...] = eqx.field(static=True, default=())  # type: ignore[assignment]
    speeds: tuple[str, ...] = eqx.field(static=True, default=())  # type: ignore[assignment]
    actuators: tuple[str, ...] = eqx.field(static=True, default=())  # type: ignore[assignment]
    closed: Program = eqx.field(static=True, kw_only=True)
    mass: Program = eqx.field(static=True, kw_only=True)
    forces: Program = eqx.field(static=True, kw_only=True)
    effect: Program = eqx.field(static=True, kw_only=True)
    rates: Program | None = eqx.field(static=True, kw_only=True)

    @property
    def constraint_names(self) -> tuple[str, ...]:  # type: ignore[override]
        """`constraint_1` and so on."""
        return tuple(f"constraint_{i}" for i in range(1, self.closed.count + 1))

    @property
    @override
    def moves_directly(self) -> bool:
        return self.rates is None

    @override
    def mass_matrix(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds speeds"]:
        return self._matrix(self.mass, q, len(self.speeds), len(self.speeds))

    @override
    def bias(self, q: Float[Array, " coordinates"], v: Float[Array, " speeds"]) -> Float[Array, " speeds"]:
        return jnp.stack(self.forces([*self._posture(q), *v]))

    @override
    def actuation(self, q: Float[Array, " coordinates"]) -> Float[Array, "speeds actuators"]:
        return self._matrix(self.effect, q, len(self.speeds), len(self.actuators))

    @override
    def velocity_map(self, q: Float[Array, " coordinates"]) -> Float[Array, "coordinates speeds"]:
        if self.rates is None:
            return jnp.eye(len(self.coordinates))
        return self._matrix(self.rates, q, len(self.coordinates), len(self.speeds))

    @override
    def constraint(self, q: Float[Array, " coordinates"]) -> Float[Array, " constraints"]:
        return self._matrix(self.closed, q, self.closed.count)

    @override
    def outputs(self, motion: Motion) -> dict[str, Array]:
        at = motion
        values = [*self._posture(at.q), *at.v, *at.torque, *at.v_dot, *at.q_dot, *at.q_ddot, *-at.multipliers]
        return self.formulas.by_name(values)

    def _posture(self, q: Array) -> list[Any]:
        return [*q, *self._values()]

    def _matrix(self, program: Program, q: Array, *shape: int) -> Array:
        entries = program(self._posture(q))
        return jnp.stack(entries).reshape(shape) if entries else jnp.zeros(shape)


def from_kane(
    kane: Any,
    numbers: Mapping[Any, Any],
    *,
    outputs: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
) -> SymPyMechanical:
    """A mechanical system from a `sympy.physics.mechanics.KanesMethod` whose `kanes_equations` have been formed.

        model = al.foreign.from_kane(kane, {m: 1.0, l: al.Normal(1.0, 0.01), g: 9.81})
        system = al.ForwardDynamics(model, start={"theta": 0.5})

    - `numbers`: a number, distribution or decision for each symbol of the equations; each has the symbol's name. A
      function of time that is no coordinate or speed, such as a wind, may be given here too, as a number or a signal;
      all others are actuators, which must enter linearly, by factors that depend on the coordinates alone;
    - `outputs`: expressions by name of coordinates, speeds, actuators and their rates, besides the standard outputs;
    - `units`: the units of outputs by name, for reports.

    Coordinates, speeds and actuators have SymPy's names, and each formulation takes the model: `al.ForwardDynamics`,
    `al.InverseDynamics`, `al.HybridDynamics`.

    Raises `ProblemError` for symbols without a number, for numbers that are not used, for dependent coordinates or
    speeds, for equations that contain the time, and for functions that JAX lacks; `MissingExtraError` without SymPy.
    """
    sympy, who = load_sympy("from_kane"), "from_kane"
    one_of(who, kane, sympy.physics.mechanics.KanesMethod)
    if len(kane._udep) or len(kane._qdep):
        raise ProblemError(
            f"{who}: expected independent coordinates and speeds; received dependent ones: "
            f"{[*kane._qdep, *kane._udep]}. Use LagrangesMethod with hol_coneqs and from_lagrange, or from_sympy with "
            "mass_matrix_full and forcing_full."
        )
    mass, forcing = returned(f"{who}: kanes_equations(), to be called first,", lambda: (kane.mass_matrix, kane.forcing))
    rates = kane.kindiffdict()
    kinematics = sympy.Matrix([rates[coordinate.diff(time_symbol())] for coordinate in kane.q])
    equations = [*kane.q], [*kane.u], mass.xreplace(rates), forcing.xreplace(rates), kinematics, [], []
    return _mechanical(who, equations, numbers, outputs, units)


def from_lagrange(
    lagrange: Any,
    numbers: Mapping[Any, Any],
    *,
    outputs: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
) -> SymPyMechanical:
    """A mechanical system from a `sympy.physics.mechanics.LagrangesMethod` whose equations have been formed.

        lagrange.form_lagranges_equations()
        model = al.foreign.from_lagrange(lagrange, {m: 1.0, l: al.Normal(1.0, 0.01), g: 9.81})

    Arguments, names and errors are those of `al.foreign.from_kane`; speeds are the coordinates' rates, `<name>_rate`.
    Holonomic constraints (`hol_coneqs`) become the model's `constraint_1`, ...: positions and velocities satisfy them,
    and no gains are needed. SymPy's multipliers may stand in `outputs`; the standard output `constraint_1_multiplier`
    has the other sign (see `al.Lagrangian`). Nonholonomic constraints are refused.
    """
    sympy, who = load_sympy("from_lagrange"), "from_lagrange"
    one_of(who, lagrange, sympy.physics.mechanics.LagrangesMethod)
    formed = f"{who}: form_lagranges_equations(), to be called first,"
    mass, forcing = returned(formed, lambda: (lagrange.mass_matrix, lagrange.forcing))
    constraints, q = [*lagrange._hol_coneqs], [*lagrange.q]
    if len(lagrange.coneqs) > len(constraints):
        raise ProblemError(
            f"{who}: expected holonomic constraints, hol_coneqs; received nonholonomic ones. Use KanesMethod, and "
            "from_sympy with its mass_matrix_full and forcing_full."
        )
    v = [coordinate.diff(time_symbol()) for coordinate in q]
    equations = q, v, mass[:, : len(q)], forcing, sympy.Matrix(v), constraints, [*lagrange.lam_vec]
    return _mechanical(who, equations, numbers, outputs, units)


def _mechanical(who: str, equations: tuple[Any, ...], numbers: Any, outputs: Any, units: Any) -> SymPyMechanical:
    """The system with `M v̇ = forcing`, `q̇ = kinematics` and `constraints = 0`, which have multipliers."""
    q, v, mass, forcing, kinematics, constraints, multipliers = equations
    sympy, time = load_sympy(who), time_symbol()
    numbers = symbols_given(f"{who}: numbers", numbers)
    formulas = expressions_by_name(f"{who}: outputs", {} if outputs is None else outputs)
    functions, _, symbols = contents_of(who, [*mass, *forcing, *kinematics, *constraints])
    free = [function for function in functions if function not in (*q, *v)]
    torques = [function for function in free if function not in numbers]
    *_, further = contents_of(f"{who}: outputs", formulas.values())
    parameters = sorted({*symbols, *further, *free} - {*torques, time}, key=name_of)
    given = numbers_by_name(who, (*q, *v, *torques), parameters, numbers)
    posture = [*q, *parameters]
    forms, drift = kinematics.jacobian(v), kinematics.xreplace(dict.fromkeys(v, 0))
    if any(not rate.equals(0) for rate in drift):
        raise refusal(who, "rates of coordinates that are linear in the speeds, without further terms", [*kinematics])
    refuse_others(
        f"{who}: the forces",
        forcing,
        [*posture, *v, *torques],
        "Make a motion that is prescribed a coordinate, and prescribe it by al.HybridDynamics; put a function of time "
        "(dynamicsymbols) in the place of the time itself, and give it in numbers as a signal.",
    )
    bias = -forcing.xreplace(dict.fromkeys(torques, sympy.S.Zero))
    effect = forcing.jacobian(torques) if torques else sympy.zeros(len(v), 0)

    def at_posture(what: str, expressions: Iterable[Any]) -> Program:
        linear = (
            "Actuators and speeds enter linearly, by factors that depend on the coordinates alone; give others in "
            "numbers, as a number or a signal."
        )
        return written(f"{who}: {what}", expressions, posture, linear)

    # Of Lagrange's method the rates of speeds are the accelerations too.
    dots = [*(speed.diff(time) for speed in v), *(q_i.diff(time) for q_i in q), *(q_i.diff(time, 2) for q_i in q)]
    meaning = "Expected coordinates, speeds, their rates, actuators and what is given in numbers."
    return SymPyMechanical(
        numbers=given,
        coordinates=tuple(map(name_of, q)),
        speeds=tuple(map(name_of, v)),
        actuators=tuple(map(name_of, torques)),
        closed=at_posture("constraints", constraints),
        mass=at_posture("the mass matrix", mass),
        forces=written(who, bias, [*posture, *v]),
        effect=at_posture("the effect of an actuator", effect),
        rates=None if forms == sympy.eye(len(q)) else at_posture("the rates of coordinates", forms),
        formulas=written(f"{who}: outputs", formulas, [*posture, *v, *torques, *dots, *multipliers], meaning),
        declared=units_given(who, units),
    )
