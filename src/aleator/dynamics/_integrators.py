"""Integrators: their abstract base, and fixed-step Runge-Kutta methods for optimisation.

Integrals over time are additional states whose rates are the integrands, so that they are as accurate as the states and
evaluated at the same instants.
"""

import abc
import itertools
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.arrays import Pytree
from aleator._core.compilation import Use, evaluate
from aleator._core.leaves import Module
from aleator.dynamics._evaluation import completed, derivative, explain_algebraic, initial_state
from aleator.dynamics._grid import Grid, Inputs, sampled
from aleator.dynamics._record import Asked, Record
from aleator.dynamics._system import System
from aleator.trajectories import AbstractSignal, before_jumps, has_jumps

STATES = "states"


class AbstractIntegrator(Module):
    """How a system's states are advanced from one instant of a grid to the next."""

    @abc.abstractmethod
    def record(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        """Simulate a realised system and record what is asked for; `inputs` include the system's own signals."""

    @abc.abstractmethod
    def reference(self) -> "AbstractIntegrator":
        """A more accurate integrator of another order, by which this one's error is estimated."""

    def explain(self, system: System, grid: Grid, inputs: Inputs) -> str:
        """Why it fails on one realised system, with the remedy; empty if it does not fail, or cannot tell."""
        del system, grid, inputs
        return ""

    def course(self, system: System, grid: Grid, inputs: Inputs) -> Float[np.ndarray, "instants states"]:
        """The states of one realised system side by side at every instant."""
        asked = Asked(frozenset({STATES}))
        rows = evaluate(lambda: self.record(ObservedStates(system), grid, inputs, asked).history[STATES], use=Use.ONCE)
        return np.asarray(rows)

    def refined(self) -> "AbstractIntegrator":
        """The same integrator with smaller tolerances, if it has any: most follow the steps of the grid."""
        return self


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method (Hairer, Nørsett and Wanner, Solving Ordinary Differential Equations I, II.1).

    - `nodes`: the stages' times as fractions of a step; `couplings`: the coefficients of each stage on those before it;
      `weights`: those of the stages in the result.
    """

    nodes: tuple[float, ...]
    couplings: tuple[tuple[float, ...], ...]
    weights: tuple[float, ...]


class AbstractFixedStep(AbstractIntegrator):
    """An explicit Runge-Kutta method that takes one step between two instants.

    Its steps do not depend on the numbers, so derivatives of the result are exact and free of noise.
    """

    tableau: ClassVar[Tableau]

    @override
    def record(self, system: System, grid: Grid, inputs: Inputs, asked: Asked) -> Record:
        nodes, couplings, weights = self.tableau
        h, inner = grid.step, sorted({node for node in (*nodes, *([0.5] if asked.nodes else [])) if 0 < node < 1})
        # A table or a spline is looked up once for all stages.
        inside = [grid.fractions[:-1] + node / grid.steps for node in inner]
        looked_up = sampled(inputs, grid, np.concatenate([grid.fractions, *inside]))
        ends = np.cumsum([grid.steps + 1, *(len(one) for one in inside)])[:-1]
        at_instants, *between = _split(looked_up, ends)
        arriving = sampled(before_jumps(inputs), grid, grid.fractions[1:]) if has_jumps(inputs) else {}
        now = {name: values[0] for name, values in at_instants.items()}
        start = initial_state(system, grid.times[0], now)

        # Traced once for all stages.
        @jax.jit
        def rates(t: Array, z: Pytree, u: dict[str, Array]) -> tuple[Pytree, tuple[Array, ...]]:
            z = completed(system, t, z, u)
            return asked.slopes(system, t, z, u)

        def advance(carried: tuple[Pytree, ...], now: tuple) -> tuple[tuple[Pytree, ...], tuple[Any, Any]]:
            (z, integrals, folded), (t, first, after, before, *middle) = carried, now
            # A step sees the side of a jump that is its own.
            last = {**after, **before}
            signals = {0.0: first, 1.0: last, **dict(zip(inner, middle, strict=True))}
            slopes: list[Pytree] = []
            growths: list[Pytree] = []
            for node, coupling in zip(nodes, couplings, strict=True):
                stage = rates(t + node * h, _moved(z, h, coupling, slopes), signals[node])
                slopes.append(stage[0])
                growths.append(stage[1])
            end = _moved(z, h, weights, slopes)
            # Outputs are taken inside the loop, so that states need not be stored.
            folded, outputs = asked.folded(folded, asked.at_instant(system, t + h, end, after))
            halfway = {}
            if asked.nodes:
                arrived = derivative(system, t + h, end, last)
                # Cubic Hermite interpolation between both ends, as accurate as these are.
                centre = jax.tree.map(lambda a, b, da, db: (a + b) / 2 + h / 8 * (da - db), z, end, slopes[0], arrived)
                halfway = asked.at_node(system, t + h / 2, centre, signals[0.5])
            return (end, _moved(integrals, h, weights, growths), folded), (outputs, halfway)

        shapes = jax.eval_shape(lambda: asked.rates(system, grid.times[0], start, now))
        zeros = jax.tree.map(lambda one: jnp.zeros(one.shape), shapes)
        spans = (
            grid.times[:-1],
            _rows(at_instants, slice(None, -1)),
            _rows(at_instants, slice(1, None)),
            arriving,
            *between,
        )
        folded, first = asked.folded(None, asked.at_instant(system, grid.times[0], start, now))
        (_, integrals, folded), (rest, middles) = jax.lax.scan(advance, (start, zeros, folded), spans)
        history = jax.tree.map(lambda start, later: jnp.concatenate([start[None], later]), first, rest)
        return Record(history, _interleaved(history, middles), integrals, folded)

    @override
    def explain(self, system: System, grid: Grid, inputs: Inputs) -> str:
        if not system.algebraic:
            return ""
        return explain_algebraic(system, grid, inputs, self.course(system, grid, inputs))


def _moved(z: Pytree, h: Any, weights: tuple[float, ...], slopes: list[Pytree]) -> Pytree:
    """`z + h * sum of weight * slope`."""
    used = [(weight, slope) for weight, slope in zip(weights, slopes, strict=True) if weight != 0]
    if not used:
        return z
    return jax.tree.map(
        lambda x, *rates: x + h * sum(weight * rate for (weight, _), rate in zip(used, rates, strict=True)),
        z,
        *(slope for _, slope in used),
    )


def _interleaved(history: dict[str, Array], middles: dict[str, Array]) -> dict[str, Array]:
    """Values at the instants and at the midpoints of the steps, in order of time."""
    nodes = {}
    for name, inside in middles.items():
        ends = history[name]
        pairs = jnp.stack([ends[:-1], inside], axis=1).reshape(2 * len(inside), *inside.shape[1:])
        nodes[name] = jnp.concatenate([pairs, ends[-1:]])
    return nodes


@final
class RungeKutta4(AbstractFixedStep):
    """The classical Runge-Kutta method of order 4, the default."""

    tableau: ClassVar[Tableau] = Tableau(
        nodes=(0.0, 0.5, 0.5, 1.0),
        couplings=((), (1 / 2,), (0.0, 1 / 2), (0.0, 0.0, 1.0)),
        weights=(1 / 6, 1 / 3, 1 / 3, 1 / 6),
    )

    @override
    def reference(self) -> AbstractIntegrator:
        return DormandPrince5()


@final
class DormandPrince5(AbstractFixedStep):
    """The method of order 5 by Dormand and Prince (1980), with fixed steps.

    Its stages lie at other fractions of a step than those of `RungeKutta4`, so it sees what these miss.
    """

    tableau: ClassVar[Tableau] = Tableau(
        nodes=(0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0),
        couplings=(
            (),
            (1 / 5,),
            (3 / 40, 9 / 40),
            (44 / 45, -56 / 15, 32 / 9),
            (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
            (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
        ),
        weights=(35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
    )

    @override
    def reference(self) -> AbstractIntegrator:
        return RungeKutta4()


def _split(signals: dict[str, Array], ends: np.ndarray) -> list[dict[str, Array]]:
    """Signals in parts, each of which ends before a row, and the rest."""
    return [_rows(signals, slice(*part)) for part in itertools.pairwise([0, *ends.tolist(), None])]


def _rows(signals: dict[str, Array], rows: slice) -> dict[str, Array]:
    return {name: values[rows] for name, values in signals.items()}


@final
class ObservedStates(System):
    """The same system, with one output `STATES`: its states side by side."""

    system: System
    states: tuple[str, ...] = eqx.field(static=True)  # type: ignore[misc]

    def __init__(self, system: System):
        self.system, self.states = system, system.states  # type: ignore[misc]

    @override
    def rhs(self, t: Any, z: Any, **inputs: Any) -> Any:
        return derivative(self.system, t, z, inputs)

    @override
    def outputs(self, t: Any, z: Any, **inputs: Any) -> dict[str, Any]:
        del t, inputs
        return {STATES: jnp.concatenate([jnp.ravel(one) for one in jax.tree.leaves(z)])}

    @override
    def starting(self, t: Any, inputs: Mapping[str, Any]) -> Mapping[str, Any]:
        return self.system.starting(t, inputs)

    @override
    def signals(self) -> Mapping[str, AbstractSignal]:
        return self.system.signals()
