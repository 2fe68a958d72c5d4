"""`Problem`: a declared design problem, and problems made of it, such as one at its means: data only."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Self, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from aleator._core.arrays import jax_array
from aleator._core.border import a_name, one_of, positive, real
from aleator._core.equations import Digest
from aleator._core.errors import ProblemError
from aleator._core.leaves import is_leaf
from aleator.design._check import check
from aleator.design._control import with_controls
from aleator.design._equations import declared
from aleator.design._expression import Constraint, Expression, as_expression
from aleator.design._functionals import in_phases, limit_in_phases
from aleator.design._noise import refuse_infinite, with_noise
from aleator.design._objectives import integrated_paths
from aleator.design._response import AbstractProblem
from aleator.design._scope import Value, ordered
from aleator.design._statistic import Statistic
from aleator.design._text import problem_text
from aleator.dynamics import (
    AbstractGrid,
    AbstractIntegrator,
    AbstractSystem,
    Instant,
    LinkedGrid,
    LinkedSystems,
    Phases,
    Simulation,
    simulation_of,
)
from aleator.expansion import Expansion, MultiElement
from aleator.feedback import Feedback, closed_loop, noisy, surrounded
from aleator.statistics import Mean
from aleator.trajectories import AbstractSignal
from aleator.uncertainty import (
    AbstractDecision,
    Choice,
    Decision,
    Integer,
    at_means,
    placements,
    uncertain_again,
)


@final
class Problem(AbstractProblem):
    """An optimal design problem: `system` contains the decisions to optimise and the distributions of what is
    uncertain.

    - `system`: the physics, a `System`, which evolves in time, or an `AlgebraicSystem`, without time, grid and inputs;
      or `Phases`, which have grids and inputs of their own;
    - `grid`: the instants; `inputs`: a signal for each input of the system, by name;
    - `minimize`: an expression of statistics; `subject_to`: constraints;
    - `expansion`: how outputs are expanded; by `al.MultiElement()` where no single polynomial follows them;
    - `integrator`: how states are advanced in time;
    - `decisions`: further decisions by name, which no model contains, such as a slack or a level that several limits
      share; `al.value(name)` is one in an expression;
    - `feedback`: a controller that makes each realisation follow the plan, that of the means.

    Its equations are traced here, and here alone: to change the code of a model, declare again. `print(problem)` shows
    it as mathematics. Raises `ProblemError`, before anything is compiled, for any inconsistency: a missing input or
    output, a wrong shape, an unknown name, a mass that can reach zero.
    """

    def __init__(
        self,
        system: AbstractSystem | Phases,
        *,
        minimize: Expression,
        subject_to: Iterable[Constraint | tuple[Constraint, ...]] = (),
        grid: AbstractGrid | None = None,
        inputs: Mapping[str, AbstractSignal] | None = None,
        expansion: Expansion | MultiElement | None = None,
        integrator: AbstractIntegrator | None = None,
        decisions: Mapping[str, AbstractDecision] | None = None,
        feedback: Feedback | None = None,
    ):
        inputs = None if inputs is None else one_of("inputs: signals by name", inputs, Mapping, "{'road': ...}")
        what = "Problem: decisions by name"
        decisions = one_of(what, {} if decisions is None else decisions, Mapping, "{'slack': al.Decision(...)}")
        for name, one in decisions.items():
            kinds = Decision, Integer, Choice
            one_of(f"Problem: decisions['{a_name('Problem: a name in decisions', name)}']", one, kinds)
        if feedback is not None:
            system = closed_loop(system, inputs or {}, feedback, grid)
        system, inputs = noisy(system, inputs, grid)
        simulation = simulation_of(system, grid, inputs, integrator, dict(decisions))
        if isinstance(system, Phases):
            simulation = surrounded(simulation, system)
        # Later changes of NumPy arrays do not affect a problem.
        self.simulation = jax.tree.map(
            lambda leaf: leaf.copy() if isinstance(leaf, np.ndarray) else leaf, with_controls(simulation)
        )
        known = self.placements.decisions
        if taken := [name for name in simulation.numbers if name not in known]:
            raise ProblemError(
                f"Problem: decisions: expected names that no number of the model has; received '{taken[0]}'. Use "
                "another name."
            )
        self.objective, limits = as_expression(minimize), list(_flatten(subject_to))
        names = list(simulation.phases)
        if isinstance(simulation.system, LinkedSystems):
            self.objective = in_phases(self.objective, names, names[-1])
            limits = [limit_in_phases(one, names, names[-1]) for one in limits]
        if isinstance(system, Phases):
            own = ((name, one) for name, phase in system.phases.items() for one in _flatten(phase.subject_to))
            limits += [limit_in_phases(one, names, name) for name, one in own]
        self.constraints = _told_apart(tuple(limits))
        if self.has_noise:
            self.objective, self.constraints = with_noise((self.objective, self.constraints))
        self.expansion = Expansion() if expansion is None else expansion
        self.physics = Digest("", False)
        check(self)
        equations, self.physics = declared(self)
        self.simulation = replace(self.simulation, equations=equations)
        refuse_infinite(self)

    def on_grid(self, grid: AbstractGrid, integrator: AbstractIntegrator | None = None) -> "Problem":
        """The same problem on another grid, with another integrator if one is given. It is not checked again.

        Raises `ProblemError` for one grid of several phases.
        """
        if isinstance(self.grid, LinkedGrid) and not isinstance(grid, LinkedGrid):
            raise ProblemError(
                "Phases have grids of their own: declare the problem again with others; received one grid."
            )
        return with_simulation(self, self.simulation.on(grid, integrator))

    def finer(self, factor: int, integrator: AbstractIntegrator) -> "Problem":
        """The same problem with so many times as many steps, by another integrator. It is not checked again."""
        return with_simulation(self, self.simulation.finer(factor, integrator))

    def with_tables_looked_up(self) -> "Problem":
        """The same problem, for programs that simulate it on its grid: see `Simulation.with_tables_looked_up`."""
        middles = bool(integrated_paths(self.expressions))
        return with_simulation(self, self.simulation.with_tables_looked_up(middles=middles))

    def narrower(self) -> "Problem | None":
        """The same problem with half the widths of `al.smooth`; None without any. It is not checked again."""
        simulation = self.simulation.narrower()
        return None if simulation is None else with_simulation(self, simulation)

    def with_bound(self, name: str, bound: float | tuple[float, float]) -> Self:
        """The same problem with the bound of the constraints called `name` set to `bound`.

        One number sets an upper or a lower bound, the right-hand side of an equality, or both bounds of a symmetric
        pair (to `-bound` and `bound`); other pairs need `(lower, upper)`. Two numbers make a limit of one side of plain
        means one of two sides. Raises `ProblemError` for a pair in the wrong order, and for a side that cannot be kept:
        that of a limit with a margin, whose other side would need a margin of its own.
        """
        constraints = self.named(name)
        lower, upper = _new_bounds(constraints, name, bound)
        if isinstance(bound, tuple) and _opens(constraints, lower, upper):
            _refuse_one_sided(constraints, name, lower, upper)
            return self._with(name, lambda one: one.with_bounds(lower, upper))
        return self._with(name, lambda one: one.with_bounds(*(_moved(one.lower, lower), _moved(one.upper, upper))))

    def with_sigmas(self, name: str, sigmas: float) -> Self:
        """The same problem with the standard deviation's multiple in the constraints called `name` set to `sigmas`."""
        sigmas = positive(f"Constraint '{name}': sigmas", sigmas)
        self.named(name)
        return self._with(
            name,
            lambda one: eqx.tree_at(lambda tree: tree.expression, one, one.expression.with_sigmas(sigmas)),
        )

    def _with(self, name: str, change: Any) -> Self:
        constraints = tuple(change(one) if one.name == name else one for one in self.constraints)
        return eqx.tree_at(lambda tree: tree.constraints, self, constraints)

    def __str__(self) -> str:
        return problem_text(self)


def _flatten(constraints: Any) -> Iterator[Constraint]:
    """Constraints from arbitrarily nested sequences, since `within` gives a pair."""
    if isinstance(constraints, Constraint):
        yield constraints
        return
    if not isinstance(constraints, Iterable) or isinstance(constraints, str):
        raise ProblemError(
            "subject_to: expected constraints, such as y.mean <= 1.0; "
            f"received {type(constraints).__name__} '{constraints}'. For an equality write expression.equals(number)."
        )
    for constraint in constraints:
        yield from _flatten(constraint)


def _told_apart(constraints: tuple[Constraint, ...]) -> tuple[Constraint, ...]:
    """Unnamed constraints on different functionals of one output, renamed by their measure.

    So `path("x")` and `terminal("x")` are called `x(t)` and `x(t_f)`, and a sweep moves only one of them.
    """
    measures: dict[str, set[str]] = {}
    for one in constraints:
        measures.setdefault(one.name, set()).add("" if one.has_own_name else one.measure)
    return tuple(
        one if one.has_own_name or len(measures[one.name]) == 1 else one.named(one.measure or one.subject)
        for one in constraints
    )


def _moved(old: Any, new: float) -> float:
    return new if np.isfinite(old) else float(old)


def _opens(constraints: tuple[Constraint, ...], lower: float, upper: float) -> bool:
    """Whether a new bound is on a side that no constraint has, where it would be lost."""
    has_lower = any(np.isfinite(one.lower) for one in constraints)
    has_upper = any(np.isfinite(one.upper) for one in constraints)
    return bool((np.isfinite(lower) and not has_lower) or (np.isfinite(upper) and not has_upper))


def _refuse_one_sided(constraints: tuple[Constraint, ...], name: str, lower: float, upper: float) -> None:
    """Raise `ProblemError` unless one constraint can take both bounds: one on nothing but means and numbers."""
    leaves = [leaf for one in constraints for leaf in one.expression.leaves]
    plain = all(isinstance(one, Value) or (isinstance(one, Statistic) and isinstance(one.kind, Mean)) for one in leaves)
    if len(constraints) > 1 or not plain:
        side = "upper" if any(np.isfinite(one.upper) for one in constraints) else "lower"
        raise ProblemError(
            f"Constraint '{name}': expected one number, since the model has {side} limits alone here; received "
            f"({lower:g}, {upper:g}). For both sides write .within(lower, upper) or a second limit in the model."
        )


def _new_bounds(
    constraints: tuple[Constraint, ...], name: str, bound: float | tuple[float, float]
) -> tuple[float, float]:
    if isinstance(bound, tuple):
        return ordered(name, *bound)
    bound = real(f"Constraint '{name}': its new bound", bound)
    if all(float(one.lower) == float(one.upper) for one in constraints):
        return float(bound), float(bound)
    lower = {float(one.lower) for one in constraints if np.isfinite(one.lower)}
    upper = {float(one.upper) for one in constraints if np.isfinite(one.upper)}
    if lower and upper and lower != {-value for value in upper}:
        raise ProblemError(
            f"Constraint '{name}' has bounds {sorted(lower)} and {sorted(upper)}, which are not symmetric: "
            "give with_bound both, (lower, upper); for a front over one side, limit each side under a name of its own."
        )
    if lower and upper:
        return ordered(name, -bound, bound)
    return float(bound), float(bound)


def declared_anew(
    problem: Problem,
    simulation: Simulation,
    *,
    minimize: Expression | None = None,
    subject_to: tuple[Constraint, ...] | None = None,
    decisions: Mapping[str, AbstractDecision] = MappingProxyType({}),
) -> Problem:
    """The same problem of another simulation, objective or constraints, or with further decisions, checked anew."""
    return Problem(
        simulation.system,
        minimize=problem.objective if minimize is None else minimize,
        subject_to=problem.constraints if subject_to is None else subject_to,
        grid=None if isinstance(simulation.grid, Instant) else simulation.grid,
        inputs=simulation.inputs,
        expansion=problem.expansion,
        integrator=simulation.integrator,
        decisions={**simulation.numbers, **decisions},
    )


def deterministic(problem: Problem) -> Problem:
    """The same problem with every distribution held at its mean (dOpt, equations 93 and 113)."""
    return with_simulation(one_of("deterministic", problem, Problem), at_means(problem.simulation))


def uncertain(problem: Problem) -> Problem:
    """The problem with its distributions restored: the inverse of `deterministic`."""
    one_of("uncertain", problem, Problem)
    return with_simulation(problem, uncertain_again(problem.simulation))


def has_random_signals(problem: Problem) -> bool:
    """Whether signals are uncertain: what is known at an instant then differs between realisations."""
    # Signals in the place of numbers count too.
    signals = filter(_is_signal, jax.tree.leaves(problem.system, is_leaf=_is_signal))
    return bool(placements(([*signals], problem.inputs)).distributions)


def _is_signal(node: Any) -> bool:
    return isinstance(node, AbstractSignal)


def frozen(problem: Problem) -> tuple[Problem, Int[np.ndarray, " direct"]]:
    """The problem without the decisions of its signals and its final time, and where the others are among all."""

    def still(tree: Any) -> Any:
        return jax.tree.map(
            lambda leaf: jax_array(leaf.initial) if isinstance(leaf, AbstractDecision) else leaf, tree, is_leaf=is_leaf
        )

    def without(system: Any) -> Any:
        for name in system.signal_fields:
            system = eqx.tree_at(lambda tree, name=name: getattr(tree, name), system, still(getattr(system, name)))
        return system

    whole, system = problem.simulation, problem.system
    if isinstance(system, LinkedSystems):
        system = replace(system, systems={name: without(one) for name, one in system.systems.items()})
    else:
        system = without(system)
    fixed = with_simulation(problem, replace(whole, system=system, inputs=still(whole.inputs), grid=still(whole.grid)))
    places = problem.placements.decisions
    where = [np.arange(places[name].where.start, places[name].where.stop) for name in fixed.placements.decisions]
    return fixed, np.concatenate([np.zeros(0, dtype=int), *where])


def with_simulation(problem: Problem, simulation: Simulation) -> Problem:
    """The problem with another simulation of the same equations. It is not checked again."""
    return eqx.tree_at(lambda tree: tree.simulation, problem, simulation)
