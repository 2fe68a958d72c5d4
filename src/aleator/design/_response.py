"""The response of a problem's system, realisation by realisation, and the numbers of its model."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple, final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from typing_extensions import override

from aleator._core.errors import ProblemError
from aleator.design._declaration import AbstractProblem
from aleator.design._expression import Expression
from aleator.design._functionals import AbstractIntegral
from aleator.design._scope import AbstractScope, AbstractScopeOfInstants
from aleator.design._statistic import AbstractFunctional, Statistic, Taken, numbers_of
from aleator.dynamics import AbstractGrid, Asked, History
from aleator.statistics import AbstractStatistic
from aleator.uncertainty import at_means, named_numbers, realise


def history(problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> History:
    """Time histories of all outputs of one realisation."""
    return realise(problem.simulation, germ, decisions).history()


def grid_at(problem: AbstractProblem, decisions: Float[Array, " n"]) -> AbstractGrid:
    """The problem's grid, with the decided final time."""
    return realise(at_means(problem.simulation), jnp.zeros(0), decisions).grid


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
    """The response of a family of realisations: arrays whose first axis is the germ points.

    - `values`: of each functional; `nodes`: of each of some paths, at the instants and at the midpoints of steps.
    """

    values: tuple[Float[Array, "points ..."], ...]
    nodes: tuple[Float[Array, "points nodes ..."], ...]


def sampled(
    problem: AbstractProblem,
    functionals: tuple[AbstractFunctional, ...],
    paths: tuple[AbstractFunctional, ...],
    germ: Float[Array, "points variables"],
    decisions: Float[Array, " n"],
) -> Sampled:
    """Functionals at each germ point; those in `paths` at the midpoints of steps too."""
    integrals = tuple(one for one in functionals if isinstance(one, AbstractIntegral))
    asked = Asked(
        instants=_outputs([one for one in functionals if not isinstance(one, AbstractIntegral)]),
        nodes=_outputs(paths),
        integrands=tuple(one.integrand for one in integrals),
        integrated=_outputs(integrals),
    )

    def one(point: Float[Array, " variables"]) -> Sampled:
        realised = realise(problem.simulation, point, decisions)
        found = realised.record(asked)
        taken = Taken(found.history, dict(zip(integrals, found.integrals, strict=True)))
        between = Taken(found.nodes, {})
        return Sampled(
            numbers_of(functionals, taken, realised.grid),
            numbers_of(paths, between, realised.grid),
        )

    return jax.vmap(one)(germ)


def _outputs(functionals: Iterable[AbstractFunctional]) -> frozenset[str]:
    return frozenset(name for one in functionals for name in one.outputs)


class Broken(NamedTuple):
    """The first non-finite output: its name, and the indices of the realisation and of the instant."""

    name: str
    point: int
    instant: int


def first_broken(outputs: Mapping[str, Float[np.ndarray, "points instants ..."]]) -> Broken | None:
    """The earliest value of some realisations that is not finite; None if all are."""
    found = []
    for name, values in outputs.items():
        bad = np.asarray(~np.isfinite(values.reshape(*values.shape[:2], -1)).all(axis=2))
        if bad.any():
            instant = int(np.argmax(bad.any(axis=0)))
            found.append(Broken(name, int(np.argmax(bad[:, instant])), instant))
    return min(found, key=lambda one: one.instant, default=None)


def unsolved(problem: AbstractProblem, germ: Float[Array, " variables"], decisions: Float[Array, " n"]) -> str:
    """Why one realisation has no solution, as far as its equations or its integrator can tell; empty if it has."""
    return realise(problem.simulation, germ, decisions).explain()


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


@final
class _Numbers(AbstractScope):
    """The model's own numbers, and no statistics."""

    def __init__(self, problem: AbstractProblem, decisions: Any):
        self._numbers = named_numbers(problem.simulation, jnp.asarray(decisions))

    def statistic(self, functionals: tuple[Any, ...], kind: AbstractStatistic) -> Array:
        received = Statistic(functionals, kind).text()
        raise ProblemError(f"Only numbers of the model itself are known here; received {received}.")

    def realised(self, functional: Any) -> Array:
        raise ProblemError(f"Only numbers of the model itself are known here; received {functional.text()}.")

    def time_integral(self, expression: Expression) -> Array:
        raise ProblemError(
            f"Only numbers of the model itself are known here; received the time integral of {expression}."
        )

    def value(self, name: str) -> Array:
        return self._numbers[name]


def value_at(expression: Expression, problem: AbstractProblem, decisions: Any) -> float:
    """The value at given decisions of an expression of the model's own numbers alone, such as a cost."""
    return float(expression.evaluate(_Numbers(problem, decisions)))
