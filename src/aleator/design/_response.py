"""The parts of a problem, and the response of its system: realisation by realisation, one system, its own numbers."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import NUMBER, jax_array, numbers_to_arrays, refuse_beyond_memory
from aleator._core.compilation import Compiled, Use
from aleator._core.equations import Digest
from aleator._core.errors import ProblemError
from aleator._core.leaves import Module, Printed
from aleator.design._expression import Constraint, Expression
from aleator.design._functionals import AbstractIntegral, At, FloquetMultiplier, events_of
from aleator.design._residuals import ROUNDED, Measured
from aleator.design._scope import AbstractScopeOfInstants, Value
from aleator.design._statistic import AbstractFunctional, Statistic, Taken, functionals_of, numbers_of
from aleator.dynamics import (
    AbstractGrid,
    AbstractIntegrator,
    AbstractSystem,
    Asked,
    Grid,
    History,
    Record,
    Simulation,
    System,
    needed,
)
from aleator.expansion import Expansion, MultiElement
from aleator.feedback import Noisy
from aleator.statistics import AbstractStatistic
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import Placements, at_means, named_numbers, placements, realise

# Numbers at each instant besides: the inputs at all stages, and 32 systems on three times as many steps in the check of
# an answer.
_AT_INSTANT = 128


class AbstractProblem(Module, Printed):
    """The parts of a problem and what follows from them; implemented by `Problem` alone.

    `physics` is the digest of its traced equations, with those of its expressions. All programs are built from the
    equations as they were declared: to change code, declare again.
    """

    simulation: Simulation
    objective: Expression
    constraints: tuple[Constraint, ...]
    expansion: Expansion | MultiElement
    physics: Digest = eqx.field(static=True)

    @property
    def is_declared(self) -> bool:
        """Whether its digest tells all code in it: not a user's statistics, or what is behind `jax.pure_callback`."""
        return self.physics.is_whole

    @property
    def system(self) -> AbstractSystem:
        """The system."""
        return self.simulation.system

    @property
    def inputs(self) -> dict[str, AbstractSignal]:
        """A signal for each input of the system, by name."""
        return self.simulation.inputs

    @property
    def grid(self) -> AbstractGrid:
        """The instants."""
        return self.simulation.grid

    @property
    def integrator(self) -> AbstractIntegrator:
        """How states are advanced in time."""
        return self.simulation.integrator

    @property
    def is_integrated(self) -> bool:
        """Whether its system has states, which are integrated over time."""
        return self.system.is_integrated

    @property
    def has_noise(self) -> bool:
        """Whether white noise moves its states, whose covariance each realisation carries."""
        return any(isinstance(one.system, Noisy) for one in self.simulation.phases.values())

    @property
    def placements(self) -> Placements:
        """Its distributions and decisions."""
        return placements(self.simulation)

    @property
    def expressions(self) -> tuple[Expression, ...]:
        """The objective, then the constraints' expressions."""
        return (self.objective, *(constraint.expression for constraint in self.constraints))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the constraints, each once."""
        return tuple(dict.fromkeys(constraint.name for constraint in self.constraints))

    def named(self, name: str) -> tuple[Constraint, ...]:
        """The constraints of one name. Raises `ProblemError` if there are none."""
        constraints = tuple(constraint for constraint in self.constraints if constraint.name == name)
        if not constraints:
            raise ProblemError(f"There is no constraint '{name}'; expected one of {list(self.names)}.")
        return constraints


def history(problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> History:
    """Time histories of all outputs of one realisation; NaN where an event that the problem names does not happen."""
    asked = Asked(events=events_of(functionals_of(problem.expressions)))
    return realise(problem.simulation, germ, decisions).record(asked).history


def grid_at(problem: AbstractProblem, decisions: Float[Array, " n"]) -> AbstractGrid:
    """The problem's grid, with the decided final time; the latest one where an event ends it."""
    return realise(at_means(problem.simulation), jax_array(np.zeros(0)), decisions).grid


def _instants(problem: AbstractProblem, decisions: Float[Array, " n"]) -> Array:
    return realise(at_means(problem.simulation), jnp.zeros(0), decisions).record(Asked(frozenset())).grid.times


_INSTANTS = Compiled(_instants, use=Use.BRIEF)


def instants_at(problem: AbstractProblem, decisions: Float[np.ndarray, " n"]) -> Float[np.ndarray, " instants"]:
    """The instants of the grid, s: those at the means, where each realisation has its own."""
    if ends_by_event(problem):
        return np.asarray(_INSTANTS(numbers_to_arrays(problem), jax_array(decisions)))
    return np.asarray(grid_at(problem, jax_array(decisions)).times)


def _ends(
    problem: AbstractProblem,
    places: tuple[str, ...],
    germ: Float[Array, "points variables"],
    decisions: Float[Array, " n"],
) -> Float[Array, "points places"]:
    def ends(germ: Array) -> Array:
        grid = realise(problem.simulation, germ, decisions).record(Asked(frozenset())).grid
        return jnp.stack([jnp.asarray(grid.of(place).t_final) for place in places])

    return jax.vmap(ends)(germ)


_ENDS = Compiled(_ends, use=Use.ONCE)


def behind_end(
    problem: AbstractProblem, germ: Float[np.ndarray, "points variables"], decisions: Float[np.ndarray, " n"]
) -> str:
    """A sentence on data that are compared with an output of a system that has ended before; empty if there are none.

    `germ`: the points at which systems are simulated.
    """
    measured = [one for one in functionals_of(problem.expressions) if isinstance(one, Measured)]
    if not (measured and ends_by_event(problem)):
        return ""
    places = tuple(one.place for one in measured)
    ends = np.asarray(_ENDS(numbers_to_arrays(problem), places, jax_array(germ), jax_array(decisions))).min(axis=0)
    for one, end in zip(measured, ends.tolist(), strict=True):
        if max(one.times) > end + ROUNDED * abs(end):
            return (
                f"residuals of '{one.output}' compare a datum at {max(one.times):.4g} s with a motion that "
                f"'{problem.grid.of(one.place).until}' ends at {end:.4g} s: leave out data behind the end, or take a "
                "grid that ends later"
            )
    return ""


def ends_by_event(problem: AbstractProblem) -> bool:
    """Whether each realisation ends at a time of its own."""
    return getattr(problem.grid, "until", None) is not None


def needed_events(problem: AbstractProblem) -> tuple[str, ...]:
    """The events that simulations of a problem look for."""
    system, grid = problem.system, problem.grid
    if not (isinstance(system, System) and isinstance(grid, Grid)):
        return ()
    return needed(system, grid, events_of(functionals_of(problem.expressions)))


def divides_steps(problem: AbstractProblem) -> bool:
    """Whether steps are divided at events, or cycles sought: a step then has many equations of single numbers."""
    return bool(needed_events(problem)) or getattr(problem.grid, "periodic", False)


def step_at(problem: AbstractProblem, decisions: Float[Array, " n"]) -> Array:
    """The time between two instants, s; 1 where there is no time."""
    return jnp.asarray(grid_at(problem, decisions).step)


def responses(
    problem: AbstractProblem,
    functionals: tuple[AbstractFunctional, ...],
    germ: Float[Array, "points variables"],
    decisions: Float[Array, " n"],
) -> tuple[Float[Array, "points ..."], ...]:
    """Each functional at each germ point: a tuple of arrays whose first axis is the points."""
    return sampled(problem, functionals, (), germ, decisions).values


class Sampled(NamedTuple):
    """The response of one realisation or, with a further axis of germ points, of a family of them.

    - `values`: of each functional; `nodes`: of each of some paths, at the instants and at the midpoints of steps.
    """

    values: tuple[Float[Any, "..."], ...]
    nodes: tuple[Float[Any, "..."], ...]


def sample(
    problem: AbstractProblem,
    functionals: tuple[AbstractFunctional, ...],
    paths: tuple[AbstractFunctional, ...],
    germ: Float[Array, " variables"],
    decisions: Float[Array, " n"],
    courses: Mapping[str, Float[Array, "parts states"]] | None = None,
) -> Sampled:
    """Functionals of one realisation; those in `paths` at the midpoints of steps too.

    - `courses`: the states from which parts of the time are simulated, see `Asked.courses`.
    """
    asked = asked_for(functionals)._replace(nodes=_outputs(paths), courses=courses, directions=decisions.size)
    record = realise(problem.simulation, germ, decisions).record(asked)
    return Sampled(
        numbers_of(functionals, taken_from(record, functionals), record.grid),
        numbers_of(paths, Taken(record.nodes, {}), record.grid),
    )


def sampled(
    problem: AbstractProblem,
    functionals: tuple[AbstractFunctional, ...],
    paths: tuple[AbstractFunctional, ...],
    germ: Float[Array, "points variables"],
    decisions: Float[Array, " n"],
) -> Sampled:
    """Functionals at each germ point, the first axis; those in `paths` at the midpoints of steps too."""
    return jax.vmap(lambda point: sample(problem, functionals, paths, point, decisions))(germ)


def asked_for(functionals: tuple[AbstractFunctional, ...]) -> Asked:
    """What a simulation records for functionals."""
    integrals = tuple(one for one in functionals if isinstance(one, AbstractIntegral))
    return Asked(
        instants=_outputs(one for one in functionals if not isinstance(one, AbstractIntegral | At)),
        integrands=tuple(one.integrand for one in integrals),
        integrated=tuple(_outputs([one]) for one in integrals),
        events=events_of(functionals),
        at_events=_outputs(one for one in functionals if isinstance(one, At)),
        multipliers=any(isinstance(one, FloquetMultiplier) for one in functionals),
    )


def taken_from(record: Record, functionals: tuple[AbstractFunctional, ...]) -> Taken:
    """The data for functionals in a record of what is `asked_for` them."""
    integrals = (one for one in functionals if isinstance(one, AbstractIntegral))
    integrated: dict[AbstractFunctional, Any] = dict(zip(integrals, record.integrals, strict=True))
    return Taken(record.history, integrated, record.events or {}, record.monodromy)


def _outputs(functionals: Iterable[AbstractFunctional]) -> frozenset[str]:
    return frozenset(name for one in functionals for name in one.outputs)


class Broken(NamedTuple):
    """The first non-finite output: its name, and the indices of the realisation and of the instant among all."""

    name: str
    point: int
    instant: int


def first_broken(outputs: Mapping[str, Float[np.ndarray, "points instants ..."]], grid: AbstractGrid) -> Broken | None:
    """The earliest value of some realisations that is not finite; None if all are."""
    broken = []
    for name, values in outputs.items():
        bad = np.asarray(~np.isfinite(values.reshape(*values.shape[:2], -1)).all(axis=2))
        if bad.any():
            instant = int(np.argmax(bad.any(axis=0)))
            broken.append(Broken(name, int(np.argmax(bad[:, instant])), (grid.where(name).start or 0) + instant))
    return min(broken, key=lambda one: one.instant, default=None)


def unsolved(problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> str:
    """Why one realisation has no solution, as far as its equations or its integrator can tell; empty if it has."""
    return realise(problem.simulation, germ, decisions).explain(events_of(functionals_of(problem.expressions)))


@final
class OneSystem(AbstractScopeOfInstants):
    """A single system: its mean, quantiles and extremes are its value, and every spread is zero."""

    def __init__(self, values: Mapping[AbstractFunctional, Array], numbers: Mapping[str, Array], step: Array):
        self._values, self._numbers, self.step = values, numbers, step

    @override
    def statistic(self, functionals: tuple[AbstractFunctional, ...], kind: AbstractStatistic) -> Array:
        value = self._values[functionals[0]]
        return value if kind.speaks_of_one_system else jnp.zeros_like(value)

    @override
    def realised(self, functional: AbstractFunctional) -> Array:
        return self._values[functional]

    @override
    def value(self, name: str) -> Array:
        return self._numbers[name]


def value_at(expression: Expression, problem: AbstractProblem, decisions: Any) -> float:
    """The value at given decisions of an expression of the model's own numbers alone, such as a cost."""
    numbers = named_numbers(problem.simulation, jax_array(decisions))
    return float(expression.evaluate(OneSystem({}, numbers, jax_array(1.0))))


def refuse_large_histories(problem: AbstractProblem, systems: int, derivatives: int, advice: str) -> None:
    """Raise `ProblemError` if the outputs of `systems` systems would not fit into memory together.

    Outputs are stored at every instant where a functional needs them there, each with its `derivatives`; besides, the
    inputs and the check of an answer take memory at each.
    """
    histories = [one for one in functionals_of(problem.expressions) if not isinstance(one, AbstractIntegral)]
    names = {name for one in histories for name in one.outputs}
    equations = problem.simulation.equations
    shapes = {} if equations is None else equations.output_shapes()
    outputs = sum(math.prod(shapes.get(name, ())) for name in names)
    instants = problem.grid.steps + 1
    what = f"{systems} systems with {outputs} outputs at {instants} instants"
    what += f" and their derivatives by {derivatives} decisions" if derivatives else ""
    refuse_beyond_memory(what, NUMBER * instants * (_AT_INSTANT + systems * outputs * (1 + derivatives)), advice)


class Estimated(NamedTuple):
    """An estimate with its error, such as a standard error: numbers, or one number per instant."""

    value: Float[np.ndarray, "*shape"]
    error: Float[np.ndarray, "*shape"]


def estimated(
    problem: AbstractProblem,
    expression: Expression,
    statistics: Mapping[str, Estimated],
    decisions: Float[np.ndarray, " n"],
    doubt: float = 0.0,
) -> Estimated | None:
    """An expression at given decisions, its `statistics` being known by their texts; None where one is missing.

    - `doubt`: the relative error of the model's own numbers in the expression.

    Its error is the sum of what the error of each would change: the worst case, for their dependence is not known.
    """
    at = jnp.asarray(decisions)
    numbers, step = named_numbers(problem.simulation, at), step_at(problem, at)
    used = {leaf.name for leaf in expression.leaves if isinstance(leaf, Value)}
    needed = {leaf.text() for leaf in expression.leaves if isinstance(leaf, Statistic)}
    if not needed <= set(statistics):
        return None
    known = {name: np.asarray(numbers[name]) for name in used}
    known = {name: Estimated(value, doubt * np.abs(value)) for name, value in known.items()}
    known |= {text: statistics[text] for text in needed}

    def evaluated(moved: str | None = None) -> np.ndarray:
        return np.asarray(expression.evaluate(_Estimates(known, step, moved)))

    value = evaluated()
    moving = (name for name, one in known.items() if np.any(one.error))
    return Estimated(value, sum((np.abs(evaluated(one) - value) for one in moving), start=np.zeros(value.shape)))


@final
class _Estimates(AbstractScopeOfInstants):
    """Statistics and numbers by their texts, the one that is `moved`, if any, shifted by its error."""

    def __init__(self, known: Mapping[str, Estimated], step: Array, moved: str | None):
        self._known, self.step, self._moved = known, step, moved

    @override
    def statistic(self, functionals: tuple[Any, ...], kind: AbstractStatistic) -> Array:
        return self.value(Statistic(functionals, kind).text())

    @override
    def value(self, name: str) -> Array:
        one = self._known[name]
        return jnp.asarray(one.value + one.error if name == self._moved else one.value)
