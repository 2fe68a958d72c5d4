"""`Control`: an input whose values on the mesh are decisions."""

from dataclasses import replace
from typing import Any, TypeVar, final

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.border import real_array, refusal, shown
from aleator._core.errors import ProblemError
from aleator._core.functions import returned
from aleator.dynamics import Grid, LinkedSystems, Simulation
from aleator.trajectories import AbstractTrajectory, Piecewise
from aleator.uncertainty import Decision

Tree = TypeVar("Tree")


@final
class Control(AbstractTrajectory):
    """An input whose values on the mesh are decisions: one for each step of the problem's grid, or for each instant.

    - `initial`: where the search starts: one number, one for each value, or a function of the fraction of the duration;
    - `lower`, `upper`: bounds, one number each or one for each value;
    - `degree`: 0 for a control that is constant over each step and jumps between them, with as many values as steps; 1
      for one that is linear between the instants, with one value more. Smoother inputs are an `al.BSpline`.

    A `Problem` puts it on its grid; on another grid the function of time stays the same. Where `al.Simultaneous`
    divides an interval of its mesh, each part has values of its own. Outputs at a jump are those of the step that
    begins there.

    Raises `ProblemError` for numbers that are not finite (bounds may be infinite), bounds that cross, a start outside
    them, and another degree; a problem raises it where there are not as many numbers as its grid asks for.
    """

    initial: Any
    lower: Float[np.ndarray, "..."]
    upper: Float[np.ndarray, "..."]
    degree: int = eqx.field(static=True)

    def __init__(self, initial: Any, lower: Any = -np.inf, upper: Any = np.inf, degree: int = 0):
        if isinstance(degree, bool) or not isinstance(degree, int) or degree not in (0, 1):
            expected = (
                "0 (constant over each step of the grid) or 1 (linear between its instants; al.BSpline is smoother)"
            )
            raise refusal("Control: degree", expected, degree)
        self.initial = initial if callable(initial) else _numbers("initial", initial)
        self.lower, self.upper = _numbers("lower", lower), _numbers("upper", upper)
        self.degree = degree
        guess = np.clip(0.0, self.lower, self.upper) if callable(initial) else self.initial
        _decided(np.asarray(guess), self.lower, self.upper)

    @property
    @override
    def shape(self) -> tuple[int, ...]:
        return ()

    @property
    @override
    def derivatives(self) -> float:
        return self.degree

    @override
    def values(self, fractions: Any, duration: Any = 1.0, order: int = 0) -> Float[Array, " n"]:
        raise ProblemError(
            "Control: its values are decisions on the grid of an al.Problem; by itself it has none. For known numbers "
            "use al.Tabulated or al.BSpline."
        )

    def on(self, grid: Grid) -> Piecewise:
        """The trajectory with a decision for each step of a grid, or for each of its instants."""
        nodes = grid.fractions
        places = nodes if self.degree else (nodes[:-1] + nodes[1:]) / 2
        guess = self.initial
        if callable(guess):
            who = "Control: initial, a function of the fraction of the duration"
            guess = real_array(f"{who}: its values", [returned(f"{who},", guess, one) for one in places])
        each = "instants" if self.degree else "steps"
        for name, numbers in {"initial": guess, "lower": self.lower, "upper": self.upper}.items():
            if numbers.shape not in ((), places.shape):
                raise ProblemError(
                    f"Control: expected as `{name}` one number or {len(places)}, one for each of the {each} of the "
                    f"grid; received {shown(numbers.shape[0] if numbers.ndim == 1 else numbers.shape)}."
                )
        decided = _decided(np.broadcast_to(guess, places.shape), self.lower, self.upper)
        return Piecewise(decided, tuple(nodes.tolist()), self.degree)


def _decided(initial: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Decision:
    """The decision of some values. Raises `ProblemError` where they are no start between bounds."""
    sizes = {one.size for one in (initial, lower, upper) if one.ndim}
    if len(sizes) > 1:
        raise ProblemError(
            "Control: expected in each of initial, lower and upper one number or one for each value on the grid; "
            f"received {' and '.join(map(str, sorted(sizes)))} numbers."
        )
    try:
        return Decision(np.broadcast_to(initial, (*sizes,)), lower, upper)
    except ProblemError as error:
        raise ProblemError(f"Control: {error}") from None


def with_controls(simulation: Simulation) -> Simulation:
    """A simulation with its controls put on its grid; where there are phases, on that of the first that has them."""

    def placed(tree: Tree, grid: Any) -> Tree:
        if not isinstance(grid, Grid):
            return tree
        return jax.tree.map(lambda node: node.on(grid) if _is_control(node) else node, tree, is_leaf=_is_control)

    system, grid = simulation.system, simulation.grid
    if not isinstance(system, LinkedSystems):
        return placed(simulation, grid)
    systems = {name: placed(one, grid.of(name)) for name, one in system.systems.items()}
    inputs = {name: placed(one, grid.of(name)) for name, one in simulation.inputs.items()}
    return replace(simulation, system=replace(system, systems=systems), inputs=inputs)


def _is_control(node: Any) -> bool:
    return isinstance(node, Control)


def _numbers(name: str, values: Any) -> Float[np.ndarray, "..."]:
    expected = "one number or one for each value on the grid"
    numbers = real_array(f"Control: {name}", values, expected)
    if numbers.ndim > 1 or numbers.size == 0:
        raise ProblemError(f"Control: {name}: expected {expected}; received shape {numbers.shape}.")
    return numbers
