"""What a problem's equations say at one mesh point of one realisation: rates, integrands, outputs, and their shapes.

Time runs by the fraction of the grid's duration: multiplied by the duration, rates and integrands are those by the
fraction, so that a free final time stands in them and the scheme stays linear.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from aleator._core.arrays import in_library
from aleator.design import (
    AbstractFunctional,
    AbstractIntegral,
    Path,
    Problem,
    Taken,
    Terminal,
    frozen,
    functionals_of,
    grid_at,
    has_random_signals,
    integrated_paths,
    numbers_of,
)
from aleator.dynamics import (
    AbstractMeanRate,
    Asked,
    Grid,
    Inputs,
    Known,
    System,
    algebraic_residuals,
    completed,
    guessed_algebraic,
    initial_state,
    known_at,
    observation,
    solved_algebraic,
    with_algebraic,
)
from aleator.trajectories import has_jumps
from aleator.uncertainty import realise

# How far from a jump its sides are told, as a part of the duration: more than rounding of times.
_BESIDE = 1e-11


class Signals(NamedTuple):
    """The signals of a realisation: the shape of each by name, in the order of `Pointwise.known`, none where they are
    uncertain; whether some are the system's own, of which decisions are not known, and whether some may jump.
    """

    shapes: dict[str, tuple[int, ...]]
    are_own: bool
    have_jumps: bool

    @property
    def size(self) -> int:
        """How many numbers they are at one point."""
        return sum(map(math.prod, self.shapes.values()))


@final
@dataclass(frozen=True)
class Shapes:
    """How many states, algebraic variables and signals there are, and the shapes of integrals and of outputs at one
    instant.
    """

    states: int
    algebraic: int
    signals: int
    integrals: tuple[tuple[int, ...], ...]
    outputs: dict[str, tuple[int, ...]]

    def size(self, names: Sequence[str]) -> int:
        """How many numbers some outputs are."""
        return sum(math.prod(self.outputs[name]) for name in names)

    def by_name(self, names: Sequence[str], table: Any) -> dict[str, Any]:
        """Some outputs, side by side along the last axis, by name."""
        return dict(zip(names, apart(table, [self.outputs[name] for name in names]), strict=True))


def apart(numbers: Any, shapes: Sequence[tuple[int, ...]]) -> list[Any]:
    """Arrays of some shapes, from their numbers side by side along the last axis; axes before it are kept."""
    parts, first = [], 0
    for shape in shapes:
        last = first + math.prod(shape)
        parts.append(numbers[..., first:last].reshape(*numbers.shape[:-1], *shape))
        first = last
    return parts


def taken_by(make: Callable[[], Any], numbers: Array) -> tuple[Any, Array]:
    """The first of some numbers in the shapes of what `make` gives, which is not computed, and those after them."""
    like, unravel = ravel_pytree(jax.tree.map(lambda one: jnp.zeros(one.shape), jax.eval_shape(make)))
    return unravel(numbers[: like.size]), numbers[like.size :]


def flat(tree: Any) -> Float[Array, " numbers"]:
    """All numbers of a tree side by side."""
    leaves = [jnp.ravel(one) for one in jax.tree.leaves(tree)]
    return jnp.concatenate([jnp.zeros(0), *leaves])


@final
@dataclass(frozen=True)
class Pointwise:
    """The equations of a problem, taken apart: made anew wherever they are traced.

    - `frozen`: the problem without the decisions of its signals; `direct`: where the others are among all;
    - `integrals`: functionals that are integrated; `paths`, `ends`: outputs that are recorded at every instant, and at
      the last one alone, by name; `nodes`: outputs whose statistics are integrated over time, and so recorded in the
      middles between instants too; `composed`: functionals of these.
    """

    problem: Problem
    frozen: Problem
    direct: Int[np.ndarray, " direct"]
    is_random: bool
    integrals: tuple[AbstractIntegral, ...]
    paths: tuple[str, ...]
    ends: tuple[str, ...]
    nodes: tuple[str, ...]
    composed: tuple[AbstractFunctional, ...]

    @classmethod
    def of(cls, problem: Problem) -> "Pointwise":
        """Those of a problem that moves in time."""
        functionals, is_random = functionals_of(problem.expressions), has_random_signals(problem)
        every = np.arange(problem.placements.size)
        fixed, direct = (problem, every) if is_random else frozen(problem)
        whole = [one for one in functionals if not isinstance(one, AbstractIntegral | Terminal)]
        return cls(
            problem,
            fixed,
            direct,
            is_random,
            tuple(one for one in functionals if isinstance(one, AbstractIntegral)),
            tuple(dict.fromkeys(name for one in whole for name in one.outputs)),
            tuple(dict.fromkeys(one.output for one in functionals if isinstance(one, Terminal))),
            tuple(dict.fromkeys(name for one in integrated_paths(problem.expressions) for name in one.outputs)),
            tuple(one for one in functionals if not isinstance(one, Path | Terminal)),
        )

    @cached_property
    def signals(self) -> Signals:
        """What signals a realisation has: nothing is computed."""
        answers: list[Signals] = []

        def realised(decisions: Array) -> Array:
            system, grid, inputs = self._known_parts(decisions)
            own = system.signals()
            every = {**own, **inputs}
            shapes = {} if self.is_random else dict(known_at(every, grid, np.zeros(1)).inputs)
            answers.append(Signals(shapes, bool(own), has_jumps(every)))
            return decisions

        jax.eval_shape(realised, _numbers(self.problem.placements.size))
        return answers[0]

    @property
    def grid(self) -> Grid:
        """The problem's grid as it is declared."""
        assert isinstance(self.problem.grid, Grid)
        return self.problem.grid

    def known(
        self,
        places: Any,
        decisions: Float[Array, " n"],
    ) -> Float[Array, "places signals"]:
        """All signals at some places, see `Mesh.places`, side by side; none where they are uncertain."""
        if self.is_random:
            return jnp.zeros((len(places), 0))
        system, grid, inputs = self._known_parts(decisions)
        every = {**system.signals(), **inputs}
        return known_at(every, grid, self._told_at(places)).rows[:, 1:]

    def _told_at(self, places: Any) -> Any:
        """Places as fractions of the duration; where signals jump, a little off on the side that is theirs."""
        if not self.signals.have_jumps:
            return places[..., 0]
        xp, places = in_library(places)
        beside = xp.where(places[..., 1] > 0, -_BESIDE, _BESIDE)
        return xp.clip(places[..., 0] + beside, 0.0, 1.0)

    def duration(self, decisions: Float[Array, " n"]) -> Float[Array, ""]:
        """From the first instant to the last, s."""
        grid = grid_at(self.problem, decisions)
        assert isinstance(grid, Grid)
        return jnp.asarray(grid.duration, dtype=float)

    def initial(self, germ: Array, place: Array, shared: Array, signals: Array) -> Float[Array, " states"]:
        """The initial states of one realisation, side by side, at the first mesh point: see `rates`."""
        return flat(initial_state(*self._now(germ, place, shared, signals)))

    def rates(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " rates"]:
        """The rates of the states, then the integrands, both by the fraction of the duration.

        - `place`: the fraction, then 1 for signals as they are before a jump there, else 0;
        - `shared`: the decisions of the model itself, then the duration; `own`: the signals, the states, and the
          algebraic variables unless these are to be solved for.
        """
        system, t, z, now = self._at(germ, place, shared, own)
        z = completed(system, t, z, now)
        integrated = self._integrated
        if not system.states:
            return shared[-1] * flat(integrated.rates(system, t, z, now))
        return shared[-1] * flat(integrated.slopes(system, t, z, now))

    def mean_rates(
        self, rate: AbstractMeanRate, germ: Array, places: Array, shared: Array, own: Array
    ) -> Float[Array, " rates"]:
        """What a block of a scheme says: see `rates`.

        - `places`: one or more, shape (places, 2); `own`: the signals at each of them, then the rest at the first.
        """
        signals, rest = jnp.split(own, [len(places) * self.signals.size])

        def at(place: Array, signal: Array, rest: Array) -> Array:
            return self.rates(germ, place, shared, jnp.concatenate([signal, rest]))

        return rate(at, places, signals.reshape(len(places), self.signals.size), rest)

    def residuals(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " algebraic"]:
        """What is left of the equations of the algebraic variables: see `rates`."""
        return algebraic_residuals(*self._at(germ, place, shared, own))

    def algebraic(self, germ: Array, place: Array, shared: Array, own: Array) -> Float[Array, " algebraic"]:
        """The algebraic variables that follow from signals and states, `own`.

        Where none are found they begin at their guess, but not at the first instant: there is no other state to try.
        """
        here = self._at(germ, place, shared, own)
        root, guess = solved_algebraic(*here)[0], flat(guessed_algebraic(*here))
        return jnp.where(root.converged, root.point, jnp.where(place[0] > 0, guess, jnp.nan))

    def outputs(self, names: tuple[str, ...], germ: Array, place: Array, shared: Array, own: Array) -> Array:
        """Some outputs, side by side."""
        system, t, z, now = self._at(germ, place, shared, own)
        outputs = observation(system, t, z, now)
        return flat([outputs[name] for name in names])

    def composites(self, shapes: Shapes, duration: Array, integrals: Array, paths: Array) -> Float[Array, " rows"]:
        """The functionals of integrals and of whole histories of one realisation, side by side."""
        totals: dict[AbstractFunctional, Array] = dict(
            zip(self.integrals, apart(integrals, shapes.integrals), strict=True)
        )
        history = shapes.by_name(self.paths, paths.reshape(-1, max(shapes.size(self.paths), 1)))
        grid = eqx.tree_at(lambda one: one.t_final, self.grid, self.grid.t_start + duration)
        return flat(list(numbers_of(self.composed, Taken(history, totals), grid)))

    def shapes(self) -> Shapes:
        """The shapes of what is recorded: nothing is computed."""
        germ, place = _numbers(len(self.problem.placements.germ_names)), _numbers(2)
        signals = self.signals.size
        shared, first = _numbers(self.direct.size + 1), _numbers(signals)
        states = jax.eval_shape(self.initial, germ, place, shared, first).size

        def recorded(germ: Array, place: Array, shared: Array, own: Array) -> tuple[Any, ...]:
            system, t, z, now = self._at(germ, place, shared, own)
            outputs = observation(system, t, z, now)
            names = (*self.paths, *self.ends)
            algebraic = guessed_algebraic(system, t, z, now) if system.algebraic else ()
            return algebraic, self._integrated.rates(system, t, z, now), {name: outputs[name] for name in names}

        own = _numbers(signals + states)
        algebraic, integrals, outputs = jax.eval_shape(recorded, germ, place, shared, own)
        return Shapes(
            states,
            sum(one.size for one in algebraic),
            signals,
            tuple(one.shape for one in integrals),
            {name: one.shape for name, one in outputs.items()},
        )

    def _known_parts(self, decisions: Float[Array, " n"]) -> tuple[System, Grid, Inputs]:
        germ = jnp.zeros(len(self.problem.placements.germ_names))
        return self._realised(self.problem, germ, decisions)

    @property
    def _integrated(self) -> Asked:
        return Asked(frozenset(), integrands=tuple(one.integrand for one in self.integrals))

    def _realised(self, problem: Problem, germ: Array, decisions: Array) -> tuple[System, Grid, Inputs]:
        """The system of one realisation, for what is asked of it, its grid and its inputs."""
        simulation = realise(problem.simulation, germ, decisions)
        system = simulation.traced
        assert isinstance(system, System)
        assert isinstance(simulation.grid, Grid)
        names = {name for one in functionals_of(self.problem.expressions) for name in one.outputs}
        return system.focused(names), simulation.grid, simulation.inputs

    def _now(self, germ: Array, place: Array, shared: Array, signals: Array) -> tuple[System, Array, dict[str, Any]]:
        """A realised system with its time and inputs at one mesh point; what follows the signals is left alone."""
        direct, duration = shared[:-1], shared[-1]
        system, _, inputs = self._realised(self.frozen, germ, direct)
        t = jnp.asarray(self.grid.t_start + place[0] * duration)
        if not self.is_random:
            # Their values are not needed: a spline would be evaluated in every block.
            known = Known(jnp.zeros((0, 1)), tuple(self.signals.shapes.items()))
            return system, t, known.unpack(jnp.concatenate([t[None], signals]))[1]
        each, span = {**system.signals(), **inputs}, (self.grid.t_start, self.grid.t_start + duration)
        told_at = jnp.asarray(self.grid.t_start + self._told_at(place) * duration)
        return system, t, {name: one.over(*span)(told_at) for name, one in each.items()}

    def _at(self, germ: Array, place: Array, shared: Array, own: Array) -> tuple[System, Array, Any, dict[str, Any]]:
        """A realised system with its time, states (and algebraic variables, if given) and inputs at one mesh point."""
        system, t, now = self._now(germ, place, shared, own)
        z, rest = taken_by(lambda: initial_state(system, t, now), own[self.signals.size :])
        if rest.size:
            z = with_algebraic(system, z, taken_by(lambda: guessed_algebraic(system, t, z, now), rest)[0])
        return system, t, z, now


def _numbers(count: int) -> jax.ShapeDtypeStruct:
    """So many numbers, for functions of which the shapes alone are asked."""
    return jax.ShapeDtypeStruct((count,), float)
